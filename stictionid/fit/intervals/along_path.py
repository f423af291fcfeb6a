"""The last fit of a model along the slips that PV placed: errors, held-out error and intervals, without a search.

Along a path the cost is smooth, and S shows only in the break-away forces of the strokes. So the intervals are those of
a normal distribution, whose covariance comes from the slopes of errors and forces. No points are sought that a
likelihood ratio does not exclude. Wrong where another path, far from this one, explains PV as well.
"""

from __future__ import annotations

import numpy as np

from ...model.model import Model
from ...model.spec import Evaluated
from ...paths.likelihood import deviance
from ...paths.settle import Settled, bounds, covariance
from ...process.controller_law import POINT_90
from ...record.study import Scatter
from ...typing import FloatArray
from ..points.fitted import Fitted
from ..points.held_out_blocks import held_out_cost
from .assemble import INTERVAL_LEVEL, INTERVAL_THRESHOLD, include_answer, margin_of
from .profile import instant_spans
from .smooth import GAIN

# Draws behind the intervals, and the fewest strokes that show how much a force scatters.
_DRAWS, _FEWEST_STROKES = 400, 5
# Errors of the command in a force, for the lower end of its scatter, the scatter and the upper end. Turns of a slide
# may bring in two more.
_ERRORS = (4.0, 2.0, 2.0)


def finish_along(model: Model, values: FloatArray, *, last: bool = True) -> Fitted:
    """A model along its paths as a fit for a step of a study, with intervals where it is the `last` one."""
    best = model.evaluate(values)
    point = model.cube(values[:, None])
    return Fitted(model, values, best.sse, 1, 1, best, held_out_cost(model, best, point),
                  _intervals(model, values, best) if last else {}, values[None, :2])


def share_moved(model: Model, values: FloatArray) -> float | None:
    """Share of the slips that PV moved or added; None where the law placed them all."""
    paths = model.spec.paths
    return None if paths is None else Settled(model, values, paths, np.nan).moved


def path_deviance(model: Model, values: FloatArray) -> float:
    """-2 log L of the path of a model beside that of its errors; 0 where the law places all slips."""
    paths = model.spec.paths
    return 0.0 if paths is None else model.log_scale + Settled(model.along(None), values, paths, np.nan).prior


def scatter_of(model: Model, values: FloatArray, unit: str) -> Scatter | None:
    """The scatter of the break-away force, less what the error of the command adds to it; None where no path shows it.

    A slip compares the command with the place where it left the stem, so that the error counts twice. The interval is
    that of a standard deviation from as many strokes. A command that errs by scan hides the scatter: it is sought in
    steps of one half only.
    """
    paths = model.spec.paths
    if paths is None or paths.by_scan or paths.count < _FEWEST_STROKES:
        return None
    wide = POINT_90 / np.sqrt(2.0 * paths.count)
    low, value, high = (float(np.sqrt(max((paths.scatter * (1.0 + sign * wide))**2 - count * paths.error**2, 0.0)))
                        for sign, count in zip((-1.0, 0.0, 1.0), _ERRORS, strict=True))
    if not high > 0.0:
        return None  # (the errors of the command alone move the slips as far)
    if paths.scatter <= bounds(model, values)[0] * (1.0 + 1e-9):
        # At its lower bound the scatter is anything smaller.
        low = 0.0
    return Scatter(value, unit, value / max(float(values[0]), 1e-12), (low, high))


def _intervals(model: Model, values: FloatArray, best: Evaluated) -> dict[str, tuple[float, float]]:
    assert model.spec.paths is not None
    along = Settled(model, values, model.spec.paths, np.nan)
    spread = covariance(along)
    point = model.cube(values[:, None])[0]
    # (its smallest eigenvalues may be negative by rounding)
    draws = np.random.default_rng(0).multivariate_normal(point, spread, _DRAWS, check_valid="ignore", method="eigh")
    draws = np.clip(np.concatenate([draws, 2.0 * point - draws]), 0.0, 1.0)
    drawn = model.values(draws)
    base, offsets = model.responses(drawn)
    known = "gain" in model.spec.fixed
    # (sizes of several segments stand once for each, and their gain is one)
    gains = np.full(len(draws), best.gain) if known else \
        model.shared.solve(base, offsets)[1].reshape(-1, len(draws))[0]
    tails = 50.0 * (1.0 - INTERVAL_LEVEL), 50.0 * (1.0 + INTERVAL_LEVEL)
    found = {name: tuple(np.percentile(row, tails).tolist()) for name, row in
             zip([*best.values, GAIN], [*drawn, gains], strict=True)}
    found |= instant_spans(model, values, lambda trial: deviance(model, trial),
                           float(deviance(model, values[:, None])[0]) + INTERVAL_THRESHOLD)
    found = include_answer(found, best)
    margin = margin_of(model, best)
    margins = {"S": margin, "J": float(np.hypot(margin, _attenuated_share(along) * values[1]))}
    return found | {name: (max(found[name][0] - margin, 0.0), found[name][1] + margin)
                    for name, margin in margins.items()}


def _attenuated_share(along: Settled) -> float:
    """Share of J that the error of the command may have added or taken.

    Only strokes of different height tell J from the gain, and a stroke goes from one wrong command to another. Errors
    of a regressor attenuate its slope by their share of its variance (Fuller 1987, section 1.1).
    """
    heights = []
    for stroke, slips in zip(along.strokes(), along.paths.slips, strict=True):
        at = slips.at[np.abs(slips.kind) == 1]
        if at.size:
            v = stroke.position[:, 0]
            heights.append(np.abs(v[np.append(at[1:], v.size) - 1] - v[np.maximum(at - 1, 0)]))
    spread = float(np.var(np.concatenate(heights))) if heights else 0.0
    return min(2.0 * along.paths.error**2 / spread, 1.0) if spread > 0.0 else 1.0
