"""Stiction laws: kernels against their reference versions, and the properties that any friction law must have."""

from __future__ import annotations

from dataclasses import replace

import naive
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stictionid.effects import get as effect_of
from stictionid.errors import ModelError, UsageError
from stictionid.laws import catalogue, get
from stictionid.laws.contract import CROSSES, INNER, INTEGRAL, LOWER, OVERSHOOT, RESTICK, UPPER, neutral_friction

rng = np.random.default_rng(5)
T = np.arange(600)
SIGNALS = {
    "sine": 50 + 4 * np.sin(T / 15),
    "triangle": 50 + 4 * np.abs((T % 80) / 40 - 1),
    "square": 50 + 4 * np.sign(np.sin(T / 20)),
    "staircase": 50 + 0.8 * np.round(5 * np.sin(T / 40)),
    "random walk": 50 + np.cumsum(0.4 * rng.standard_normal(600)),
    "noisy sine": 50 + 4 * np.sin(T / 15) + 0.1 * rng.standard_normal(600),
    "quantised": np.round(50 + 4 * np.sin(T / 15) + 0.1 * rng.standard_normal(600), 1),
    "rests": np.repeat(50 + 3 * rng.standard_normal(60), 10),
}
NUMBERS = [(3.0, 1.5), (4.0, 4.0), (2.0, 0.0), (2.0, 3.0), (0.0, 0.0), (0.7, 0.2)]
TWINS = {
    "chen": naive.chen, "kano": naive.kano, "he": naive.he, "choudhury": naive.choudhury,
    "stenman": lambda u, S, J: naive.stenman(u, S),
}
SEARCHED = [law for law in catalogue().values() if law.searchable]
E_LAWS = ["chen", "kano", "he"]  # the two-parameter laws that look at the force


@pytest.mark.parametrize("signal", SIGNALS)
@pytest.mark.parametrize("law", TWINS)
def test_kernels_are_their_twins(law: str, signal: str) -> None:
    command = SIGNALS[signal]
    S, J = np.array(NUMBERS).T
    ours = get(law).positions(command, get(law).friction(S, J))
    for p, (s, j) in enumerate(NUMBERS):
        if law == "choudhury" and s == j == 0.0:
            continue  # its turns hold one sample whatever S is: checked by the others
        np.testing.assert_allclose(ours[:, p], TWINS[law](command, s, j), atol=1e-12, err_msg=f"S={s} J={j}")


@pytest.mark.parametrize("signal", sorted(SIGNALS))
def test_chens_plain_law_is_the_full_one_without_what_no_effect_asked_for(signal: str) -> None:
    rng = np.random.default_rng(0)
    S = rng.uniform(0.5, 8.0, 21)
    table, share = neutral_friction(S, S * rng.uniform(0.0, 1.5, 21)), rng.uniform(-1.0, 1.0, 21)
    full = table.copy()
    full[LOWER, 3] = -1e9  # a stop that is never reached: this block takes the other path
    np.testing.assert_array_equal(get("chen").positions(SIGNALS[signal], table, share=share),
                                  get("chen").positions(SIGNALS[signal], full, share=share))


@pytest.mark.parametrize("K", [1.0, 1.4, 1.9])
def test_he_and_wang_is_its_twin(K: float) -> None:
    table = get("he-wang").friction(3.0, 1.0, values={"overshoot": K})
    ours = get("he-wang").positions(SIGNALS["noisy sine"], table)[:, 0]
    np.testing.assert_allclose(ours, naive.he_wang(SIGNALS["noisy sine"], 3.0, 1.0, K), atol=1e-12)


@pytest.mark.parametrize("signal", SIGNALS)
def test_chen_equals_kano(signal: str) -> None:
    S, J = np.array(NUMBERS).T
    table = neutral_friction(S, J)
    np.testing.assert_allclose(get("chen").positions(SIGNALS[signal], table),
                               get("kano").positions(SIGNALS[signal], table), atol=1e-12)


def test_an_infinite_restick_speed_makes_he_of_chen() -> None:
    table = neutral_friction(3.0, 1.0)
    table[RESTICK] = np.inf
    np.testing.assert_array_equal(get("chen").positions(SIGNALS["noisy sine"], table)[:, 0],
                                  naive.he(SIGNALS["noisy sine"], 3.0, 1.0))


