"""A valve moved along a known sequence of slips: the law decides where a slip lands, the path when it comes.

The stiction laws let a valve break away at the first sample where the force exceeds f_s. A real break-away force
differs from stroke to stroke, so a slip comes a little early or late. `replay_slips` moves valves (P of them at once)
that slip at given samples, and gives for every stroke the forces that the stem withstood. With slips `by law` it moves
the valve as the laws of Chen (slides on) and He (rests at once) do. Wrong for laws that land elsewhere.

Source: Chen et al. 2008, He et al. 2007; docs/details.md, section 3; the random break-away force is section 14.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from ..laws.contract import (
    CROSSES,
    FD_DOWN,
    FD_DRIFT,
    FD_UP,
    FS_DOWN,
    FS_DRIFT,
    FS_UP,
    INTEGRAL,
    LOWER,
    OVERSHOOT,
    RESTICK,
    TIE,
    UPPER,
    Law,
    lanes_by_change,
)
from ..numerics.jit import LANES, LINE, kernel, output
from ..numerics.noise.normal import log_upper
from ..typing import BoolArray, FloatArray, IntArray
from .forces import AT, BEFORE, OTHER, Forces, ScanForces
from .slips import Paths, ScanErrors, Slips
from .unseen_scans import ROWS, replay_unseen

# Error of a difference of two commands, and the distance in errors from which its sign is sure.
_BOTH, _SURE = 2.0**0.5, 4.0


# Rows of the working table: f_s and f_d up and down, what they grow by, the speed from which a stem slides on, stops;
# then position, 1 while moving, direction, largest forces up and down since the last rest, and the chance of the turns.
(_FS_UP, _FS_DOWN, _FD_UP, _FD_DOWN, _FS_MORE, _FD_MORE, _SPEED, _LOW, _HIGH, _V, _MOVES, _HEADING, _UP, _DOWN,
 _CHANCE) = range(15)
_ROWS = 15


@kernel
def _replay(command: FloatArray, friction: FloatArray, profile: FloatArray, start: FloatArray, rests: bool,
            doubt: FloatArray, events: IntArray, kinds: IntArray, known: int, position: FloatArray,
            margins: FloatArray, turns: FloatArray, law_at: IntArray, law_way: IntArray) -> int:
    """Fill position (n, P), margins (slips + 1, 3, P) and turns (P,); slips by the law from sample `known` on.

    Slips by the law go into `law_at` and `law_way`, of one lane only; their number is returned.
    """
    n, lanes = position.shape
    found = 0
    work = np.empty(_ROWS * LANES + LINE)
    work = work[-(work.ctypes.data // 8) % LINE:]
    strokes = np.empty(LANES, np.int64)
    for first in range(0, lanes, LANES):
        width, event = min(LANES, lanes - first), 0
        for p in range(width):
            q = first + p
            work[_FS_UP * LANES + p], work[_FS_DOWN * LANES + p] = friction[FS_UP, q] + TIE, friction[FS_DOWN, q] + TIE
            work[_FD_UP * LANES + p], work[_FD_DOWN * LANES + p] = friction[FD_UP, q], friction[FD_DOWN, q]
            work[_FS_MORE * LANES + p], work[_FD_MORE * LANES + p] = friction[FS_DRIFT, q], friction[FD_DRIFT, q]
            work[_SPEED * LANES + p] = np.inf if rests else friction[RESTICK, q]
            work[_LOW * LANES + p], work[_HIGH * LANES + p] = friction[LOWER, q], friction[UPPER, q]
            work[_V * LANES + p], work[_MOVES * LANES + p], work[_HEADING * LANES + p] = start[q], 0.0, 0.0
            work[_UP * LANES + p], work[_DOWN * LANES + p], work[_CHANCE * LANES + p] = -np.inf, -np.inf, 0.0
            strokes[p] = 0
        for k in range(n):
            u = command[k]
            du = u - command[k - 1] if k > 0 else 0.0
            growth, speed, by_law = profile[k], abs(du), k >= known
            path_way, turned = 0, False
            while event < events.size and events[event] == k and not by_law:
                if abs(kinds[event]) == 1:
                    path_way = kinds[event]
                else:
                    turned = True
                event += 1
            said = math.log(doubt[k] if turned else 1.0 - doubt[k]) if not by_law and doubt[k] > 0.0 else 0.0
            row = position[k, first:first + width]
            # (at most commands nothing slips: then all lanes run at once, without branches)
            slips = path_way != 0 or by_law
            for p in range(0 if slips else width):
                v, moves, heading = work[_V * LANES + p], work[_MOVES * LANES + p] > 0.0, work[_HEADING * LANES + p]
                low, high = work[_LOW * LANES + p], work[_HIGH * LANES + p]
                fs_add, fd_add = work[_FS_MORE * LANES + p] * growth, work[_FD_MORE * LANES + p] * growth
                to_up, to_down = u - (work[_FD_UP * LANES + p] + fd_add), u + (work[_FD_DOWN * LANES + p] + fd_add)
                on = moves & (((du * heading > 0.0) & (speed >= work[_SPEED * LANES + p])) != turned)
                new = (to_up if to_up > v else v) if heading > 0.0 else to_down if to_down < v else v
                held = low if new < low else new
                held = high if held > high else held
                stays = on & (held == new)
                up, down = u - v - (work[_FS_UP * LANES + p] + fs_add), v - u - (work[_FS_DOWN * LANES + p] + fs_add)
                up, down = up if v < high else -np.inf, down if v > low else -np.inf
                most_up, most_down = work[_UP * LANES + p], work[_DOWN * LANES + p]
                most_up = -np.inf if moves & (not stays) else most_up
                most_down = -np.inf if moves & (not stays) else most_down
                work[_UP * LANES + p] = up if (not on) & (up > most_up) else most_up
                work[_DOWN * LANES + p] = down if (not on) & (down > most_down) else most_down
                work[_CHANCE * LANES + p] += said if moves else 0.0
                work[_MOVES * LANES + p] = 1.0 if stays else 0.0
                work[_V * LANES + p] = row[p] = held if on else v
            for p in range(width if slips else 0):
                q, way = first + p, path_way
                v, low, high = work[_V * LANES + p], work[_LOW * LANES + p], work[_HIGH * LANES + p]
                fs_add, fd_add = work[_FS_MORE * LANES + p] * growth, work[_FD_MORE * LANES + p] * growth
                to_up, to_down = u - (work[_FD_UP * LANES + p] + fd_add), u + (work[_FD_DOWN * LANES + p] + fd_add)
                a, c, stops = work[_UP * LANES + p], work[_DOWN * LANES + p], work[_SPEED * LANES + p]
                if work[_MOVES * LANES + p] > 0.0:
                    heading = work[_HEADING * LANES + p]
                    goes_on = (du * heading > 0.0 and speed >= stops) != turned
                    work[_CHANCE * LANES + p] += said
                    stays = False
                    if goes_on:
                        new = max(to_up, v) if heading > 0.0 else min(to_down, v)
                        v = min(max(new, low), high)
                        stays = v == new
                    work[_MOVES * LANES + p] = 1.0 if stays else 0.0
                    if not stays:
                        a, c = -np.inf, -np.inf
                    if goes_on:
                        work[_V * LANES + p], work[_UP * LANES + p], work[_DOWN * LANES + p] = v, a, c
                        row[p] = v
                        continue
                up = u - v - (work[_FS_UP * LANES + p] + fs_add) if v < high else -np.inf
                down = v - u - (work[_FS_DOWN * LANES + p] + fs_add) if v > low else -np.inf
                if by_law and (up > 0.0 or down > 0.0):
                    way = 1 if up > 0.0 else -1
                    if lanes == 1 and found < law_at.size:
                        law_at[found], law_way[found] = k, way
                        found += 1
                if way != 0:
                    if strokes[p] < margins.shape[0]:
                        margins[strokes[p], BEFORE, q] = a if way > 0 else c
                        margins[strokes[p], AT, q] = up if way > 0 else down
                        margins[strokes[p], OTHER, q] = max(c, down) if way > 0 else max(a, up)
                    strokes[p] += 1
                    if friction[CROSSES, q] > 0.0 and speed < stops:
                        # It stays where a moving command crossed the likeliest force of this step, not where that is.
                        to_up -= up - max(min(0.0, up), a)
                        to_down += down - max(min(0.0, down), c)
                    spare = friction[OVERSHOOT, q] - 1.0
                    new = to_up + spare * (to_up - v) if way > 0 else to_down + spare * (to_down - v)
                    v = min(max(new, low), high)
                    work[_MOVES * LANES + p] = 1.0 if v == new and stops < np.inf else 0.0
                    work[_HEADING * LANES + p] = 1.0 if du > 0.0 else -1.0 if du < 0.0 else 0.0
                    a, c = -np.inf, -np.inf
                else:
                    a, c = max(a, up), max(c, down)
                work[_V * LANES + p], work[_UP * LANES + p], work[_DOWN * LANES + p] = v, a, c
                row[p] = v
        for p in range(width):
            q, stroke = first + p, strokes[p]
            if stroke < margins.shape[0]:
                margins[stroke, BEFORE, q], margins[stroke, AT, q] = work[_UP * LANES + p], np.nan
                margins[stroke, OTHER, q] = work[_DOWN * LANES + p]
            turns[q] = work[_CHANCE * LANES + p]
    return found


@dataclass(frozen=True)
class Replayed:
    """Positions (n, P) of valves along a path, and the forces of their strokes."""

    position: FloatArray
    forces: Forces


def supports_replay(law: Law, friction: FloatArray) -> bool:
    """True where a valve (ROWS, P) slips and lands as `replay_slips` moves it."""
    return law.slips is not None and not bool(friction[INTEGRAL].any())


def doubts(command: FloatArray, error: float, parts: int = 1, digits: float = 0.0) -> FloatArray:
    """Chance (n,) that a command known to an `error` in % (standard deviation) turned where the record says not.

    Of a command that was rebuilt in `parts` of a sample only the samples were rounded. The error of their `digits`
    moved no command, so it is no turn between them: it leaves in doubt, once in a sample and where the command turns,
    which way the command goes in the time of a sample. What is left of the error is that of every part.
    """
    n, move = command.size, np.diff(command, prepend=command[:1])
    if parts == 1:
        return _chances(move, error, np.arange(n) > 0)
    ahead = command[np.minimum(np.arange(n) + parts - 1, n - 1)] - command[np.maximum(np.arange(n) - 1, 0)]
    told = np.arange(n) % parts == 1
    told[1:] |= move[1:] * move[:-1] <= 0.0
    told[0], between = False, float(np.sqrt(max(error**2 - digits**2, 0.0)))
    by_digits, by_parts = _chances(ahead, min(digits, error), told), _chances(move, between, np.arange(n) > 0)
    return by_digits + by_parts - 2.0 * by_digits * by_parts  # (two errors may cancel)


def _chances(moves: FloatArray, error: float, told: BoolArray) -> FloatArray:
    """Chance (n,) that moves of a command went the other way, where `told`; both of its ends have the error."""
    found = np.zeros(moves.size)
    if error > 0.0:
        apart = np.abs(moves) / (_BOTH * error)
        near = np.flatnonzero((apart <= _SURE) & told)
        found[near] = np.exp(log_upper(apart[near]))
    return found


def _without_copies(columns: FloatArray) -> int:
    """Number of columns (k, P) up to the first of those that equal the last one."""
    other = np.flatnonzero((columns != columns[:, -1:]).any(axis=0))
    return int(other[-1]) + 2 if other.size else 1


def replay_slips(law: Law, command: FloatArray, friction: FloatArray, profile: FloatArray, share: FloatArray,
                 slips: Slips, *, doubt: FloatArray | None = None, errors: ScanErrors | None = None,
                 lent: bool = False) -> Replayed:
    """Valves (ROWS, P) moved along the slips; `doubt` (n,) as of `doubts`, None for a command that is exact.

    With `errors` the command errs at every unseen scan by itself.
    """
    friction = np.ascontiguousarray(friction)
    position = output("replay", command.size, friction.shape[1], lent)
    shape = slips.count + 1, 3 if errors is None else ROWS
    margins, turns = np.full((*shape, friction.shape[1]), np.nan), np.zeros(friction.shape[1])
    none, doubt = np.empty(0, np.int64), np.zeros(command.size) if doubt is None else doubt
    start = law.start(float(command[0]), friction, share)[0].copy()
    # A block of candidates is filled up with copies of the last one, which move as it does.
    alone = _without_copies(np.vstack([friction, share]))
    every = position, margins, turns
    for lanes, counts in lanes_by_change(friction[:, :alone], profile):
        moved = np.ascontiguousarray(friction[:, :alone][:, lanes])
        width = moved.shape[1]
        own, m, chance = parts = every if width == turns.size else (
            np.empty((command.size, width)), np.full((*shape, width), np.nan), np.zeros(width))
        valve = command, moved, counts, start[:alone][lanes], law.slips == "rests", doubt
        path = slips.at, slips.kind, slips.known, own, m, chance
        if errors is None:
            _replay(*valve, *path, none, none)
        else:
            replay_unseen(*valve, errors.command, errors.own, *path)
        for whole, part in zip(every, parts, strict=True) if parts is not every else ():
            if alone == 1:
                # (all columns at once, in a third of the time)
                whole[...] = part
            else:
                whole[..., :alone][..., lanes] = part
    if 1 < alone < turns.size:
        for whole in every:
            whole[..., alone:] = whole[..., alone - 1:alone]
    return Replayed(position, (Forces if errors is None else ScanForces)(margins, turns))


def by_law(law: Law, command: FloatArray, friction: FloatArray, profile: FloatArray, share: FloatArray) -> Slips:
    """The slips of one valve (ROWS, 1) that breaks away exactly at f_s."""
    friction = np.ascontiguousarray(friction)
    at, way = np.empty(command.size, np.int64), np.empty(command.size, np.int64)
    none = np.empty(0, np.int64)
    (_, profile), = lanes_by_change(friction, profile)
    found = _replay(command, friction, profile, law.start(float(command[0]), friction, share)[0].copy(),
                    law.slips == "rests", np.zeros(command.size), none, none, 0, np.empty((command.size, 1)),
                    np.empty((0, 3, 1)), np.zeros(1), at, way)
    return Slips(at[:found].copy(), way[:found].copy(), command.size, command.size)


class AlongPath:
    """A law whose valves slip where a path says; it stands in a model in the place of the law."""

    def __init__(self, law: Law, slips: Slips, doubt: FloatArray, errors: ScanErrors | None = None,
                 landed: FloatArray | None = None) -> None:
        # `doubt` (n,) and `errors` as of `replay_slips`; `landed` (n,) is how far the stem is expected from where the
        # law lets it land, in %.
        self._law, self._slips, self._doubt, self._errors, self._landed = law, slips, doubt, errors, landed
        # What the last positions were of, and their forces.
        self._last: tuple[tuple[FloatArray, ...], Forces] | None = None

    def landing(self, landed: FloatArray) -> AlongPath:
        """The same law with a stem that is expected beside its place, by so much (n,) in %."""
        return AlongPath(self._law, self._slips, self._doubt, self._errors, landed)

    def strokes(self, command: FloatArray, friction: FloatArray, profile: FloatArray, share: FloatArray, *,
                lent: bool = False) -> Replayed:
        """The strokes of valves (ROWS, P) along the path, exactly where the law lets them land."""
        return replay_slips(self._law, command, friction, profile, share, self._slips, doubt=self._doubt,
                            errors=self._errors, lent=lent)

    def forces(self, command: FloatArray, friction: FloatArray, profile: FloatArray, share: FloatArray) -> Forces:
        """The forces of `strokes`; a likelihood asks for them behind the positions of the same valves."""
        if self._last is not None:
            (moved, growth, table, shares), found = self._last
            if (moved is command and growth is profile and np.array_equal(table[:, :share.size], friction)
                    and np.array_equal(shares[:share.size], share)):
                return found.first(share.size)
        return self.strokes(command, friction, profile, share, lent=True).forces

    @property
    def path(self) -> Slips:
        """The slips of the path."""
        return self._slips

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # (a copy that has nothing yet)
            raise AttributeError(name)
        return getattr(self._law, name)

    def positions(self, command: FloatArray, friction: FloatArray, *, profile: FloatArray | None = None,
                  share: FloatArray | float = 0.0, lent: bool = False) -> FloatArray:
        """Valve positions (n, P) along the path; as `Law.positions`."""
        profile = np.zeros(command.size) if profile is None else profile
        shares = share if isinstance(share, np.ndarray) else np.full(friction.shape[1], float(share))
        found = self.strokes(command, friction, profile, shares, lent=lent)
        self._last = (command, profile, friction.copy(), shares.copy()), found.forces
        position = found.position
        if self._landed is not None:
            position += self._landed[:, None]
        return position


def law_along(law: Law, paths: Paths | None, samples: int, parts: int, doubts: Callable[[float], FloatArray]) -> Law:
    """The law of a valve that slips where the first path says, if that belongs to a grid of so many samples.

    The grid has so many `parts` from a row to the next. `doubts` gives the chances of `doubts` for an error of the
    command.
    """
    if paths is None or paths.slips[0].size != samples:
        return law
    return cast(Law, AlongPath(law, paths.slips[0], doubts(paths.error), paths.scan_errors(samples, parts)))
