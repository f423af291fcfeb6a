"""Numbers for an effect that plainly shows in a simulated loop, for users who name an effect and give no numbers.

Sizes go by the same loop without the effect: its swing, its travel, its lags, and the valve's S and J. An effect that
is not listed takes the middle of each parameter's range.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..effects import get
from ..numerics.parameters import Parameter
from .closed_loop import Setting, simulate

# Significant digits of a default: enough to be visible, few enough to be read.
_DIGITS = 3


@dataclass(frozen=True, slots=True)
class _Loop:
    """Scales of a loop without the effect: S and J in %, lag and length in s, swing of y, travel of the valve in %.

    `speed` is the median speed of the command where it moves, in %/s; `noise` the deviation of its noise, `top` the
    highest y after its first quarter.
    """

    S: float
    J: float
    lag_s: float
    length_s: float
    swing: float
    lowest: float
    highest: float
    speed: float
    noise: float
    top: float


_Values = Mapping[str, float]
# Effects by name. Sizes are the middle of those with which the catalogue is tested to be found.
_SIZES: dict[str, Callable[[_Loop], _Values]] = {
    "asymmetric-stiction": lambda s: {"jump_up": 1.4 * s.J, "jump_down": 0.6 * s.J},
    "stiction-drift": lambda s: {"stickband_growth": 300.0 * s.S / s.length_s, "jump_growth": 100.0 * s.J / s.length_s},
    "re-sticking": lambda s: {"restick_speed": s.speed},
    "slip-overshoot": lambda s: {"overshoot": 1.5},
    "travel-limit": lambda s: {"upper": s.highest - 0.25 * (s.highest - s.lowest)},
    "slew-limit": lambda s: {"rate": s.J / (0.6 * s.lag_s)},
    "valve-characteristic": lambda s: {"log_rangeability": 3.5},
    "gain-nonlinearity": lambda s: {"curvature": 0.75 / s.swing},
    "backlash": lambda s: {"play": 0.3 * s.S},
    "direction-dependent-lag": lambda s: {"closing_ratio": 2.0},
    "gain-drift": lambda s: {"drift": -40_000.0 / s.length_s},
    "inverse-response": lambda s: {"zero_s": 0.4 * s.lag_s, "lag_s": 0.4 * s.lag_s},
    "leak": lambda s: {"leak": 200.0 / s.lag_s},
    "measurement-filter": lambda s: {"time_constant_s": 0.5 * s.lag_s},
    "measurement-limit": lambda s: {"upper": s.top - 0.2 * s.swing},
    "underdamped-process": lambda s: {"natural_period_s": 4.0 * s.lag_s, "damping": 0.35},
    "load-noise": lambda s: {"root": 0.8, "innovation_sd": 0.1 * s.J},
    "extra-lag": lambda s: {"second_time_constant_s": 0.6 * s.lag_s},
    "sinusoidal-disturbance": lambda s: {"period_s": 6.0 * s.lag_s, "amplitude": 0.1 * s.swing},
    "step-disturbance": lambda s: {"time_s": 0.5 * s.length_s, "size": 0.2 * s.swing},
    "ramp-disturbance": lambda s: {"start_s": 0.3 * s.length_s, "rate": 0.5 * s.swing / s.length_s},
    "narrow-band-disturbance": lambda s: {"period_s": 4.0 * s.lag_s, "coherence_cycles": 4.0,
                                          "amplitude": 0.08 * s.swing},
    "random-walk-disturbance": lambda s: {"innovation_sd": s.noise},
    "coloured-noise": lambda s: {"root": 0.8, "innovation_sd": s.noise},
    "measured-disturbance": lambda s: {"lag_s": 0.5 * s.lag_s, "dead_time_s": 0.2 * s.lag_s, "gain": 0.1 * s.swing},
}
# Noise effects in a loop without noise take this share of its swing. Unit: 1.
_NOISE_SHARE = 0.01


def visible(name: str, setting: Setting, *, seed: int = 0) -> dict[str, float]:
    """Values of an effect that show in the loop of `setting`; UsageError for an unknown effect."""
    effect = get(name)
    scales = _scales(setting, seed)
    sizes = _SIZES[name](scales) if name in _SIZES else {p.name: _middle(p) for p in effect.parameters}
    limits = {p.name: p for p in effect.parameters}
    return {key: min(max(float(f"{value:.{_DIGITS}g}"), limits[key].low), limits[key].high)
            for key, value in sizes.items()}


def _scales(setting: Setting, seed: int) -> _Loop:
    clean = simulate(replace(setting, effects=()), seed=seed).loop
    late = clean.process_value[clean.samples // 4:]
    swing = float(np.ptp(late)) or 1.0
    position = clean.position if clean.position is not None else clean.output
    speeds = np.abs(np.diff(clean.output)) / setting.step_s
    moving = speeds[speeds > 0.0]
    plant = setting.plant
    lag = max(plant.time_constant_s, plant.second_time_constant_s, plant.dead_time_s, 2.0 * setting.step_s)
    return _Loop(setting.S or 1.0, setting.J or setting.S or 1.0, lag, setting.duration_s, swing, float(position.min()),
                 float(position.max()), float(np.median(moving)) if moving.size else 1.0,
                 setting.noise_sd or _NOISE_SHARE * swing, float(late.max()))


def _middle(p: Parameter) -> float:
    """Middle of a range, of its logarithms where it is searched so."""
    return float(np.sqrt(p.low * p.high)) if p.log and p.low > 0.0 else 0.5 * (p.low + p.high)