@pytest.mark.parametrize("law", SEARCHED, ids=lambda law: law.name)
def test_contract(law) -> None:
    command = SIGNALS["noisy sine"]
    table = law.friction(np.linspace(0.5, 5, 37), np.linspace(0.1, 3, 37) * (np.linspace(0.5, 5, 37) > 1))
    kept = command.copy(), table.copy()
    whole = law.positions(command, table)
    assert np.isfinite(whole).all()
    assert (command == kept[0]).all() and (table == kept[1]).all()
    assert law.source and law.equation and law.cannot and law.checked and law.summary
    # Running piece by piece, one sample at a time in the middle, is running it whole.
    state = law.start(float(command[0]), table, np.zeros(37))
    pieces, at = [], 0
    for end in (200, 201, 202, 450, command.size):
        out = np.empty((end - at, 37))
        law.run(command[at:end], table, np.zeros(end - at), state, out)
        pieces.append(out)
        at = end
    assert (np.concatenate(pieces) == whole).all()
    # Lanes do not touch each other.
    alone = law.positions(command, np.ascontiguousarray(table[:, 33:34]))
    assert (alone[:, 0] == whole[:, 33]).all()


@pytest.mark.parametrize("law", SEARCHED, ids=lambda law: law.name)
def test_compiled_equals_plain_python(law, monkeypatch: pytest.MonkeyPatch) -> None:
    command = SIGNALS["sine"][:120]
    table = law.friction(np.array([3.0, 1.0]), np.array([1.0, 0.5]))
    out, plain = np.empty((120, 2)), np.empty((120, 2))
    rest = law.start(float(command[0]), table, np.zeros(2))
    law.run(command, table, np.zeros(120), rest.copy(), out)
    chen = get("chen")  # (laws without a kernel of their own run in this one)
    monkeypatch.setattr("stictionid.laws.he.CHEN", replace(chen, run=chen.run.py_func))
    getattr(law.run, "py_func", law.run)(command, table, np.zeros(120), rest, plain)
    assert (out == plain).all()


commands = st.lists(st.floats(-2.0, 2.0).map(lambda x: round(x, 3)), min_size=30, max_size=120).map(
    lambda steps: 50.0 + np.cumsum(steps))
stictions = st.tuples(st.floats(0.1, 8.0), st.floats(0.0, 1.0)).map(lambda p: (p[0], p[0] * p[1]))


@settings(max_examples=60, deadline=None)
@given(command=commands, stiction=stictions, law=st.sampled_from(E_LAWS))
def test_at_rest_the_force_is_within_static_friction(command, stiction, law) -> None:
    S, J = stiction
    v = get(law).positions(command, neutral_friction(S, J))[:, 0]
    rests = np.diff(v, prepend=command[0]) == 0.0
    assert (np.abs(command - v)[rests] <= 0.5 * (S + J) + 1e-6).all()


@settings(max_examples=60, deadline=None)
@given(command=commands, stiction=stictions, shift=st.floats(-30, 30), law=st.sampled_from(E_LAWS))
def test_offset_and_sign_do_not_matter(command, stiction, shift, law) -> None:
    table = neutral_friction(*stiction)
    v = get(law).positions(command, table)[:, 0]
    shifted = get(law).positions(command + round(shift, 3), table)[:, 0]
    mirrored = get(law).positions(100.0 - command, table)[:, 0]
    # A tie that round-off breaks the other way is no failure of the law: skip those.
    force = np.abs(np.abs(command - np.concatenate([[command[0]], v[:-1]])) - 0.5 * sum(stiction))
    if force.min() > 1e-6 and np.abs(np.diff(command)).min() > 1e-6:
        np.testing.assert_allclose(shifted - round(shift, 3), v, atol=1e-9)
        np.testing.assert_allclose(100.0 - mirrored, v, atol=1e-9)


