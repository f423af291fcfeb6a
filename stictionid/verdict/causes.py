"""Other causes of an oscillation than stiction: a sine from elsewhere, tight tuning, setpoint moves, noise.

The cause is reported beside the verdict and is no part of it. A steady sine in y is a disturbance from elsewhere or a
loop at its stability limit. u and y alone cannot tell these two apart, because any linear loop answers a sine as if it
were its own. The distance to the stability limit comes from the identified process and the PI law estimated from r, y
and u. Wrong where several causes act at once: the first that fits is named. Source: docs/details.md, section 10;
frequency response of the loop (Shang et al., Fig. 1).
"""

from __future__ import annotations

import numpy as np

from ..effects import get
from ..fit.noise.prewhitening import Whitened
from ..fit.starts.beside_effect import LAG
from ..model.spec import INTEGRATOR
from ..process.controller_law import usual_law
from ..record.controller import Controller
from ..record.loop import Loop
from ..typing import BoolArray, FloatArray

# Share of PV's variance that one steady sine must hold, or a sine with its multiples.
_SINE, _CYCLE = 0.75, 0.6
# Share of the ultimate gain from which the tuning counts as tight.
_TIGHT = 0.7
# Share of PV's variance that the friction-free model may leave where setpoint moves count as the cause.
_FOLLOWED = 0.2
# Factor by which the spectrum is finer than the record gives; multiples of a cycle that are looked at.
_FINER, _MULTIPLES = 16, 4


def looks_like(loop: Loop, free: Whitened, *, denied: bool = True) -> str:
    """One sentence on the cause of the oscillation, from the friction-free model; empty where nothing stands out.

    A valve whose friction is not `denied` may make a cycle itself. Of several segments the longest is used: a sine
    keeps its phase within one.
    """
    e, part = free.evaluated, loop.longest
    loop, good, residual = loop.longest_segment(), e.counted[part] > 0, e.residual[part]
    y = loop.process_value[good]
    variance = float(np.var(y))
    if not variance:
        return ""
    left = float(np.var(residual[good])) / variance
    moves = loop.setpoint is not None and float(np.var(loop.setpoint[good])) > _FOLLOWED * variance
    if moves and left <= _FOLLOWED:
        return "the loop moves because its setpoint does"
    signal = np.where(good, np.nan_to_num(loop.process_value), 0.0)
    period, sine, cycle = steady_sine(signal, good)
    if sine >= _SINE:
        return (f"y is one steady sine of period {period * loop.step_s:.4g} s ({100 * sine:.0f} % of its variance): a "
                "disturbance from elsewhere, or tuning at the stability limit, which a record in manual would tell")
    if cycle >= _CYCLE:
        who = ("a neighbour that cycles, perhaps by a sticky valve of its own" if denied else
               "this valve or a neighbour's, which a record in manual would tell")
        return f"y repeats every {period * loop.step_s:.4g} s ({100 * cycle:.0f} % of its variance): {who}"
    share = _of_ultimate_gain(free, usual_law(loop, held=True))
    if share is not None and share >= _TIGHT:
        return (f"the record looks like tight tuning: the controller gain is {100 * share:.0f} % of the gain at which "
                "this loop oscillates by itself")
    return "what moves y is no steady oscillation: a disturbance that wanders, or noise"


def steady_sine(signal: FloatArray, good: BoolArray) -> tuple[float, float, float]:
    """Period in samples of the strongest steady sine, its share of the variance, and the share with its multiples.

    Only good samples count. A wave whose phase wanders holds a small share, however narrow its band.
    """
    x = np.where(good, signal - signal[good].mean(), 0.0)
    n = x.size
    power = np.abs(np.fft.rfft(x * np.hanning(n), _FINER * n)) ** 2
    power[:2 * _FINER] = 0.0
    k = int(power.argmax())
    if not k:
        return np.inf, 0.0, 0.0
    angle = 2.0 * np.pi * k / (_FINER * n) * np.flatnonzero(good)[:, None] * np.arange(1, _MULTIPLES + 1)
    target = x[good]
    shares = []
    for part in (angle[:, :1], angle):
        columns = np.concatenate([np.sin(part), np.cos(part), np.ones((target.size, 1))], axis=1)
        rest = target - columns @ np.linalg.lstsq(columns, target, rcond=None)[0]
        shares.append(1.0 - float(rest @ rest) / float(target @ target))
    return _FINER * n / k, shares[0], shares[1]


def _of_ultimate_gain(free: Whitened, law: Controller | None) -> float | None:
    """The controller's gain as a share of the ultimate gain of the loop; None where that is unknown."""
    e, v = free.evaluated, free.evaluated.values
    if law is None or law.integral_time_s is None or law.gain * e.gain <= 0.0:
        return None
    lags = [v["time_constant_s"], v.get(f"{LAG}:{get(LAG).parameters[0].name}", 0.0)]
    w = np.geomspace(1e-3, 1e3, 4000) / max(sum(lags) + v["dead_time_s"], 1e-9)
    s = 1j * w
    response = np.exp(-s * v["dead_time_s"]) * (1.0 + 1.0 / (s * law.integral_time_s)) * abs(e.gain)
    for lag in lags:
        response = response / (1.0 + s * lag)
    if free.model.spec.process == INTEGRATOR:
        response = response / s
    phase = np.unwrap(np.angle(response))
    if not (phase < -np.pi).any():
        return None
    return abs(law.gain) * float(abs(response[int(np.argmax(phase < -np.pi))]))
