"""Period and S_max: whole cycles only, noise does not add crossings, and a clear reason where there is none.

Studies of loops whose mean wanders or whose turns are uneven are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from quick_loops import quick

from stictionid.errors import CannotTell
from stictionid.model.closed_loop import Controller, Plant, Setting, preset, simulate, with_stiction
from stictionid.record.evidence import Evidence
from stictionid.record.loop import Loop
from stictionid.record.oscillation import BY_TURNS, FEWEST_TURNS, count_reversals, find_range
from stictionid.record.preconditions import FEWEST_SAMPLES, check

# Five of the sixteen rows of Tables 2 and 3: S, J, the paper's S_max. All rows: benchmarks/paper_tables.py.
ROWS = [("foptd", 3.5, 3.5, 4.118), ("foptd", 5.0, 3.0, 5.591), ("foptd", 5.0, 1.5, 5.235),
        ("itptd", 3.5, 3.5, 4.902), ("itptd", 5.0, 2.0, 8.848)]


@pytest.mark.parametrize(("name", "S", "J", "s_max"), ROWS)
def test_s_max_of_the_paper(name: str, S: float, J: float, s_max: float) -> None:
    found = find_range(simulate(with_stiction(preset(name), S, J)).loop)
    assert found.oscillating
    assert found.s_max == pytest.approx(s_max, rel=0.02)


def sine(noise: float = 0.0, period: float = 50.0, samples: int = 1000, setpoint: bool = True) -> Loop:
    t = np.arange(samples)
    rng = np.random.default_rng(0)
    y = 10.0 + np.sin(2 * np.pi * t / period) + noise * rng.standard_normal(samples)
    return Loop(output=50.0 + 2.0 * np.cos(2 * np.pi * t / period), process_value=y,
                setpoint=np.full(samples, 10.0) if setpoint else None, units={"output": "%"})


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3])
def test_noise_adds_no_cycles(noise: float) -> None:
    found = find_range(sine(noise))
    assert len(found.cycles) == 19
    assert found.period_median_s == pytest.approx(50.0, rel=0.02)
    assert found.s_max == pytest.approx(4.0, rel=0.01)
    assert found.period_s >= found.period_median_s


def test_without_setpoint_the_mean_of_y_is_the_reference_and_said() -> None:
    found = find_range(sine(setpoint=False))
    assert found.reference == "mean of y" and "mean of y" in found.reason


@pytest.mark.parametrize(("loop", "words"), [
    (Loop(output=np.full(200, 40.0), process_value=np.random.default_rng(0).standard_normal(200)), "constant at 40"),
    (Loop(output=np.arange(200.0), process_value=np.full(200, 3e-44)), "does not vary"),
    (sine(samples=120), "only 1 whole cycle,"),
    (Loop(output=np.ones(3), process_value=np.ones(3)), "3 usable samples"),
])
def test_not_oscillating_because(loop: Loop, words: str) -> None:
    found = find_range(loop)
    assert not found.oscillating and words in found.reason


@pytest.mark.parametrize(("samples", "words"), [(40, "only 40 usable samples, 60 are needed"),
                                                (200, "only 40 usable samples of 200, 60 are needed")])
def test_a_record_with_few_samples_that_count_is_not_called_short(samples: int, words: str) -> None:
    loop = replace(sine(samples=samples), used=np.arange(samples) < 40)
    with pytest.raises(CannotTell, match=words) as told:
        check(loop, find_range(loop))
    assert ("--start" in str(told.value.hint)) == (samples > 40)


def test_reversals_are_counted_with_a_threshold() -> None:
    zigzag = np.array([0, 1, 2, 1, 0, 1, 0.9, 2, 0, 3.0])
    assert count_reversals(zigzag, 0.5) == 4
    assert count_reversals(zigzag, 1.5) == 4
    assert count_reversals(np.zeros(5), 0.1) == 0


def _wandering(seed: int, S: float) -> Loop:
    """A loop whose setpoint wanders beyond its cycle and is not exported; without friction a sine moves it."""
    rng, n = np.random.default_rng(seed), 1200
    slow = np.cumsum(np.cumsum(rng.standard_normal(n)))
    slow = 15.0 * (slow - slow.mean()) / np.ptp(slow)
    setting = Setting(Plant(2.0, 10.0, 6.0), Controller(0.4, 12.0, scan_s=1.0), S, 0.5 * S, duration_s=float(n),
                      noise_sd=0.05, setpoint_moves=tuple(enumerate(np.diff(slow, prepend=0.0).tolist())))
    other = None if S else 2.0 * np.sin(2 * np.pi * np.arange(n) / 55.0)
    return replace(simulate(setting, seed=seed, disturbance=other).loop, setpoint=None, position=None)


@pytest.mark.parametrize("seed", [1, 3, 6, 9])
def test_cycles_around_a_wandering_mean_are_told_by_the_turns_of_the_output(seed: int) -> None:
    found = find_range(_wandering(seed, 3.0))
    assert found.reference == BY_TURNS and found.oscillating and found.reversals >= FEWEST_TURNS
    assert 60.0 < found.period_median_s < 220.0


@pytest.mark.parametrize("seed", [2, 3, 4, 5])
def test_the_period_by_turns_is_that_of_a_sine_on_a_wandering_mean(seed: int) -> None:
    found = find_range(_wandering(seed, 0.0))
    assert found.reference == BY_TURNS
    assert found.period_median_s == pytest.approx(55.0, rel=0.03)


def test_turns_of_a_walk_are_no_cycles() -> None:
    rng = np.random.default_rng(2)
    walk = np.cumsum(rng.standard_normal(900)) + np.linspace(0.0, 60.0, 900)
    found = find_range(Loop(output=50.0 + walk, process_value=2.0 * walk, setpoint=None, step_s=1.0))
    assert not found.oscillating and found.reference == "mean of y"


def test_turns_on_a_ramp_that_hides_them_are_counted() -> None:
    """The ramp moves the output over thirty cycles' swings, so that a tenth of its span is no turn."""
    t = np.arange(1200.0)
    found = find_range(Loop(output=40.0 + 0.03 * t + np.sin(2 * np.pi * t / 60.0),
                            process_value=np.cos(2 * np.pi * t / 60.0), setpoint=np.zeros(t.size)))
    assert found.reference == "setpoint" and found.oscillating and found.reversals >= 38


