"""The template of a user-written effect, found by diagnose where a loop has it and left alone where not."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import test_written_effects
from commands import run

LOOP = ("--gain", 1.2, "--time-constant", 20, "--dead-time", 4, "--kc", 0.7, "--ti", 12, "--scan", 1, "--noise", 0.06,
        "--duration", 1500, "--setpoint", "0:6", "--setpoint", "300:-10", "--setpoint", "700:12", "--setpoint",
        "1100:-9", "--S", 4, "--J", 2.5)


@pytest.mark.parametrize(("seed", "start", "width"), [(3, 48.0, 2.0), (4, 52.0, 1.5), (5, 46.0, 3.0), (6, None, None)])
def test_the_template_is_added_where_it_is_and_nowhere_else(tmp_path: Path, seed: int, start: float | None,
                                                           width: float | None) -> None:
    effect, export, study = (tmp_path / name for name in ("my_effect.py", "loop.csv", "study.json"))
    assert run("effects", "--new", "worn-trim", "-o", effect).returncode in (0, 2)
    if not effect.exists():
        from stictionid.effects.contract.template import template

        effect.write_text(template("worn-trim"))
    hidden = () if start is None else ("--effect", f"worn-trim:start={start},width={width}", "--effects", effect)
    assert run("simulate", *LOOP, "--seed", seed, *hidden, "-o", export).returncode == 0
    assert run("identify", export, "-o", study).returncode == 0
    begin = time.process_time()
    done = run("diagnose", study, "--all", "--apply", "--jobs", 1, "--effects", effect, "--json")
    assert done.returncode == 0 and time.process_time() - begin < 60.0
    found = json.loads(done.stdout)
    assert [c["effect"] for c in found["candidates"] if c["effect"] == "worn-trim"] == ["worn-trim"]
    named = [step["added"] for step in found["steps"] if step["added"]]
    assert named == ([] if start is None else ["worn-trim"])
    assert found["estimate"]["S"] == pytest.approx(4.0, rel=0.01)
    if start is not None:
        values = {p["name"]: p["value"] for p in found["steps"][-1]["parameters"] if p["effect"] == "worn-trim"}
        # Slips are 2.5 % long: between two places where the valve rests the place of the worn part does not show.
        assert values["width"] == pytest.approx(width, rel=0.05) and values["start"] == pytest.approx(start, abs=1.25)


def test_a_second_lag_written_as_a_function_is_the_built_in_one(tmp_path: Path) -> None:
    looped = test_written_effects.LOOPED
    test_written_effects.test_a_second_lag_written_in_any_form_is_the_built_in_one(tmp_path, looped)
