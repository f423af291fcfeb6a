"""Severity of stiction: the loop as it is against the same loop with a valve that does not stick.

The controller is a PI law estimated from r, y and u. The process is that of the estimate. The free-run residual and the
disturbances of the model stay as they are. The same loop then runs again with S = J = 0. Wrong where the controller is
not PI, or the disturbance was itself caused by the friction. Source: docs/details.md, section 13; Shang et al., Fig. 1
(the loop).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..numerics.jit import kernel
from ..process.controller_law import usual_law
from ..record.controller import Controller
from ..record.loop import Loop, bridged
from ..record.study import Estimate
from ..record.swing import BANDS_SOURCE, Severity, band, touched_bands
from ..typing import FloatArray

_DAY_S = 86400.0
# A simulated loop that swings this many times wider than the record is no valid model of it.
_RUNAWAY = 3.0
_PARTS = 6
# A process value beyond this is unstable. Unit: that of y.
_LOST = 1e12


def severity(loop: Loop, estimate: Estimate, residual: FloatArray, position: FloatArray, *,
             held: bool = True) -> Severity:
    """Severity of S and J. `residual` (n,) acts on y from outside, `position` (n,) is the valve's.

    `residual` is not a number where the model says nothing; `held` says whether the output was held between samples.
    """
    percent = estimate.unit == "%"
    hours = max(float(loop.driven.sum()) * loop.step_s, 1e-9)
    now = _travel(position[loop.driven]) / hours * _DAY_S
    word, words = (band(estimate.S), touched_bands(estimate.S, estimate.S_interval)) if percent else (None, ())
    law = usual_law(loop, held=held)
    sd = float(np.std(loop.process_value[loop.used]))
    after = None if law is None else _repair_valve(loop, estimate, law, without_gaps(loop, residual))
    if law is None or after is None:
        why = ("no setpoint" if loop.setpoint is None else
               "the controller is no PI law" if law is None else "the loop without friction can't be rebuilt")
        return Severity(word, words, sd, None, None, now, None, None, None, f"not simulated: {why}", BANDS_SOURCE)
    y, u = after
    sd_after = float(np.std(y[loop.used]))
    share = max(1.0 - (sd_after / sd) ** 2, 0.0) if sd else 0.0
    later = _travel(u[loop.driven]) / hours * _DAY_S
    digits, unit = (0 if now >= 10.0 else 2), estimate.unit
    said = (f"without friction the valve would travel {later:,.{digits}f} {unit} a day instead of "
            f"{now:,.{digits}f} {unit}")
    return Severity(word, words, sd, sd_after, share, now, later, law.gain, law.integral_time_s, said, BANDS_SOURCE)


def with_controller(found: Severity, controller: Controller | None) -> Severity:
    """The severity with the numbers of a controller's exact law, where one was found and the loop was run again."""
    if controller is None or found.controller_gain is None:
        return found
    return replace(found, controller_gain=controller.gain, integral_time_s=controller.integral_time_s)


def without_gaps(loop: Loop, residual: FloatArray) -> FloatArray:
    """A disturbance (n,) without gaps: straight between two PV values that are there, 0 elsewhere."""
    return np.where(np.isnan(loop.process_value), bridged(residual), np.nan_to_num(residual))


def _travel(position: FloatArray) -> float:
    return float(np.abs(np.diff(position)).sum())


def _repair_valve(loop: Loop, estimate: Estimate, law: Controller,
                  residual: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """y and u (n,) of the same loop with a valve that follows its command; PI law, process and residual unchanged.

    None where that loop is unstable, or swings too wide to be a model of this one.
    """
    assert loop.setpoint is not None
    y_known = bridged(loop.process_value)
    r = np.where(np.isfinite(loop.setpoint), loop.setpoint, y_known)
    y, u, fine = perfect_valve(loop, estimate, law, r, residual, float(y_known[0]), float(loop.output[0]))
    if not fine or np.std(y[loop.used]) > _RUNAWAY * np.std(loop.process_value[loop.used]):
        return None
    return y, u


def perfect_valve(loop: Loop, estimate: Estimate, law: Controller, r: FloatArray, residual: FloatArray,
             start_y: float = 0.0, start_u: float = 0.0) -> tuple[FloatArray, FloatArray, bool]:
    """y and u (n,) of the loop with a perfect valve, from a setpoint and a disturbance at the output (n,), and whether
    it is stable."""
    lags = [t for t in estimate.time_constants_s if t > 0]
    fastest = min([*lags, estimate.dead_time_s or np.inf, loop.step_s * _PARTS])
    parts = int(np.clip(np.ceil(_PARTS * loop.step_s / max(fastest, 1e-9)), 1, 20)) if loop.samples < 50_000 else 1
    h = loop.step_s / parts
    y, u = np.empty(loop.samples), np.empty(loop.samples)
    fine = _closed(r, residual, parts, h, np.exp(-h / np.array(lags)), round(estimate.dead_time_s / h),
                   estimate.gain, estimate.integrating, law.gain, law.gain / (law.integral_time_s or np.inf) * h,
                   start_u, start_y, y, u)
    return y, u, bool(fine)


@kernel
def _closed(r: FloatArray, residual: FloatArray, parts: int, h: float, decays: FloatArray, delay: int, gain: float,
            integrating: bool, proportional: float, integral: float, start_u: float, start_y: float, y: FloatArray,
            u: FloatArray) -> bool:
    """Fill y and u (n,) of the closed loop, a command, `delay` parts, lags, an integrator; False where it is unstable.
    """
    states = np.zeros(decays.size)
    queue = np.zeros(delay + 1)
    level, total, at = 0.0, 0.0, 0
    for k in range(r.size):
        now, command = 0.0, 0.0
        for _ in range(parts):
            if integrating:
                out = level
            elif decays.size:
                out = states[-1]
            else:
                out = queue[at % (delay + 1)]
            now = start_y + gain * out + residual[k]
            e = r[k] - now
            total += integral * e
            command = start_u + proportional * e + total
            queue[at % (delay + 1)] = command - start_u
            at += 1
            x = queue[at % (delay + 1)]
            for i in range(decays.size):
                states[i] = x + (states[i] - x) * decays[i]
                x = states[i]
            if integrating:
                level += h * x
        y[k], u[k] = now, command
        if not np.isfinite(now) or abs(now) > _LOST:
            return False
    return True
