"""What a stiction law must bring, and the friction numbers that the valve effects may change.

A law is one file in this folder with a constant `LAW`. Searched laws bring a kernel over candidates:

    run(command (n,), friction (ROWS, P), profile (n,), state (states, P), position (n, P))

which advances `state` in place, so that running a record piece by piece gives what running it whole gives; the
closed-loop simulator calls the same kernel one sample at a time. `command` is in % of span, `position` in % of
travel. The friction rows carry every effect of kind F, so each law gets every such effect and no kernel calls
another file's. Rows at their neutral value (see `neutral_friction`) leave the plain law.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import ModelError
from ..loop import FloatArray
from ..parameters import Parameter

# Rows of the friction table. Forces are in % of travel: f_s breaks away, f_d slides (paper Eq. 1).
FS_UP, FS_DOWN, FD_UP, FD_DOWN = 0, 1, 2, 3  # per direction of travel, %
FS_DRIFT, FD_DRIFT = 4, 5  # change per unit of the profile, %
RESTICK = 6  # a sliding valve sticks when the command moves less than this, % per valve step
OVERSHOOT = 7  # He & Wang's K at the slip, 1 = none
LOWER, UPPER = 8, 9  # hard stops, %
ROWS = 10

# Break-away needs |e| to exceed f_s by this much, so that quantised commands which tie with f_s hold. Unit: %.
TIE = 1e-9


@dataclass(frozen=True, slots=True)
class Law:
    """One stiction law: its kernel, its parameters beyond S and J, and what must be known about it.

    `start(command0, friction, share)` gives the state (states, P) for a valve at rest whose residual force is
    `share` (P,) of f_s. `one_parameter` laws tie J to S. `searchable` is False for physical laws, which only
    simulate. `checked` says whether the printed source was seen or the law was reconstructed.
    """

    name: str
    summary: str
    equation: str
    source: str
    checked: str
    cannot: str
    run: Callable[..., None]
    start: Callable[[float, FloatArray, FloatArray], FloatArray]
    states: int
    searchable: bool = True
    one_parameter: bool = False
    sliding_state: int | None = 1
    parameters: tuple[Parameter, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    def positions(self, command: FloatArray, friction: FloatArray, *, profile: FloatArray | None = None,
                  share: FloatArray | float = 0.0) -> FloatArray:
        """Valve positions (n, P) under `command` (n,) for a friction table (ROWS, P), from rest at `share` of f_s."""
        command = np.ascontiguousarray(command, dtype=np.float64)
        friction = np.ascontiguousarray(friction, dtype=np.float64)
        lanes = friction.shape[1]
        profile = np.zeros(command.size) if profile is None else np.ascontiguousarray(profile)
        state = self.start(float(command[0]), friction, np.broadcast_to(np.asarray(share, float), lanes))
        position = np.empty((command.size, lanes))
        self.run(command, friction, profile, state, position)
        return position


def neutral_friction(stickband: FloatArray | float, slip_jump: FloatArray | float) -> FloatArray:
    """Friction table (ROWS, P) of the plain law for stickband plus deadband S and slip jump J, both in % (Eq. 1).

    Raises ModelError for S < 0, J < 0 or J > 2S: f_s = (S+J)/2 and f_d = (S-J)/2 would leave their validity.
    """
    S = np.atleast_1d(np.asarray(stickband, dtype=np.float64))
    J = np.atleast_1d(np.asarray(slip_jump, dtype=np.float64))
    check_stiction(S, J)
    S, J = np.broadcast_arrays(S, J)
    table = np.zeros((ROWS, S.size))
    table[FS_UP] = table[FS_DOWN] = 0.5 * (S + J)
    table[FD_UP] = table[FD_DOWN] = 0.5 * (S - J)
    table[OVERSHOOT] = 1.0
    table[LOWER], table[UPPER] = -np.inf, np.inf
    return table


def check_stiction(stickband: FloatArray | float, slip_jump: FloatArray | float) -> None:
    """Refuse S < 0, J < 0 and J > 2S (f_d would be below -S/2), with the value and the limit."""
    S, J = np.broadcast_arrays(np.atleast_1d(stickband), np.atleast_1d(slip_jump))
    if not np.isfinite(S).all() or (S < 0).any():
        raise ModelError(f"stickband plus deadband S = {S[~(S >= 0)][0]:g} % must not be negative", "give S >= 0")
    if not np.isfinite(J).all() or (J < 0).any():
        raise ModelError(f"slip jump J = {J[~(J >= 0)][0]:g} % must not be negative", "give J >= 0")
    if (J > 2 * S * (1 + 1e-12)).any():
        bad = int(np.flatnonzero(J > 2 * S * (1 + 1e-12))[0])
        raise ModelError(f"slip jump J = {J[bad]:g} % is more than 2 S = {2 * S[bad]:g} %",
                         f"give J <= {2 * S[bad]:g}")
