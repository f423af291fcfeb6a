"""Valve bench: step and ramp tests of a stiction law after ISA-75.25, compared with an ideal valve of the same S and J.

Every test begins with a ramp that makes the stem slide, so that its state is known. Three figures follow from command
and position alone. The dead band is the command from a reversal until the stem moves. The resolution is the command
from a rest until it moves on in the same direction. The overshoot of a slip is in % of J. They are compared with S and
J. A law may fail an expectation by design: that shows its limits.

The tests scale with W, the larger of S and J (at least 1 %): ramps move the command by 1 %/s in steps of W/250. Only
the steps have the fixed sizes of the standard's manner, 0.1 to 10 %.

Source: docs/details.md, section 3; ISA-75.25.01 for the kind of tests (the standard's text has not been reproduced).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from ..errors import UsageError
from ..laws.contract import Law
from ..typing import FloatArray

# Speed of the ramps. Unit: %/s; fast against the Stribeck velocity of the physical laws, slow against their lag.
RATE = 1.0
# Command steps per W, and the tolerance of a measured width, as a share of W. Unit: 1.
_STEPS_PER_W, _TOLERANCE = 250, 0.02
# A stem that moved by less than this share of one command step rests. Unit: 1.
_REST = 0.1
# A ramp on which the stem rests for more than this share of the samples is a staircase. Unit: 1.
_STAIRCASE = 0.2
# Largest overshoot that counts as none: a damped stem ends a slip within it. Unit: % of J.
_OVERSHOOT = 5.0
STEP_SIZES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)  # %
# The largest W for which every test stays inside 0..100 %. Unit: %.
LARGEST_W = 20.0
_CENTRE = 50.0


@dataclass(frozen=True, slots=True)
class Expectation:
    """One property of an ideal valve, true or false for this one, with the measured and the ideal number."""

    what: str
    holds: bool
    measured: float | None
    expected: float | None
    unit: str = "%"


@dataclass(frozen=True, slots=True)
class BenchOutcome:
    """One test of one law: signals (n,) in % over time in s, and three figures (None: not measured by this test)."""

    test: str
    summary: str
    time_s: FloatArray
    command: FloatArray
    position: FloatArray
    dead_band: float | None
    resolution: float | None
    overshoot: float | None
    expectations: tuple[Expectation, ...]

    def to_dict(self, *, series: bool = False) -> dict[str, Any]:
        """The record of the JSON output; `series` adds the signals."""
        record: dict[str, Any] = {
            "test": self.test, "summary": self.summary, "dead_band": self.dead_band, "resolution": self.resolution,
            "overshoot": self.overshoot, "expectations": [asdict(e) for e in self.expectations]}
        if series:
            record["series"] = {"time_s": self.time_s.tolist(), "u": self.command.tolist(),
                                "u_v": self.position.tolist()}
        return record


@dataclass(frozen=True, slots=True)
class _Scale:
    """Sizes of a bench in %: S, J, f_s, W, one command `step`, and the tolerance `near`; `step_s` in s."""

    S: float
    J: float

    @property
    def W(self) -> float:
        return max(self.S, self.J, 1.0)

    @property
    def fs(self) -> float:
        return 0.5 * (self.S + self.J)

    @property
    def step(self) -> float:
        return self.W / _STEPS_PER_W

    @property
    def step_s(self) -> float:
        return self.step / RATE

    @property
    def near(self) -> float:
        return _TOLERANCE * self.W


class _Path:
    """A command built piece by piece; `at` holds the sample at which each piece begins."""

    def __init__(self, scale: _Scale) -> None:
        self.scale, self.values = scale, [_CENTRE]
        self.at: list[int] = []

    def ramp(self, by: float) -> _Path:
        """Move by so many % at the bench's rate."""
        self.at.append(len(self.values) - 1)
        count = round(abs(by) / self.scale.step)
        start = self.values[-1]
        self.values += [start + by * (i + 1) / count for i in range(count)]
        return self

    def hold(self, samples: int) -> _Path:
        """Hold the command for so many samples."""
        return self.jump(0.0, samples)

    def jump(self, by: float, samples: int) -> _Path:
        """Move by so many % at once and hold the command for so many samples."""
        self.at.append(len(self.values) - 1)
        self.values += [self.values[-1] + by] * samples
        return self

    def command(self) -> FloatArray:
        """The whole command (n,), %."""
        return np.array(self.values)


