"""A quick look at one loop: range, and whether friction would explain it, from a coarse search.

The swarms of `identify` find basins of S and J, a grid finds their process, a short polish the best; the same grid
without friction is what it must beat. No estimate, no intervals, no restarts: it says which loops deserve `identify`.
The thresholds are those of `identify`; where the coarse search finds no valve worth comparing, it says undecided.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from . import methods as method_room
from .errors import CannotTell
from .fit import basins, process_costs, search_model, with_process
from .gates import check
from .identify import _CLEAN, _STICKS, Options, _abstained, _data, _made, _whole
from .loop import Loop
from .methods.run import Run
from .model import Spec
from .oscillation import find_range
from .results import Study, Verdict
from .search import refine

# A quick verdict is never surer than this.
_SUREST = 0.6
# The polish of the basins: first standard deviation as a share of the range, and rounds.
_SPREAD, _ROUNDS = 0.03, 25


def screen(loop: Loop, *, options: Options | None = None) -> Study:
    """Range and quick verdict of one loop as a study without an estimate; S and J of the search are its evidence."""
    options = options or Options()
    options.check()
    found = find_range(loop)
    piece, notes = _whole(loop)
    try:
        check(piece, found)
        run = Run(piece, found, options, method_room.get("auto"), rng=np.random.default_rng(options.seed),
                  tell=lambda text, share: None)
        verdict = _verdict(run)
    except CannotTell as reason:
        return _abstained(loop, found, options, reason)
    return Study(_made(options), _data(loop, piece, notes), found, verdict, None, command=options.command)


def _verdict(run: Run) -> Verdict:
    model = search_model(run.model(Spec(law=run.law)))
    starts = with_process(model, basins(model, run.rng))
    polished = refine(model.costs, starts, run.rng, spread=_SPREAD, rounds=_ROUNDS)
    values, stuck = model.values(polished.points[:1]), float(polished.costs[0])
    if not np.isfinite(stuck):
        raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                         code="valve-never-moves")
    free = run.model(replace(model.spec, friction_free=True))
    free = search_model(free)
    T, L = np.meshgrid(np.linspace(0.05, 0.95, 24), np.linspace(0.0, 0.95, 20), indexing="ij")
    cube = np.zeros((T.size, free.space.size))
    cube[:, 3], cube[:, 4] = T.ravel(), L.ravel()
    grid = free.values(cube)
    best = float(process_costs(free, grid, free.positions(free.values(cube[:1]))).min())
    used = run.used_y()
    rows = float(model.shared.rows)
    without = float(np.std(used)) if not np.isfinite(best) else float(np.sqrt(best / rows))
    with_it, variance = float(np.sqrt(stuck / rows)), float(np.var(used))
    explained = (without**2 - with_it**2) / variance if variance else 0.0
    drop = 1.0 - with_it / without if without else 0.0
    evidence = {"rmse_without_friction": without, "rmse_with_friction": with_it, "share_of_pv_variance": explained,
                "error_drop": drop, "S": float(values[0, 0]), "J": float(values[1, 0])}
    said = (f"quick look: friction lowers the free-run error from {without:.4g} to {with_it:.4g} ({100 * drop:.0f} %, "
            f"{100 * explained:.1f} % of the variance of y)")
    if explained < -_CLEAN[0] and drop < 0.0:
        return Verdict("undecided", "quick look: the coarse search found no valve that fits as well as none does; "
                       "only identify can tell", 0.1, evidence)
    if explained < _CLEAN[0] or drop < _CLEAN[1]:
        return Verdict("no stiction", said, _SUREST, evidence)
    if explained >= _STICKS[0] and drop >= _STICKS[1]:
        return Verdict("stiction", said, min(_SUREST, 0.4 + explained), evidence)
    return Verdict("undecided", said, 0.3, evidence)
