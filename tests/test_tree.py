"""The tree of a search: its JSON, its lines on a terminal and in markdown, its picture."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from stictionid.errors import DataError
from stictionid.record.study import Study, study_from_json, to_json
from stictionid.record.tree import Edge, Equivalent, Gate, TreeNode

GOLDEN = Path(__file__).parent / "golden"


def _node(number: int, parent: int | None, op: str, what: str, rmse: float | None, status: str, *,
          effects: tuple[str, ...] = (), bic: float | None = None, gates: tuple[Gate, ...] = (),
          structure: str = "chen, first-order, hold", noise: str = "white") -> TreeNode:
    return TreeNode(number, parent, Edge(op, what), effects, structure, noise, {"S": 5.0, "J": 2.0}, rmse, rmse, bic,
                    status, gates)


def _study() -> Study:
    return study_from_json((GOLDEN / "study_schema_1_diagnosed.json").read_text(encoding="utf-8"))


def _searched() -> Study:
    root = _node(0, None, "root", "chen, first-order, hold", 1.168, "named", bic=-100.0)
    stop = _node(1, 0, "add", "travel-limit", 0.0504, "named", effects=("travel-limit",), bic=-2840.0,
                 gates=(Gate("held-out", True, "the held-out error falls by 95 %"),))
    return replace(_study(), tree=(root, stop), evaluations=12345, unasked=("stiction-drift", "slew-limit"),
                   equivalents=(Equivalent(1, ("travel-limit",), 4.4, 2.3, -2838.0, "a bump in MAN"),),
                   missing_reason="a stop of the valve")


def test_a_study_with_a_tree_is_written_and_read_again() -> None:
    study = _searched()
    text = to_json(study)
    assert study_from_json(text) == study
    node = json.loads(text)["tree"][1]
    assert list(node) == ["id", "parent", "edge", "effects", "structure", "noise", "parameters", "rmse",
                          "rmse_one_step", "bic", "status", "gates"]
    assert node["edge"] == {"op": "add", "what": "travel-limit"}
    assert list(node["gates"][0]) == ["name", "passed", "reason"]


def test_fields_stand_in_the_order_of_the_contract() -> None:
    content = json.loads(to_json(_searched()))
    keys = list(content)
    first = keys.index("candidates")
    assert keys[first:first + 8] == ["candidates", "tree", "evaluations", "unasked", "equivalents", "missing_reason",
                                     "missing", "adequate"]
    candidate = list(content["candidates"][0])
    assert candidate[candidate.index("delta_bic") + 1] == "gain_beyond_noise"
    assert candidate[candidate.index("detectable_from") + 1] == "rejected_because"
    assert list(content["equivalents"][0]) == ["node", "effects", "S", "J", "bic", "what_would_tell"]


def test_a_study_of_an_older_version_has_no_tree() -> None:
    study = _study()
    assert (study.tree, study.evaluations, study.unasked, study.equivalents, study.missing_reason) == \
        ((), None, (), (), "")
    assert {(c.gain_beyond_noise, c.rejected_because) for c in study.candidates} == {(None, "")}


def test_numbers_that_do_not_exist_are_dropped_and_read_again() -> None:
    node = replace(_node(0, None, "root", "chen", 1.0, "failed"), parameters={"S": 5.0, "J": float("nan")},
                   rmse=float("inf"), bic=float("nan"))
    assert (node.parameters, node.rmse, node.bic) == ({"S": 5.0}, None, None)
    study = replace(_study(), tree=(node,))
    assert study_from_json(to_json(study)) == study


@pytest.mark.parametrize(("field", "value", "said"), [
    ("status", "best", "the status 'best' is none of named, expanded"),
    ("edge", {"op": "flip", "what": "x"}, "the edge 'flip' is none of root, add"),
    ("parent", "none", r"study\.tree\[0\]\.parent"), ("gates", {}, r"study\.tree\[0\]\.gates is not a list"),
    ("parameters", {"S": None}, r"study\.tree\[0\]\.parameters\.S"),
])
def test_a_damaged_tree_is_named(field: str, value: object, said: str) -> None:
    content = json.loads(to_json(_searched()))
    content["tree"][0][field] = value
    with pytest.raises(DataError, match=said):
        study_from_json(json.dumps(content))