def _moves(x: FloatArray, start: int, direction: float, least: float) -> int | None:
    """First sample after `start` at which the stem has moved `least` along `direction` from its furthest point back."""
    way = direction * x[start:]
    gone = way - np.minimum.accumulate(way) > least
    return start + int(gone.argmax()) if gone.any() else None


def _width(u: FloatArray, x: FloatArray, start: int, direction: float, scale: _Scale) -> tuple[float | None, int]:
    """Command needed from `start` until the stem moves, and the sample where it does (-1: never)."""
    k = _moves(x, start, direction, 0.5 * scale.step)
    return (None, -1) if k is None else (float(abs(u[k] - u[start])), k)


def _jump(u: FloatArray, x: FloatArray, k: int, direction: float) -> float | None:
    """Size of the slip that begins at sample k: the fall of the force from break-away to its least value."""
    if k < 1:
        return None
    force = direction * (u - x)
    window = force[k:k + _STEPS_PER_W // 2]
    before = max(force[k - 1], force[k - 2] if k > 1 else -math.inf)
    return float(before - window.min())


def _expect_close(what: str, measured: float | None, expected: float, scale: _Scale) -> Expectation:
    return Expectation(what, measured is not None and abs(measured - expected) <= scale.near + scale.step,
                       measured, expected)


def _overshoot(jump: float | None, scale: _Scale) -> float | None:
    if jump is None or scale.near > scale.J:
        return None
    return max(0.0, 100.0 * (jump / scale.J - 1.0))


def _expect_calm(overshoot: float | None) -> tuple[Expectation, ...]:
    if overshoot is None:
        return ()
    return (Expectation("no overshoot at a slip", overshoot <= _OVERSHOOT, overshoot, 0.0, "% of J"),)


def _slides(x: FloatArray, start: int, stop: int, scale: _Scale) -> Expectation:
    """Expectation: from half a W after the first move on, the stem follows the ramp without resting."""
    begin = start + _STEPS_PER_W // 2
    rests = np.abs(np.diff(x[begin:stop])) <= _REST * scale.step if start > 0 and stop - begin > 2 else np.ones(1)
    share = float(np.mean(rests))
    return Expectation("slides with the ramp, no staircase", share <= _STAIRCASE, 100.0 * share, 0.0, "% at rest")


def _expect_unbroken(x: FloatArray, start: int, scale: _Scale) -> Expectation:
    """Expectation: after its first move the stem does not stop again while the command goes on."""
    moving = np.abs(np.diff(x[max(start, 0):])) > _REST * scale.step
    longest = run = 0
    for moves in moving[:_STEPS_PER_W].tolist():
        run = 0 if moves else run + 1
        longest = max(longest, run)
    frozen = longest * scale.step
    return Expectation("does not freeze again after it moved", start > 0 and frozen <= 5 * scale.near,
                       frozen if start > 0 else None, 0.0)


def _held_by_friction(u: FloatArray, x: FloatArray, scale: _Scale, slack: float = 0.0) -> Expectation:
    """Expectation: where the stem rests, the force is no more than static friction can hold."""
    rests = np.abs(np.diff(x)) <= _REST * scale.step
    force = float(np.abs(u - x)[1:][rests].max(initial=0.0))
    return Expectation("at rest the force stays within f_s", force <= scale.fs + scale.near + scale.step + slack,
                       force, scale.fs)


def _ramp(run: _Run, scale: _Scale) -> BenchOutcome:
    path = _Path(scale).ramp(2 * scale.W).ramp(-4 * scale.W).ramp(4 * scale.W)
    u, x = run(path.command(), False)
    found = []
    for turn, direction in ((path.at[1], -1.0), (path.at[2], 1.0)):
        band, k = _width(u, x, turn, direction, scale)
        found.append((band, k, _jump(u, x, k, direction)))
    band, k, jump = found[0]
    other = found[1][0]
    overshoot = _overshoot(jump, scale)
    mean = None if band is None or other is None else 0.5 * (band + other)
    return run.outcome("ramp", u, x, mean, None, overshoot, (
        _expect_close("dead band is S", mean, scale.S, scale), _expect_close("slip jump is J", jump, scale.J, scale),
        _slides(x, k, path.at[2], scale), _held_by_friction(u, x, scale), *_expect_calm(overshoot)))


def _staircase(run: _Run, scale: _Scale) -> BenchOutcome:
    stair, rest = scale.W / 20.0, 20
    path = _Path(scale).ramp(-scale.W).ramp(2 * scale.W).hold(rest)
    for count, by in ((20, stair), (80, -stair)):
        for _ in range(count):
            path.jump(by, rest)
    u, x = run(path.command(), True)
    ends = np.array([*path.at[4:], u.size - 1])
    moved = np.abs(np.diff(x[ends]))
    jumps = moved[moved > 0.5 * stair]
    jump = float(jumps[1:].mean()) if jumps.size > 1 else None
    # A stair that breaks the stem away moves it past J by the excess of the stair, half of it on average.
    return run.outcome("staircase", u, x, None, None, None, (
        Expectation("after each rest it jumps by J", jump is not None and abs(jump - max(scale.J, stair))
                    <= stair + scale.near, jump, max(scale.J, stair)),
        _held_by_friction(u[ends], x[ends], scale)))


def _steps(run: _Run, scale: _Scale) -> BenchOutcome:
    rest = 50
    path = _Path(scale)
    tried = []
    for size in STEP_SIZES:
        path.ramp(-2 * scale.W).ramp(2 * scale.W).hold(rest)
        tried.append((size, len(path.values) - 1))
        path.jump(size, rest).jump(-size, rest)
    u, x = run(path.command(), True)
    least = 0.5 * scale.step
    ups = [size for size, k in tried if x[k + rest] - x[k] > least]
    downs = [size for size, k in tried if size in ups and x[k + rest] - x[k + 2 * rest] > least]
    up, down = min(ups, default=None), min(downs, default=None)
    want_up = min((s for s in STEP_SIZES if s > scale.J), default=None)
    want_down = min((s for s in STEP_SIZES if s > max(scale.S, scale.J)), default=None)
    ends = np.array(path.at[1:])
    return run.outcome("steps", u, x, down, up, None, (
        _first("smallest step on that moves it: the first above J", up, want_up, scale.J, scale),
        _first("smallest step back that moves it: the first above S", down, want_down, max(scale.S, scale.J), scale),
        _held_by_friction(u[ends], x[ends], scale)))


def _first(what: str, found: float | None, wanted: float | None, width: float, scale: _Scale) -> Expectation:
    """Expectation on the smallest step that moved the stem; one that equals the width may go either way."""
    ties = found is not None and abs(found - width) <= scale.near
    return Expectation(what, found == wanted or ties, found, wanted)


def _turns(run: _Run, scale: _Scale, test: str, hold: int) -> BenchOutcome:
    path = _Path(scale).ramp(2 * scale.W).hold(hold).ramp(-4 * scale.W)
    u, x = run(path.command(), False)
    band, k = _width(u, x, path.at[-1], -1.0, scale)
    overshoot = _overshoot(_jump(u, x, k, -1.0), scale)
    return run.outcome(test, u, x, band, None, overshoot, (
        _expect_close("dead band is S", band, scale.S, scale), _expect_unbroken(x, k, scale)))


def _resume(run: _Run, scale: _Scale) -> BenchOutcome:
    # 2.3 W, so that laws that move in stairs rest somewhere between two of them.
    path = _Path(scale).ramp(-2 * scale.W).ramp(2.3 * scale.W).hold(_STEPS_PER_W).ramp(2 * scale.W)
    u, x = run(path.command(), False)
    width, k = _width(u, x, path.at[-1], 1.0, scale)
    jump = _jump(u, x, k, 1.0)
    overshoot = _overshoot(jump, scale)
    return run.outcome("resume", u, x, None, width, overshoot, (
        _expect_close("resolution is J", width, scale.J, scale), _expect_close("slip jump is J", jump, scale.J, scale),
        _expect_unbroken(x, k, scale)))


def _wave(scale: _Scale) -> FloatArray:
    height = 2.0 * scale.W
    period_s = 2.0 * math.pi * height / (2.0 * RATE)
    return _CENTRE + height * np.sin(2.0 * math.pi * np.arange(0.0, 2.5 * period_s, scale.step_s) / period_s)


def _sine(run: _Run, scale: _Scale) -> BenchOutcome:
    u, x = run(_wave(scale), False)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(u))) != 0) + 1
    bands, jumps = [], []
    for turn in turns[1:-1].tolist():
        direction = float(np.sign(u[turn + 1] - u[turn]))
        band, k = _width(u, x, turn, direction, scale)
        bands.append(math.nan if band is None else band)
        jumps.append(_jump(u, x, k, direction) or 0.0)
    band = float(np.mean(bands)) if bands and np.isfinite(bands).all() else None
    jump = float(np.mean(jumps))
    overshoot = _overshoot(jump, scale)
    # The command moves by up to two steps a sample here.
    return run.outcome("sine", u, x, band, None, overshoot, (
        _expect_close("dead band is S", band, scale.S, scale), _expect_close("slip jump is J", jump, scale.J, scale),
        _held_by_friction(u, x, scale, scale.step)))


