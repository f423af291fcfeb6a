"""Exports slower than the controller's scan: the output rebuilt at the scans, the choice of it, and its limits.

Studies of rebuilt scans, and of scans that noise hides, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from stictionid.errors import UsageError
from stictionid.fit.starts.intersample import surely_moves, surely_scanned
from stictionid.methods.option_check import check_options
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.process.scan import (
    MOST_PARTS,
    answers,
    command_at_scans,
    late_moves,
    parts_of,
    pi_law,
    ran_between,
    ran_with_samples,
)
from stictionid.record.loop import Loop
from stictionid.verbs.identify import Options, identify

SETTING = Setting(Plant(1.5, 12.0, 8.0), Controller(0.45, 12.0, scan_s=1.0), 3.0, 1.5, duration_s=2000.0,
                  setpoint_moves=((0.0, 3.0),))

# The base alone, without the intervals.
POINTS = Options(base_only=True, intervals=False)


def thinned(keep: int, setting: Setting = SETTING, seed: int = 1) -> tuple[Loop, np.ndarray]:
    """One scan in `keep` of a 1 s record, and the output at all scans up to its last sample."""
    loop = simulate(setting, seed=seed).loop
    part = slice(None, None, keep)
    kept = replace(loop, output=loop.output[part], process_value=loop.process_value[part], used=loop.used[part],
                   setpoint=loop.setpoint[part], position=None, step_s=loop.step_s * keep)
    return kept, loop.output[:(kept.samples - 1) * keep + 1]


def test_the_law_of_the_controller_is_read_from_every_fifth_scan() -> None:
    law = pi_law(thinned(5)[0], 5)
    assert law.gain == pytest.approx(0.45, rel=1e-3) and law.per_scan == pytest.approx(0.45 / 12.0, rel=0.01)
    assert law.fit > 0.999


def test_every_second_scan_tells_the_other() -> None:
    noisy = replace(SETTING, noise_sd=0.1)
    loop, true = thinned(2, noisy)
    law = pi_law(loop, 2)
    error = command_at_scans(loop, 2)[:true.size] - true
    assert np.std(error) < 0.15 * law.gain * 0.1  # the noise of a scan alone moves the output by 0.045 %


def test_the_course_of_y_between_samples_makes_the_command_better() -> None:
    loop, true = thinned(5)
    full = simulate(SETTING, seed=1).loop.process_value
    course = np.append(full, np.full(loop.samples * 5 - full.size, full[-1]))
    plain, known = (np.std(command_at_scans(loop, 5, c)[:true.size] - true) for c in (None, course + 7.0))
    assert known < 0.05 * plain and plain < 0.1 * np.std(np.repeat(loop.output, 5)[:true.size] - true)


def test_a_setpoint_that_moves_between_samples_is_placed_at_its_scan() -> None:
    moving = replace(SETTING, setpoint_moves=((0.0, 3.0), (503.0, -4.0), (1001.0, 4.0), (1499.0, -2.0)))
    loop, true = thinned(5, moving)
    # A scan off costs the whole move.
    assert np.abs(command_at_scans(loop, 5)[:true.size] - true).max() < 0.3 * 0.45 * 4.0


def moved_at(loop: Loop, keep: int) -> np.ndarray:
    """Commands of a grid at which a sample shows a move of the setpoint, and those back to the sample before."""
    rows = np.flatnonzero(np.diff(loop.setpoint)) + 1
    return np.unique(rows[:, None] * keep - np.arange(keep))


@pytest.mark.parametrize("seed", [1, 2])
def test_a_setpoint_under_a_law_without_a_sum_is_moved_in_the_middle_and_may_have_come_anywhere(seed: int) -> None:
    moves = tuple((100.0 * k + 37.0 * k % 11, 3.0 * (-1)**k) for k in range(18))
    proportional = replace(SETTING, controller=Controller(0.6, 1e9, scan_s=1.0), setpoint_moves=moves)
    loop, true = thinned(5, proportional, seed)
    error, near = command_at_scans(loop, 5)[:true.size] - true, moved_at(loop, 5)
    # A move comes up to two scans early or late, so that scans in which the command lacks it are rare, but wholly off.
    lacks = np.abs(error) > 0.5 * 0.6 * 3.0
    assert 0 < lacks.sum() <= 2 * len(moves) and np.isin(np.flatnonzero(lacks), near).all()
    late = late_moves(loop, 5, held=True)
    np.testing.assert_allclose(late[near], np.std(np.arange(5)))
    assert np.count_nonzero(late) == near.size
    # So may a jump of a command that moves all the time, unless the record may show every scan.
    noisy, _ = thinned(5, replace(proportional, noise_sd=0.05), seed)
    np.testing.assert_array_equal(late_moves(noisy, 5, held=False), late)
    assert not late_moves(replace(noisy, step_s=2.0), 5, held=False).any()
    # The sum of a PI law tells the scan, where no noise hides it.
    for noise, least, most in ((0.0, 0.0, 0.1), (0.4, 0.3, 1.3)):
        known, _ = thinned(5, replace(SETTING, setpoint_moves=moves, noise_sd=noise), seed)
        assert least <= late_moves(known, 5, held=True)[moved_at(known, 5)].mean() < most


def test_without_a_law_the_corners_are_what_is_left() -> None:
    loop, _ = thinned(5)
    blind = replace(loop, setpoint=None)
    assert pi_law(blind, 5) is None and command_at_scans(blind, 5).size == 5 * loop.samples
    assert (parts_of(10.0, 1.0), parts_of(60.0, 1.0), parts_of(1.0, 1.0), parts_of(10.0, 5.0)) == (10, 10, 1, 2)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_setpoint_moves_tell_the_sign_of_a_controller_that_is_no_pi_law(sign: float) -> None:
    """A gap controller on a noisy y, of either action; no sign where r has nothing to do with u, or tracks y."""
    rng, n = np.random.default_rng(1), 800
    r = np.cumsum(np.where(rng.random(n) < 0.02, rng.choice([-2.0, 2.0], n), 0.0))
    y = np.convolve(r, np.full(20, 0.05))[:n] + 0.3 * rng.standard_normal(n)
    e = r - y
    u = 50.0 + sign * np.where(np.abs(e) < 0.4, 0.3, 1.5) * e
    loop = Loop(output=u, process_value=y, setpoint=r)
    assert pi_law(loop, 1) is None and answers(loop) == sign
    assert answers(replace(loop, output=rng.permutation(u))) == 0.0
    assert answers(replace(loop, setpoint=y)) == answers(replace(loop, setpoint=None)) == 0.0


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_an_error_and_its_sum_tell_the_sign_of_a_controller_that_hides_its_law(sign: float) -> None:
    """A PI controller whose output has noise of its own; no sign for a process that answers steps of u at once."""
    rng, n = np.random.default_rng(2), 1500
    y = np.convolve(rng.standard_normal(n), 0.9 ** np.arange(40))[:n]
    u = 50.0 - sign * (1.2 * y + 0.1 * np.cumsum(y)) + 0.5 * rng.standard_normal(n)
    loop = Loop(output=u, process_value=y, setpoint=np.zeros(n))
    assert pi_law(loop, 1) is None and answers(loop) == sign
    steps = 50.0 + np.repeat(rng.standard_normal(n // 30), 30)
    by_hand = Loop(output=steps, process_value=2.0 * steps + 0.1 * rng.standard_normal(n), setpoint=np.zeros(n))
    assert answers(by_hand) == answers(replace(loop, output=rng.permutation(u))) == 0.0


def test_a_controller_that_scans_with_the_samples_is_not_taken_apart() -> None:
    slow = replace(SETTING, step_s=5.0, controller=replace(SETTING.controller, scan_s=5.0), noise_sd=0.02)
    study = identify(simulate(slow, seed=1).loop, options=POINTS)
    assert study.steps[0].model["between"] == "hold"


def test_options_that_do_not_fit_are_refused() -> None:
    loop, _ = thinned(1)
    with pytest.raises(UsageError, match="no slower than"):
        identify(loop, options=Options(between="decimated"))
    with pytest.raises(UsageError, match="not positive"):
        check_options(Options(scan_s=0.0))
    with pytest.raises(UsageError, match="--scan has no meaning"):
        check_options(Options(method="arx", scan_s=2.0))


def test_a_controller_ran_with_the_samples_only_where_its_law_is_exact_there():
    every_scan, _ = thinned(1)
    assert ran_with_samples(every_scan) and not ran_between(every_scan, 5)
    every_fifth, _ = thinned(5)
    assert ran_between(every_fifth, 5) and not ran_with_samples(every_fifth)
    # A law that is just one at the samples, and just none between them, tells nothing.
    noise = np.random.default_rng(1).standard_normal(every_scan.samples) * np.std(np.diff(every_scan.output))

    def rough(size: float) -> Loop:
        return replace(every_scan, output=every_scan.output + size * noise)

    least, most = 0.1, 0.5
    for _ in range(30):
        middle = 0.5 * (least + most)
        least, most = (middle, most) if pi_law(rough(middle), 1) else (least, middle)
    assert pi_law(rough(least), 1) is not None and pi_law(rough(least), MOST_PARTS) is None
    assert not ran_with_samples(rough(least))


def test_a_command_without_the_noise_of_y_moved_between_its_samples_and_any_other_may_have_been_held() -> None:
    free = Setting(Plant(1.5, 10.0, 2.0, 4.0), Controller(0.5, 10.0), duration_s=600.0, noise_sd=0.05,
                   setpoint_moves=((0.0, 3.0), (200.0, -4.0), (400.0, 5.0)), fine_step_s=0.1)
    loop = simulate(free, seed=3).loop
    assert surely_moves(loop)
    assert not surely_moves(simulate(replace(free, noise_sd=0.0), seed=3).loop)
    scanning = replace(free, controller=replace(free.controller, scan_s=1.0))
    scanned_loop = simulate(scanning, seed=3).loop
    assert not surely_moves(scanned_loop)
    # An export that keeps the corners of straight lines has taken the noise away.
    knots = np.arange(0, loop.samples, 5)
    lines = np.interp(np.arange(loop.samples), knots, scanned_loop.output[knots])
    assert not surely_moves(replace(scanned_loop, output=lines))
    # One that rounds has noise of its own, which is none of y.
    assert surely_moves(replace(loop, output=np.round(loop.output, 1)))
    assert not surely_moves(replace(scanned_loop, output=np.round(scanned_loop.output, 1)))
    # A controller that hardly does more than integrate answers noise by little, but shares it.
    integral = simulate(replace(scanning, controller=Controller(0.02, 0.4, scan_s=1.0), noise_sd=0.1), seed=3).loop
    assert not surely_moves(replace(integral, output=np.round(20.0 * integral.output) / 20.0))
    # Noise that y got from its own rounding tells nothing: the controller may have seen y before.
    quiet = simulate(replace(scanning, noise_sd=0.001), seed=3).loop
    assert not surely_moves(replace(quiet, process_value=np.round(quiet.process_value, 2),
                                    output=np.round(quiet.output, 1)))


@pytest.mark.parametrize("scan_s", [1.0, 0.0])
@pytest.mark.parametrize("noise_sd", [0.05, 0.0])
def test_only_a_command_that_holds_the_noise_of_y_was_surely_scanned(scan_s: float, noise_sd: float) -> None:
    """Rounded, so that no law of the controller is exact at the samples. A smooth y is followed just as closely."""
    setting = replace(SETTING, controller=replace(SETTING.controller, scan_s=scan_s), noise_sd=noise_sd)
    loop = simulate(setting, seed=3).loop
    loop = replace(loop, output=np.round(loop.output, 2), position=None)
    assert surely_scanned(loop) == (scan_s > 0.0 and noise_sd > 0.0)


def test_a_continuous_controller_under_a_load_that_wanders_did_not_surely_scan() -> None:
    """OP follows the load from sample to sample as that of a scanning one does, but it lacks the noise of PV."""
    rng = np.random.default_rng(5)
    load = lfilter([1.0], [1.0, -0.9], 0.05 * rng.standard_normal(2000))
    for scan_s in (1.0, 0.0):
        setting = replace(SETTING, controller=replace(SETTING.controller, scan_s=scan_s), noise_sd=0.05)
        loop = replace(simulate(setting, seed=3, disturbance=load).loop, position=None)
        rounded = replace(loop, output=np.round(loop.output, 2))
        assert surely_scanned(rounded) is (scan_s > 0.0) and not surely_moves(rounded)
