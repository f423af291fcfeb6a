"""The effect catalogue: every effect keeps the contract, vanishes at its neutral value, and can be hidden.

Those hidden in records made by others are found in benchmarks/long.
"""

from __future__ import annotations

import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from loops_with_effects import MOVES, NOISE, SMALL, loop_of, small
from quick_loops import PLAIN, asked_only, quick
from real_nodes import MOVES as MOVES_OF_SETPOINT
from real_nodes import SETTINGS, model_on, true_values

from stictionid.effects import catalogue, get, parse
from stictionid.effects.contract import AXES, Context
from stictionid.errors import StictionidError, UsageError
from stictionid.fit.points.moves import descend_model
from stictionid.fit.with_effect import Scouted
from stictionid.laws.contract import neutral_friction
from stictionid.model.closed_loop import OPERATING_POINT, preset, simulate, with_stiction
from stictionid.model.model import Model
from stictionid.model.spec import Spec
from stictionid.numerics.parameters import Parameter, Space
from stictionid.record.loop import Loop
from stictionid.verbs.add import add
from stictionid.verbs.diagnose import diagnose
from stictionid.verbs.identify import identify

EFFECTS = list(catalogue().values())
NAMES = set(SMALL)


def context() -> Context:
    rng = np.random.default_rng(0)
    t = np.arange(300.0)
    y = 50 + 2 * np.sin(t / 8 - 1) + 0.1 * rng.standard_normal(300)
    return Context(50 + 3 * np.sin(t / 8), y, np.full(300, 50.0), 1.0, 50.0, 6.0, {"D1": rng.standard_normal(300)},
                   0.1 * rng.standard_normal(300))


def base(duration: float = 300.0):
    setting = with_stiction(preset("foptd"), 4.0, 2.0)
    return replace(setting, controller=replace(setting.controller, scan_s=1.0), duration_s=duration)


@pytest.mark.parametrize("parts", [1, 8])
def test_a_rest_shows_away_from_the_turns_of_a_moving_command(parts: int) -> None:
    # Between two samples behind its turns a triangle has one speed, and a sine is slow next to them alone.
    t = np.arange(1000 * parts) / parts + 0.4
    sine, triangle = 3.0 * np.sin(2.0 * np.pi * t / 50.0), np.abs(t % 50.0 - 25.0)
    moves = Context(sine, sine[::parts], None, 2.0, 100.0, held=False)
    limits = get("re-sticking").limits
    assert limits is not None
    (low,), (even,) = limits(moves), limits(replace(moves, command=triangle))
    assert 0.1 < low.low * 50.0 / (2.0 * np.pi) / 1.5 < 0.4 and low.high > 0.18
    assert even.low == pytest.approx(0.5) and even.high >= 1.0
    held, = limits(replace(moves, held=True))
    flat, = limits(replace(moves, command=np.zeros(t.size)))
    assert held.low == flat.low == 0.0 and flat.high > 0.0


def test_every_effect_of_the_catalogue_has_a_loop_that_hides_it() -> None:
    assert set(catalogue()) == NAMES


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_an_effect_says_what_it_is(effect) -> None:
    assert effect.kind in "FTLN" and effect.equation and effect.source and effect.summary
    assert all(p.unit and p.meaning and p.low <= p.neutral <= p.high for p in effect.parameters)
    assert all(name in NAMES for name in effect.confused_with)
    texts = (effect.noun, effect.sentence, effect.action, *filter(None, [effect.brief]))
    assert all(texts) and effect.seen_over in AXES
    said = {name for part in re.findall(r"\{(.*?)\}", " ".join(texts)) for name in part.split("+")}
    assert said <= {p.name for p in effect.parameters} | {"tag"}
    for p in effect.parameters_for(context()):
        assert p.low < p.high and p.low <= p.neutral <= p.high
    if effect.guess:
        guesses = effect.guess(context())
        assert guesses.shape[1] == len(effect.parameters_for(context())) and np.isfinite(guesses).all()


