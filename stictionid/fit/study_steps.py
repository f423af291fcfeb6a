"""A study's last model opened for refits, and a study with new steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ..errors import DataError
from ..model.restore import described_segments, rebuild_model
from ..options import Options
from ..process.rounded import is_coarse
from ..record.intervals import Span, hull, intervals_withheld, united, without_intervals
from ..record.loop import Loop
from ..record.oscillation import find_range
from ..record.study import Estimate, Step, Study
from .adequacy import judge_adequacy, with_one_noise
from .context import Run, process_numbers
from .intervals.along_path import scatter_of
from .noise.completion import Refit
from .points.fitted import Fitted, as_it_stands

# Width of the interval of J, as a share of it, from which J is unknown. Unit: 1.
_OPEN = 0.5


def open_last_model(loop: Loop, study: Study, seed: int) -> tuple[Run, Fitted]:
    """The study's last model on its record, ready for refits; DataError for an abstained study."""
    if not study.steps or not study.steps[-1].model:
        raise DataError("the study abstained, so there is no model to work on", study.verdict.reason)
    piece, _ = described_segments(loop, study.steps[-1].model)
    model, values = rebuild_model(piece, study.steps[-1].model)
    options = Options(law=model.spec.law, seed=seed, intervals=study.with_intervals)
    run = Run(piece, find_range(piece), options, law=model.spec.law, rng=np.random.default_rng(seed),
              tell=lambda text, share: None)
    return run, as_it_stands(model, values)


def with_steps(study: Study, steps: tuple[Step, ...], after: Fitted) -> Study:
    """The study with new steps and one noise for all; main values and adequacy are those of the last step's fit."""
    if intervals_withheld(study.steps) or not study.with_intervals:
        steps = without_intervals(steps)
    steps = with_one_noise(steps, after.model.loop)
    holds, why = judge_adequacy(steps[-1], after.model.loop)
    # The best model that holds these effects is now the last step.
    rows = tuple(replace(c, rmse=steps[-1].error.rmse) if c.effect in steps[-1].effects else c
                 for c in study.candidates)
    return replace(study, steps=steps, estimate=estimate(study, after), adequate=holds, adequate_reason=why,
                   missing=(), candidates=rows)


def with_noise_of(study: Study, done: Refit) -> Study:
    """The study with its noise also bounded by the innovations of a completed model, and its adequacy judged anew."""
    steps = with_one_noise(study.steps, done.model.loop, done.innovation_sd)
    if steps == study.steps:
        return study
    holds, why = judge_adequacy(steps[-1], done.model.loop)
    return replace(study, steps=steps, adequate=holds, adequate_reason=why)


def estimate(study: Study, fit: Fitted) -> Estimate | None:
    """The study's main values after a refit."""
    if study.estimate is None:
        return None
    v = fit.best.values
    if intervals_withheld(study.steps) or not study.with_intervals:
        fit = replace(fit, intervals={}, pieces={})
    spans = fit.intervals
    found = replace(study.estimate, S=v["S"], J=v["J"], S_interval=spans.get("S"), J_interval=spans.get("J"),
                    S_pieces=fit.pieces.get("S"), J_pieces=fit.pieces.get("J"),
                    initial_residual_force=v["initial_residual_force"],
                    scatter=scatter_of(fit.model, fit.values, study.estimate.unit), **process_numbers(fit))
    return with_known_jump(found, fit.model.loop, study.steps)


def with_known_jump(found: Estimate, loop: Loop, steps: Iterable[Step]) -> Estimate:
    """The estimate with J marked as unknown where its interval is wider than half of J, or withheld.

    It is withheld for rounding, and by a finding of a step: the valve stops and starts between the samples there.
    """
    if (span := found.J_interval) is None:
        open_ = is_coarse(loop, found.S) or intervals_withheld(steps)
    else:
        open_ = span[1] - span[0] > _OPEN * found.J
    return replace(found, J_known=not open_)


def with_stated_interval(fit: Fitted, found: Estimate) -> Fitted:
    """The fit with the interval of S that a study states, so that no verdict on S contradicts it."""
    return fit if found.S_interval is None else replace(fit, intervals={**fit.intervals, "S": found.S_interval})


def widen_to_equivalents(found: Estimate, reach: Mapping[str, tuple[Span, ...]]) -> Estimate:
    """The estimate with intervals of S and J widened to the pieces `reach` of the equivalents."""
    if not reach or found.S_interval is None or found.J_interval is None:
        return found
    S = united([*(found.S_pieces or (found.S_interval,)), *reach["S"]])
    J = united([*(found.J_pieces or (found.J_interval,)), *reach["J"]])
    return replace(found, S_interval=hull(S), J_interval=hull(J), S_pieces=S if len(S) > 1 else None,
                   J_pieces=J if len(J) > 1 else None)
