"""The screen: the answer stands first, one ranking follows, and every next step that is printed runs as printed.

The chain of all next steps of one loop is in benchmarks/long.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from unittest import mock

import commands
import pytest
import study_factory
from study_factory import HOSTILE, searched

import stictionid as st
from stictionid.cli.common.next_step import next_step
from stictionid.cli.common.output import Progress
from stictionid.effects import catalogue
from stictionid.record.study import Candidate, ErrorSummary, ParameterValue, Study, to_json
from stictionid.reports.answer import answers
from stictionid.reports.facts import facts, position_sentences

SAMPLE = Path(__file__).parent.parent / "sample_data" / "foptd.csv"
STOP = Candidate("travel-limit", True, 0.0493, 0.0502, 0.05, 92.6, 50.0, 214.0, gain_beyond_noise=214.0,
                 blocks_better=5, blocks=5, parameters=(ParameterValue("travel-limit", "lower", 44.8, "%"),
                                                        ParameterValue("travel-limit", "upper", 52.0, "%")))
OTHERS = tuple(Candidate(name, False, 0.6 - 0.01 * k, None, None, 1.0, 1.0, 0.5, gain_beyond_noise=-float(k),
                         rejected_because="gains too little")
               for k, name in enumerate(sorted(set(catalogue()) - {"travel-limit", "slew-limit"})))


def diagnosed(*named: Candidate, **more) -> Study:
    """A base model at 13 times the noise, whose search named these effects and asked all the others."""
    study = searched(240).study
    base = replace(study.steps[0], error=ErrorSummary(0.666, 0.68, 0.1, 0.11, 0.05, 84.0, -100.0))
    whole = {"steps": (base,), "candidates": (*named, *OTHERS), "missing": tuple(c.effect for c in named),
             "adequate": False, "adequate_reason": "made up", "missing_reason": "", **more}
    return replace(study, **whole)


def test_the_missing_effect_stands_first_with_its_numbers_before_it_is_in_the_model() -> None:
    (line,) = answers(diagnosed(STOP), applied=False)
    assert line.startswith("missing: ") and "(travel-limit)" in line and "52.0" in line and "unknown" not in line
    assert "Error 0.666 -> 0.0493 m³/h, the noise." in line and "Better on 5 of 5 held-out blocks." in line
    assert "Check end stops" in line
    more = diagnosed(replace(STOP, rmse=0.1), missing_reason="PV answers the weather")
    far, beside = answers(more, applied=False)
    assert "0.100 m³/h, 2.00 x the noise 0.0500" in far and beside == "beside it: PV answers the weather"
    old = diagnosed(STOP, candidates=())
    assert "(travel-limit)" in answers(old, applied=False)[0] and "unknown" not in answers(old, applied=False)[0]


def test_each_effect_that_was_added_has_a_line_and_what_is_left_another() -> None:
    study = searched(240).study
    first, last = study.steps
    lag = replace(last, error=replace(last.error, rmse=0.07))
    stop = replace(last, added="travel-limit", effects=("extra-lag", "travel-limit"),
                   parameters=(*last.parameters, *STOP.parameters))
    both = replace(study, steps=(first, lag, stop), missing=("extra-lag", "travel-limit"))
    one, two = answers(both, applied=True)
    assert one.startswith("added: the loop has one more lag of 2.11 s") and "Error 0.0840 -> 0.0700" in one
    assert two.startswith("added: ") and "(travel-limit)" in two and "Error 0.0700 -> 0.0521 m³/h, the noise." in two
    *_, left = answers(replace(both, adequate=False, missing_reason="PV answers the weather"), applied=True)
    assert left == "still missing: unknown. Error 0.0521 m³/h, the noise. PV answers the weather."


def test_a_search_that_names_nothing_says_which_nothing_it_is() -> None:
    right = searched(240).study
    assert answers(replace(right, missing=()), applied=False) == (
        "missing: nothing. The free-run error 0.0521 is the noise.",)
    wandering = replace(right, missing=(), adequate=False,
                        adequate_reason="explained but for a random walk", carried_by="a random walk", steps=(
        replace(right.steps[0], error=replace(right.steps[0].error, rmse=0.3)),))
    assert answers(wandering, applied=False) == ("missing: nothing, explained but for a random walk",)
    both = answers(replace(wandering, missing=("random-walk-disturbance",)), applied=True)
    assert len(both) == 2 and both[1] == "Explained but for a random walk."
    assert answers(diagnosed(), applied=False) == (
        "missing: unknown. Error 0.666 m³/h, 13.3 x the noise 0.0500. No effect of the catalogue helps enough.",)


def printed(study: Study, folder: Path, *options: str) -> list[str]:
    """The lines of a diagnosis that ends in this study."""
    (folder / "s.json").write_text(to_json(study), encoding="utf-8")
    with mock.patch("stictionid.verbs.diagnose.diagnose", return_value=study), \
            mock.patch("stictionid.cli.diagnose.open_data"):
        done = commands.run("diagnose", folder / "s.json", "-q", *options)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_one_ranking_follows_the_answer_and_the_rest_waits_for_details(tmp_path: Path) -> None:
    study = diagnosed(STOP)
    lines, whole = printed(study, tmp_path), printed(study, tmp_path, "--details")
    assert lines[0].startswith("missing: ") and max(map(len, lines + whole)) <= 80
    head = next(i for i, line in enumerate(lines) if line.startswith("|effect"))
    columns, first = ([word.strip() for word in lines[at].strip("|").split("|")] for at in (head, head + 2))
    assert columns == ["effect", "error", "x noise", "gain", "answer"]
    assert first == ["travel-limit", "0.0493", "0.986", "214", "named"]
    assert f"and {len(OTHERS) + 1 - 12} more: --details" in lines
    asked = {c.effect for c in OTHERS}
    assert sum(line[1:].split(" ")[0] in asked for line in lines) == 11
    assert sum(line[1:].split(" ")[0] in asked for line in whole) == len(OTHERS)
    assert not any("cost evaluations" in line for line in lines) and any("cost evaluations" in line for line in whole)
    assert "models tried" in whole and not any("more: --details" in line for line in whole)


def test_no_text_of_a_file_reaches_the_screen_raw(tmp_path: Path) -> None:
    study = study_factory.hostile().study
    shown = "\n".join(printed(replace(study, steps=(replace(study.steps[0], model={}),)), tmp_path, "--details"))
    assert not any(mark in shown for mark in ("\x1b", "\x07", "\u202e")) and HOSTILE not in shown


def test_the_tree_is_the_last_section_of_a_page() -> None:
    assert facts(searched(240).study).sections[-1].key == "tree"


@pytest.mark.parametrize(("study", "asked", "words"), [
    (diagnosed(STOP), None, "add travel-limit"),
    (diagnosed(replace(STOP, effect="step-disturbance", variant="load")), None, "add step-disturbance@load"),
    (diagnosed(replace(STOP, effect="measured-disturbance", variant="TI 7")), None, "add 'measured-disturbance:TI 7'"),
    (diagnosed(candidates=()), None, "diagnose"), (diagnosed(), None, "report"), (diagnosed(), False, "diagnose"),
    (searched(240).study, None, "report"), (study_factory.abstained().study, None, "report"),
])
def test_the_next_step_follows_from_the_study(study: Study, asked: bool | None, words: str, tmp_path: Path) -> None:
    # The model of the step makes it one that can be run again.
    study = replace(study, steps=tuple(replace(s, model={"effects": list(s.effects)}) for s in study.steps))
    said = next_step(study, tmp_path / "my s.json", data=SAMPLE, effects=[Path("own.py")], asked=asked)
    assert said.startswith(f"stictionid {words} '{tmp_path}/my s.json' {SAMPLE} --effects own.py")
    assert said.endswith(f" -o '{tmp_path}/my s.html'") == (words == "report")
    # Nothing can be asked of a study whose data are gone; its report needs none.
    assert next_step(study, tmp_path / "s.json", asked=asked).startswith("stictionid report ")


@pytest.mark.parametrize("name", ["x.csv", "x.TXT", "x.parquet", "x.xlsx", "x.mat"])
def test_a_study_is_not_written_under_the_name_of_a_data_file(name: str, tmp_path: Path) -> None:
    (tmp_path / "s.json").write_text(to_json(searched(240).study))
    for words in (("identify", SAMPLE), ("diagnose", "s.json"), ("add", "extra-lag", "s.json"),
                  ("remove", "extra-lag", "s.json")):
        refused = commands.run(*words, "-o", name, "--force", cwd=tmp_path)
        assert refused.returncode == 2 and "type -o x.json" in refused.stderr
    assert not (tmp_path / name).exists()


def test_report_takes_the_data_file_after_its_study(tmp_path: Path) -> None:
    assert commands.run("identify", SAMPLE, "--base-only", "-q", "-o", tmp_path / "s.json").returncode == 0
    study = json.loads((tmp_path / "s.json").read_text())
    study["data"]["file"] = "gone.csv"
    (tmp_path / "s.json").write_text(json.dumps(study))
    (tmp_path / "moved.csv").write_bytes(SAMPLE.read_bytes())
    told_of = [commands.run("report", "s.json", *words, "-o", f"{k}.html", "--force", cwd=tmp_path)
               for k, words in enumerate(((), ("moved.csv",), ("--data", "moved.csv")))]
    assert [done.returncode for done in told_of] == [0, 0, 0]
    pages = [(tmp_path / f"{k}.html").read_text() for k in range(3)]
    assert "No pictures" in pages[0] and pages[1] == pages[2] and "No pictures" not in pages[1]
    for words in (("s.json", "s.json", "moved.csv"), ("s.json", "moved.csv", "--data", "moved.csv")):
        refused = commands.run("report", *words, cwd=tmp_path)
        assert refused.returncode == 2 and "one data file" in refused.stderr
    assert commands.run("report", "moved.csv", cwd=tmp_path).returncode == 3


def test_a_stage_that_takes_long_is_not_said_again_every_few_seconds(
        capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = Progress(False)
    for second in range(2, 100):
        now[0] = float(second)
        progress("searching (S, J)", 0.1 if second < 90 else 0.2)
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(" after ")[0] for line in lines] == ["searching (S, J), 10 %"] * 2 + ["searching (S, J), 20 %"]


def test_a_summary_calls_effects_missing_only_while_the_model_lacks_them() -> None:
    named = st.Study(diagnosed(STOP)).summary()
    held = st.Study(searched(240).study).summary()
    assert named.loc["missing", "value"] == "travel-limit" and "effect" not in named.index
    assert held.loc["effect", "value"] == "extra-lag" and "missing" not in held.index


def test_a_position_that_differs_from_the_model_says_why() -> None:
    study = searched(240).study
    e = study.estimate
    assert e is not None and e.from_position is not None and position_sentences(study) == []
    jumps = replace(study, estimate=replace(e, from_position=replace(e.from_position, J=3.5)))
    (said,) = position_sentences(jumps)
    assert said.startswith("J from the position, 3.50 %, differs from J, 2.03 %: ") and "filtered" in said
    # Intervals of a model that misses something bound nothing.
    wide = replace(jumps, estimate=replace(jumps.estimate, J_interval=(1.0, 5.7)))
    assert position_sentences(wide) == []
    (said,) = position_sentences(replace(wide, adequate=False))
    assert "without what the model misses" in said


def test_help_tells_abstained_from_undecided() -> None:
    for command in ("identify", "study"):
        text = " ".join(commands.run(command, "--help").stdout.split())
        assert "3 content that can't be used, or a record that holds too little for S and J (abstained)" in text
        assert "4 with --strict, undecided with S and J, or a model that is not adequate" in text
