"""Contract of a stiction law, and the table of friction numbers that effects on the valve may change.

A law is one file in `laws/` with a constant `LAW`. Searched laws bring a kernel over candidates:

    run(command (n,), friction (ROWS, P), profile (n,), state (states, P), position (n, P))

The kernel advances `state` in place, so that running a record piece by piece gives what running it whole gives. The
closed-loop simulator calls the same kernel one sample at a time. `command` is in % of span, `position` in % of
travel. The friction rows carry every effect of kind F, so each law gets every such effect and no kernel calls
another file's. Rows at their neutral value (see `neutral_friction`) leave the plain law.

A law's own numbers stand in the same table. `Law.friction` checks S and J in the law's own words. `supply` sets rows
(He & Wang's K) or appends rows after ROWS (mass, spring and time step of a physical valve). So `run` has one signature
for all laws, and a physical law has the time between two commands.

`written.py` holds a user's file to this contract and turns it into a `Law`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from ...errors import ModelError
from ...numerics.jit import kernel, output
from ...numerics.parameters import Parameter
from ...typing import FloatArray, IntArray
from .behind_positioner import STATES, run_inner

# Rows of the friction table. Forces are in % of travel: f_s at break-away, f_d while sliding (Shang et al., Eq. 1).
FS_UP, FS_DOWN, FD_UP, FD_DOWN = 0, 1, 2, 3  # per direction of travel, %
FS_DRIFT, FD_DRIFT = 4, 5  # change per unit of the profile, %
RESTICK = 6  # a sliding valve sticks when the command moves less than this, % per valve step
OVERSHOOT = 7  # He & Wang's K at the slip, 1 = none
LOWER, UPPER = 8, 9  # hard stops, %
CROSSES = 10  # 1 where the command moves within its samples: a slip begins where it crosses f_s, not where it ends
INTEGRAL = 11  # rate of a positioner's integral part, 1 per valve step, 0 = none (see behind_positioner.py)
INNER = 12  # its integral part at the start, %
SINCE = 13  # first command at which the change with the profile counts, 0 = always
ROWS = 14

# Break-away needs |e| to exceed f_s by this much, so that quantised commands which tie with f_s hold. Unit: %.
TIE = 1e-9


def check_stiction(stickband: FloatArray | float, slip_jump: FloatArray | float) -> None:
    """Refuse S < 0, J < 0 and J > 2S (f_d would be below -S/2), with the value and the limit."""
    S, J = np.broadcast_arrays(np.atleast_1d(stickband), np.atleast_1d(slip_jump))
    check_size(S, "stickband plus deadband S")
    check_size(J, "slip jump J")
    if (J > 2 * S * (1 + 1e-12)).any():
        bad = int(np.flatnonzero(J > 2 * S * (1 + 1e-12))[0])
        raise ModelError(f"slip jump J = {J[bad]:g} % is more than 2 S = {2 * S[bad]:g} %",
                         f"give J <= {2 * S[bad]:g}")


def check_size(width: FloatArray, what: str) -> None:
    """Refuse a width in % that is negative or not a number, naming it."""
    width = np.atleast_1d(width)
    bad = ~(np.isfinite(width) & (width >= 0))
    if bad.any():
        says = "must not be negative" if width[bad][0] < 0 else "is not a finite number"
        raise ModelError(f"{what} = {width[bad][0]:g} % {says}", f"give {what.split()[-1]} >= 0")


@dataclass(frozen=True, slots=True)
class Law:
    """One stiction law: its kernel, its parameters beyond S and J, its source and its limits.

    `start(command0, friction, share)` gives the state (states, P) for a valve at rest whose residual force is
    `share` (P,) of f_s. `one_parameter` laws tie J to S. `searchable` is False for physical laws, which only
    simulate. `checked` says whether the printed source was seen or the law was reconstructed. `slips` says what a
    valve does after a slip to u - f_d: "slides" on with the command, or "rests" at once; None where a slip lands
    elsewhere, so that the law has no random break-away force (see paths/).

    `parameters` are the law's own, beyond S and J, with their `defaults`; `check` refuses S and J outside its
    validity. `dynamic` laws move while the command rests, so they are advanced every step of an integration. `file` and
    `sha256` are those of a user-written law.
    """

    name: str
    summary: str
    equation: str
    source: str
    checked: str
    cannot: str
    run: Callable[..., None]
    start: Callable[[float, FloatArray, FloatArray], FloatArray]
    searchable: bool = True
    one_parameter: bool = False
    sliding_state: int | None = 1
    dynamic: bool = False
    parameters: tuple[Parameter, ...] = ()
    defaults: Mapping[str, float] = field(default_factory=dict)
    check: Callable[[FloatArray | float, FloatArray | float], None] = check_stiction
    supply: Callable[[FloatArray, Mapping[str, float], float, bool], FloatArray] | None = None
    slips: str | None = None
    file: str = ""
    sha256: str = ""

    def friction(self, stickband: FloatArray | float, slip_jump: FloatArray | float, *,
                 values: Mapping[str, float] | None = None, step_s: float = 1.0, held: bool = True) -> FloatArray:
        """Friction table (>= ROWS, P) of this law for S and J in %, with `values` of its own parameters by name.

        `step_s` is the time between two commands; a `held` command jumps at its instant, any other goes straight
        from one sample to the next. Both matter to physical laws only; J does not matter to one-parameter laws.
        Raises ModelError for S, J or values outside the law's validity, in the law's own sentence.
        """
        self.check(stickband, slip_jump)
        chosen = dict(self.defaults)
        for name, value in (values or {}).items():
            if name not in chosen:
                known = ", ".join(chosen) or "none beyond S and J"
                raise ModelError(f"the law {self.name} has no parameter '{name}'", f"its parameters: {known}")
            chosen[name] = float(value)
        table = neutral_friction(stickband, stickband if self.one_parameter else slip_jump)
        return table if self.supply is None else self.supply(table, chosen, step_s, held)

    def searched_friction(self, S: FloatArray, J: FloatArray) -> FloatArray:
        """Friction table (ROWS, P) inside a search: valid S and J (P,), the law's own parameters at their defaults."""
        table = friction_table(S, S if self.one_parameter else J)
        return table if self.supply is None else self.supply(table, dict(self.defaults), 1.0, True)

    def positions(self, command: FloatArray, friction: FloatArray, *, profile: FloatArray | None = None,
                  share: FloatArray | float = 0.0, lent: bool = False) -> FloatArray:
        """Valve positions (n, P) under `command` (n,) for a friction table (ROWS, P), from rest at `share` of f_s.

        `lent` positions hold until the next call (see `scratch` in numerics/jit.py).
        """
        command = np.ascontiguousarray(command, dtype=np.float64)
        friction = np.ascontiguousarray(friction, dtype=np.float64)
        lanes = friction.shape[1]
        profile = np.zeros(command.size) if profile is None else np.ascontiguousarray(profile)
        shares = share if isinstance(share, np.ndarray) else np.full(lanes, float(share))
        state = self.start(float(command[0]), friction, shares)
        position = output("law", command.size, lanes, lent)
        _advance(self.run, command, friction, profile, state, position)
        inner = np.flatnonzero(friction[INTEGRAL])
        if inner.size:
            own = np.ascontiguousarray(friction[:, inner])
            moved = np.empty((command.size, inner.size))
            _advance(inner_loop, command, own, profile, inner_start(float(command[0]), own, shares[inner]), moved)
            position[:, inner] = moved
        return position