@pytest.mark.parametrize("effect", EFFECTS, ids=lambda e: e.name)
def test_at_its_neutral_value_an_effect_vanishes_from_a_simulation(effect) -> None:
    given = {"jump_up": 2.0, "jump_down": 2.0} if effect.name == "asymmetric-stiction" else {}
    plain = simulate(base()).loop
    hidden = simulate(replace(base(), effects=((effect.name, given),))).loop
    np.testing.assert_allclose(hidden.process_value, plain.process_value, atol=1e-9)


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.run], ids=lambda e: e.name)
def test_a_transform_runs_in_pieces_as_it_runs_whole(effect) -> None:
    c = context()
    signal = np.stack([c.command, c.command + 1.0], axis=1)
    parameters = effect.parameters_for(c)
    theta = np.array([[1.5 * p.low if p.log else 0.6 * p.low + 0.4 * p.high] * 2 for p in parameters])
    kept = signal.copy()
    whole = effect.transformed(signal, theta, c)
    assert np.isfinite(whole).all() and (signal == kept).all() and not np.allclose(whole, signal)
    state = effect.start(signal, theta) if effect.start else np.zeros((max(effect.states, 1), 2))
    follows = c.time_s if effect.timed else c.process_value - c.centre
    y = follows[:, None].repeat(2, axis=1)
    pieces = []
    for a, b in ((0, 100), (100, 101), (101, 300)):
        out = np.empty((b - a, 2))
        effect.run(signal[a:b], y[a:b], theta, 1.0, state, out)
        pieces.append(out)
    assert (np.concatenate(pieces) == whole).all()
    plain = np.empty((300, 2))
    state = effect.start(signal, theta) if effect.start else np.zeros((max(effect.states, 1), 2))
    effect.run.py_func(signal, y, theta, 1.0, state, plain)
    np.testing.assert_allclose(plain, whole, rtol=1e-12)


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.friction], ids=lambda e: e.name)
def test_a_friction_effect_leaves_its_input_alone_and_vanishes_when_neutral(effect) -> None:
    table = neutral_friction([4.0, 3.0], [2.0, 1.0])
    kept = table.copy()
    parameters = effect.parameters_for(context())
    theta = np.array([[p.neutral] * 2 for p in parameters])
    same = effect.friction(table, theta, 1.0, True)
    limits = {"travel-limit"}  # its neutral value is a stop out of reach, not an infinite one
    assert (table == kept).all() and (effect.name in limits or (same == kept).all())


@pytest.mark.parametrize("J", [1.6, 3.4])
def test_a_point_with_another_slip_jump_leaves_its_stops_at_the_same_samples(J: float) -> None:
    stop = 53.0
    loop = simulate(replace(SETTINGS["first-order"], duration_s=1500.0, setpoint_moves=MOVES_OF_SETPOINT,
                            effects=(("travel-limit", {"upper": stop}),))).loop
    model = model_on(loop, Spec(effects=("travel-limit",)))
    upper = model.rows_of("travel-limit").stop - 1
    known = {**true_values(), "initial_residual_force": 0.0, "travel-limit:upper": stop}
    here = model.cube(model.vector(known)[:, None])
    there = here.copy()
    there[:, 1] = model.cube(model.vector({**known, "J": J})[:, None])[:, 1]
    values = model.values(np.concatenate([here, there]))
    assert values[1].tolist() == pytest.approx([known["J"], J])
    assert values[upper].tolist() == pytest.approx([stop, stop + 0.5 * (J - known["J"])])
    # Samples at which the stem turns.
    turns = []
    for step in np.diff(model.positions(values), axis=0).T:
        moves = np.flatnonzero(step)
        turns.append(moves[1:][np.diff(np.sign(step[moves])) != 0.0].tolist())
    assert len(turns[0]) > 10 and turns[0] == turns[1]


@pytest.mark.parametrize("effect", [e for e in EFFECTS if e.columns], ids=lambda e: e.name)
def test_linear_columns_have_the_records_shape(effect) -> None:
    c = context()
    theta = np.array([[0.5 * (p.low + p.high)] * 3 for p in effect.parameters_for(c)])
    for column in effect.columns(theta, c):
        assert column.shape == (300, 3) and np.isfinite(column).all()


def test_unknown_effects_and_variants_name_what_there_is() -> None:
    with pytest.raises(UsageError) as refusal:
        get("extra-lug")
    assert "extra-lag" in refusal.value.hint
    with pytest.raises(UsageError):
        parse("step-disturbance@nowhere")


