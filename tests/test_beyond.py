"""Ringing, inverse response, lags by direction, drifts, filters and limits: parameters come back from a simulation.

Whole studies, and the search for a positioner, are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest
from loops_with_effects import BEYOND, NOISE, SMALL, small

from stictionid.effects import catalogue, get, parse
from stictionid.errors import ModelError, UsageError
from stictionid.fit.points.moves import behind_valve
from stictionid.fit.public_values import values_of
from stictionid.model.closed_loop import OPERATING_POINT, preset, simulate
from stictionid.model.model import Model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.options import check_tag
from stictionid.process.linear import Dynamics, free_run
from stictionid.selection.node import additions

KNOWN = {"measurement-filter": "time_constant_s", "backlash": "play"}
# Noise of a load, and load steps, whose times a search finds, are in test_load_noise.py. No slope leads to the time of
# a change: tests/test_valve_changes.py finds it by the search.
LOADS = {"load-noise", "random-load-steps"}
SEARCHED = sorted(set(BEYOND) - {*LOADS, "positioner", "stiction-change", *KNOWN})


def spelt(name: str) -> str:
    """The name as a model has it: with its known number."""
    return f"{name}:{SMALL[name][2][KNOWN[name]]}" if name in KNOWN else name


def near_truth(name: str, away: float) -> tuple[Model, np.ndarray]:
    """A model of the small loop with an effect, and its values with process and effect off by a share."""
    setting, loop = small(name)
    effect, values, plant = get(name), SMALL[name][2], setting.plant
    spec = Spec(process=INTEGRATOR if plant.integrating else FIRST_ORDER, effects=(spelt(name),))
    model = Model(loop, spec, s_max=float(np.ptp(loop.output)), period_s=40.0)
    lag = plant.time_constant_s
    if name == "underdamped-process":
        lag = float(values["damping"]) * float(values["natural_period_s"]) / np.pi
    # The loop starts at rest; the first recorded output may have moved the valve already.
    play = float(values.get("play", 0.0))
    force, most = float(loop.output[0]) - OPERATING_POINT, 0.5 * (setting.S + setting.J + play)
    force = force if abs(force) <= most else float(np.sign(force)) * 0.5 * (setting.S - setting.J + play)
    searched = [] if name in KNOWN else [p.name for p in effect.parameters_for(model.context)]
    at = model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": force / most,
                       "time_constant_s": lag * (1.0 + away), "dead_time_s": plant.dead_time_s,
                       **{f"{name}:{n}": float(values[n]) * (1.0 + away) for n in searched}})
    return model, at


def polished(model: Model, name: str, at: np.ndarray) -> np.ndarray:
    """Values polished behind the valve, whose S and J stay: their steps belong to the searches of benchmarks/long."""
    own = model.rows_of(spelt(name))
    found = behind_valve(model, model.cube(at[:, None]), own, turns=40, settle=1e-7)
    return model.values(found.points[:1])[:, 0]


@pytest.mark.parametrize("name", SEARCHED)
def test_parameters_come_back_from_their_own_simulation(name: str) -> None:
    model, at = near_truth(name, 0.2)
    values = polished(model, name, at)
    found = model.evaluate(values)
    assert found.rmse <= 1.05 * NOISE
    truth = SMALL[name][2]
    said = values_of(name, model, values, found)
    assert set(said) <= {p.name for p in get(name).parameters}
    for key, value in truth.items():
        assert said[key] == pytest.approx(value, rel=0.1), (key, said)


def test_a_law_with_forces_of_its_own_refuses_a_positioner() -> None:
    setting, _ = small("positioner")
    with pytest.raises(UsageError, match="karnopp has forces of its own, and no positioner") as refusal:
        simulate(replace(setting, law="karnopp"))
    assert "leave the positioner out" in refusal.value.hint


@pytest.mark.parametrize("name", sorted(KNOWN))
def test_a_known_number_is_held_and_the_rest_is_that_of_the_loop(name: str) -> None:
    model, at = near_truth(name, 0.0)
    values = polished(model, name, at)
    assert model.evaluate(values).rmse <= 1.05 * NOISE
    key, number = KNOWN[name], SMALL[name][2][KNOWN[name]]
    assert values_of(spelt(name), model, values, model.evaluate(values)) == {key: number}
    with pytest.raises(UsageError, match="held at a number that is known") as refusal:
        check_tag(name, small(name)[1])
    assert f"write {name}:" in refusal.value.hint
    for wrong in ("fast", "-1", "1e9"):
        with pytest.raises(UsageError, match=f"{name}:{wrong} is no "):
            parse(f"{name}:{wrong}")


def test_a_known_play_is_part_of_the_band_and_nothing_else_shows() -> None:
    play = float(SMALL["backlash"][2]["play"])
    setting, with_play = small("backlash")
    wider = simulate(replace(setting, S=setting.S + play, effects=()), seed=21).loop
    np.testing.assert_allclose(with_play.process_value, wider.process_value, atol=1e-9)
    assert with_play.position is not None


def test_only_what_u_and_y_can_tell_is_asked_for() -> None:
    loop, clipped = small("extra-lag")[1], small("measurement-limit")[1]
    late = set(additions(Spec(), loop, last=True))
    asked = set(additions(Spec(), loop)) | late
    assert late == {"positioner"}
    by_hand = {name for name, effect in catalogue().items() if effect.asked != "diagnose"}
    assert by_hand == {"random-load-steps", *KNOWN} and not asked & by_hand
    assert set(BEYOND) - by_hand - {"leak", "measurement-limit", *LOADS} <= asked
    assert "leak" not in asked and "leak" in additions(Spec(process=INTEGRATOR, increments=True), loop)
    assert "measurement-limit" not in asked and "measurement-limit" in additions(Spec(), clipped)


def test_samples_at_the_end_of_a_range_do_not_count_and_rounded_ones_do() -> None:
    counted = get("measurement-limit").counted
    assert counted is not None
    rng = np.random.default_rng(2)
    wave = 50.0 + 4.0 * np.sin(np.arange(800) / 9.0) + 0.1 * rng.standard_normal(800)
    clipped = np.clip(wave, 47.0, 52.5)
    assert np.array_equal(~counted(clipped), (clipped == 47.0) | (clipped == 52.5))
    for step in (0.02, 0.1, 0.5, 1.0, 2.0):
        assert counted(np.round(wave / step) * step).all(), step
    missing = np.where(np.arange(800) % 7 == 0, np.nan, clipped)
    assert np.isnan(missing[counted(missing)]).sum() == np.isnan(missing).sum()
    assert counted(np.full(50, 3.0)).all() and counted(np.full(5, np.nan)).all()


def test_a_leak_belongs_to_an_integrator() -> None:
    loop = small("leak")[1]
    with pytest.raises(ModelError, match="leak belongs to an integrating process"):
        Model(loop, Spec(effects=("leak",)), s_max=5.0, period_s=40.0)
    with pytest.raises(UsageError, match="needs an integrating process"):
        simulate(replace(preset("foptd"), effects=(("leak", {"leak": 3.0}),)))


@pytest.mark.parametrize(("ratio", "growth"), [(0.4, 0.0), (1.0, 0.0), (2.5, 0.0), (1.0, 0.02), (0.4, -0.02)])
def test_a_lag_by_direction_and_a_delay_that_drifts_are_what_small_steps_make_of_them(ratio: float,
                                                                                     growth: float) -> None:
    rng = np.random.default_rng(5)
    position = 50.0 + np.cumsum(rng.standard_normal((60, 1)) * (rng.random((60, 1)) < 0.2), axis=0)
    one = np.ones(1)
    dynamics = Dynamics(7.0 * one, 2.3 * one, 0.0 * one, False, closing=ratio * one,
                        dead_time_drift=growth / 2.3 * one if growth else None)
    want = naive.directional(position[:, 0], 7.0, 2.3, ratio, 1.0, growth=growth)
    np.testing.assert_allclose(free_run(position, dynamics, step_s=1.0)[:, 0], want, atol=5e-3 if growth else 2e-3)
    # A record that begins later has the dead time of that moment.
    later = free_run(position, replace(dynamics, since_s=20.0), step_s=1.0)
    longer = free_run(position, replace(dynamics, dead_time_s=(2.3 + 20.0 * growth) * one,
                                        dead_time_drift=growth / (2.3 + 20.0 * growth) * one), step_s=1.0)
    np.testing.assert_allclose(later, longer, atol=1e-9)
    if ratio == 1.0 and not growth:
        plain = free_run(position, replace(dynamics, closing=None), step_s=1.0)
        np.testing.assert_allclose(free_run(position, dynamics, step_s=1.0), plain, atol=1e-9)
    # Behind the lag everything is linear: two halves of a sample are the sample.
    behind = replace(dynamics, second_time_constant_s=4.0 * one)
    whole, halves = (free_run(np.repeat(position, m, axis=0), behind, step_s=1.0, substeps=m) for m in (1, 8))
    np.testing.assert_allclose(whole, halves, atol=0.02 * np.ptp(halves))