def rest_position(command0: FloatArray | float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """Position (P,) of a stem at rest under a command in % with residual force `share` (P,) of f_s, within its stops.
    """
    force = share * np.where(share > 0.0, friction[FS_UP], friction[FS_DOWN])
    return np.asarray(np.clip(command0 - force, friction[LOWER], friction[UPPER]))


def _advance(run: Callable[..., None], command: FloatArray, friction: FloatArray, profile: FloatArray,
             state: FloatArray, position: FloatArray) -> None:
    """Run a law in pieces, so that the friction of every lane changes only from its own command on (row SINCE)."""
    if not (friction[SINCE] > 0.0).any():
        run(command, friction, profile, state, position)
        return
    edges = np.unique(np.clip(friction[SINCE], 0, command.size)).astype(np.int64)
    for first, end in pairwise(sorted({0, *edges.tolist(), command.size})):
        changed = friction[SINCE] <= first
        table = friction if changed.all() else friction.copy()
        table[[FS_DRIFT, FD_DRIFT]] *= changed
        run(command[first:end], table, profile[first:end], state, position[first:end])


def lanes_by_change(friction: FloatArray, profile: FloatArray) -> Iterator[tuple[IntArray | slice, FloatArray]]:
    """Lanes whose friction changes from the same command on, with the profile (n,) that counts for them.

    Where it counts from the start for all lanes, they are one slice.
    """
    if not (friction[SINCE] > 0.0).any():
        yield slice(None), profile
        return
    for since in np.unique(friction[SINCE]):
        yield np.flatnonzero(friction[SINCE] == since), np.where(np.arange(profile.size) >= since, profile, 0.0)


def inner_start(command0: float, friction: FloatArray, share: FloatArray) -> FloatArray:
    """State (states, P) of valves behind a positioner that integrates, at rest with residual force share * f_s."""
    state = np.empty((STATES, friction.shape[1]))
    state[0] = rest_position(command0 + friction[INNER], friction, share)
    state[1], state[2] = friction[INNER], command0
    return state


def inner_loop(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
               position: FloatArray) -> None:
    """Advance valves behind a positioner that integrates, as `Law.run` does; all lanes have a rate."""
    used = [FS_UP, FS_DOWN, FD_UP, FD_DOWN, FS_DRIFT, FD_DRIFT, OVERSHOOT, LOWER, UPPER, INTEGRAL]
    run_inner(command, friction[used], profile, bool(friction[CROSSES, 0]), state, position)


def neutral_friction(stickband: FloatArray | float, slip_jump: FloatArray | float) -> FloatArray:
    """Friction table (ROWS, P) of the plain law for stickband plus deadband S and slip jump J, both in % (Eq. 1).

    Raises ModelError for S < 0, J < 0 or J > 2S: f_s = (S+J)/2 and f_d = (S-J)/2 would leave their validity.
    """
    S = np.atleast_1d(np.asarray(stickband, dtype=np.float64))
    J = np.atleast_1d(np.asarray(slip_jump, dtype=np.float64))
    check_stiction(S, J)
    return friction_table(*np.broadcast_arrays(S, J))


def friction_table(S: FloatArray, J: FloatArray) -> FloatArray:
    """Table of `neutral_friction` for arrays (P,) known to be valid; the search calls it for every population."""
    table = np.empty((ROWS, S.size))
    _fill(np.ascontiguousarray(S), np.ascontiguousarray(J), table)
    return table


@kernel
def _fill(S: FloatArray, J: FloatArray, table: FloatArray) -> None:
    for p in range(S.size):
        for row in range(ROWS):
            table[row, p] = 0.0
        table[FS_UP, p] = table[FS_DOWN, p] = 0.5 * (S[p] + J[p])
        table[FD_UP, p] = table[FD_DOWN, p] = 0.5 * (S[p] - J[p])
        table[OVERSHOOT, p] = 1.0
        table[LOWER, p], table[UPPER, p] = -np.inf, np.inf
