"""Numbers for an effect that plainly shows in a simulated loop, for users who name an effect and give no numbers.

Sizes go by the same loop without the effect: its swing, its travel, its lags, and the valve's S and J. An effect
that does not say its size takes the middle of each parameter's range.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..effects import get
from ..effects.contract import Scales
from ..numerics.parameters import Parameter
from .closed_loop import Setting, simulate

# Significant digits of a default: enough to be visible, few enough to be read.
_DIGITS = 3
# Noise effects in a loop without noise take this share of its swing. Unit: 1.
_NOISE_SHARE = 0.01


def visible_values(name: str, setting: Setting, *, seed: int = 0) -> dict[str, float]:
    """Values of an effect that show in the loop of `setting`; UsageError for an unknown effect."""
    effect = get(name)
    scales = _scales(setting, seed)
    sizes = effect.visible(scales) if effect.visible else {p.name: _middle(p) for p in effect.parameters}
    limits = {p.name: p for p in effect.parameters}
    return {key: min(max(float(f"{value:.{_DIGITS}g}"), limits[key].low), limits[key].high)
            for key, value in sizes.items()}


def _scales(setting: Setting, seed: int) -> Scales:
    clean = simulate(replace(setting, effects=()), seed=seed).loop
    late = clean.process_value[clean.samples // 4:]
    swing = float(np.ptp(late)) or 1.0
    position = clean.position if clean.position is not None else clean.output
    speeds = np.abs(np.diff(clean.output)) / setting.step_s
    moving = speeds[speeds > 0.0]
    plant = setting.plant
    lag = max(plant.time_constant_s, plant.second_time_constant_s, plant.dead_time_s, 2.0 * setting.step_s)
    return Scales(setting.S or 1.0, setting.J or setting.S or 1.0, lag, setting.duration_s, swing,
                  float(position.min()), float(position.max()), float(np.median(moving)) if moving.size else 1.0,
                  setting.noise_sd or _NOISE_SHARE * swing, float(late.max()))


def _middle(p: Parameter) -> float:
    """Middle of a range, of its logarithms where it is searched so."""
    return float(np.sqrt(p.low * p.high)) if p.log and p.low > 0.0 else 0.5 * (p.low + p.high)
