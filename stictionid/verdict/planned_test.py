"""The shortest manual test of a loop that decides an open answer, found by simulating every answer.

Each candidate is one large step of OP, small steps back and a return to the start. The answers run through it: the
valve of the study, a valve that follows, and valves of models that explain the record alike. Every answer may fit a
process of its own (gain, level, lags, dead time) and any initial force. The squared distance of the responses that is
left, over the noise, is the expected likelihood ratio. An integrating process gets the same steps once more downwards,
so that PV returns.

Wrong where the model of the study is: its effects beyond law, lags and dead time are left out, and so are loads that
move while the loop is in manual. Source: docs/details.md, section 9.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import permutations

import numpy as np

from .. import laws
from ..errors import UsageError
from ..process.linear import Dynamics, free_run
from ..record.loop import Loop
from ..record.planned_test import PlannedTest, ValveAnswer
from ..record.preconditions import FEWEST_SAMPLES
from ..record.study import Estimate, Study
from ..typing import FloatArray

NEEDED = 75.0
"""Least expected likelihood ratio, twice its logarithm. Its standard deviation is 2 sqrt(75), so that it exceeds the 40
of a verdict (verdict/judge.py) in 97 % of tests. Unit: 1."""
# Share of S by which S or J of two answers differs where they disagree, and the most answers told apart.
_DISAGREE, _MOST_ANSWERS = 0.2, 3
# "No stiction" denies an S of a fifth of the swing of OP; a test denies one of this share. Unit: 1.
_DENIED = 0.15
# Share of the squared free-run error by which friction lowers it: the error falls by 9 %, where a verdict of stiction
# needs 5 %. Unit: 1.
_SHOWN = 0.2
# S and gain of the study are taken as true within this factor, as far as their intervals reach.
_UNSURE = 1.5
# Sizes of a small step: at most this share of S, and down to it over the other, on a scale of round numbers.
_LARGEST, _FINEST, _ROUND = 1.2, 12.0, (1.0, 1.5, 2.0, 3.0, 5.0, 7.0)
# The large step in small ones, the number of small steps back, and how often all of it is done.
_LARGE, _BACK, _TURNS = (3, 4, 5, 7, 9), (2, 3, 4, 5, 6), (1, 2, 4)
# Small steps back together, in the largest S that may be true: PV has to show where the stem breaks away. Unit: 1.
_BREAKS = 1.2
# Hold of a step: the largest possible dead time and these time constants; no shorter than this for the hand, and in
# samples. Unit: s, 1.
_HOLDS, _SHORTEST_S, _FEWEST = (1.0, 2.0, 3.0, 6.0), 5.0, 5
# Most parts of a hold in a simulation, and the longest test that a person is asked for. Unit: 1, s.
_PARTS, _LONGEST_S = 20, 7200.0
# Processes that a rival may have: factors of the lag, dead times more in lags, second lags in lags; and start forces.
_LAGS, _DEADS, _SECOND = (0.5, 0.7, 1.0, 1.4, 2.0, 3.0), (-0.3, 0.0, 0.2, 0.5), (0.0, 0.3, 1.0)
_FORCES = (-0.95, -0.5, 0.0, 0.5, 0.95)
# Noise around a simulated PV, in standard deviations, that its limits must hold.
_NOISE = 3.0
# Rivals nearest to a true response whose noise model is asked for, and the order of its autoregression.
_NEAREST, _ORDER = 3, 4
# Step of the slopes of a process, in lags. Unit: 1.
_SLOPE = 0.05
# Swing that is assumed to be allowed where no limits are given, in spans of the record.
_ALLOWED = 2.0
# Longest record, in records like the present one, that is advised instead of a test; samples in a period of a good one.
_MOST_RECORDS, _FINE = 20.0, 40
Limits = tuple[float, float]


@dataclass(frozen=True, slots=True)
class _Plant:
    """Process of the study and its noise at low frequency, where steps act.

    `white` is the standard deviation of white noise on samples of `step_s`, `walk` that of the steps of a random walk.
    `error` is the free-run error. All are in the unit of PV.
    """

    estimate: Estimate
    step_s: float
    error: float
    white: float
    walk: float

    @property
    def lags(self) -> tuple[float, float]:
        """First and second time constant in seconds, the first one positive."""
        first, second, *_ = *(t for t in self.estimate.time_constants_s if t > 0), 0.0, 0.0
        return first or self.step_s, second

    def lanes(self, valves: Sequence[tuple[float, float]], forces: Sequence[float] = _FORCES,
              wide: bool = False) -> FloatArray:
        """Lanes (6, k): S, J, start force, both lags and dead time; if `wide`, of processes around that of the study.
        """
        (first, second), dead = self.lags, self.estimate.dead_time_s
        around = [(a * first, second + c * first, max(dead + b * first, 0.0))
                  for a in _LAGS for b in _DEADS for c in _SECOND] if wide else [(first, second, dead)]
        return np.array([(S, J, z, *p) for S, J in valves for z in (forces if S > 0 else (0.0,)) for p in around]).T

    def responses(self, output: FloatArray, part_s: float, lanes: FloatArray) -> FloatArray:
        """PV per unit of gain (n, k) every `part_s` in lanes (6, k)."""
        law = laws.get(self.estimate.law)
        position = law.positions(output, law.searched_friction(lanes[0], lanes[1]), share=lanes[2])
        linear = Dynamics(lanes[3], lanes[5], lanes[4], self.estimate.integrating)
        return free_run(position, linear, step_s=part_s)

    def left(self, output: FloatArray, part_s: float, truth: FloatArray, rivals: FloatArray) -> FloatArray:
        """Errors (a, m, n) of the nearest of rivals (6, k) to true lanes (6, a), in the unit of PV.

        A rival has a gain, a level and a start of its own, under an integrator a steady load, too. Its process follows
        along its slopes.
        """
        n, first = output.size, self.lags[0]
        ages = np.arange(n) * part_s
        known = np.column_stack([np.ones(n), np.exp(-ages / first), *([ages] * self.estimate.integrating)])
        base = np.linalg.qr(known)[0]

        def free(x: FloatArray) -> FloatArray:
            return x - base @ (base.T @ x)

        y, found = (free(self.responses(output, part_s, x)) for x in (truth, rivals))
        size = (y.T @ found)**2 / np.maximum((found**2).sum(axis=0), 1e-300)
        near = rivals[:, np.argsort(-size, axis=1)[:, :_NEAREST].ravel()]
        moved = np.repeat(near[:, :, None], 4, axis=2)
        moved[[3, 4, 5], :, [1, 2, 3]] += _SLOPE * first
        columns = free(self.responses(output, part_s, moved.reshape(6, -1))).reshape(n, -1, 4)
        columns[..., 1:] -= columns[..., :1]
        axes = np.linalg.qr(columns.transpose(1, 0, 2))[0]
        target = np.repeat(y.T, near.shape[1] // y.shape[1], axis=0)[..., None]
        error = target - axes @ (axes.transpose(0, 2, 1) @ target)
        return abs(self.estimate.gain) * error.reshape(y.shape[1], -1, n)

    def ratio(self, error: FloatArray, part_s: float) -> float:
        """Least expected likelihood ratio of errors (a, m, n), of which an autoregression takes what it can."""
        samples, n = part_s / self.step_s, error.shape[-1]
        variance = self.white**2 / samples
        if self.walk:
            variance, error = 2.0 * variance + self.walk**2 * samples, np.diff(error)
        error = error.reshape(-1, error.shape[-1]) / math.sqrt(variance)
        lagged = np.stack([(error[:, k:] * error[:, :error.shape[1] - k]).sum(axis=1) for k in range(_ORDER + 1)],
                          axis=1) / error.shape[1]
        lagged[:, 0] += 1.0
        order = np.abs(np.subtract.outer(np.arange(_ORDER), np.arange(_ORDER)))
        taps = np.linalg.solve(lagged[:, order], lagged[:, 1:, None])[..., 0]
        return float(n * np.log((lagged[:, 0] - (taps * lagged[:, 1:]).sum(axis=1)).min()))


def with_plan(study: Study, loop: Loop | None, *, op_limits: Limits | None = None,
              pv_limits: Limits | None = None) -> Study:
    """The study with the test that would decide it; none where it is decided. Without a record its plan stays.

    Limits that are not given are those of an earlier plan. UsageError for limits that do not hold the record's own
    operating point.
    """
    answers, old = _answers(study), study.planned_test
    if len(answers) < 2:
        return replace(study, planned_test=None)
    if old is not None:
        op_limits = op_limits or (None if "op" in old.assumed else old.op_limits)
        pv_limits = pv_limits or (None if "pv" in old.assumed else old.pv_limits)
    return study if loop is None else replace(study, planned_test=_plan_for(study, loop, answers, op_limits, pv_limits))


def _answers(study: Study) -> tuple[ValveAnswer, ...]:
    """Valves that the study leaves open: that of the estimate, one that follows, and others that explain it alike."""
    e = study.estimate
    if e is None or not e.S > 0.0 or not study.steps or not study.steps[-1].model:
        return ()
    found = [ValveAnswer(e.S, e.J)]
    if study.verdict.stiction == "undecided":
        found.append(ValveAnswer(0.0, 0.0))
    if study.verdict.stiction != "no stiction":
        for other in study.equivalents:
            near = _DISAGREE * max(e.S, other.S)
            if all(abs(other.S - a.S) > near or abs(other.J - a.J) > near for a in found):
                found.append(ValveAnswer(other.S, other.J))
    return tuple(found[:_MOST_ANSWERS])


def _plan_for(study: Study, loop: Loop, answers: tuple[ValveAnswer, ...], op_limits: Limits | None,
              pv_limits: Limits | None) -> PlannedTest:
    e, step = study.estimate, study.steps[-1]
    assert e is not None
    u, y = loop.output[loop.driven], loop.process_value[loop.used]
    start, level = float(f"{u.mean():.3g}"), float(y.mean())
    assumed = tuple(name for name, given in (("op", op_limits), ("pv", pv_limits)) if given is None)
    op = op_limits or ((0.0, 100.0) if e.unit == "%" and 0.0 <= start <= 100.0 else _wide_limits(u))
    pv = pv_limits or _wide_limits(y)
    for name, (low, high), now in (("--op-limits", op, start), ("--pv-limits", pv, level)):
        if not low < now < high:
            raise UsageError(f"{name} {low:g},{high:g} do not hold the mean of the record, {now:.4g}",
                             f"give {name} LO,HI with LO below and HI above {now:.4g}")
    noise = max(step.error.rmse_one_step or step.error.best, 1e-9 * float(np.ptp(y)), 1e-300)
    lasting = noise / max(abs(1.0 + sum(step.model.get("taps", ()))), 1e-9)
    sizes = (noise, lasting) if step.model.get("increments") else (lasting, 0.0)
    plant = _Plant(e, loop.step_s, step.error.best, *sizes)
    plan = PlannedTest(answers, start, (), 0.0, 0.0, 0.0, NEEDED, op, pv, assumed, otherwise=_other_record(study, loop))
    if e.gain == 0.0:
        return replace(plan, reason="PV does not answer OP in the model, whose gain is 0")
    gentlest = np.inf
    for hold_s, moves in _candidates(plant, answers):
        parts = min(round(hold_s / loop.step_s), _PARTS)
        output, part_s = np.repeat([start, *(start + np.cumsum(moves))], parts), hold_s / parts
        lanes = np.concatenate([plant.lanes(_vary_answer(e, a)) for a in answers], axis=1)
        way = _ends(e.gain, e.gain_interval)[1] * plant.responses(output, part_s, lanes)
        ends, reach = start + np.cumsum(moves), float(np.abs(way).max())
        sign = next((s for s in (1, -1) if _within_limits(start + s * (ends - start), op) and
                     _within_limits(level + s * way, pv, _NOISE * step.error.best)), 0)
        if not sign and reach >= gentlest:
            continue
        ratio = _least_ratio(plant, answers, output, part_s)
        if ratio < NEEDED:
            continue
        if sign:
            return replace(plan, moves=tuple(float(f"{sign * m:.6g}") for m in moves), hold_s=hold_s,
                           pv_change=reach, likelihood_ratio=float(ratio), reason="")
        gentlest = reach
        plan = replace(plan, reason=f"none stays within the limits: the gentlest test that settles it moves OP by "
                                    f"{np.ptp([start, *ends]):.3g} {e.unit} and PV by {reach:.3g}")
    return plan if plan.reason else replace(
        plan, reason=f"in none of up to {_LONGEST_S / 3600.0:g} h does PV differ enough beside its noise")


def _candidates(plant: _Plant, answers: Sequence[ValveAnswer]) -> list[tuple[float, FloatArray]]:
    """Hold in s and moves (m,) of every test that is tried, the shortest first, of equally long ones the smallest."""
    e, S = plant.estimate, max(a.S for a in answers)
    back = _BREAKS * max(S for a in answers for S, _ in _vary_answer(e, a))
    decades = range(math.floor(math.log10(S / _FINEST)), math.ceil(math.log10(_LARGEST * S)) + 1)
    sizes = [x for d in decades for r in _ROUND if S / _FINEST <= (x := r * 10.0**d) <= _LARGEST * S]
    lag, dead = sum(e.time_constants_s), max(e.dead_time_s, *(e.dead_time_interval or (0.0,)))
    holds = {_round_up(max(dead + c * lag, _SHORTEST_S, _FEWEST * plant.step_s), plant.step_s) for c in _HOLDS}
    found = [(hold, size * np.array(moves * turns)) for hold in holds for size in sizes for turns in _TURNS
             for moves in _patterns(e.integrating, back / size)
             if FEWEST_SAMPLES * plant.step_s <= (len(moves) * turns + 1) * hold <= _LONGEST_S]
    return sorted(found, key=lambda c: ((c[1].size + 1) * c[0], float(np.ptp([0.0, *np.cumsum(c[1])])), c[0]))


def _patterns(integrating: bool, fewest: float) -> Iterator[list[float]]:
    """Moves in small steps: a large one, small ones back, and the return; for an integrator the same again downwards.

    The small ones are at least the `fewest`.
    """
    for large in _LARGE:
        for back in _BACK:
            if fewest <= back < large:
                small, rest = [-1.0] * back, float(large - back)
                yield [float(large), *small, -rest - large, *(-x for x in small), rest] if integrating else \
                    [float(large), *small, -rest]


def _round_up(seconds: float, step_s: float) -> float:
    """The next whole number of samples, of two digits where that is one."""
    unit = 10.0 ** max(math.floor(math.log10(seconds)) - 1, 0)
    return math.ceil(math.ceil(seconds / unit - 1e-9) * unit / step_s - 1e-9) * step_s


def _vary_answer(e: Estimate, answer: ValveAnswer) -> list[tuple[float, float]]:
    """S and J of an answer, and its S at both ends of the interval as far as that is believed; J in proportion."""
    if answer.S == 0.0 or e.S_interval is None:
        return [(answer.S, answer.J)]
    return [(f * answer.S, f * answer.J) for f in (1.0, *_ends(1.0, (e.S_interval[0] / e.S, e.S_interval[1] / e.S)))]


def _ends(value: float, interval: tuple[float, float] | None) -> tuple[float, float]:
    """The smallest and the largest size of a number in its interval, as far as that is believed, with its sign."""
    if interval is None:
        return value, value
    low, high = sorted(float(np.clip(x / value, 1.0 / _UNSURE, _UNSURE)) for x in interval)
    return low * value, high * value


def _least_ratio(plant: _Plant, answers: Sequence[ValveAnswer], output: FloatArray, part_s: float) -> float:
    """Least expected likelihood ratio of two answers; 0 where friction would explain too little of PV.

    A valve that follows has to deny a small S as well.
    """
    least = np.inf
    for true, other in permutations(answers, 2):
        truth = plant.lanes(_vary_answer(plant.estimate, true) if other.S == 0.0 else [(true.S, true.J)])
        rivals = plant.lanes([(other.S, other.J)], wide=True)
        if true.S == 0.0:
            S = _DENIED * float(np.ptp(output))
            small = plant.lanes([(S, share * S) for share in (0.0, 0.5, 1.0)], (0.0,), wide=True)
            rivals = np.concatenate([rivals, small], axis=1)
        error = plant.left(output, part_s, truth, rivals)
        if other.S == 0.0 and (error**2).mean(axis=-1).min() < _SHOWN * plant.error**2:
            return 0.0
        least = min(least, plant.ratio(error, part_s))
        if least < NEEDED:
            break
    return least


def _within_limits(values: FloatArray, limits: Limits, margin: float = 0.0) -> bool:
    return bool(limits[0] <= values.min() - margin and values.max() + margin <= limits[1])


def _wide_limits(signal: FloatArray) -> Limits:
    """Limits assumed for a signal (n,): its mean and twice its span in the record."""
    half = 0.5 * _ALLOWED * float(np.ptp(signal))
    return float(f"{signal.mean() - half:.4g}"), float(f"{signal.mean() + half:.4g}")


def _other_record(study: Study, loop: Loop) -> str:
    """The record that would do where no test is possible: its length, or its sampling, in words."""
    ratio = study.verdict.evidence.likelihood_ratio or 0.0
    length_s, period_s = float(loop.driven.sum()) * loop.step_s, study.range.period_median_s
    times = NEEDED / ratio if ratio > 0.0 else np.inf
    if 1.0 < times <= _MOST_RECORDS:
        return (f"a record in automatic of {_round_up(times * length_s, loop.step_s):g} s, {times:.2g} times this one: "
                "what it tells grows with its length")
    if period_s is not None and period_s < _FINE * loop.step_s:
        return f"an export every {period_s / _FINE:.2g} s or faster, with setpoint moves"
    return "the measured position of the valve: PV alone tells too little, however long the record"
