"""No name of an effect outside its file: traces, tests that tell it apart and roles are the effect's own."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from stictionid.effects import catalogue, get, leaving
from stictionid.effects.contract import TRACES
from stictionid.fit.noise.completion import AUTOREGRESSIVE, RANDOM_WALK, RESONANT
from stictionid.fit.starts.beside_effect import LAG, RESTING
from stictionid.selection.doubts import deciding_measurement
from stictionid.selection.node import BASE_EFFECTS
from stictionid.selection.score import COLOURED, NARROW, WALKING
from stictionid.verbs.selftest import HIDDEN

PACKAGE = Path(__file__).parent.parent / "stictionid"
FREE = ("selection", "comparison", "reports", "cli", "verdict", "fit", "methods", "model", "batch", "api", "verbs")
# The self-test hides effects of its own choice, in one table.
CHOSEN = "verbs/selftest.py"


def words_of(path: Path) -> Iterator[str]:
    """Strings of a module that are no docstrings."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    said = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in said:
            yield node.value


def test_no_folder_beside_the_catalogue_knows_an_effect_by_name() -> None:
    names = set(catalogue())
    found = {(path.relative_to(PACKAGE).as_posix(), name) for room in FREE for path in (PACKAGE / room).rglob("*.py")
             for word in words_of(path) for name in (word.partition(":")[0].partition("@")[0],) if name in names}
    assert {path for path, _ in found} == {CHOSEN}
    hidden = {named[0] for named in HIDDEN if named}
    words = [word for word in words_of(PACKAGE / CHOSEN) if word in names]
    assert sorted(words) == sorted(hidden)


def test_a_role_that_one_effect_has_is_found_by_what_the_effect_says_of_itself() -> None:
    first = {e.name for e in catalogue().values() if e.by_itself}
    assert first == BASE_EFFECTS == {LAG, RESTING} and get(LAG).dynamics and get(RESTING).friction
    for name, kind in ((WALKING, RANDOM_WALK), (COLOURED, AUTOREGRESSIVE), (NARROW, RESONANT)):
        assert get(name).noise == kind and get(name).asked == "diagnose"


def test_every_effect_has_a_test_that_settles_it_and_traces_that_are_asked_for() -> None:
    for name, effect in catalogue().items():
        assert effect.settled_by, name
        assert set(effect.leaves) <= set(TRACES), name
        assert set(effect.told_apart) <= set(catalogue()) - {name}, name
        # What a residual can't be told from has a test of its own, here or there.
        for rival in effect.confused_with:
            assert effect.told_apart.get(rival) or catalogue()[rival].told_apart.get(name), (name, rival)


def test_every_trace_points_to_effects_the_likeliest_first() -> None:
    for trace in TRACES:
        found = leaving(trace)
        assert found and [catalogue()[n].leaves[trace] for n in found] == list(range(1, len(found) + 1)), trace


@pytest.mark.parametrize(("name", "rival", "part"), [
    ("extra-lag", "slew-limit", "two steps in manual of different size"),
    ("slew-limit", "extra-lag", "two steps in manual of different size"),
    ("underdamped-process", "sinusoidal-disturbance", "comes to rest"),
    ("step-disturbance@load", "step-disturbance@output", "how a load enters"),
    ("gain-drift", "coloured-noise", "a shift")])
def test_a_rival_is_told_apart_whichever_file_says_how(name: str, rival: str, part: str) -> None:
    assert part in deciding_measurement(name, (rival,))
    assert deciding_measurement(name, ()) == ""
