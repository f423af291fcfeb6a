"""Gain, time constant and dead time from an open-loop step test, as the paper takes them from its Fig. 7.

The record's command (or its measured valve position, where there is one) runs through K e^{-L s} / (T s + 1). T and L
are searched; K and the level follow by least squares. The whole record counts, so a test with several steps is used
as it is. The result can serve `identify` as its fixed plant.

Wrong where the valve sticks in the test itself: after a reversal up to S of the step never reaches the stem, and K
is low by that share. A measured position avoids it. Wrong for a process that integrates or is far from first order:
the first is refused, the second shows in `rmse`.

Source: Shang et al., Fig. 7 and Eq. 21 (the tank); exact discretisation in process/linear.py.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import DataError
from ..numerics.population import refine
from ..numerics.varpro import Shared
from ..record.loop import Finding, Loop
from ..record.oscillation import FLAT, noise_of
from ..typing import BoolArray, FloatArray
from .linear import Dynamics, free_run

_FEWEST_SAMPLES = 20
# Largest share of samples in which the command of a step test moves; more is a controller at work. Unit: 1.
_CLOSED_LOOP = 0.2
# The model must explain at least this share of y's variance after the step.
_EXPLAINED = 0.7
# The record must last this many time constants after the last step (and dead time): y is then within 14 % of its end.
_SETTLED_LAGS = 2.0
_GRID_LAGS, _GRID_DEADS = 40, 40
_ROUNDS = 60


@dataclass(frozen=True, slots=True)
class StepTest:
    """A process from a step record: gain in units of y per %, times in seconds, error in the unit of y."""

    gain: float
    time_constant_s: float
    dead_time_s: float
    rmse: float
    explained: float
    steps: int
    from_position: bool

    @property
    def fixed(self) -> dict[str, float]:
        """The process as the fixed plant of an identification."""
        return {"gain": self.gain, "time_constant_s": self.time_constant_s, "dead_time_s": self.dead_time_s}

    def finding(self, file: str | None = None) -> Finding:
        """Finding for the study that states the process and the share of variance explained."""
        source = "the measured valve position" if self.from_position else "the output"
        return Finding("step-test", "info",
                       f"the process is that of a step test{f' in {file}' if file else ''}: gain {self.gain:.4g}, time "
                       f"constant {self.time_constant_s:.4g} s, dead time {self.dead_time_s:.4g} s, from {source} "
                       f"({100 * self.explained:.1f} % of the variance of y explained)",
                       {**self.fixed, "rmse": self.rmse, "explained": self.explained, "steps": self.steps},
                       (), "Shang et al., Fig. 7")


def fit_step(loop: Loop) -> StepTest:
    """First order with dead time from an open-loop record; DataError, with the value, where it holds no step test."""
    piece = loop.longest_segment()
    good = piece.used & np.isfinite(piece.process_value)
    if good.sum() < _FEWEST_SAMPLES:
        raise DataError(f"the step test has {int(good.sum())} usable samples, {_FEWEST_SAMPLES} are needed",
                        "give a longer record")
    k = np.arange(piece.samples)
    y = np.interp(k, k[good], piece.process_value[good])
    seen = piece.position is not None and np.isfinite(piece.position[good]).all()
    moves = _moves(piece, good)
    u = np.interp(k, k[good], (piece.position if seen else piece.output)[good])  # type: ignore[index]
    if np.ptp(y) <= FLAT * max(float(np.abs(y).max()), 1e-30):
        raise DataError(f"the process value does not answer the step: its whole span is {np.ptp(y):.3g}",
                        "check the transmitter, or give another record")
    first, last = int(moves[0]), int(moves[-1])
    T, L, shared = _search(piece, u, y, good, rest=piece.samples - first)
    base = _response(u, np.array([T]), np.array([L]), piece.step_s)
    sse, size = shared.solve(base)
    variance = shared.target_energy
    explained = 1.0 - float(sse[0]) / variance if variance > 0 else 0.0
    if not explained >= _EXPLAINED:
        raise DataError(f"a first-order process explains {100 * max(explained, 0.0):.0f} % of the variance of y in the "
                        f"step test, {100 * _EXPLAINED:.0f} % are needed",
                        "give a larger step or a quieter record; an integrating process has no such step test")
    after = (piece.samples - last) * piece.step_s
    if after < L + _SETTLED_LAGS * T:
        raise DataError(f"the step test ends {after:.4g} s after its last step, but dead time {L:.4g} s and time "
                        f"constant {T:.4g} s need {L + _SETTLED_LAGS * T:.4g} s",
                        "give a longer record; a process that never settles integrates, and has no gain")
    rmse = float(np.sqrt(sse[0] / max(shared.rows, 1)))
    return StepTest(float(size[0, 0]), T, L, rmse, explained, int(moves.size), bool(seen))


def _moves(loop: Loop, good: BoolArray) -> NDArray[np.intp]:
    """Samples at which the command stepped; DataError where it never does or moves all the time."""
    u = loop.output[good]
    swing = float(np.ptp(u))
    if swing <= FLAT * max(float(np.abs(u).max()), 1e-30):
        raise DataError(f"the output rests at {u[0]:.6g} all through the step test: there is no step in it",
                        "give the record of an open-loop step with --step-test")
    jitter = max(4.0 * noise_of(u), 1e-3 * swing)
    jumps = np.flatnonzero(np.abs(np.diff(u)) > jitter)
    if jumps.size > _CLOSED_LOOP * u.size or not jumps.size:
        share = float(np.mean(np.diff(u) != 0.0))
        raise DataError(f"the output moves in {100 * share:.0f} % of the samples of the step test: that is a loop in "
                        "automatic, or a ramp, not an open-loop step",
                        "put the controller in manual and step its output")
    return np.flatnonzero(good)[jumps]


def _response(u: FloatArray, T: FloatArray, L: FloatArray, step_s: float) -> FloatArray:
    return free_run(u[:, None], Dynamics(T, L, np.zeros(T.size), False), step_s=step_s)


def _search(loop: Loop, u: FloatArray, y: FloatArray, good: BoolArray, *, rest: int) -> tuple[float, float, Shared]:
    """Time constant and dead time in seconds with the smallest error; `rest` samples follow the first step."""
    step = loop.step_s
    longest = rest * step
    shared = Shared.prepare(y, np.ones((y.size, 1)), good)
    low, high = np.log(0.05 * step), np.log(3.0 * longest)

    def cost(cube: FloatArray) -> FloatArray:
        T, L = np.exp(low + (high - low) * cube[:, 0]), 0.9 * longest * cube[:, 1]
        return np.concatenate([shared.costs(_response(u, T[a:a + 32], L[a:a + 32], step))
                               for a in range(0, T.size, 32)])

    T, L = np.meshgrid(np.linspace(0.0, 1.0, _GRID_LAGS), np.linspace(0.0, 1.0, _GRID_DEADS), indexing="ij")
    grid = np.stack([T.ravel(), L.ravel()], axis=1)
    starts = grid[np.argsort(cost(grid), kind="stable")[:3]]
    best = refine(cost, starts, np.random.default_rng(0), spread=0.02, rounds=_ROUNDS, settle=1e-9).points[0]
    return float(np.exp(low + (high - low) * best[0])), float(0.9 * longest * best[1]), shared