def test_uneven_turns_of_a_setpoint_that_moves_are_no_matter_of_cycles() -> None:
    rng = np.random.default_rng([8, 78])
    at, size = np.sort(rng.uniform(0, 1235, 14)), rng.choice([-1.0, 1.0], 14) * rng.uniform(3.0, 8.0, 14)
    setting = Setting(Plant(1.2, 20.0, 8.0), Controller(0.7, 20.0, scan_s=1.0), 2.0, 1.0, duration_s=1235.0,
                      noise_sd=0.05, setpoint_moves=tuple(zip(at.tolist(), size.tolist(), strict=True)))
    found = find_range(simulate(setting, seed=1).loop)
    assert found.reference == "setpoint" and "uneven" not in found.reason


def test_a_record_of_just_enough_samples_is_not_too_short_and_one_less_is() -> None:
    loop = quick()
    found = find_range(loop)
    for samples, code in ((FEWEST_SAMPLES, "dead-signal"), (FEWEST_SAMPLES - 1, "too-short")):
        with pytest.raises(CannotTell) as refusal:
            check(replace(loop.cut(0, samples), process_value=np.ones(samples)), found)
        assert refusal.value.code == code


@pytest.mark.parametrize(("excluded", "stated"), [(0.1234, 0.13), (0.12, 0.12), (7.01, 7.1), (None, None), (0.0, 0.0)])
def test_the_excluded_stickband_is_stated_in_two_digits_rounded_up(excluded: float | None,
                                                                   stated: float | None) -> None:
    assert Evidence(S_excluded_above=excluded).S_stated_above == stated