def _noisy_sine(run: _Run, scale: _Scale) -> BenchOutcome:
    clean = _wave(scale)
    noise = 0.01 * scale.W * np.random.default_rng(0).standard_normal(clean.size)
    u, x = run(clean + noise, False)
    travel = float(np.ptp(x))
    least = np.ptp(clean) - 2.0 * scale.fs
    return run.outcome("noisy-sine", u, x, None, None, None, (
        Expectation("noise does not keep it stuck: it travels", travel >= float(0.8 * least), travel, float(least)),
        _held_by_friction(u, x, scale, scale.step)))


TESTS: Mapping[str, tuple[str, Callable[[_Run, _Scale], BenchOutcome]]] = {
    "ramp": ("ramp up, down and up again", _ramp),
    "staircase": ("small stairs with a hold on each, up then down", _staircase),
    "steps": ("steps of 0.1 to 10 % on in the direction of travel, then back", _steps),
    "reversal-after-hold": ("ramp up, hold, ramp down",
                            partial(_turns, test="reversal-after-hold", hold=_STEPS_PER_W)),
    "reversal-at-once": ("ramp up, in the next sample ramp down", partial(_turns, test="reversal-at-once", hold=0)),
    "resume": ("ramp up, hold, ramp on", _resume),
    "sine": ("sine", _sine),
    "noisy-sine": ("sine with noise of 1 % of the larger of S and J", _noisy_sine),
}


