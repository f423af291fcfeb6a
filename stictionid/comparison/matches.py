"""Matches of effects with a residual: how far the free-run error would fall by an effect's own change of the output.

Each effect is switched on at the values where a search of it would begin. The change of the output, with the effect's
linear columns, is fitted to the residual by least squares beside all base parameters, which are taken as linear. The
samples count as the independent ones that they are worth. This is a score test at a few points: it ranks, and only a
refit names. Innovations are no guide here, because the noise model takes what is slow and hides a sine. Wrong where the
effect has moved S and J into another basin. Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..effects import noises_in, parse
from ..errors import ModelError
from ..fit.noise.completion import Refit, complete_quickly
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import INTEGRATOR
from ..numerics.autoregression import filter_residual
from ..numerics.noise.likelihood import Likelihood
from ..selection.node import additions
from ..typing import FloatArray
from ..verdict.detectable import directions_of, outputs
from .model_run import Ground

# A column that keeps less than this share of its size beside the base parameters is theirs.
_THEIRS = 1e-6


@dataclass(frozen=True, slots=True)
class Match:
    """An effect's gain in BIC, and the share (0 to 1) of the square of the free-run error that it explains."""

    effect: str
    gain: float
    share: float


def matches(ground: Ground) -> tuple[Match, ...]:
    """All effects that `diagnose` may ask for and whose change gains more than its numbers cost, best first."""
    quiet = _quiet(ground)
    rows, before = ground.effective_rows, quiet.model
    counted = quiet.evaluated.counted > 0
    residual, sure = filter_residual(quiet.evaluated.residual, counted, quiet.polynomial, before.loop.starts)
    good = (before.weight > 0) & sure
    base, _ = np.linalg.qr(directions_of(before, quiet) * good[:, None])
    residual = np.where(good, residual, 0.0)
    residual -= base @ (base.T @ residual)
    best: dict[str, Match] = {}
    for name in additions(before.spec, ground.loop):
        effect = parse(name)[0]
        try:
            left = min((_left(residual, base, columns * good[:, None]) for columns in _changes(quiet, name)),
                       default=1.0)
        except (ModelError, np.linalg.LinAlgError):
            continue
        gain = Likelihood(1.0, rows).deviance - Likelihood(max(left, 1e-12), rows).bic(len(effect.parameters))
        if gain > max(best[effect.name].gain if effect.name in best else 0.0, 0.0):
            best[effect.name] = Match(effect.name, gain, 1.0 - left)
    return tuple(sorted(best.values(), key=lambda m: (-m.gain, m.effect)))


def _quiet(ground: Ground) -> Refit:
    """The model as it stands, in levels without its noise; an integrator in the differences in which it was fitted."""
    model: Model = ground.model
    if model.spec.process != INTEGRATOR:
        noises = noises_in(model.spec.effects)
        spec = replace(model.spec, effects=tuple(n for n in model.spec.effects if n not in noises), taps=(),
                       increments=False)
        model = rebind_model(model, spec)
    done = replace(complete_quickly(model, model.vector(ground.evaluated.values)), taps=np.empty(0))
    return replace(done, model=done.white_model())


def _left(residual: FloatArray, base: FloatArray, columns: FloatArray) -> float:
    """The share of a residual's square that columns (n, k) leave beside the orthonormal directions of the base."""
    rest = columns - base @ (base.T @ columns)
    size = np.linalg.norm(rest, axis=0)
    keep = size > _THEIRS * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    q, _ = np.linalg.qr(rest[:, keep] / size[keep])
    return 1.0 - float(np.sum((q.T @ residual) ** 2)) / max(float(residual @ residual), 1e-300)


def _changes(quiet: Refit, name: str) -> Iterator[FloatArray]:
    """Columns (n, k) of the effect at each value where a search of it begins."""
    before, (effect, option) = quiet.model, parse(name)
    wide = rebind_model(before, replace(before.spec, effects=(*before.spec.effects, name)), quiet.evaluated.left)
    rows = wide.rows_of(name)
    guesses = effect.guess(wide.context_of(option)) if effect.guess else np.zeros((1, 0))
    if guesses.shape[1] != rows.stop - rows.start:
        return
    trial = wide.vector(quiet.evaluated.values)[:, None].repeat(len(guesses) + 1, axis=1)
    trial[rows, 1:] = guesses.T
    output, own = outputs(wide, trial, quiet.evaluated.own)
    for j in range(1, len(guesses) + 1):
        columns = own[:, j, 1:] if effect.columns else np.empty((output.shape[0], 0))
        if effect.moves or not effect.columns:
            columns = np.column_stack([output[:, j] - output[:, 0], columns])
        if (columns != 0.0).any():
            yield columns
