"""The smallest size of each effect that this record would have shown, so that "not named" means something.

An effect of a given size changes the prewhitened model output. The part that the base parameters could undo is taken
out by a linear projection, and what is left is compared with the innovations. The effect would have been named where
the expected gain reaches both the information criterion and the one-step drop that are asked for. Noise effects by the
expected likelihood ratio of their spectrum (Whittle). A local expectation, not a guarantee. Source: docs/details.md,
section 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import parse
from ..effects.contract import Effect
from ..errors import ModelError
from ..fit.noise.completion import Refit
from ..fit.noise.load import LOAD, load_power
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import INTEGRATOR
from ..numerics.narrow_band import shape
from ..typing import FloatArray

# End of a size whose parameter has no unit: the contract of effects writes "-" for it.
_NO_UNIT = " -"
# Gain in BIC and drop of the one-step error that a named effect needs, as in the policy of the search.
_BIC, _DROP = 20.0, 0.005
# Sizes tried on either side of the neutral value, as shares of the range.
_LADDER = np.geomspace(2e-3, 1.0, 24)
# Relative steps of the finite differences of the base parameters.
_DELTA = 0.01
# Start times or periods at which a disturbance's size is asked for; the median is stated.
_TIMES = (0.2, 0.35, 0.5, 0.65, 0.8)


def detectable_sizes(names: Sequence[str], best: Refit) -> dict[str, str]:
    """For each effect the smallest size that would have been named beside a model, as "parameter from value unit"."""
    out = {}
    for name in names:
        try:
            said = _size(name, best)
        except (ModelError, np.linalg.LinAlgError):
            said = None
        if said:
            out[name] = said
    return out


def need(rows: float, count: int) -> float:
    """Expected likelihood-ratio gain that an effect of so many numbers needs to be named."""
    return max(_BIC + count * float(np.log(rows)), -2.0 * rows * float(np.log1p(-_DROP)))


def _size(name: str, best: Refit) -> str | None:
    effect, _ = parse(name)
    if effect.noise is not None:
        return _noise_size(effect, best)
    model = best.white_model()
    spec = replace(model.spec, effects=(*model.spec.effects, name))
    wide = rebind_model(model, spec, best.evaluated.left)
    values = wide.vector(best.evaluated.values)
    directions = directions_of(model, best)
    good = model.weight > 0
    variance = best.innovation_sd**2
    goal = need(float(good.sum()), len(effect.parameters)) * variance
    if effect.columns and not effect.moves:
        return _linear_size(effect, name, wide, values, directions, good, goal)
    return _searched_size(effect, name, wide, values, directions, good, goal, best)


def directions_of(model: Model, best: Refit) -> FloatArray:
    """Orthonormal directions (n, q) in which the base parameters and linear columns move the prewhitened output."""
    values = best.evaluated.values
    vector = model.vector(values)
    trial = vector[:, None].repeat(2 * model.head + 1, axis=1)
    for i in range(model.head):
        step = _DELTA * max(abs(vector[i]), 1e-3 if i in model.forces else 0.02 * model.step_s if i > 2 else 0.1)
        trial[i, 1 + 2 * i] += step
        trial[i, 2 + 2 * i] -= step
    output, own = outputs(model, trial, best.evaluated.own)
    moved = np.stack([output[:, 1 + 2 * i] - output[:, 2 + 2 * i] for i in range(model.head)], axis=1)
    columns = np.concatenate([moved, own[:, 0, :], model.shared.basis], axis=1)
    columns = columns * (model.weight > 0)[:, None]
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 1e-12] / norms[norms > 1e-12]
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return u[:, s > 1e-8 * s[0]]


def outputs(model: Model, values: FloatArray, sizes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Prewhitened outputs (n, P) with the linear sizes held, and all own columns (n, P, k)."""
    own = np.ascontiguousarray(np.moveaxis(model.own_columns(*model.responses(values)), 0, 2))
    k = min(len(sizes), own.shape[2])
    return own[:, :, :k] @ sizes[:k], own


def _energy_left(change: FloatArray, directions: FloatArray, good: np.ndarray) -> FloatArray:
    """Energies (P,) of changes (n, P) beyond what the base could undo."""
    masked = change * good[:, None]
    rest = masked - directions @ (directions.T @ masked)
    return np.sum(rest**2, axis=0)


