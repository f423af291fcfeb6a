"""Linear process dynamics: exact response to a held valve position, at the samples, for many candidates at once.

G(s) = K e^{-L s} / ((T1 s + 1)(T2 s + 1)), or the same over s when integrating; T2 = 0 is the base process. The gain
K stays outside (it is linear), so responses are per unit of gain and start from rest at the first position.

The position is held over each of `substeps` equal parts of a sampling interval; between parts nothing is
approximated, and the dead time L may be any fraction of a part. Wrong when the position moves inside a part.
Source: exact discretisation of cascaded lags (zero-order hold), METHODS.md sections 3 and 4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .kernels import LANES, kernel
from .loop import FloatArray
from .parameters import Parameter

# Rows of the coefficient table that the kernel reads.
_A1, _B1, _C1, _A2, _B2X, _B2, _C2, _HELD, _PART, _GX, _GZ, _GI = range(12)
_COEFFICIENTS = 12
# Further rows of the working table: first position, part to report, and the states.
_START, _PICK, _X, _Z, _TOTAL, _BEFORE, _OUT = range(12, 19)
_WORK = 19
# Two time constants closer than this share are spread apart: the cascade's formula divides by their difference.
# Unit: 1; at 1e-6 the response moves by less than 1e-6 of its size.
_SPREAD = 1e-6

TIME_CONSTANT = Parameter("time_constant_s", "s", 0.0, np.inf, 0.0, "lag of the process")
DEAD_TIME = Parameter("dead_time_s", "s", 0.0, np.inf, 0.0, "time before the process answers")


@dataclass(frozen=True, slots=True)
class Dynamics:
    """Time constants and dead time of P candidates, each (P,), in seconds; `integrating` holds for all."""

    time_constant_s: FloatArray
    dead_time_s: FloatArray
    second_time_constant_s: FloatArray
    integrating: bool


@kernel
def _run(position, substeps, table, whole, fine, plain, response):
    """Fill response (samples + longest whole delay, P); rows before a lane's delay stay as they are (zero)."""
    lanes = response.shape[1]
    samples = position.shape[0] // substeps
    work = np.empty(_WORK * LANES)
    at = np.empty(LANES, np.int64)
    flat = response.reshape(response.size)
    for first in range(0, lanes, LANES):
        width = min(LANES, lanes - first)
        last = first + width
        for p in range(width):
            for r in range(_COEFFICIENTS):
                work[r * LANES + p] = table[r, first + p]
            for r in range(_COEFFICIENTS, _WORK):
                work[r * LANES + p] = 0.0
            work[_START * LANES + p] = position[0, first + p]
            work[_PICK * LANES + p] = float(substeps - 1 - fine[first + p])
            at[p] = (1 + whole[first + p]) * lanes + first + p
        for k in range(samples - 1):
            for s in range(substeps):
                row = position[k * substeps + s, first:last]
                part = float(s)
                if plain:
                    for p in range(width):
                        now = row[p] - work[_START * LANES + p]
                        x = work[_A1 * LANES + p] * work[_X * LANES + p] + (
                            work[_C1 * LANES + p] * work[_BEFORE * LANES + p] + work[_B1 * LANES + p] * now)
                        work[_X * LANES + p] = x
                        work[_BEFORE * LANES + p] = now
                        kept = work[_OUT * LANES + p]
                        work[_OUT * LANES + p] = x if work[_PICK * LANES + p] == part else kept
                else:
                    for p in range(width):
                        now = row[p] - work[_START * LANES + p]
                        before = work[_BEFORE * LANES + p]
                        x = work[_X * LANES + p]
                        z = (work[_A2 * LANES + p] * work[_Z * LANES + p] + work[_B2X * LANES + p] * x) + (
                            work[_C2 * LANES + p] * before + work[_B2 * LANES + p] * now)
                        x = work[_A1 * LANES + p] * x + (work[_C1 * LANES + p] * before + work[_B1 * LANES + p] * now)
                        total = work[_TOTAL * LANES + p] + (
                            work[_PART * LANES + p] * before + work[_HELD * LANES + p] * now)
                        work[_X * LANES + p] = x
                        work[_Z * LANES + p] = z
                        work[_TOTAL * LANES + p] = total
                        work[_BEFORE * LANES + p] = now
                        y = work[_GZ * LANES + p] * z + (
                            work[_GX * LANES + p] * x + work[_GI * LANES + p] * total)
                        kept = work[_OUT * LANES + p]
                        work[_OUT * LANES + p] = y if work[_PICK * LANES + p] == part else kept
            for p in range(width):
                i = at[p]
                # Every lane writes into its own later row, so that dead times differ without a gather.
                flat[np.uint64(i)] = work[_OUT * LANES + p]
                at[p] = i + lanes


def free_run(position: FloatArray, dynamics: Dynamics, *, step_s: float, substeps: int = 1,
             centred: bool = False) -> FloatArray:
    """Response per unit of gain (n, P) at the samples to positions (n*substeps, P), from rest at the first one.

    `step_s` is the sampling time. With `centred`, a position stands for the time around its instant (half a part
    before to half a part after) instead of the part that follows it: right for a command that moves between
    samples. Dead times below half a part are then taken as half a part.
    """
    part = step_s / substeps
    lanes = position.shape[1]
    T1 = np.maximum(np.broadcast_to(dynamics.time_constant_s, lanes), 1e-9 * part)
    T2 = np.broadcast_to(dynamics.second_time_constant_s, lanes)
    T2 = np.where(np.abs(T2 - T1) < _SPREAD * T1, T1 * (1 + _SPREAD), T2)
    delay = np.maximum(np.broadcast_to(dynamics.dead_time_s, lanes) - (0.5 * part if centred else 0.0), 0.0) / part
    steps = np.floor(delay + 1e-12)
    f = np.clip(delay - steps, 0.0, 1.0)
    h, rest = part, (1.0 - f) * part
    table = np.empty((_COEFFICIENTS, lanes))
    a1, e1 = np.exp(-h / T1), np.exp(-rest / T1)
    table[_A1], table[_B1], table[_C1] = a1, 1.0 - e1, e1 - a1
    lagged = T2 > 1e-9 * part
    T2_safe = np.where(lagged, T2, 1.0)
    a2, e2 = np.exp(-h / T2_safe), np.exp(-rest / T2_safe)
    gap = T1 - T2_safe
    cross = T1 / np.where(gap == 0.0, 1.0, gap)
    # z answers x, which answers the held position: weights of z, x, and the two positions in the part.
    table[_A2] = np.where(lagged, a2, 0.0)
    table[_B2X] = np.where(lagged, cross * (a1 - a2), a1)
    table[_B2] = np.where(lagged, (1.0 - e2) - cross * (e1 - e2), table[_B1])
    table[_C2] = np.where(lagged, (1.0 - a2) - cross * (a1 - a2) - table[_B2], table[_C1])
    table[_HELD], table[_PART] = rest, h - rest
    table[_GX] = -T1 if dynamics.integrating else 0.0
    table[_GZ] = -np.where(lagged, T2, 0.0) if dynamics.integrating else 1.0
    table[_GI] = 1.0 if dynamics.integrating else 0.0
    whole = (steps // substeps).astype(np.int64)
    fine = (steps - whole * substeps).astype(np.int64)
    samples = position.shape[0] // substeps
    response = np.zeros((samples + int(whole.max(initial=0)), lanes))
    plain = not dynamics.integrating and not lagged.any()
    _run(np.ascontiguousarray(position), substeps, table, whole, fine, plain, response)
    return response[:samples]
