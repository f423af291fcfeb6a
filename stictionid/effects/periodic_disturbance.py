"""Periodic disturbance: the limit cycle of another loop reaches the process value as a distorted wave.

The period is searched; sine and cosine of up to five harmonics are linear. A wave that enters at the load has the same
harmonics at the output, so that one form stands for both. No harmonic may fall on a line of the loop's own cycle: there
a valve that sticks explains as much, and nothing in u and y tells them apart. So a neighbour of the same period has no
name here. The phase does not wander: over a long record a cycle that drifts is a `narrow-band-disturbance`.

Equation: d(t) = sum over h = 1..5 of a_h sin(2 pi h t / period_s) + b_h cos(2 pi h t / period_s). Source:
docs/method.md, section 5.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.parameters import Parameter
from ..numerics.spectrum import lines_over_noise
from ..typing import BoolArray, FloatArray
from .contract import Context, Disturbance, Effect, Place, Scales, Values

_PERIOD = Parameter("period_s", "s", 1e-3, 1e7, 60.0, "period of the disturbance", log=True)
_AMPLITUDE = Parameter("amplitude", "unit of y", 0.0, 1e9, 0.0, "half of the swing at the output")
_PHASE = Parameter("phase", "rad", -7.0, 7.0, 0.0, "phase of the first harmonic at the start of the record")
_DISTORTION = Parameter("distortion", "-", 0.0, 1.0, 0.6, "rms of the harmonics from the second on, of all")
_HARMONICS = np.arange(1.0, 6.0)
# Shortest period in samples, so that a wave of the last harmonic has 2.5, and fewest periods in the record.
_SHORTEST, _FEWEST = 12.5, 4.0
# Lines of the loop's own cycle, and how close to one is on it: as a share of its frequency, and in lines of the record.
_OWN, _SHARE, _LINES = np.arange(1.0, 13.0), 0.03, 2.5
# Frequencies between two lines of the spectrum, and starting points of the search.
_FINE, _STARTS = 8, 6


def _limits(context: Context) -> tuple[Parameter, ...]:
    low = _SHORTEST * context.step_s
    high = max(context.length_s / _FEWEST, 2.0 * low)
    return (replace(_PERIOD, low=low, high=high, neutral=high),)


def _on_own(frequency: FloatArray, context: Context) -> BoolArray:
    """True for frequencies in Hz that lie on a line of the loop's own cycle."""
    if not context.cycle_s > 0.0:
        return np.zeros(frequency.shape, np.bool_)
    own = _OWN / context.cycle_s
    wide = np.maximum(_SHARE * own, _LINES / context.length_s)
    return np.asarray((np.abs(frequency[..., None] - own) < wide).any(axis=-1), np.bool_)


def _columns(theta: FloatArray, context: Context) -> tuple[FloatArray, ...]:
    first = np.exp(2j * np.pi * context.time_s[:, None] / theta[0])
    free = ~_on_own(_HARMONICS[:, None] / theta[0], context)
    out, wave = [], np.ones_like(first)
    for keep in free:
        wave = wave * first
        out += [np.ascontiguousarray(wave.imag * keep), np.ascontiguousarray(wave.real * keep)]
    return tuple(out)