@pytest.mark.parametrize("law", E_LAWS)
@pytest.mark.parametrize(("S", "J"), [(4.0, 2.0), (3.0, 3.0), (2.0, 0.5)])
def test_the_valve_jumps_by_j_after_a_slip_and_needs_s_to_reverse(law: str, S: float, J: float) -> None:
    up = 50 + 0.01 * np.arange(1000)
    down = up[-1] - 0.01 * np.arange(1, 1500)
    command = np.concatenate([up, down])
    v = get(law).positions(command, neutral_friction(S, J))[:, 0]
    first = int(np.flatnonzero(np.diff(v))[0]) + 1
    assert command[first] - 50.0 == pytest.approx((S + J) / 2, abs=0.011)
    assert v[first] - 50.0 == pytest.approx(J, abs=0.021)
    turn = up.size - 1
    back = turn + 1 + int(np.flatnonzero(np.diff(v[turn:]) < 0)[0])
    held = command[turn] - v[turn]  # f_d for a sliding valve; He's has stopped somewhere below f_s
    assert command[turn] - command[back] == pytest.approx(held + (S + J) / 2, abs=0.021)
    if law != "he":
        assert command[turn] - command[back] == pytest.approx(S, abs=0.021)


@pytest.mark.parametrize("law", ["chen", "kano", "he", "stenman"])
def test_without_friction_the_valve_follows(law: str) -> None:
    np.testing.assert_allclose(get(law).positions(SIGNALS["noisy sine"], get(law).friction(0.0, 0.0))[:, 0],
                               SIGNALS["noisy sine"], atol=1e-9)


@pytest.mark.parametrize(("S", "J", "words"), [(-1.0, 0.0, "S = -1"), (2.0, -0.5, "J = -0.5"), (2.0, 4.5, "J = 4.5"),
                                              (float("nan"), 1.0, "nan")])
def test_values_outside_a_laws_validity_are_refused(S: float, J: float, words: str) -> None:
    with pytest.raises(ModelError, match=words):
        get("chen").friction(S, J)


def test_an_unknown_law_names_the_nearest() -> None:
    with pytest.raises(UsageError) as refusal:
        get("cheng")
    assert "chen" in refusal.value.hint


@pytest.mark.parametrize("S_J", [(4.0, 2.0), (6.0, 1.5)])
def test_a_damped_karnopp_valve_has_the_s_and_j_it_was_given(S_J: tuple[float, float]) -> None:
    S, J = S_J
    law = get("karnopp")
    command = np.concatenate([50 + 0.02 * np.arange(500), 60 - 0.02 * np.arange(800)])
    table = law.friction(S, J, step_s=0.1, held=False)
    v = law.positions(command, table)[:, 0]
    # Break-away is where the stem first moves by more than pre-sliding round-off.
    first = int(np.flatnonzero(np.abs(np.diff(v)) > 1e-4)[0])
    assert command[first] - 50 == pytest.approx((S + J) / 2, rel=0.01)
    sliding = slice(400, 500)
    assert (command - v)[sliding].mean() == pytest.approx((S - J) / 2, rel=0.02)


@pytest.mark.parametrize("name", ["karnopp", "lugre"])
def test_physical_laws_simulate_but_are_not_searched(name: str) -> None:
    law = get(name)
    assert not law.searchable
    with pytest.raises(ModelError):
        law.friction(2.0, 3.0)  # F_c would be negative


def test_an_overshooting_slip_begins_where_a_moving_command_crosses_f_s() -> None:
    K, parts, fine = 1.6, 8, 100
    # (At rest for the first part, so that both begin alike.)
    command = 50.0 + 4.0 * np.sin(np.maximum(np.arange(400 * parts * fine) - fine, 0) / (20.0 * parts * fine))
    effect = effect_of("slip-overshoot")
    held, moving = (effect.friction(neutral_friction(3.0, 1.0), np.array([[K]]), 1.0, flag) for flag in (True, False))
    start = np.zeros(1)
    # So fine that no slip begins a noticeable way beyond f_s: the slow, obvious twin.
    true = get("chen").positions(command, held, share=start)[fine - 1::fine, 0]
    here = get("chen").positions(command[fine - 1::fine], moving, share=start)[:, 0]
    late = get("chen").positions(command[fine - 1::fine], held, share=start)[:, 0]
    assert np.abs(np.diff(true)).max() > 1.59 and np.abs(here - true).max() < 1e-3 < 1e-2 < np.abs(late - true).max()


