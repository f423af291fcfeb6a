"""Matches of effects with a residual: the BIC that an effect's own change of the model output gains.

Each effect is switched on at the values where a search of it would begin. The change of the output, with the effect's
linear columns, is fitted to the residual by least squares beside all base parameters, which are taken as linear. It is
fitted to the innovations, and to the residual itself, whose samples count as the independent ones that they are worth:
a noise model would hide a sine. This is a score test at a few points: it ranks, and only a refit names. Wrong where the
effect has moved S and J into another basin. Source: CRITICISM.md section 2.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.noise.completion import Refit, quick
from ..model.model import Model
from ..model.segments import bound
from ..numerics.autoregression import filtered
from ..selection.node import additions
from ..typing import BoolArray, FloatArray
from ..verdict.detectable import directions_of, outputs
from .model_run import Ground

# A column that keeps less than this share of its size beside the base parameters is theirs.
_THEIRS = 1e-6


@dataclass(frozen=True, slots=True)
class Match:
    """An effect's gain in BIC, and the share (0 to 1) of the square of innovations or residual that it explains."""

    effect: str
    gain: float
    share: float
    of_innovations: bool


@dataclass(frozen=True, slots=True)
class _Filtered:
    """A model behind one filter: residual (n,), directions (n, q) of its parameters, samples to use and their worth."""

    refit: Refit
    rows: float
    model: Model
    good: BoolArray
    directions: FloatArray
    residual: FloatArray

    def left_by(self, columns: FloatArray) -> float:
        """The share of the residual's square that columns (n, k) leave beside the base parameters."""
        masked = columns * self.good[:, None]
        size = np.linalg.norm(masked, axis=0)
        rest = masked - self.directions @ (self.directions.T @ masked)
        rest = rest[:, np.linalg.norm(rest, axis=0) > _THEIRS * np.maximum(size, 1e-300)]
        q, _ = np.linalg.qr(rest / np.linalg.norm(rest, axis=0))
        return 1.0 - float(np.sum((q.T @ self.residual) ** 2)) / float(self.residual @ self.residual)


def matches(ground: Ground) -> tuple[Match, ...]:
    """All effects that `diagnose` may ask for and whose change gains more than it costs, best first."""
    done = quick(ground.model, ground.model.vector(ground.evaluated.values))
    ways = [_behind(done, float(done.good.sum())), _behind(replace(done, taps=np.empty(0)), ground.effective_rows)]
    best: dict[str, Match] = {}
    for name in additions(done.model.spec, ground.loop):
        effect = parse(name)[0]
        for way in ways:
            try:
                left = min((way.left_by(columns) for columns in _changes(way, name)), default=1.0)
            except (ModelError, np.linalg.LinAlgError):
                continue
            gain = -way.rows * float(np.log(max(left, 1e-12))) - len(effect.parameters) * float(np.log(way.rows))
            if gain > max(best[effect.name].gain if effect.name in best else 0.0, 0.0):
                best[effect.name] = Match(effect.name, gain, 1.0 - left, way is ways[0])
    return tuple(sorted(best.values(), key=lambda m: (-m.gain, m.effect)))


def _behind(refit: Refit, rows: float) -> _Filtered:
    model = refit.white_model()
    counted = refit.evaluated.counted > 0
    residual, sure = filtered(refit.evaluated.residual, counted, refit.polynomial, model.loop.starts)
    good = (model.weight > 0) & sure
    span = directions_of(model, refit) * good[:, None]
    span, _ = np.linalg.qr(span)
    masked = np.where(good, residual, 0.0)
    return _Filtered(refit, rows, model, good, span, masked - span @ (span.T @ masked))


def _changes(way: _Filtered, name: str) -> Iterator[FloatArray]:
    """Columns (n, k) of the effect at each value where a search of it begins."""
    before, (effect, option) = way.model, parse(name)
    wide = bound(before.loop, replace(before.spec, effects=(*before.spec.effects, name)), s_max=before.s_max,
                 period_s=before.period_s, residual=way.refit.evaluated.left)
    rows = wide.rows_of(name)
    guesses = effect.guess(wide.context_of(option)) if effect.guess else np.zeros((1, 0))
    if guesses.shape[1] != rows.stop - rows.start:
        return
    trial = wide.vector(way.refit.evaluated.values)[:, None].repeat(len(guesses) + 1, axis=1)
    trial[rows, 1:] = guesses.T
    output, own = outputs(wide, trial, way.refit.evaluated.own)
    for j in range(1, len(guesses) + 1):
        columns = own[:, j, 1:] if effect.columns else np.empty((output.shape[0], 0))
        if effect.moves or not effect.columns:
            columns = np.column_stack([output[:, j] - output[:, 0], columns])
        if (columns != 0.0).any():
            yield columns
