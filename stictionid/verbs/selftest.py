"""The verb `selftest`: false alarms, right names and interval coverage on simulated loops whose truth is known.

Loops are simulated from a seed of their own, a third of them with nothing hidden, the others with one effect each. Each
goes through identify, diagnose and add. The required rates are those the thresholds were chosen for, with allowance for
chance in so few loops. Source: docs/details.md, section 11.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass

import numpy as np

from ..effects import get, walks
from ..errors import StictionidError
from ..model.closed_loop import Controller, Plant, Setting, simulate
from ..options import Options
from ..typing import Progress
from .diagnose import diagnose
from .identify import identify

LOOPS, QUICK_LOOPS = 40, 3
# Rates that must hold (docs/details.md, section 11): at most and at least.
FALSE_ALARMS, RIGHT_NAMES, COVERAGE = 0.02, 0.90, 0.85
# A rate fails only when chance would bring it this far off less often than this.
_CHANCE = 0.01
_SAMPLES, _NOISE = 1200, 0.06
_PLANTS = ((Plant(1.2, 20.0, 4.0), Controller(0.7, 18.0, scan_s=1.0)), (Plant(2.0, 6.0, 3.0),
           Controller(0.15, 6.0, scan_s=1.0)))
# Effects hidden in turn, each plainly visible at this noise; None is a clean loop.
HIDDEN: tuple[tuple[str, Mapping[str, float | str]] | None, ...] = (
    None, ("step-disturbance", {"time_s": 650.0, "size": 1.2}), ("extra-lag", {"second_time_constant_s": 8.0}),
    None, ("asymmetric-stiction", {"jump_up": 3.6, "jump_down": 1.6}), ("sinusoidal-disturbance",
                                                                     {"period_s": 37.0, "amplitude": 0.4}),
    ("gain-nonlinearity", {"curvature": 0.06}), ("ramp-disturbance", {"start_s": 400.0, "rate": 0.003}),
    None, ("travel-limit", {"upper": 52.5}), ("random-walk-disturbance", {"innovation_sd": 0.06}),
    ("stiction-drift", {"stickband_growth": 1.2}),
)


@dataclass(frozen=True, slots=True)
class LoopResult:
    """One loop: the hidden effect, the named ones (with equivalents), and whether the intervals hold the truth."""

    seed: int
    hidden: str | None
    named: tuple[str, ...]
    equivalents: tuple[str, ...]
    right: bool
    S_covered: bool | None
    J_covered: bool | None
    S_error: float | None
    message: str = ""


@dataclass(frozen=True, slots=True)
class Rate:
    """One rate with its limit; `holds` is False only where chance cannot explain it."""

    name: str
    hits: int
    of: int
    limit: str
    holds: bool


@dataclass(frozen=True, slots=True)
class SelfTest:
    """The rates, the loops behind them, and whether all of them hold."""

    passed: bool
    rates: tuple[Rate, ...]
    loops: tuple[LoopResult, ...]


def selftest(*, loops: int = LOOPS, seed: int = 0, jobs: int = 1, progress: Progress | None = None) -> SelfTest:
    """Run the loops in `jobs` processes and judge the rates. The same seed gives the same loops."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_all_start_methods, get_context

    tell = progress or (lambda text, share: None)
    tasks = [(seed, i) for i in range(loops)]
    found: list[LoopResult] = []
    spread = jobs > 1 and "fork" in get_all_start_methods()
    with ProcessPoolExecutor(jobs, get_context("fork")) if spread else nullcontext() as pool:
        for result in map(_one, tasks) if pool is None else pool.map(_one, tasks):
            found.append(result)
            tell(f"loop {len(found)} of {loops}", len(found) / loops)
    rates = _rates(found)
    return SelfTest(all(r.holds for r in rates), rates, tuple(found))


def setting_of(seed: int, number: int) -> tuple[Setting, str | None]:
    """The simulated loop of one number, and the effect hidden in it."""
    rng = np.random.default_rng([seed, number, 4])
    plant, controller = _PLANTS[(number // len(HIDDEN)) % len(_PLANTS)]
    S = float(rng.uniform(4.0, 6.0))
    J = float(S * rng.uniform(0.4, 0.6))
    moves = ((0.0, 3.0), (250.0, -4.0), (520.0, 5.0), (800.0, -4.0), (1000.0, 3.0))
    hidden = HIDDEN[number % len(HIDDEN)]
    setting = Setting(plant, controller, S=S, J=J, duration_s=float(_SAMPLES), setpoint_moves=moves, noise_sd=_NOISE,
                      effects=() if hidden is None else ((hidden[0], dict(hidden[1])),))
    return setting, hidden[0] if hidden else None


def _one(task: tuple[int, int]) -> LoopResult:
    seed, number = task
    setting, hidden = setting_of(seed, number)
    at = 1000 * seed + number
    try:
        loop = simulate(setting, seed=at).loop
        study = identify(loop, options=Options(seed=seed))
        if not study.steps:
            return LoopResult(at, hidden, (), (), False, None, None, None, study.verdict.reason)
        after = diagnose(loop, study, apply=True, seed=seed)
    except StictionidError as error:
        return LoopResult(at, hidden, (), (), False, None, None, None, error.message)
    named = (*(s.added for s in study.steps if s.added), *after.missing)
    equal = tuple(e for c in after.candidates if c.accepted for e in c.equivalent_to)
    right = not named if hidden is None else bool(named) and (named[0] == hidden or hidden in equal)
    e = after.estimate
    S, J = setting.S, setting.J
    for name, values in setting.effects:
        if own := get(name).setting:
            # The effect says what S and J of the estimate stand for.
            _, S, J = own({k: float(v) for k, v in values.items()}, S, J)
    covered = [None if e is None or span is None else span[0] <= true <= span[1] for span, true in
               ((e.S_interval if e else None, S), (e.J_interval if e else None, J))]
    judged = right and not walks([hidden] if hidden else ())
    return LoopResult(at, hidden, named, equal, right, covered[0] if judged else None, covered[1] if judged else None,
                      e.S / setting.S - 1.0 if e else None)


def _rates(found: Sequence[LoopResult]) -> tuple[Rate, ...]:
    clean = [r for r in found if r.hidden is None]
    hidden = [r for r in found if r.hidden is not None]
    alarms = sum(not r.right for r in clean)
    right = sum(r.right for r in hidden)
    out = [Rate("false alarms in clean loops", alarms, len(clean), f"at most {100 * FALSE_ALARMS:.0f} %",
                _tail(alarms, len(clean), FALSE_ALARMS) >= _CHANCE),
           Rate("right names of hidden effects", right, len(hidden), f"at least {100 * RIGHT_NAMES:.0f} %",
                _tail(len(hidden) - right, len(hidden), 1.0 - RIGHT_NAMES) >= _CHANCE)]
    for name, covered in (("S in its 90 % interval", [r.S_covered for r in found]),
                          ("J in its 90 % interval", [r.J_covered for r in found])):
        known = [c for c in covered if c is not None]
        out.append(Rate(name, sum(known), len(known), f"at least {100 * COVERAGE:.0f} %",
                        _tail(len(known) - sum(known), len(known), 1.0 - COVERAGE) >= _CHANCE))
    return tuple(out)


def _tail(hits: int, of: int, rate: float) -> float:
    """Chance of at least so many hits of `of` at a rate (binomial)."""
    return sum(math.comb(of, k) * rate**k * (1.0 - rate) ** (of - k) for k in range(hits, of + 1))
