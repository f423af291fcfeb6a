"""No name of an effect outside its file: traces, tests that tell it apart and roles are the effect's own."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from stictionid.effects import catalogue, leaving
from stictionid.effects.contract import TRACES
from stictionid.selection.tells import settling

PACKAGE = Path(__file__).parent.parent / "stictionid"
FREE = ("selection", "comparison", "reports", "cli", "verdict", "fit", "methods", "model", "batch", "api", "verbs")
# Names that are still known elsewhere. The search knows its three noises, and the two effects of its base by name
# (a lag, a valve that rests). The self-test hides effects of its own choice.
LEFT = {("selection/node.py", "extra-lag"), ("selection/score.py", "coloured-noise"),
        ("selection/score.py", "narrow-band-disturbance"), ("selection/score.py", "random-walk-disturbance"),
        ("fit/starts/beside_effect.py", "re-sticking")}
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
    assert {(path, name) for path, name in found if path != CHOSEN} == LEFT


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
    assert part in settling(name, (rival,))
    assert settling(name, ()) == ""
