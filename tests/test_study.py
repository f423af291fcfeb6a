"""Studies of every released schema load for ever; damaged, foreign and newer ones are refused in a sentence."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from stictionid.errors import DataError
from stictionid.record.study import study_from_json, to_json

GOLDEN = Path(__file__).parent / "golden"
STUDIES = sorted(GOLDEN.glob("study_schema_*.json"))


@pytest.mark.parametrize("path", STUDIES, ids=lambda p: p.name)
def test_golden_studies_load_and_write_what_they_were(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    study = study_from_json(text)
    written, kept = json.loads(to_json(study)), json.loads(text)
    assert contains(written, kept)
    assert (study.estimate is None) == path.stem.endswith("abstained")


def contains(larger: object, smaller: object) -> bool:
    """Every field of `smaller` stands in `larger` with the same value; later versions may add fields."""
    if isinstance(smaller, dict):
        return isinstance(larger, dict) and all(k in larger and contains(larger[k], v) for k, v in smaller.items())
    if isinstance(smaller, list):
        return isinstance(larger, list) and len(larger) == len(smaller) and all(map(contains, larger, smaller))
    return larger == smaller


CONTRACT = {
    "created_by": {"version", "seed", "python", "numpy", "numba"},
    "data": {"file", "sha256", "columns", "units", "rows", "rows_used", "step_s", "start", "end", "findings"},
    "range": {"oscillating", "period_s", "period_median_s", "s_max", "cycles", "reason"},
    "verdict": {"stiction", "reason", "confidence"},
    "estimate": {"S", "J", "unit", "S_interval", "J_interval", "interval_level", "law", "gain", "time_constants_s",
                 "dead_time_s", "integrating", "initial_residual_force", "from_position"},
}


def test_a_study_has_every_field_of_the_contract() -> None:
    study = json.loads((GOLDEN / "study_schema_1.json").read_text(encoding="utf-8"))
    assert next(iter(study)) == "schema"
    for part, fields in CONTRACT.items():
        assert fields <= set(study[part]), part
    assert {"steps", "laws", "candidates", "missing", "adequate", "adequate_reason"} <= set(study)
    step = study["steps"][0]
    assert {"added", "effects", "parameters", "error", "restarts", "findings"} <= set(step)
    assert {"effect", "name", "value", "unit", "interval", "at_bound", "identifiable"} <= set(step["parameters"][0])
    assert {"rmse", "rmse_holdout", "rmse_one_step", "rmse_one_step_holdout", "noise_sd", "fit_percent",
            "bic"} <= set(step["error"])
    assert {"start_s", "period_s", "u_swing"} <= set(study["range"]["cycles"][0])


def test_the_evidence_of_a_verdict_keeps_its_keys() -> None:
    content = json.loads((GOLDEN / "study_schema_1.json").read_text(encoding="utf-8"))
    short = {"rmse_with_friction": 0.05, "blocks": 5, "held_out_gain": None, "held_out_won": None, "of_a_method": [1]}
    for evidence in (short, {"code": "too-few-cycles"}, {"likelihood_ratio": 41.5, "looks_like": "a sine"}, {}):
        content["verdict"]["evidence"] = evidence
        study = study_from_json(json.dumps(content))
        assert list(json.loads(to_json(study))["verdict"]["evidence"].items()) == list(evidence.items())
    content["verdict"]["evidence"] = {"likelihood_ratio": "much"}
    with pytest.raises(DataError, match=r"verdict\.evidence\.likelihood_ratio is 'much', not a number"):
        study_from_json(json.dumps(content))


def test_the_evidence_of_a_finding_holds_what_is_decided_by_it() -> None:
    content = json.loads((GOLDEN / "study_schema_1_laws.json").read_text(encoding="utf-8"))
    finding = content["steps"][0]["findings"][0]
    finding["evidence"] |= {"share": 0.5, "stretches": [[0.0, 5.0], [7.5, 9.0]], "S_range": [1.0, 2.0]}
    study = study_from_json(json.dumps(content))
    read = study.steps[0].findings[0]
    assert read.laws is not None and read.laws.kept in read.laws.alike and read.stretches == ((0.0, 5.0), (7.5, 9.0))
    assert read.evidence == {"share": 0.5, "S_range": [1.0, 2.0]} and read.caps_verdict is None
    assert json.loads(to_json(study))["steps"][0]["findings"][0]["evidence"] == finding["evidence"]
    finding["evidence"]["caps_verdict"] = "perhaps"
    with pytest.raises(DataError, match="caps_verdict is 'perhaps', not true or false"):
        study_from_json(json.dumps(content))


def test_the_noise_that_carries_a_model_is_a_field_and_is_read_from_the_words_of_older_studies() -> None:
    content = json.loads((GOLDEN / "study_schema_1.json").read_text(encoding="utf-8"))
    for start in ("", "the output is recorded in steps of 0.1 %; "):
        words = f"{start}explained but for a drift: the free-run error 0.149 is 7.29 times the irreducible noise 0.0204"
        old = study_from_json(json.dumps({**content, "adequate": False, "adequate_reason": words}))
        assert old.completed and old.carried_by == "a drift" and study_from_json(to_json(old)) == old
        assert not study_from_json(to_json(replace(old, carried_by=""))).completed
    assert not study_from_json(json.dumps(content)).carried_by


@pytest.mark.parametrize("text", [
    "", "{", "[]", "null", "{}", '{"schema": 3}', '{"schema": "something/1"}', '{"schema": "stictionid.study/99"}',
    '{"schema": "stictionid.study/1"}', '{"schema": "stictionid.study/1", "created_by": 5}', "[" * 100000,
])
def test_what_is_no_study_is_refused(text: str) -> None:
    with pytest.raises(DataError) as refusal:
        study_from_json(text)
    assert refusal.value.hint and refusal.value.exit_code == 3


def test_one_damaged_field_is_named() -> None:
    content = json.loads((GOLDEN / "study_schema_1.json").read_text(encoding="utf-8"))
    content["estimate"]["S"] = "large"
    with pytest.raises(DataError, match=r"^the study is damaged: estimate\.S is 'large', not a number$"):
        study_from_json(json.dumps(content))


def test_missing_fields_are_named_in_words() -> None:
    text = (GOLDEN / "study_schema_1.json").read_text(encoding="utf-8")
    content = json.loads(text)
    del content["steps"][0]["error"]["rmse"]
    for damaged, said in (('{"schema": "stictionid.study/1"}', "damaged: it has no created_by, data, range"),
                          (json.dumps(content), r"damaged: steps\[0\]\.error has no rmse$"),
                          (text[:len(text) // 2], "cut off: it is no JSON from line [0-9]+, column [0-9]+ on$")):
        with pytest.raises(DataError, match=said) as refusal:
            study_from_json(damaged)
        assert "__init__" not in refusal.value.message and refusal.value.hint
