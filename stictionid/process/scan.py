"""Controller output at the scans between the samples of a slow export, for example a 1 s scan exported every 10 s.

The controller is a PI law of r and y; its gain and integral time are read from the changes of u from sample to sample.
Between two samples y is unknown, but u gives its mean: the integral part grew by exactly the errors of those scans.
The error there is a cubic through the samples around, plus a parabola that makes that mean right. The PI law turns it
into the output of every scan.

The response of a fitted model describes y between samples better than a cubic does, because y has a kink where the
response to a slip arrives. With that response given as `course` the command is more exact. Measured against the true
scans, the error is a tenth of their noise where every second scan is exported. For slower exports it is as large as
the noise, which can't be recovered.

Without a setpoint, or where the controller is no PI law, the output is rebuilt from its own corners
(process/intersample.py) at the instants of the scans. Wrong where the controller filters y or has a derivative, and
where the valve moves more than once between two samples. Source: docs/details.md, section 6.4; positional PI algorithm
with rectangular integration, one step a scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..record.loop import Loop, bridged
from ..record.oscillation import noise_of
from ..typing import BoolArray, FloatArray
from .intersample import CORNER, MOVES_ALWAYS, kicks, rebuild
from .smooth import smoothed

# Name of this mode between samples (`MODES` of intersample.py holds the others).
DECIMATED = "decimated"
# Longest scan of a usual DCS in seconds: a slower record does not show every scan.
SLOWEST_SCAN_S = 2.0
# Largest number of scans rebuilt between two samples; slower exports are rebuilt at every tenth of a sample.
MOST_PARTS = 10
# Largest share of the variance of the output's changes that a PI law may leave unexplained. Unit: 1.
_PI_LEAVES = 0.1
# Largest ratio of unexplained variances, PI law at the samples to PI law between them, for a controller that ran with
# the samples. Measured for such a controller: 0 against 1e-6 to 1e-4 unexplained. Measured for one that ran between
# the samples: ratio 0.9 to 1.5. Unit: 1.
_EXACT = 0.25
_FEWEST_CHANGES = 20
# Largest share of the variance of the output's changes that a proportional law may leave, for rounding. Unit: 1.
_P_LEAVES = 0.02
# F value of the integral part, with one degree of freedom, from which a law has one: chance reaches it in 1 of 1e4.
_INTEGRAL = 15.0
# Least t value of the gains with which u follows setpoint moves, or the error and its sum: for moves 21 or more on 81
# loops of benchmarks/plants, 7 on a real loop that wanders. Least share of the energy of these moves that y does not
# follow. Unit: 1.
_KICKS, _TRACKS = 10.0, 1e-6
# What a PI law that ran with the samples leaves of the changes of u at the most, as a share of their variance.
_NOTHING = 1e-8


@dataclass(frozen=True, slots=True)
class PiLaw:
    """PI law read from sampled r, y and u: gain (% per unit of e), per scan too, and share of the changes explained."""

    gain: float
    per_scan: float
    fit: float


def parts_of(step_s: float, scan_s: float) -> int:
    """Number of scans rebuilt in one sampling interval; 1 where the record is as fast as its scan."""
    return int(np.clip(round(step_s / scan_s), 1, MOST_PARTS))


def command_at_scans(loop: Loop, parts: int, course: FloatArray | None = None) -> FloatArray:
    """Command at `parts` scans from each sample to the next, shape (n*parts,); the last sample is held.

    `course` (n*parts,) is y at the scans as far as it is known, up to a smooth remainder. Every scan has noise of its
    own. So what the noise of a row did to the output is in that row only, and in the sum of a PI law behind it.
    """
    u = bridged(loop.output)
    law = pi_law(loop, parts, course) or p_law(loop)
    if parts == 1:
        return rebuild(u, parts, CORNER, loop.setpoint)
    if law is None:
        jumps, late = kicks(u, loop.setpoint)
        level = np.cumsum(jumps)
        scans = rebuild(level + smoothed(u - level), parts, CORNER, loop.setpoint, peaks=False).reshape(-1, parts)
        at = np.flatnonzero(_untold(jumps, late))
        scans[at - 1, parts - parts // 2:] += jumps[at, None]
        return _with_rows(scans, u)
    y = bridged(loop.process_value) - (0.0 if course is None else course[::parts])
    # (the sum of a PI law tells the noise at a single scan between two rows)
    noise = np.zeros(u.size) if law.per_scan and parts == 2 else y - smoothed(y)
    e, between, moved = _errors(loop, parts, course, noise)
    calm = u + law.gain * noise
    missing = _missing(law, calm, e, between.sum(axis=1) - noise[1:])
    # A setpoint that moved between two samples is moved at the first scan from which it makes the mean right. As far as
    # the law does not tell that, it is moved in the middle.
    tells, middle = _told_share(law, moved, missing, parts), 0.5 * (parts - 1)
    for k in np.flatnonzero(moved).tolist():
        early = int(np.clip(round(middle + tells[k] * (missing[k] / moved[k] - middle)), 0, parts - 1))
        between[k, parts - 1 - early:parts - 1] += moved[k]
        missing[k] -= early * moved[k] if law.per_scan else 0.0
    missing *= _trusted_share(missing, parts * noise_of(bridged(loop.process_value)))
    s = np.arange(1, parts + 1) / parts
    bubble = s * (1.0 - s)
    between += (missing / bubble.sum())[:, None] * bubble
    integral = calm[:-1, None] - law.gain * e[:-1, None] + law.per_scan * np.cumsum(between, axis=1)
    rebuilt = integral + law.gain * between
    rebuilt += (calm[1:] - rebuilt[:, -1])[:, None] * s
    out = np.empty((u.size, parts))
    out[:-1, 1:] = rebuilt[:, :-1]
    return _with_rows(out, u)


def late_moves(loop: Loop, parts: int, *, held: bool) -> FloatArray:
    """Standard deviation (n*parts,) of the time at which a command moves with its setpoint, in parts of a sample.

    It is that of all parts up to a row that shows such a move, and 0 elsewhere. A sample tells only that the setpoint
    moved since the last one. The sum of a PI law tells when, as well as it is met in samples without such moves; where
    a command moves all the time, its slopes behind the kicks do. Without these it is anywhere in the sample, but for
    a record that may show every scan of a controller whose command moves.
    """
    found = np.zeros((loop.output.size, parts))
    if loop.setpoint is None or parts == 1 or not (held or loop.step_s > SLOWEST_SCAN_S):
        return found.ravel()
    u = bridged(loop.output)
    law = (pi_law(loop, parts) or p_law(loop)) if held else None
    if law:
        e, between, moved = _errors(loop, parts, None)
        missing = _missing(law, u, e, between.sum(axis=1))
        late = np.where(moved != 0.0, 1.0 - _told_share(law, moved, missing, parts), 0.0)
    else:
        late = _untold(*kicks(u, loop.setpoint))[1:].astype(float)
    late = np.sqrt(_spread_of_moves(parts) * late)
    found[:-1, 1:], found[1:, 0] = late[:, None], late
    return found.ravel()


def _untold(jumps: FloatArray, late: FloatArray) -> BoolArray:
    """Samples (n,) with a jump whose time within the sample the slopes do not tell (`kicks`)."""
    return (jumps != 0.0) & (late == 1.0).all()


def _spread_of_moves(parts: int) -> float:
    """Variance of an instant that may be any of the scans of a sample."""
    return (parts**2 - 1.0) / 12.0


def _missing(law: PiLaw, command: FloatArray, error: FloatArray, summed: FloatArray) -> FloatArray:
    """Sums (n-1,) of errors that the changes of a command (n,) show beyond those `summed`; zeros for a P law."""
    changes = np.diff(command) - law.gain * np.diff(error) - law.per_scan * summed
    return changes / law.per_scan if law.per_scan else np.zeros(changes.size)


def _told_share(law: PiLaw, moved: FloatArray, missing: FloatArray, parts: int) -> FloatArray:
    """Share (n-1,) in which the sum of a law tells when a setpoint moved, beside the middle of the sample."""
    still = missing[moved == 0.0]
    if not law.per_scan or not still.size:
        return np.zeros(moved.size)
    spread = _spread_of_moves(parts) * moved**2
    return spread / np.maximum(spread + float(np.mean(still**2)), np.finfo(float).tiny)


def _with_rows(scans: FloatArray, rows: FloatArray) -> FloatArray:
    """A command (n, parts) with the recorded one (n,) at its rows, and held behind the last; flat."""
    scans[:, 0], scans[-1, 1:] = rows, rows[-1]
    return scans.ravel()


def hidden_noise(loop: Loop, parts: int) -> float | None:
    """Standard deviation in % of what the noise of PV does to the output at scans in no sample; None without a law.

    A P or PI law passes it on by its gain. What it does to the sum of a PI law shows in the next sample.
    """
    law = pi_law(loop, parts) or p_law(loop)
    return None if law is None else abs(law.gain) * noise_of(bridged(loop.process_value))


def unseen_noise(loop: Loop, parts: int) -> float:
    """Standard deviation in % of what noise at one scan in no sample does to the output, where no sample tells it.

    Every sample tells the sum of a PI law, and with it the mean of that noise. Without a law the noise of the output
    from sample to sample is that of a scan.
    """
    law = pi_law(loop, parts)
    if law is None:
        return hidden_noise(loop, parts) or noise_of(bridged(loop.output))
    return abs(law.gain) * noise_of(bridged(loop.process_value)) * float(np.sqrt((parts - 2) / (parts - 1)))


def _trusted_share(missing: FloatArray, likely: float) -> float:
    """Share in which sums of the control error between samples are taken from the integral part of a law.

    The noise of y in that many scans, `likely`, bounds what can be true of them. The rest is rounding of u, or a law
    that is not quite the controller's, over a small integral part.
    """
    found = float(np.mean(missing**2))
    return min(likely * likely / found, 1.0) if found > 0.0 else 1.0


def p_law(loop: Loop) -> PiLaw | None:
    """Proportional law at the samples, exact up to rounding; None where r is unknown or u needs more than that.

    It holds at any scan, so that it does not tell the scan of the controller.
    """
    if loop.setpoint is None:
        return None
    good = _measured_intervals(loop, 1)
    error = np.diff(bridged(loop.setpoint) - bridged(loop.process_value))[good]
    change = np.diff(bridged(loop.output))[good]
    energy = float(change @ change)
    if change.size < _FEWEST_CHANGES or not energy > 0.0 or not float(error @ error) > 0.0:
        return None
    gain = float(error @ change / (error @ error))
    fit = 1.0 - float(np.sum((change - gain * error) ** 2)) / energy
    return PiLaw(gain, 0.0, fit) if fit >= 1.0 - _P_LEAVES else None


def pi_law(loop: Loop, parts: int, course: FloatArray | None = None) -> PiLaw | None:
    """PI law of the controller that made u, with `parts` scans a sample; None where u follows no such law."""
    if loop.setpoint is None:
        return None
    e, between, moved = _errors(loop, parts, course)
    good = _measured_intervals(loop, parts) & (moved == 0.0)
    design = np.stack([np.diff(e), between.sum(axis=1)], axis=1)[good]
    change = np.diff(bridged(loop.output))[good]
    energy = float(change @ change)
    if change.size < _FEWEST_CHANGES or not energy > 0.0:
        return None
    sizes, *_ = np.linalg.lstsq(design, change, rcond=None)
    rest = change - design @ sizes
    fit = 1.0 - float(rest @ rest) / energy
    if fit < 1.0 - _PI_LEAVES or sizes[0] * sizes[1] <= 0.0 or not _integrates(design, sizes, rest, change):
        return None
    return PiLaw(float(sizes[0]), float(sizes[1]), fit)


def _integrates(design: FloatArray, sizes: FloatArray, rest: FloatArray, change: FloatArray) -> bool:
    """True where the integral part of a law explains more than rounding errors of the numbers would."""
    gain = float(design[:, 0] @ change / (design[:, 0] @ design[:, 0]))
    without = change - gain * design[:, 0]
    return float(without @ without) > max((1.0 + _INTEGRAL / change.size) * float(rest @ rest),
                                          np.finfo(float).eps * float(change @ change))


def _measured_intervals(loop: Loop, parts: int) -> BoolArray:
    """Intervals (n-1,) of which y is measured at both ends and, for `parts` in between, at the samples beside them."""
    assert loop.used is not None
    good = loop.used[1:] & loop.used[:-1]
    if parts > 1:
        known = np.isfinite(loop.process_value)
        good[1:] &= known[:-2]
        good[:-1] &= known[2:]
    return good


def ran_with_samples(loop: Loop) -> bool:
    """True where a PI law of the sampled r and y gives u exactly: the controller ran with the samples and held u.

    No other evidence is beyond doubt: where an effect is missing in the model, y does not show the course of u between
    samples. False where rounding, a derivative or a filter hides the law.
    """
    with_them = pi_law(loop, 1)
    if with_them is None:
        return False
    if np.count_nonzero(_measured_intervals(loop, MOST_PARTS)) < _FEWEST_CHANGES:
        # PV is missing too often for a law between the samples to be held against it.
        return 1.0 - with_them.fit <= _NOTHING
    return _law_is_exact(with_them, pi_law(loop, MOST_PARTS))


def answers(loop: Loop) -> float:
    """Sign of the process gain, 1 or -1, taken from the controller's; 0 where u shows neither a law nor setpoint moves.

    The two signs agree in every loop with negative feedback. A model of u and y may take the controller for the
    process, which has the other sign.
    """
    law = pi_law(loop, 1)
    return _kick_sign(loop) or _integral_sign(loop) if law is None else float(np.sign(law.gain))


def _integral_sign(loop: Loop) -> float:
    """Sign with which u follows the error at once and in its sum; 0 where chance may make either.

    A derivative, a filter or unseen scans hide the law, but not these two signs. A process that answers u at once shows
    no sum.
    """
    if loop.setpoint is None:
        return 0.0
    error = bridged(loop.setpoint) - bridged(loop.process_value)
    good = _measured_intervals(loop, 1) & (np.diff(bridged(loop.setpoint)) == 0.0)
    design = np.stack([np.diff(error), error[1:] + error[:-1]], axis=1)[good]
    change = np.diff(bridged(loop.output))[good]
    moments = design.T @ design
    if change.size < _FEWEST_CHANGES or not np.linalg.cond(moments) < 1.0 / np.finfo(float).eps:
        return 0.0
    sizes = np.linalg.solve(moments, design.T @ change)
    rest = change - design @ sizes
    spread = np.sqrt(np.diag(np.linalg.inv(moments)) * float(rest @ rest) / change.size)
    sure = (np.abs(sizes) > _KICKS * spread).all() and sizes[0] * sizes[1] > 0.0
    return float(np.sign(sizes[0])) if sure else 0.0


def _kick_sign(loop: Loop) -> float:
    """Sign with which u follows moves of the setpoint at once, whatever y does; 0 where it does not follow them."""
    if loop.setpoint is None:
        return 0.0
    good = _measured_intervals(loop, 1)
    setpoint, y, change = (np.diff(bridged(x))[good] for x in (loop.setpoint, loop.process_value, loop.output))
    # Regression on both: moves of setpoint and u less what y tells of them.
    moves, change = (x - y * float(x @ y) / max(float(y @ y), np.finfo(float).tiny) for x in (setpoint, change))
    energy = float(moves @ moves)
    # In manual a setpoint may track y.
    if change.size < _FEWEST_CHANGES or not energy > _TRACKS * float(setpoint @ setpoint):
        return 0.0
    size = float(moves @ change) / energy
    left = change - size * moves
    return float(np.sign(size)) if size**2 * energy * change.size > _KICKS**2 * float(left @ left) else 0.0


def ran_between(loop: Loop, parts: int) -> bool:
    """True where u follows a PI law that ran `parts` times a sample, and not one that ran with the samples exactly."""
    between, with_them = pi_law(loop, parts), pi_law(loop, 1)
    return between is not None and not (with_them is not None and _law_is_exact(with_them, between))


def scans_between_samples(loop: Loop, scan_s: float) -> bool:
    """True where a controller that scans every `scan_s` seconds moved the output between samples, unseen by them."""
    return parts_of(loop.step_s, scan_s) > 1 and not ran_with_samples(loop)


def _law_is_exact(with_samples: PiLaw, between: PiLaw | None) -> bool:
    """True where the PI law at the samples explains the changes of u far better than the one between them."""
    # Without a PI law between the samples, the largest share that one may leave takes its place.
    return 1.0 - with_samples.fit <= _EXACT * (_PI_LEAVES if between is None else 1.0 - between.fit)


def _errors(loop: Loop, parts: int, course: FloatArray | None,
            noise: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Control error at the samples (n,) and at the scans up to the next one (n-1, parts), and moves of r (n-1,).

    The error is that of y without a `noise` (n,).
    The remainder of y beside `course` follows cubics through four samples. Straight lines make the integral of a
    curved error too small, and with it the integral time of the law (5 % in one case). A setpoint that moves now and
    then is held up to the next sample, and the moves returned are not zero there. One that moves all the time follows
    cubics as well.
    """
    assert loop.setpoint is not None
    r, y = bridged(loop.setpoint), bridged(loop.process_value) - noise
    moved = np.diff(r)
    known = np.zeros((y.size, parts)) if course is None else course.reshape(y.size, parts)
    smooth = y - known[:, 0]
    if np.mean(moved != 0.0) > MOVES_ALWAYS:
        moved, smooth = np.zeros(moved.size), smooth - r
        between = -_cubics(smooth, parts)
    else:
        between = r[:-1, None] - _cubics(smooth, parts)
        between[:, -1] += moved
    between[:, :-1] -= known[:-1, 1:]
    between[:, -1] -= known[1:, 0]
    return r - y, between, moved


def _cubics(signal: FloatArray, parts: int) -> FloatArray:
    """A signal (n,) at `parts` points up to each next sample (n-1, parts), on cubics through four samples."""
    s = np.arange(1, parts + 1) / parts
    padded = np.concatenate([[2.0 * signal[0] - signal[1]], signal, [2.0 * signal[-1] - signal[-2]]])[:, None]
    a, b, c, d = padded[:-3], padded[1:-2], padded[2:-1], padded[3:]
    return (s * (s - 1.0) * (-a * (s - 2.0) + d * (s + 1.0)) / 6.0
            + (s + 1.0) * (s - 2.0) * (b * (s - 1.0) - c * s) / 2.0)
