"""The valve bench: which expectation holds or fails for each law, refusals through the command line, its picture."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from stictionid.cli.app import app
from stictionid.errors import ModelError, UsageError
from stictionid.laws import catalogue, get
from stictionid.model.valve_bench import LARGEST_W, TESTS, put_on_bench

LAWS = sorted(catalogue())
# The known failures that must show, as test and beginning of the expectation; every other expectation holds for S = 5 %
# and J = 3 %. Source: docs/details.md, section 3; each was read off the picture of the bench as well.
STAIRCASE = ("ramp", "slides with the ramp")
STUCK_AGAIN = {("reversal-after-hold", "does not freeze"), ("reversal-at-once", "does not freeze"),
               ("resume", "does not freeze")}
LATE = {("ramp", "dead band"), ("reversal-after-hold", "dead band"), ("reversal-at-once", "dead band"),
        ("sine", "dead band"), ("resume", "resolution")}
FAILS: dict[str, set[tuple[str, str]]] = {
    "chen": set(), "kano": set(), "karnopp": set(),
    "lugre": {("sine", "dead band")},  # creeps before it slips, 5.14 % where 5.12 % is allowed
    "he": {STAIRCASE, *STUCK_AGAIN, *LATE, ("steps", "smallest step on")},
    "stenman": {STAIRCASE, *STUCK_AGAIN, *LATE},
    "he-wang": {STAIRCASE, *STUCK_AGAIN, *LATE, ("ramp", "slip jump"), ("ramp", "no overshoot"),
                ("staircase", "after each rest"), ("resume", "slip jump"), ("sine", "slip jump")},
    # Isolated steps: it sums the moves since the last turn and forgets the force, so no step of any size moves it.
    "choudhury": {("steps", "smallest step on"), ("steps", "smallest step back"), ("steps", "at rest the force"),
                  ("staircase", "after each rest"), ("staircase", "at rest the force"),
                  ("reversal-after-hold", "dead band"), ("reversal-after-hold", "does not freeze"),
                  ("resume", "does not freeze"), ("noisy-sine", "noise does not"), ("noisy-sine", "at rest")},
}


def shown_by(*arguments: str) -> Any:
    """A command in this process, which is quicker; a refusal is `exception`."""
    return CliRunner().invoke(app, list(arguments))


@pytest.mark.parametrize("law", LAWS)
def test_each_expectation_holds_or_fails_as_known(law: str) -> None:
    wanted = FAILS[law]
    for outcome in put_on_bench(get(law)):
        for e in outcome.expectations:
            known = any(outcome.test == test and e.what.startswith(what) for test, what in wanted)
            assert e.holds != known, (law, outcome.test, e)


def test_the_known_failures_in_numbers() -> None:
    steps = {o.test: o for o in put_on_bench(get("choudhury"))}["steps"]
    assert steps.resolution is None and steps.dead_band is None  # not even 10 % moves it, twice S
    ramp = put_on_bench(get("he"), tests=("ramp",))[0]
    resting = next(e for e in ramp.expectations if e.what.startswith("slides"))
    assert resting.measured > 90  # % of the samples at rest: a staircase
    jumps = np.diff(ramp.position)
    assert np.median(np.abs(jumps[np.abs(jumps) > 0.5])) == pytest.approx(3.0, abs=0.05)  # stairs of J
    overshoot = put_on_bench(get("he-wang"), tests=("ramp",))[0].overshoot
    assert overshoot == pytest.approx(37.0, abs=1.0)  # its K is 1.37 by default


@pytest.mark.parametrize(("S", "J"), [(5.0, 3.0), (2.0, 2.0), (4.0, 0.0), (3.0, 5.0)])
def test_chen_and_kano_are_the_same_valve_on_every_test(S: float, J: float) -> None:
    for a, b in zip(put_on_bench(get("chen"), S=S, J=J), put_on_bench(get("kano"), S=S, J=J), strict=True):
        np.testing.assert_allclose(a.position, b.position, atol=1e-9, err_msg=a.test)
        assert a.dead_band == pytest.approx(b.dead_band) and a.resolution == pytest.approx(b.resolution)


@pytest.mark.parametrize(("S", "J"), [(5.0, 3.0), (0.5, 0.2), (4.0, 0.0), (20.0, 10.0), (3.0, 3.0)])
def test_chen_meets_every_expectation_whatever_its_size(S: float, J: float) -> None:
    outcomes = put_on_bench(get("chen"), S=S, J=J)
    assert [o.test for o in outcomes] == list(TESTS)
    for o in outcomes:
        assert all(e.holds for e in o.expectations), (o.test, o.expectations)
        assert o.command.min() >= 0 and o.command.max() <= 100 and np.isfinite(o.position).all()


def test_a_bench_refuses_what_would_leave_the_stroke_or_does_not_exist() -> None:
    with pytest.raises(UsageError, match="too large"):
        put_on_bench(get("chen"), S=LARGEST_W + 1)
    with pytest.raises(UsageError, match="unknown test"):
        put_on_bench(get("chen"), tests=("jump",))


@pytest.mark.parametrize(("law", "words"), [
    ("karnopp:mass=0", "mass of the valve is 0 kg"), ("karnopp:mass=-2", "mass of the valve is -2 kg"),
    ("karnopp:spring=0", "spring of the valve is 0"), ("karnopp:F_s=10,F_c=20", "F_s = 10 N is below Coulomb"),
    ("karnopp:F_s=10,F_c=-1", "F_c = -1 N must not be negative"), ("karnopp:F_s=10", "F_s alone"),
    ("karnopp:mass=1e-16", "too coarse for this stem"), ("karnopp:mas=1", "has no parameter 'mas'"),
    ("karnopp:mass=x", "is not par=number"), ("lugre:bristle_stiffness=0", "bristle stiffness"),
    ("chen:mass=1", "has no parameter 'mass'"),
    ("he-wang:overshoot=5", "K = 5 is not between 1"),
])
def test_numbers_outside_a_laws_validity_are_refused_in_its_own_sentence(law: str, words: str) -> None:
    out = shown_by("laws", "--test", law)
    assert isinstance(out.exception, ModelError | UsageError) and out.stdout == ""
    assert words in out.exception.message and out.exception.hint and out.exception.exit_code == 2


@pytest.mark.parametrize(("arguments", "words"), [
    ("--law chen --S 2 --J 5", "J = 5 % is more than 2 S"), ("--law stenman --S -1", "d = S = -1 %"),
    ("--law karnopp --S 2 --J 3", "Coulomb friction would be negative"),
    ("--law karnopp:mass=0 --S 5", "mass of the valve is 0 kg"),
    ("--law karnopp:mass=1e-14 --step 60 --scan 60", "too coarse"),
])
def test_simulate_refuses_the_same(arguments: str, words: str, tmp_path: Path) -> None:
    out = shown_by("simulate", *arguments.split(), "-o", str(tmp_path / "x.csv"))
    assert isinstance(out.exception, ModelError) and words in out.exception.message and not list(tmp_path.iterdir())


@pytest.mark.parametrize("law", ["karnopp", "lugre"])
def test_a_coarse_step_of_a_physical_law_is_refined(law: str) -> None:
    """A minute between two held commands gives the stem that sixty seconds of the same command give."""
    held = 50.0 + np.cumsum(np.random.default_rng(4).uniform(-4, 4, 30))
    coarse = get(law).positions(held, get(law).friction(5.0, 3.0, step_s=60.0))[:, 0]
    fine = get(law).positions(np.repeat(held, 60), get(law).friction(5.0, 3.0, step_s=1.0))[59::60, 0]
    np.testing.assert_allclose(coarse, fine, atol=0.01)
    with pytest.raises(ModelError, match="too coarse"):
        get(law).friction(5.0, 3.0, step_s=60.0, values={"mass": 1e-14})


def test_forces_and_s_and_j_map_both_ways() -> None:
    out = shown_by("laws", "karnopp:F_s=213.36,F_c=53.34", "--test", "ramp", "--json")
    shown = json.loads(out.stdout)
    assert (shown["S"], shown["J"]) == (pytest.approx(5.0, abs=0.01), pytest.approx(3.0, abs=0.01))
    assert shown["forces_N"] == {"F_s": pytest.approx(213.36), "F_c": pytest.approx(53.34)}
    assert "F_s = 213.4 N" in shown_by("laws", "karnopp:F_s=213.36,F_c=53.34", "--test", "ramp").stdout


@pytest.mark.parametrize("law", LAWS)
def test_a_laws_page_shows_what_must_be_known(law: str) -> None:
    shown = json.loads(shown_by("laws", law, "--json").stdout)
    assert shown["equation"] and shown["source"] and shown["cannot"] and shown["checked"] and shown["parameters"]
    assert any(word in shown["checked"] for word in ("checked", "reconstructed", "read"))
    text = " ".join(shown_by("laws", law).stdout.split())
    for part in ("parameters", "equation", "source", "cannot represent", shown["checked"].split()[0]):
        assert part in text
    for p in shown["parameters"]:
        assert p["name"] in text and p["unit"] and p["meaning"]