def _combs(signal: FloatArray, context: Context) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Frequencies (k,) in Hz, power over noise of all harmonics of each (k,), and that of the first one alone (k,)."""
    n, limits = signal.size, _limits(context)[0]
    frequency = np.asarray(np.fft.rfftfreq(_FINE * n, context.step_s), np.float64)
    at = np.flatnonzero((frequency >= 1.0 / limits.high) & (frequency <= 1.0 / limits.low))
    if not signal.any() or not at.size:
        return np.empty(0), np.empty(0), np.empty(0)
    power = np.where(_on_own(frequency, context), 0.0, lines_over_noise(signal, _FINE))
    each = np.array([power[int(h) * at] for h in _HARMONICS])
    return frequency[at], each.sum(axis=0), each[0]


def _guess(context: Context) -> FloatArray:
    """Periods whose harmonics the residual shows best, then that in y."""
    found: list[float] = []
    for signal, count in ((context.residual, _STARTS - 1), (context.process_value, 1)):
        frequency, gain, _ = _combs(np.nan_to_num(signal), context) if signal is not None else (np.empty(0),) * 3
        for _ in range(count if frequency.size else 0):
            best = float(frequency[gain.argmax()])
            found.append(1.0 / best)
            gain = np.where(np.abs(frequency - best) * context.length_s < _LINES, 0.0, gain)
    return np.array(found or [_limits(context)[0].high])[:, None]


def _shown(context: Context) -> float:
    """Gain by the harmonics from the second on beyond the best single line, less the price of their columns."""
    residual = context.residual
    _, gain, first = _combs(np.nan_to_num(residual), context) if residual is not None else (np.empty(0),) * 3
    price = 2.0 * (_HARMONICS.size - 1) * np.log(context.process_value.size)
    return float(np.max(gain) - np.max(first) - price) if gain.size else 0.0


def _wave(sizes: FloatArray, turns: FloatArray) -> FloatArray:
    """The disturbance at angles (n,) of the first harmonic, from its sizes (10,): sine and cosine of each harmonic."""
    angle = turns[:, None] * _HARMONICS
    return np.asarray(np.sin(angle) @ sizes[::2] + np.cos(angle) @ sizes[1::2], np.float64)


def _report(searched: Values, sizes: FloatArray, base: Values) -> dict[str, float]:
    wave = _wave(sizes, np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))
    power = np.maximum(sizes[::2] ** 2 + sizes[1::2] ** 2, 0.0)
    return {"period_s": searched["period_s"], "amplitude": 0.5 * float(np.ptp(wave)),
            "phase": float(np.arctan2(sizes[1], sizes[0])),
            "distortion": float(np.sqrt(power[1:].sum() / max(power.sum(), np.finfo(float).tiny)))}


def _disturb(values: Values, time_s: FloatArray, rng: np.random.Generator) -> Disturbance:
    """A wave whose further harmonics fall with their number, as those of a sawtooth."""
    later = np.where(_HARMONICS > 1.0, 1.0 / _HARMONICS, 0.0)
    weight = values["distortion"] * later / np.linalg.norm(later)
    weight[0] = np.sqrt(1.0 - values["distortion"] ** 2)
    sizes = np.zeros(2 * _HARMONICS.size)
    sizes[::2] = weight
    whole = _wave(sizes, np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))
    turns = 2.0 * np.pi * time_s / values["period_s"] + values["phase"]
    wave = _wave(sizes, turns) * (2.0 * values["amplitude"] / float(np.ptp(whole)))
    return wave, np.zeros_like(time_s), {}


def _visible(scales: Scales) -> Values:
    return {"period_s": 6.0 * scales.lag_s, "amplitude": 0.15 * scales.swing, "distortion": 0.6}


EFFECT = Effect(
    name="periodic-disturbance", kind="L", place=Place.DISTURBANCE,
    summary="the limit cycle of another loop adds to the process value as a distorted wave",
    equation="d(t) = sum of a_h sin(2 pi h t / period_s) + b_h cos(2 pi h t / period_s), h = 1..5",
    source="docs/method.md, section 5",
    parameters=(_PERIOD, _AMPLITUDE, _PHASE, _DISTORTION), searched=("period_s",),
    contains=("sinusoidal-disturbance",), limits=_limits, columns=_columns, guess=_guess, shown=_shown, report=_report,
    disturb=_disturb, visible=_visible,
    leaves={"colour": 6, "line": 4},
    noun="another loop's cycle of {period_s}",
    sentence="A wave of {period_s} with harmonics, such as the cycle of another loop, moves PV by {amplitude} either "
             "way.",
    seen_over="phase",
    action="Look for the loop that swings every {period_s}, and read its tag with --extra.",
    of_record=("phase",),
    settled_by="the loop in manual: a cycle from elsewhere goes on",
)