def test_a_resting_valve_slips_where_a_moving_command_crosses_f_s() -> None:
    parts, fine = 8, 500
    command = 50.0 + 4.0 * np.sin(np.maximum(np.arange(400 * parts * fine) - fine, 0) / (20.0 * parts * fine))
    effect = effect_of("re-sticking")
    held, moving = (effect.friction(neutral_friction(3.0, 1.0), np.array([[1e6]]), 1.0, flag) for flag in (True, False))
    start = np.zeros(1)
    # Slips of the fine command begin up to 5e-5 % beyond f_s, and 100 of them add up.
    true = get("chen").positions(command, held, share=start)[fine - 1::fine, 0]
    here = get("chen").positions(command[fine - 1::fine], moving, share=start)[:, 0]
    late = get("chen").positions(command[fine - 1::fine], held, share=start)[:, 0]
    apart = np.abs(here - true)
    assert np.quantile(apart, 0.98) < 0.02 < 0.04 < np.quantile(np.abs(late - true), 0.9)


def test_a_resting_valve_slips_several_times_in_one_long_move() -> None:
    friction = effect_of("re-sticking").friction(neutral_friction(3.0, 1.0), np.array([[1e6]]), 1.0, False)
    there = get("chen").positions(np.array([50.0, 50.0, 54.5, 54.5]), friction)[:, 0]
    # f_s = 2: slips of J = 1 follow at 52, 53 and 54.
    np.testing.assert_allclose(there, [50.0, 50.0, 53.0, 53.0])


@pytest.mark.parametrize(("law", "moving"), [("chen", False), ("stenman", False)])
def test_a_positioner_that_integrates_is_its_twin_under_any_law(law: str, moving: bool) -> None:
    """Further laws under a held and a moving command are in benchmarks/long."""
    command = SIGNALS["sine"][:90] + 0.3 * SIGNALS["noisy sine"][:90] - 0.3 * SIGNALS["noisy sine"][0]
    if moving:  # within a part of a moving command w grows with the middle of the part, so the parts are short
        command = np.interp(np.arange(0.0, 45.0, 1.0 / 8.0), np.arange(90.0), command)
    cases = [(3.0, 1.5, 0.05, 0.4, 0.3), (3.0, 2.5, 0.3, -0.5, -0.9), (1.0, 0.0, 0.1, 0.0, 0.0)]
    S, J, rate, w, share = np.array(cases).T
    table = get(law).friction(S, J)
    parts = 8.0 if moving else 1.0
    table[INTEGRAL], table[INNER], table[CROSSES] = rate / parts, w, float(moving)
    ours = get(law).positions(command, table, share=share)
    for p, (s, j, r, start, force) in enumerate(cases):
        want = naive.behind_positioner(command, s, s if law == "stenman" else j, r / parts, start, force,
                                       moving=moving)
        np.testing.assert_allclose(ours[:, p], want, atol=0.03, err_msg=str(cases[p]))


def test_a_positioner_waits_at_a_stop_and_takes_an_overshoot() -> None:
    command = 50.0 + 6.0 * np.sin(T[:120] / 9.0)
    table = neutral_friction(3.0, 2.0)
    table[INTEGRAL], table[UPPER], table[OVERSHOOT] = 0.2, 52.5, 1.4
    want = naive.behind_positioner(command, 3.0, 2.0, 0.2, stops=(-np.inf, 52.5), K=1.4)
    got = get("chen").positions(command, table)[:, 0]
    np.testing.assert_allclose(got, want, atol=0.03)
    assert want.max() == pytest.approx(52.5) and (got == 52.5).sum() > 20


@pytest.mark.parametrize("law", SEARCHED, ids=lambda law: law.name)
def test_lanes_without_a_positioner_keep_every_bit_beside_one_that_has_it(law) -> None:
    command = SIGNALS["noisy sine"]
    table = law.friction(np.array([3.0, 2.0, 4.0]), np.array([1.0, 2.0, 0.5]))
    plain = law.positions(command, table)
    table[INTEGRAL, 1] = 0.1
    beside = law.positions(command, table)
    assert (beside[:, [0, 2]] == plain[:, [0, 2]]).all() and not np.allclose(beside[:, 1], plain[:, 1])


def test_a_positioner_moves_the_stem_under_a_resting_command() -> None:
    command = np.concatenate([np.full(5, 50.0), np.full(300, 51.8)])
    table = neutral_friction(3.0, 1.5)
    assert np.ptp(get("chen").positions(command, table)) == 0.0
    table[INTEGRAL] = 0.05
    stem = get("chen").positions(command, table)[:, 0]
    assert np.ptp(stem[100:]) == pytest.approx(1.5, abs=1e-9)  # it hunts by the slip jump, to and fro
    assert stem[100:].min() < 51.8 < stem[100:].max()
