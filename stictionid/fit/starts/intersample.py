"""Tests, refits and uncertainty for a command that may move between its samples instead of being held.

y shows such a motion only where nothing else is missing: a lag rounds the slips as a moving command does. The command
itself may show it: one without any of the noise of y was not computed from these samples of y. Source: docs/details.md,
section 6.4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...model.model import Model
from ...model.segments import rebind_model
from ...model.spec import Evaluated, Spec
from ...numerics.population import Found
from ...process.intersample import CORNER
from ...process.rounded import step_of, thinned_output
from ...process.scan import SLOWEST_SCAN_S, ran_with_samples
from ...record.loop import Loop, bridged
from ...record.oscillation import noise_of
from ...typing import FloatArray
from ..points.moves import descend_model, with_start

# Parts of a sampling interval when the command moves between samples.
SUBSTEPS = 4
# Sample-to-sample noise of the command, as a share of its swing, above which nothing is rebuilt between samples.
_ROUGH = 2e-3
# Ratio of two sample-to-sample noises, of the command and of y, each as a share of its swing. Below it the controller
# did not see the samples of y. Purely integral control gives about four over the samples of a period, a filter about
# one over its samples. Measured: 1e-11 to 0.07 without scans (above 0.007 only at corners of an integrator), 0.15 and
# more with scans.
_UNSEEN = 0.01
# Share of the swings' ratio with which the command answers the noise of y, up to which the controller did not see it.
# Measured on 117 loops of benchmarks/plants (P, PI, PID, gap; noise of four kinds; exports at every scan to every
# tenth; rounded and not): scanned 0.21 to 4.8, moving 0 to 0.083 where the fastest changes of y are noise, but for one
# under a random walk. Then the same for their correlation, rounding left out: a filter of y, or an integral part alone,
# answers with little gain, but shares the noise (0.9 and more).
_ANSWERED, _APART = 0.1, 0.4
# Errors of that share that count beside it, and factor of its error: third differences of white noise correlate.
_ERRORS, _CORRELATED = 2.0, 1.52
# Largest share of rounding in the variance of y's noise: the controller may see y before it is rounded.
_ROUNDING = 0.5
# The same correlation from which the controller saw the noise in the samples of y, and so ran with them: 0.79 and more
# on 16 loops exported at the scan, 0.12 to 0.79 on 28 of 33 continuous ones under a load that wanders. Then the
# correlation of neighbouring fastest changes of y up to which they are noise (-0.75 for white noise; 31 of 35 scanned
# loops and 31 of 34 moving ones lie below, a fast y without noise at 0).
_SEEN, _ALTERNATES = 0.75, -0.55
# Noise of y, as a share of its swing, from which its fastest changes are noise.
_NOISY = 5e-4
# Multiple of the median beyond which a change is none of noise; fewest samples for a correlation.
_CLIPPED, _FEW = 5.0, 100
# Share of the largest change up to which the middle one is that of straight lines between corners.
_LINES = 1e-6
# Share of the third differences of a command that measure its noise. The largest fifth is left out, because it may come
# from corners. Unit: 1.
_NOT_CORNERS = 0.8
# Mean of the smallest 80 % of the absolute values of normal noise. Unit: its standard deviation.
_MEAN_OF_NORMAL = 0.5586
# Share of samples without a change of the command above which its noise can't be measured. Unit: 1.
_UNCHANGED = 0.5
# Fewer samples give no useful quantile.
_FEWEST = 20
# Error of a rebuilt command at slips, as a share of its move from sample to sample (benchmarks/verdicts.py, seeds below
# 1000).
_REBUILT = 0.35
# A short descent: its turns, and the fall of the cost at which it has settled.
QUICK_TURNS, QUICK_SETTLE = 8, 1e-3


def may_move(loop: Loop) -> bool:
    """True where the command may have moved between samples and is smooth enough to be rebuilt there.

    A noisy command has no corners to find. Rounding is no such noise. A historian that thinned it made its own corners.
    """
    if thinned_output(loop) is not None:
        return False
    u = loop.output[loop.driven]
    # (rounding to a step is uniform in each)
    noise = float(np.sqrt(max(noise_of(u)**2 - step_of(loop.output)**2 / 12.0, 0.0)))
    return noise < _ROUGH * float(np.ptp(u)) and not ran_with_samples(loop)


def surely_moves(loop: Loop) -> bool:
    """True where the command certainly moved between samples: it does not answer the sample-to-sample noise of y.

    No controller computes such a command from these samples. False where y has no noise, but for a record slower than
    every usual scan, where the command is compressed, and where it does not change in half of the samples. Wrong for a
    purely integral controller whose output is rounded to more than it moves by noise.
    """
    u, y = loop.output[loop.used], loop.process_value[loop.used]
    swings = float(np.ptp(u)), float(np.ptp(y))
    if u.size < _FEWEST or not min(swings) > 0.0 or float(np.mean(np.diff(u) == 0.0)) > _UNCHANGED:
        return False
    fastest, noise_of_y = np.sort(np.abs(np.diff(u, 3))), noise_of(y)
    noise = float(np.mean(fastest[:int(_NOT_CORNERS * fastest.size)])) / _MEAN_OF_NORMAL / np.sqrt(20.0)
    unseen = noise < _UNSEEN * swings[0] * noise_of_y / swings[1]
    noisy = noise_of_y >= _NOISY * swings[1] and step_of(y)**2 / 12.0 <= _ROUNDING * noise_of_y**2
    slow = loop.step_s > SLOWEST_SCAN_S
    return (unseen or ((noisy or slow) and _answers_no_noise(loop, swings[1] / swings[0]))) and may_move(loop)


def _answers_no_noise(loop: Loop, ratio: float) -> bool:
    """True where the fastest changes of the command are none of those of y times a gain; `ratio` is one over a gain."""
    u, y = _fastest_changes(loop)
    if not u.size:
        return False
    apart = _least_correlation(loop, u, _APART)
    gain = float(u @ y) / float(y @ y)
    left = u - gain * y
    error = _CORRELATED * float(np.sqrt((left @ left) / (y @ y) / u.size))
    return abs(_correlation(u, y)) < apart and ratio * (abs(gain) + _ERRORS * error) < _ANSWERED


def surely_scanned(loop: Loop) -> bool:
    """True where the command was computed from these samples of y: its fastest changes are those of the noise of y.

    A course between such samples would tell a model the noise of the next y before it comes. False where the fastest
    changes of y are no noise: a command that moves follows them just as closely.
    """
    if ran_with_samples(loop):
        return True
    fast = np.diff(loop.process_value[loop.used], 3)
    if fast.size < _FEW or not np.ptp(fast) > 0.0:
        return False
    most = _CLIPPED * float(np.median(np.abs(fast)))
    fast = np.clip(fast, -most, most) if most else fast
    if _correlation(fast[1:], fast[:-1]) > _ALTERNATES:
        return False
    u, y = _fastest_changes(loop)
    return u.size > 0 and abs(_correlation(u, y)) >= _least_correlation(loop, u, _SEEN)


def _least_correlation(loop: Loop, u: FloatArray, exact: float) -> float:
    """The correlation of fastest changes that counts as `exact` does without rounding, and is none of chance.

    Third differences `u` (k,) of the command have 20 times the variance of its rounding, which is no answer to y.
    """
    own = max(1.0 - 20.0 / 12.0 * step_of(loop.output)**2 / float(np.mean(u * u)), 0.0)
    return max(exact * float(np.sqrt(own)), _ERRORS * _CORRELATED / float(np.sqrt(u.size)))


def _correlation(a: FloatArray, b: FloatArray) -> float:
    return float(np.corrcoef(a, b)[0, 1])


def _fastest_changes(loop: Loop) -> tuple[FloatArray, FloatArray]:
    """Third differences (k,) of the command and of y, setpoint moves and large changes left out; empty for too few."""
    fast = [np.diff(x, 3) for x in (bridged(loop.output), bridged(loop.process_value))]
    good = np.convolve(loop.used, np.ones(4), "valid") > 3.5
    none = np.empty(0), np.empty(0)
    if loop.setpoint is not None:
        still = np.diff(bridged(loop.setpoint), 3) == 0.0
        good &= still if np.count_nonzero(still & good) >= _FEW else good
    if not good.any() or any(np.median(np.abs(x[good])) <= _LINES * np.max(np.abs(x[good])) for x in fast):
        return none
    for x in fast:
        good &= np.abs(x) <= _CLIPPED * np.median(np.abs(x[good]))
    u, y = (x[good] for x in fast)
    return (u, y) if u.size >= _FEW and np.ptp(u) > 0.0 and np.ptp(y) > 0.0 else none


def as_moving(spec: Spec) -> Spec:
    """The same spec under a command that moves between samples."""
    return replace(spec, between=CORNER, substeps=SUBSTEPS)


def let_command_move(held: Model, values: FloatArray, moving: Spec) -> Found:
    """The result of a short descent with a command that moves between samples, from values (d,) found with a held one.
    """
    spec = held.spec
    model = rebind_model(held, replace(moving, process=spec.process, increments=spec.increments, taps=spec.taps),
                         held.context.residual)
    starts = values[:, None].repeat(3, axis=1)
    starts[4] = np.maximum(starts[4] + model.step_s * np.array([0.0, 0.5, 1.0]), 0.0)
    return descend_model(model, with_start(model, model.cube(starts)), turns=QUICK_TURNS, settle=QUICK_SETTLE)


def between_samples(model: Model, best: Evaluated) -> float:
    """Uncertainty of S and J in % from slips between two samples, where the command is not known.

    A record as fast as the scans of a DCS knows its command. A slower one knows the command at a slip to within its
    move from one sample to the next. A command rebuilt between samples (or at the scans there) is known to a share of
    that move.
    """
    share = _REBUILT if model.spec.between != "hold" else 1.0 if model.step_s > SLOWEST_SCAN_S else 0.0
    moves = []
    for position, output in zip(model.split(best.stem), model.split(model.loop.output), strict=True):
        moved = np.abs(np.diff(position)) > 1e-9
        moves.append(np.abs(np.diff(output))[np.flatnonzero(moved[1:] & ~moved[:-1]) + 1])
    slips = np.concatenate(moves)
    return share * float(np.median(slips)) if slips.size and share else 0.0
