"""The verb `screen`: a quick look at one loop with its range and a verdict from a coarse search.

The swarms of `identify` find basins of S and J, a grid finds their process, a short polish the best. The verdict is
that of `identify` on this model. There is no estimate, no interval and no restart: the result says which loops deserve
`identify`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import laws
from ..errors import CannotTell
from ..fit.context import Run
from ..fit.noise.prewhitening import whiten_model
from ..fit.points.moves import descend_model
from ..fit.starts.basins import basins, with_process
from ..methods.option_check import check_options
from ..model.spec import Spec
from ..numerics.population import refine
from ..options import Options
from ..record.loop import Loop
from ..record.oscillation import find_range
from ..record.preconditions import check
from ..record.segments import chosen
from ..record.study import Study, Verdict
from ..verdict.judge import cap_verdict, compare_with_free
from .identify import abstained, data_record, made_by
from .long_records import excerpt, looked_at

# Highest confidence of a quick verdict.
_SUREST = 0.6
# The polish of the basins: first standard deviation as a share of the range, rounds, and how many are finished.
_SPREAD, _ROUNDS, _POLISHED = 0.03, 25, 2


def screen(loop: Loop, *, options: Options | None = None) -> Study:
    """Range and quick verdict of one loop as a study without an estimate; S and J of the search are its evidence."""
    options = options or Options()
    check_options(options)
    piece, notes = chosen(loop)
    found = find_range(piece)
    try:
        check(piece, found)
        view = excerpt(piece, found, options)
        if view is not None:
            piece, notes = view.loop, (*notes, looked_at(view))
        run = Run(piece, found, options, law=options.law or laws.DEFAULT, rng=np.random.default_rng(options.seed),
                  tell=lambda text, share: None)
        verdict = cap_verdict(_verdict(run), loop)
    except CannotTell as reason:
        return abstained(loop, found, options, reason)
    return Study(made_by(options), data_record(loop, piece, notes), found, verdict, None, command=options.command)


def _verdict(run: Run) -> Verdict:
    model = run.model(Spec(law=run.law))
    starts = with_process(model, basins(model, run.rng))
    polished = refine(model.costs, starts, run.rng, spread=_SPREAD, rounds=_ROUNDS)
    if not np.isfinite(polished.costs[0]):
        raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                         code="valve-never-moves")
    found = descend_model(model, polished.points[:_POLISHED])
    values = model.values(found.points[:1])[:, 0]
    quick = compare_with_free(run, whiten_model(model, values))
    return replace(quick, reason=f"quick look: {quick.reason}", confidence=min(quick.confidence, _SUREST),
                   evidence=replace(quick.evidence, S=float(values[0]), J=float(values[1])))