@pytest.mark.parametrize("effects", [
    (("nobody", {}),), (("extra-lag", {"speed": 1.0}),), (("extra-lag", {"second_time_constant_s": -1.0}),),
    (("step-disturbance", {"at": "nowhere"}),), (("extra-lag", {}), ("extra-lag", {})),
])
def test_a_simulation_refuses_effects_that_make_no_sense(effects) -> None:
    with pytest.raises(StictionidError) as refusal:
        simulate(replace(base(), effects=effects))
    assert refusal.value.hint


def test_nothing_is_invented_among_a_few_effects() -> None:
    """A search for all effects is in benchmarks/long."""
    loop = quick()
    with asked_only("step-disturbance", "extra-lag", "travel-limit", "asymmetric-stiction"):
        searched = diagnose(loop, identify(loop, options=PLAIN), everything=True)
    assert searched.missing == () and len({c.effect for c in searched.candidates}) == 4
    assert all(c.delta_bic is not None and c.delta_bic < 10 for c in searched.candidates)


def test_add_refuses_what_is_there_already_and_what_it_cannot_have() -> None:
    loop = quick()
    study = identify(loop, options=PLAIN)
    once = add(loop, study, "extra-lag")
    assert [s.added for s in once.steps] == [None, "extra-lag"]
    # The verdict is that of the last model.
    assert study.verdict.evidence.effects == () and once.verdict.evidence.effects == ("extra-lag",)
    with pytest.raises(UsageError):
        add(loop, once, "extra-lag")
    with pytest.raises(UsageError):
        add(loop, study, "measured-disturbance")
    dead = identify(Loop(output=np.full(300, 40.0), process_value=np.random.default_rng(0).standard_normal(300)))
    with pytest.raises(StictionidError):
        add(loop, dead, "extra-lag")


def test_a_rate_is_at_its_bound_on_the_scale_it_is_searched_on() -> None:
    rate = Parameter("rate", "% / s", 0.06, 60.0, 60.0, "fastest stroke", log=True)
    assert not rate.at_bound(0.1) and not rate.at_bound(59.0) and rate.at_bound(0.0602) and rate.at_bound(60.0)
    assert rate.share(np.sqrt(0.06 * 60.0)) == pytest.approx(0.5)
    plain = replace(rate, log=False)
    assert plain.share(plain.low + 0.25 * (plain.high - plain.low)) == pytest.approx(0.25)
    assert replace(rate, low=3.0, high=3.0).at_bound(3.0)
    root = replace(plain, low=0.0, neutral=0.0, power=3.0)
    assert root.share(60.0 / 8.0) == pytest.approx(0.5) and root.share(-1.0) == 0.0
    space, values = Space((rate, root)), np.array([[0.06, 1.0, 60.0], [0.0, 0.4, 60.0]])
    np.testing.assert_allclose(space.to_cube(values)[1], [rate.share(1.0), root.share(0.4)])


def test_a_model_moves_values_to_the_cube_and_back_on_every_scale() -> None:
    loop = simulate(base()).loop
    model = Model(loop, Spec(effects=("re-sticking", "slew-limit", "extra-lag")), s_max=6.0, period_s=50.0)
    cube = np.random.default_rng(0).random((20, model.space.size))
    np.testing.assert_allclose(model.cube(model.values(cube)), cube, atol=1e-9)