def _linear_size(effect: Effect, name: str, wide: Model, values: FloatArray, directions: FloatArray, good: np.ndarray,
                 goal: float) -> str | None:
    rows = wide.rows_of(name)
    ranges = effect.parameters_for(wide.context)
    trial = values[:, None].repeat(len(_TIMES), axis=1)
    for i, p in enumerate(ranges):
        share = np.array(_TIMES)
        trial[rows.start + i] = np.exp(np.log(p.low) + share * np.log(p.high / p.low)) if p.log \
            else p.low + share * (p.high - p.low)
    if effect.tried_at is not None:
        trial[rows.start] = effect.tried_at(wide.context)
    base, offsets = wide.responses(trial)
    n = wide.loop.samples
    before = dict(wide.sizes_at(trial[:, 0]))[name].start
    energy = _energy_left(base[offsets[before]:offsets[before] + n], directions, good)
    unit = float(np.median(np.sqrt(goal / np.maximum(energy, 1e-300))))
    if not np.isfinite(unit) or unit > 1e6:
        return None
    reported = effect.public_values({p.name: float(trial[rows.start + i, 2]) for i, p in enumerate(ranges)},
                                    np.array([unit, 0.0]), {"length_s": wide.context.length_s})
    for p in effect.parameters:
        if p.name in reported and p.name not in (effect.searched or ()):
            return f"{p.name} from {abs(reported[p.name]):.2g} {p.unit}".removesuffix(_NO_UNIT)
    return None


def _searched_size(effect: Effect, name: str, wide: Model, values: FloatArray, directions: FloatArray,
                   good: np.ndarray, goal: float, best: Refit) -> str | None:
    """The size from which on the effect would have been seen, in the direction that shows less."""
    rows = wide.rows_of(name)
    if effect.at_once:
        values = np.append(values[:rows.stop - 1], [0.5 * wide.context.length_s, *values[rows.stop:]])
    said: list[str] = []
    for i, p in enumerate(effect.parameters_for(wide.context)):
        sides: list[tuple[float, float]] = []
        for end in (p.low, p.high):
            if abs(end - p.neutral) < 1e-12:
                continue
            sizes = np.exp(np.log(p.neutral) + _LADDER * np.log(end / p.neutral)) if p.log \
                else p.neutral + _LADDER * (end - p.neutral)
            trial = values[:, None].repeat(sizes.size + 1, axis=1)
            trial[rows.start + i, 1:] = sizes
            output, _ = outputs(wide, trial, best.evaluated.own)
            energy = _energy_left(output[:, 1:] - output[:, :1], directions, good)
            # From here on every larger size would have been seen, too.
            hidden = np.flatnonzero(~(energy >= goal))
            k = int(hidden[-1]) + 1 if hidden.size else 0
            if k < sizes.size:
                sides.append((float(_LADDER[k]), float(sizes[k])))
        if sides:
            # The direction that shows less decides.
            size = max(sides)[1]
            word = "down to" if size < p.neutral and len(sides) == 1 else "from"
            shown = abs(size) if len(sides) == 2 and p.neutral == 0.0 else size
            said.append(f"{effect.known_as.get(p.name, p.name)} {word} {shown:.3g} {p.unit}".removesuffix(_NO_UNIT))
    return "; ".join(said[:2]) if effect.two_sided else said[0] if said else None


def _noise_size(effect: Effect, best: Refit) -> str | None:
    """Smallest noise effect by the expected likelihood ratio of its spectrum against white noise."""
    rows = float(best.good.sum())
    if effect.noise == "random-walk":
        ratio = np.geomspace(1e-5, 10.0, 400)
        gain = rows * np.log((1.0 + ratio**2 * rows / 6.0) / (1.0 + ratio + 0.5 * ratio**2))
        return _first_size(gain, rows, 1, ratio * best.innovation_sd, "innovation_sd", "unit of y")
    if effect.noise == "resonant":
        w = np.pi * (np.arange(4096) + 0.5) / 4096
        step = best.model.step_s
        period = np.clip(0.6 * best.model.period_s, 5.0 * step, None)
        strength = np.geomspace(1e-3, 30.0, 200)
        f = shape(w, np.full(strength.size, 2.0 * np.pi * step / period), np.full(strength.size, 5.0), strength)
        gain = rows * (np.log(f.mean(axis=0)) - np.log(f).mean(axis=0))
        return _first_size(gain, rows, 3, best.innovation_sd * np.sqrt(2.0 * strength), "amplitude", "unit of y")
    if effect.noise == LOAD:
        if best.model.spec.process == INTEGRATOR:
            return None
        power = load_power(best.model, best.values)
        strength = np.geomspace(1e-3, 30.0, 200)
        f = 1.0 + power[:, None] / power.mean() * strength
        gain = rows * (np.log(f.mean(axis=0)) - np.log(f).mean(axis=0))
        sizes = best.innovation_sd * np.sqrt(strength / power.mean()) / max(abs(best.evaluated.gain), 1e-12)
        return _first_size(gain, rows, 1, sizes, "innovation_sd", "%")
    root = np.linspace(0.01, 0.98, 400)
    return _first_size(-rows * np.log1p(-root**2), rows, 1, root, "root", "-")


def _first_size(gain: FloatArray, rows: float, count: int, sizes: FloatArray, name: str, unit: str) -> str | None:
    seen = np.flatnonzero(gain >= need(rows, count))
    return f"{name} from {sizes[seen[0]]:.2g} {unit}" if seen.size else None