@dataclass(frozen=True, slots=True)
class _Run:
    """Runs one law under a command; for physical laws it is held, or moves in a straight line, between samples."""

    law: Law
    scale: _Scale
    values: Mapping[str, float]

    def __call__(self, command: FloatArray, held: bool) -> tuple[FloatArray, FloatArray]:
        table = self.law.friction(self.scale.S, self.scale.J, values=self.values, step_s=self.scale.step_s, held=held)
        return command, self.law.positions(command, table)[:, 0]

    def outcome(self, test: str, u: FloatArray, x: FloatArray, dead_band: float | None, resolution: float | None,
                overshoot: float | None, expectations: tuple[Expectation, ...]) -> BenchOutcome:
        """The signals and figures of a test, with its name."""
        return BenchOutcome(test, TESTS[test][0], np.arange(float(u.size)) * self.scale.step_s, u, x, dead_band,
                            resolution, overshoot, expectations)


def put_on_bench(law: Law, *, S: float = 5.0, J: float = 3.0, tests: tuple[str, ...] = tuple(TESTS),
                 values: Mapping[str, float] | None = None) -> list[BenchOutcome]:
    """Run `tests` on a law with S and J in % (and `values` of its own parameters); one-parameter laws take J = S.

    Raises ModelError for numbers the law refuses and UsageError for an unknown test. UsageError, too, where the larger
    of S and J exceeds LARGEST_W, because the command would leave 0..100 %.
    """
    unknown = [name for name in tests if name not in TESTS]
    if unknown:
        raise UsageError(f"unknown test '{unknown[0]}'", "tests: " + ", ".join(TESTS))
    law.check(S, J)
    J = S if law.one_parameter else J
    scale = _Scale(S, J)
    if scale.W > LARGEST_W:
        raise UsageError(f"S = {S:g} % and J = {J:g} % are too large for the bench, whose ramps would leave "
                         "0..100 %", f"give S and J up to {LARGEST_W:g} %")
    run = _Run(law, scale, dict(values or {}))
    return [TESTS[name][1](run, scale) for name in tests]