@pytest.mark.parametrize("behind", [True, False])
def test_a_gain_follows_what_the_process_makes_whether_a_shift_is_in_it_or_behind_it(behind: bool) -> None:
    at_s, size = 500.0, 1.5
    if behind:
        # A sensor that shifts, to a controller whose setpoint shifts with it: the process sees neither.
        setting, loop = small("gain-nonlinearity", setpoint_moves=(*MOVES, (at_s, -size)))
        shift = np.where(loop.time_s >= at_s, size, 0.0)
        loop = replace(loop, setpoint=loop.setpoint + shift, process_value=loop.process_value + shift)
    else:
        setting, loop = small("gain-nonlinearity", effects=(
            ("gain-nonlinearity", {"curvature": 0.08}),
            ("step-disturbance", {"time_s": at_s, "size": size, "at": "output"})))
    model = Model(loop, Spec(between="hold", effects=("gain-nonlinearity", "step-disturbance@output")),
                  s_max=float(np.ptp(loop.output)), period_s=30.0)
    # The first output has not moved the valve yet.
    force = (loop.output[0] - OPERATING_POINT) / (0.5 * (setting.S + setting.J))
    start = model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": force,
                          "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s,
                          "gain-nonlinearity:curvature": 0.08, "step-disturbance@output:time_s": at_s})
    for _ in range(2):
        near = model.follow_guide(model.evaluate(start).guide)
        start = near.values(descend_model(near, near.cube(start[:, None])).points[:1])[:, 0]
    found = model.evaluate(start)
    assert found.rmse <= 1.05 * NOISE
    # Without the step, or with it on the wrong side of the process, the guide would be another y.
    away = found.guide - found.model
    assert np.ptp(away) == pytest.approx(size if behind else 0.0, abs=0.1)


def test_a_gain_that_follows_y_is_that_of_the_whole_sample_so_nothing_is_left_without_noise() -> None:
    setting, loop = small("gain-nonlinearity", noise_sd=0.0)
    model = Model(loop, Spec(between="hold", effects=("gain-nonlinearity",)), s_max=float(np.ptp(loop.output)),
                  period_s=30.0)
    force = (loop.output[0] - OPERATING_POINT) / (0.5 * (setting.S + setting.J))
    start = model.vector({"S": setting.S, "J": setting.J, "initial_residual_force": force,
                          "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s,
                          "gain-nonlinearity:curvature": 0.08})
    for _ in range(3):
        near = model.follow_guide(model.evaluate(start).guide)
        start = near.values(descend_model(near, near.cube(start[:, None])).points[:1])[:, 0]
    # With y at the start of each sample it was 13e-4 of the swing, and J 1.3 % off.
    assert model.evaluate(start).rmse < 2e-4 * np.ptp(loop.process_value)
    assert start[1] == pytest.approx(setting.J, rel=2e-3)


def test_a_gain_that_follows_y_does_not_run_away_on_the_way_to_its_own() -> None:
    """Without bounds y reached a million times the error on this record before it came back."""
    _, loop, _, sd = loop_of(754, "gain-nonlinearity", 0.01, 0.0, 1500)
    model = Model(loop, Spec(between="corner", substeps=8, effects=("gain-nonlinearity",)), s_max=5.339,
                  period_s=174.77)
    values = model.vector({"S": 3.669, "J": 1.369, "initial_residual_force": -0.472, "time_constant_s": 5.311,
                           "dead_time_s": 3.12, "gain-nonlinearity:curvature": 0.087})
    found = model.evaluate(values)
    assert found.rmse < 3.0 * sd
    # One more turn, from the model's own y, leaves as much.
    assert model.follow_guide(found.model).costs_of(values[:, None])[0] == pytest.approx(found.sse, rel=0.01)


def test_a_step_is_looked_for_where_what_is_left_jumps_and_not_where_it_still_dies_away() -> None:
    n, at = 400, 137
    left = 50.0 * np.exp(-np.arange(n) / 6.0) + np.random.default_rng(0).normal(0.0, 0.1, n)
    left[at:] += 3.0
    known = replace(context(), process_value=np.zeros(n), residual=left)
    times = get("step-disturbance").guess(known)[:, 0]
    assert np.abs(times - at * known.step_s).min() < 1e-9
    # Without anything known the times are spread over the record.
    plain = get("step-disturbance").guess(replace(known, residual=None))[:, 0]
    assert set(plain) < set(times) and plain.min() < 0.05 * known.length_s < 0.95 * known.length_s < plain.max()


def test_a_look_without_a_model_gains_nothing_and_says_so_without_a_warning() -> None:
    model = Model(simulate(base()).loop, Spec(), s_max=6.0, period_s=50.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        gains = [Scouted(model, np.empty((0, 5)), cost, 1.0).gain for cost in (np.inf, 1.0, 0.5)]
    assert gains[:2] == [-np.inf, 0.0] and gains[2] == pytest.approx(model.shared.rows * np.log(2.0))
