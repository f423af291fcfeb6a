"""Reports as markdown, JSON and terminal text: golden files, hostile text, same bytes, and every refusal."""

from __future__ import annotations

import dataclasses
import io
import json
import os
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import study_factory
from commands import Done, run
from printed import same_text
from quick_loops import WORDS

from stictionid.errors import UsageError
from stictionid.fit.adequacy import judge_adequacy
from stictionid.record.evidence import Evidence
from stictionid.record.study import to_json
from stictionid.record.swing import Severity
from stictionid.reports import sections, wording
from stictionid.reports.answer import answers
from stictionid.reports.facts import facts
from stictionid.reports.pages.json import report_json
from stictionid.reports.pages.write import write_report
from stictionid.reports.pictures.curves import Case, gather
from stictionid.reports.pictures.figures import draw, figure_bytes
from stictionid.reports.pictures.gallery import pictures

GOLDEN = Path(__file__).parent / "golden"
KINDS = ("good", "doubtful", "abstained", "searched")
# Set to 1 to write the golden files anew after an intended change; read the difference before committing it.
_REWRITE = os.environ.get("STICTIONID_REWRITE_GOLDEN") == "1"


def case(kind: str) -> Case:
    return getattr(study_factory, kind)()


def same_as_golden(text: str, name: str) -> None:
    """The text reads as the golden file of that name, as far as any processor says it."""
    path = GOLDEN / name
    if _REWRITE:
        path.write_text(text, encoding="utf-8")
    same_text(path.read_text(encoding="utf-8"), text)


def is_one_sentence(out: Done, code: int) -> None:
    assert out.returncode == code, out.stderr
    assert out.stdout == ""
    lines = out.stderr.splitlines()
    assert lines[0].startswith("stictionid: ") and len(lines) <= 2, out.stderr


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a small simulated record and its study, made by the commands."""
    folder = tmp_path_factory.mktemp("made")
    out = run("simulate", *WORDS, "-o", "loop.csv", cwd=folder)
    assert out.returncode == 0, out.stderr
    out = run("identify", "loop.csv", "-o", "study.json", "--quiet", cwd=folder)
    assert out.returncode == 0, out.stderr
    return folder


@pytest.mark.printed
@pytest.mark.parametrize("kind", KINDS)
def test_markdown_reads_as_the_golden_file(kind: str, tmp_path: Path) -> None:
    write_report([case(kind)], tmp_path / "r.md")
    same_as_golden((tmp_path / "r.md").read_text(encoding="utf-8"), f"report_{kind}.md")


def test_the_page_says_the_same_shares_as_the_json(tmp_path: Path) -> None:
    page, data = tmp_path / "r.html", tmp_path / "r.json"
    for out in (page, data):
        write_report([case("searched")], out)
    swing = json.loads(data.read_text(encoding="utf-8"))["studies"][0]["study"]["swing"]
    headline = re.search(r'class="said">(.*?)</p>', page.read_text(encoding="utf-8"))[1]
    said = sorted(float(n) for n in re.findall(r"(\d+) %", headline))
    exact = sorted(100 * s["share"] for s in swing["causes"] if s["share"] >= 0.01)
    assert said == pytest.approx(exact, abs=1.0) and sum(said) == 100
    assert f"{swing['sd_perfect']:.3g}" in headline and f"{swing['sd']:.3g}" in headline


@pytest.mark.printed
@pytest.mark.parametrize("kind", KINDS)
def test_json_facts_read_as_the_golden_file(kind: str) -> None:
    one = case(kind)
    content = json.loads(report_json([one], [pictures(one)]))
    assert content["schema"] == "stictionid.report/1"
    study = content["studies"][0]
    shown = {"facts": study["facts"], "pictures": {k: p["alt"] for k, p in study["pictures"].items()}}
    same_as_golden(json.dumps(shown, indent=1, ensure_ascii=False), f"report_{kind}.json")


def test_json_holds_every_number_a_picture_shows() -> None:
    one = case("good")
    study = json.loads(report_json([one], [pictures(one)]))["studies"][0]
    assert len(study["series"]["process_value"]) == one.loop.samples
    assert len(study["series"]["model"]) == one.loop.samples
    for picture in study["pictures"].values():
        for panel in picture["panels"]:
            assert panel["lines"] or panel["cells"] or panel["marks"] or panel["branches"]
            assert all(len(line["x"]) == len(line["y"]) for line in panel["lines"])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("extension", ["md", "json", "html"])
def test_the_same_study_gives_the_same_bytes(kind: str, extension: str, tmp_path: Path) -> None:
    written = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        files = write_report([case(kind)], tmp_path / folder / f"r.{extension}")
        written.append({f.name: f.read_bytes() for f in files})
    assert written[0] == written[1]


def test_png_figures_are_the_same_bytes_and_named_in_the_text(tmp_path: Path) -> None:
    first = {f.name: f.read_bytes() for f in write_report([case("doubtful")], tmp_path / "r.md", figures="png")}
    again = {f.name: f.read_bytes() for f in write_report([case("doubtful")], tmp_path / "r.md", figures="png")}
    assert first == again
    text = first.pop("r.md").decode()
    assert first and all(name in text and content[:4] == b"\x89PNG" for name, content in first.items())


def test_every_picture_has_an_alternative_that_states_a_finding() -> None:
    for kind in KINDS:
        for picture in pictures(case(kind)).values():
            assert re.search(r"\d", picture.alt) and len(picture.alt) > 30, picture.key


def test_hostile_text_stays_text_in_markdown(tmp_path: Path) -> None:
    write_report([study_factory.hostile()], tmp_path / "r.md")
    text = (tmp_path / "r.md").read_text(encoding="utf-8")
    outside = re.sub(r"^(`{3,})(?:sh|text)\n.*?^\1$", "", text.replace("<!-- stictionid report -->", "", 1),
                     flags=re.DOTALL | re.MULTILINE)
    assert "<" not in outside and ">" not in outside
    assert not re.search(r"(?<!\\)\[d", outside) and not re.search(r"(?<!\\)`b", outside)
    assert max(map(len, text.splitlines())) < 6000
    no_control_characters(text)


def no_control_characters(text: str) -> None:
    bad = [c for c in text if (ord(c) < 32 and c != "\n") or ord(c) == 127 or "\u202a" <= c <= "\u202e"
           or "\ud800" <= c <= "\udfff"]
    assert not bad


def test_hostile_text_stays_text_in_svg(tmp_path: Path) -> None:
    files = [f for f in write_report([study_factory.hostile()], tmp_path / "r.md") if f.suffix == ".svg"]
    assert len(files) > 5
    for file in files:
        text = file.read_text(encoding="utf-8")
        no_control_characters(text)
        tree = ElementTree.fromstring(text)
        names = {element.tag.rpartition("}")[2] for element in tree.iter()}
        assert not names & {"script", "image", "foreignObject", "a"}


def test_hostile_text_stays_text_in_json() -> None:
    one = study_factory.hostile()
    text = report_json([one], [pictures(one)])
    text.encode("utf-8")
    assert json.loads(text)["studies"][0]["study"]["data"]["name"].startswith("<script>")


def test_several_studies_are_compared(tmp_path: Path) -> None:
    files = write_report([case(kind) for kind in KINDS], tmp_path / "r.md")
    text = files[-1].read_text(encoding="utf-8")
    assert text.count("\n## Valve stiction: ") == len(KINDS) and "Loops compared" in text
    assert len({f.name for f in files}) == len(files)
    with pytest.raises(UsageError):
        write_report([case("good")], tmp_path / "r.pdf")


def test_an_effect_added_later_shows_what_the_verdict_and_the_map_were_made_from() -> None:
    one = study_factory.good()
    mapped = replace(one.study.cost_map, step=0)
    one = replace(one, study=replace(one.study, cost_map=mapped))
    text = facts(one.study)
    assert text.reason.startswith("Before extra-lag was added: ") and "Now the free-run error is" in text.reason
    # A verdict that was reached with it needs no such word.
    known = replace(one.study, verdict=replace(one.study.verdict, evidence=Evidence(effects=("extra-lag",))))
    assert facts(known).reason == wording.sentence(known.verdict.reason)
    commands = next(s for s in text.sections if s.key == "method").commands
    assert commands[-1] == "stictionid add extra-lag study.json"
    drawn = pictures(one)["cost_map"]
    assert {m.label for m in drawn.panels[0].marks} >= {"optimum", "last model"} and "before" in drawn.title
    alone = replace(one, study=replace(one.study, cost_map=replace(mapped, step=len(one.study.steps) - 1)))
    assert "Before" not in facts(alone.study).reason and "before" not in pictures(alone)["cost_map"].title


def test_the_map_states_no_jump_that_the_study_does_not_know() -> None:
    one = study_factory.good()
    assert one.study.estimate is not None and "J 2.03 %" in pictures(one)["cost_map"].alt
    unknown = replace(one.study, estimate=replace(one.study.estimate, J_interval=None, J_known=False))
    said = pictures(replace(one, study=unknown))["cost_map"].alt
    assert "S 5.01 %; its J is unknown" in said and "2.03" not in said
    jump = next(row for s in facts(unknown).sections if s.key == "size" for row in s.tables[0].rows if "J" in row[0])
    assert jump[1] == "unknown"


def test_what_to_do_next_names_the_effect_that_waits() -> None:
    study = study_factory.doubtful().study
    bullets = next(s for s in facts(study).sections if s.key == "next").bullets
    assert any("stictionid diagnose STUDY" in b for b in bullets)
    waiting = replace(study, missing=("slew-limit",))
    bullets = next(s for s in facts(waiting).sections if s.key == "next").bullets
    assert any("stictionid add slew-limit STUDY" in b for b in bullets)


def test_every_number_of_the_text_has_its_unit_where_the_export_has_none() -> None:
    study = study_factory.searched().study
    bare = facts(replace(study, data=replace(study.data, units={})))
    assert re.search(r"instead of [\d.]+ units of PV", bare.headline)
    process = next(s for s in bare.sections if s.key == "parameters").text[0]
    assert re.search(r"with gain [\d.]+ units of PV per %", process)


def test_the_evidence_is_in_words_and_its_counts_are_whole() -> None:
    study = study_factory.good().study
    measured = Evidence(likelihood_ratio=104.2, blocks_won=5, blocks=5, effects=(), held_out_gain=0.1, held_out_won=4,
                        S_excluded_above=1.5)
    told = facts(replace(study, verdict=replace(study.verdict, evidence=measured)))
    rows = dict(next(t for t in next(s for s in told.sections if s.key == "method").tables
                     if t.caption.startswith("Evidence")).rows)
    assert rows["blocks compared"] == "5" and rows["effects in both"] == "none"
    assert not [name for name in rows if "_" in name]


def test_a_study_without_intervals_does_not_say_what_they_hold() -> None:
    study = study_factory.good().study
    bare = facts(replace(study, estimate=replace(study.estimate, S_interval=None, J_interval=None)))
    text = next(s for s in bare.sections if s.key == "size").text
    assert text[0] == "S and J have no intervals." and not any("90 %" in line for line in text)


def test_a_record_whose_output_stands_at_its_limit_throughout_has_a_page(tmp_path: Path) -> None:
    rows = [f"{k},50,{50 + 3 * np.sin(k / 9):.3f},0" for k in range(200)]
    (tmp_path / "closed.csv").write_text("\n".join(["time_s,SP,PV,OP", *rows]) + "\n", encoding="utf-8")
    run("identify", "closed.csv", "-o", "study.json", "-q", cwd=tmp_path)
    for page in ("page.html", "page.md"):
        out = run("report", "study.json", "-o", page, cwd=tmp_path)
        assert out.returncode == 0, out.stderr
        assert "0 usable samples" in (tmp_path / page).read_text(encoding="utf-8")


def test_slips_that_pv_placed_are_said_beside_an_error_at_the_noise() -> None:
    study = study_factory.good().study
    last = study.steps[-1]
    error = replace(last.error, rmse=0.306, rmse_path=0.2073, slips_moved=0.62, noise_sd=0.1874, landing_sd=0.0719)
    held, why = judge_adequacy(replace(last, error=error), study_factory.good().loop)
    assert not held and "within 5 % of 0.2007, the irreducible noise 0.1874 together with unknown digits of the" in why
    slow = replace(last, error=error, model={**last.model, "paths": {"jitter": 0.29}})
    assert "together with unknown moves of the output between the samples" in judge_adequacy(
        slow, study_factory.good().loop)[1]
    known = replace(study, steps=(*study.steps[:-1], replace(last, error=error)), missing=(), adequate=held,
                    adequate_reason=why, carried_by="slips that PV moved")
    (line,) = answers(known, applied=True)
    assert "with slips where PV places them (62 % moved)" in line


def test_a_severity_in_the_study_is_shown() -> None:
    meaning = Severity("severe", ("severe",), 2.0, 0.5, 0.9, 5000.0, 900.0, 0.1, 5.0,
                       "without friction the process value would scatter by 0.5 instead of 2", "EnTech (1998)")
    later = dataclasses.replace(study_factory.good().study, severity=meaning)
    text = " ".join(next(s for s in facts(later).sections if s.key == "size").text)
    assert "ithout friction the process value would scatter by 0.5 instead of 2" in text


def test_rule_labels_never_lie_on_each_other_nor_outside() -> None:
    from stictionid.reports.pictures.axes import Axis
    from stictionid.reports.pictures.legend import rule_labels
    from stictionid.reports.pictures.picture import Panel, Rule

    panel = Panel("x", "y", rules=tuple(Rule("x", v, "moderate") for v in (0.5, 0.52, 1.0, 5.0, 9.99, 30.0)))
    drawn = ElementTree.fromstring(f"<g>{rule_labels(panel, Axis(0, 10, 60, 420), 100, 7.3, lambda t, _: t)}</g>")
    boxes = [(float(t.get("x")), float(t.get("y"))) for t in drawn.iter("text")]
    assert len(boxes) == 5  # 30 is out of sight
    assert all(x >= 60 and x + 7.3 * 8 <= 420 for x, _ in boxes)
    for i, (x, y) in enumerate(boxes):
        assert all(y != other_y or abs(x - other_x) >= 7.3 * 8 for other_x, other_y in boxes[i + 1:])


def test_drawn_axes_hold_every_number_of_the_picture() -> None:
    """A caller can zoom into the axes, read them and add to them: they are in the units of the data."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    for kind in ("good", "doubtful", "hostile"):
        for picture in pictures(getattr(study_factory, kind)()).values():
            figure, settings = Figure(figsize=(9, 9), layout="constrained"), dict(rcParams)
            ax = figure.subplots()
            assert draw(picture, ax) is ax and dict(rcParams) == settings
            assert len(figure.axes) == len(picture.panels) + (picture.key == "cost_map")  # which has a scale beside it
            for panel, one in zip(picture.panels, figure.axes, strict=False):
                drawn = [np.asarray(line.get_xydata()) for line in one.lines]
                drawn += [np.array([[p.get_width(), p.get_y() + p.get_height() / 2] for p in bars]) for bars
                          in one.containers]
                drawn += [np.array([s[1] for s in c.get_segments()]) for c in one.collections
                          if hasattr(c, "get_segments")]
                wanted = [np.column_stack([line.x, line.y]) for line in panel.lines]
                wanted += [np.array([[m.x, m.y]]) for m in panel.marks]
                for points in wanted:
                    assert any(d.shape == points.shape and np.allclose(d, points, equal_nan=True) for d in drawn)
                assert {r.value for r in panel.rules} <= {v for d in drawn if len(d) == 2 for v in d.ravel()}
                assert len(one.patches) >= len(panel.bands) + len(panel.boxes)
                assert one.get_xlabel().startswith(panel.x_label[:5])
                if panel.names:
                    assert len(one.get_yticklabels()) == len(panel.names)


def test_panels_share_the_place_of_the_axes() -> None:
    from matplotlib.figure import Figure

    for layout in (None, "constrained"):
        figure = Figure(figsize=(6, 6), layout=layout)
        beside, ax = figure.subplots(1, 2)
        free = figure.add_axes((0.1, 0.1, 0.2, 0.2)) if layout is None else beside
        for one in (ax, free):
            place, others = one.get_position(), len(figure.axes)
            draw(pictures(case("good"))["fit"], one)
            lower = figure.axes[others]
            if layout is None:
                assert place.x0 == pytest.approx(lower.get_position().x0)
                assert place.y0 == pytest.approx(lower.get_position().y0)
            assert lower.get_position().y1 < one.get_position().y0
            one.set_xlim(100, 200)
            assert lower.get_xlim() == (100, 200)


def test_a_tag_is_no_formula_in_a_png() -> None:
    one = case("good")
    loop = replace(one.loop, units=dict.fromkeys(one.loop.units, "$\\frac{$"))
    study = replace(one.study, candidates=tuple(replace(c, effect="$_^$") for c in one.study.candidates),
                    data=replace(one.study.data, units=loop.units))
    for picture in pictures(replace(one, loop=loop, study=study)).values():
        assert len(figure_bytes(picture, "png")) > 3_000


@pytest.mark.parametrize(("text", "written"), [
    ("FIC101.PV", "FIC101.PV"), ("=1+cmd", "'=1+cmd"), ("+1", "'+1"), ("-tag", "'-tag"), ("@SUM(A1)", "'@SUM(A1)"),
    ("\t=1", "' =1"), ('a"b', '"a""b"'), ("a,b", '"a,b"'), ("a\nb\x1b[31m", "a b [31m"), ("", "")])
def test_foreign_cells_are_no_formulas(text: str, written: str) -> None:
    from stictionid.system.csv_safety import cell

    assert cell(text) == written


def test_a_written_record_disarms_its_tags(tmp_path: Path) -> None:
    import csv

    from stictionid.record.write import write_loop

    loop = case("good").loop
    tags = ["=cmd|' /C calc'!A0", "@x", "a,b", 'q"q', "-plain"]
    write_loop(replace(loop, extras={t: -loop.output for t in tags}), tmp_path / "r.csv")
    with open(tmp_path / "r.csv", newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert all(name[0] not in "=+-@" for name in rows[0]) and len(rows[0]) == len(rows[1])
    assert float(rows[1][-1]) < 0  # numbers stay numbers


def test_a_long_record_is_written_compactly_and_in_full(tmp_path: Path) -> None:
    one = study_factory.good(20_000)
    text = report_json([one], [pictures(one)])
    assert len(text) < 20_000 * 7 * 21 and text.count("\n") < 20_000
    series = json.loads(text)["studies"][0]["series"]
    assert series["process_value"] == one.loop.process_value.tolist()
    assert series["model"][0] is None and len(series["model"]) == 20_000


def test_report_through_a_process(made: Path, tmp_path: Path) -> None:
    words = [sys.executable, "-m", "stictionid", "report", "study.json", "-o", str(tmp_path / "p.html")]
    process = subprocess.run(words, capture_output=True, text=True, encoding="utf-8", cwd=made)
    assert process.returncode == 0 and process.stdout == "" and f"wrote {tmp_path}" in process.stderr
    for extension in ("md", "json", "html"):
        out = run("report", made / "study.json", "-o", tmp_path / f"r.{extension}", cwd=made)
        assert out.returncode == 0 and out.stdout == "" and f"wrote {tmp_path}" in out.stderr
    out = run("report", made / "study.json", "--json", cwd=made)
    assert json.loads(out.stdout)["studies"][0]["study"]["verdict"]["stiction"] == "stiction"
    assert (tmp_path / "r.html").read_bytes() == (tmp_path / "p.html").read_bytes()
    assert "pictures beside it" not in run("report", made / "study.json", "-o", tmp_path / "r.json", cwd=made).stderr


def test_an_older_report_is_replaced_and_another_file_is_not(made: Path, tmp_path: Path) -> None:
    target = tmp_path / "r.md"
    for _ in range(2):
        assert run("report", made / "study.json", "-o", target, cwd=made).returncode == 0
    target.write_text("my notes")
    is_one_sentence(run("report", made / "study.json", "-o", target, cwd=made), 2)
    assert target.read_text() == "my notes"
    assert run("report", made / "study.json", "-o", target, "--force", cwd=made).returncode == 0


def test_a_place_that_can_not_be_written_is_one_sentence(made: Path, tmp_path: Path) -> None:
    for target in (tmp_path / "absent" / "r.md", tmp_path, tmp_path / "r.pdf", tmp_path / "r"):
        is_one_sentence(run("report", made / "study.json", "-o", target, cwd=made), 2)
    is_one_sentence(run("report", made / "study.json", "-o", tmp_path / "r.md", "--figures", "gif", cwd=made), 2)
    assert not list(tmp_path.iterdir())


def test_a_study_that_is_none_is_one_sentence(made: Path, tmp_path: Path) -> None:
    is_one_sentence(run("report", tmp_path / "absent.json", "-o", tmp_path / "r.md"), 2)
    (tmp_path / "text.json").write_text("not JSON")
    is_one_sentence(run("report", tmp_path / "text.json", "-o", tmp_path / "r.md"), 3)
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\x00")
    is_one_sentence(run("report", tmp_path / "binary.json", "-o", tmp_path / "r.md"), 3)
    newer = json.loads((made / "study.json").read_text()) | {"schema": "stictionid.study/99"}
    (tmp_path / "newer.json").write_text(json.dumps(newer))
    is_one_sentence(run("report", tmp_path / "newer.json", "-o", tmp_path / "r.md"), 3)
    assert not (tmp_path / "r.md").exists()


def test_changed_data_are_refused(made: Path, tmp_path: Path) -> None:
    (tmp_path / "study.json").write_bytes((made / "study.json").read_bytes())
    (tmp_path / "loop.csv").write_bytes((made / "loop.csv").read_bytes() + b"\n")
    out = run("report", "study.json", "-o", "r.md", cwd=tmp_path)
    is_one_sentence(out, 3)
    assert "has changed since the study" in out.stderr and not (tmp_path / "r.md").exists()


def test_missing_data_give_tables_and_say_so(made: Path, tmp_path: Path) -> None:
    (tmp_path / "study.json").write_bytes((made / "study.json").read_bytes())
    out = run("report", "study.json", "-o", "r.md", cwd=tmp_path)
    assert out.returncode == 0 and "were not found" in out.stderr
    text = (tmp_path / "r.md").read_text(encoding="utf-8")
    assert "No pictures" in text and "Parameters of the last model" in text and "trend.svg" not in text
    out = run("report", "study.json", "--data", made / "loop.csv", "-o", "r.md", cwd=tmp_path)
    assert out.returncode == 0 and "trend.svg" in (tmp_path / "r.md").read_text(encoding="utf-8")
    is_one_sentence(run("report", "study.json", "--data", "absent.csv", "-o", "r.md", cwd=tmp_path), 3)


def test_an_abstained_study_is_a_report_and_exit_0(tmp_path: Path) -> None:
    study = tmp_path / "study.json"
    study.write_text(to_json(study_factory.abstained().study), encoding="utf-8")
    for extension in ("md", "html", "json"):
        assert run("report", study, "-o", tmp_path / f"r.{extension}").returncode == 0
    assert "What to do next" in (tmp_path / "r.md").read_text(encoding="utf-8")


def on_terminal(one: Case, *, encoding: str = "utf-8", width: int = 80) -> str:
    """What print_case writes to a file of that encoding."""
    from rich.console import Console

    from stictionid.cli.common.terminal import print_case

    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding=encoding, newline="\n")
    print_case(one, Console(file=stream, width=width, highlight=False, markup=False, emoji=False))
    stream.flush()
    return raw.getvalue().decode(encoding)


@pytest.mark.printed
@pytest.mark.parametrize("kind", KINDS)
def test_the_terminal_reads_as_the_golden_file(kind: str) -> None:
    same_as_golden(on_terminal(case(kind)), f"report_{kind}.txt")


@pytest.mark.parametrize("encoding", ["utf-8", "ascii", "cp437", "latin-1"])
def test_the_terminal_is_plain_and_80_columns_wide(encoding: str) -> None:
    for one in (*map(case, KINDS), study_factory.hostile()):
        text = on_terminal(one, encoding=encoding)
        no_control_characters(text)
        assert max(map(len, text.splitlines())) <= 80
    shown = on_terminal(case("good"), encoding=encoding)
    assert any("\u2801" <= c <= "\u28ff" for c in shown) == (encoding == "utf-8")
    assert shown.count("|") > 20 and "fails at" in shown


def test_the_trend_of_a_flat_or_empty_signal_is_drawn() -> None:
    import numpy as np

    from stictionid.cli.common.terminal import raster

    assert raster(np.full(50, 3.0), 20, 8, 3.0, 3.0).sum() == 20
    ramp = raster(np.arange(500.0), 20, 8, 0.0, 499.0)
    assert ramp.any(axis=0).all() and ramp.any(axis=1).all() and ramp[7, 0] and ramp[0, 19]
    assert not raster(np.full(50, np.nan), 20, 8, 0.0, 1.0).any()


def test_without_out_the_report_is_printed(made: Path) -> None:
    out = run("report", made / "study.json", cwd=made)
    assert out.returncode == 0 and "The valve sticks" in out.stdout and "What to do next" in out.stdout
    no_control_characters(out.stdout)


def test_the_valve_picture_shows_a_window_with_break_aways_both_ways() -> None:
    one = study_factory.good(1800)
    resting = one.curves[-1].position.copy()
    resting[900:] = resting[900]
    drawn = pictures(replace(one, curves=tuple(replace(c, position=resting) for c in one.curves)))["characteristic"]
    moves = np.diff(next(line for line in drawn.panels[0].lines if line.name == "inferred position").y)
    assert moves.min() < 0.0 < moves.max()


def test_effects_of_the_base_stand_beside_the_same_model_without_them() -> None:
    one = study_factory.modelled()
    drawn = pictures(one)
    for key in ("evidence-0-0", "evidence-1"):
        without, found = drawn[key].panels[0].lines[:2]
        assert np.std(without.y) > 1.5 * np.std(found.y)
    assert "the other numbers kept" in drawn["evidence-0-0"].caption
    assert "the other numbers kept" not in drawn["evidence-1"].caption
    shown = [s.pictures for s in facts(one.study).sections if s.key.startswith("evidence-of")]
    assert shown == [("evidence-0-0",), ("evidence-1",)]


def test_every_effect_has_one_row_and_one_of_the_model_is_never_rejected() -> None:
    study = study_factory.searched(240).study
    (table,) = next(s for s in facts(study).sections if s.key == "candidates").tables
    assert table.columns[:5] == ("effect", "error", "x noise", "gain beyond noise", "answer")
    assert table.rows[0][:5] == ("extra-lag", "0.0521", "1.04", "150", "named")
    later = replace(study.steps[-1], effects=("extra-lag", "slew-limit"))
    (table,) = next(s for s in facts(replace(study, steps=(study.steps[0], later))).sections
                    if s.key == "candidates").tables
    assert [row[4] for row in table.rows] == ["named", "in the model"]


def test_an_effect_that_raises_the_error_is_not_praised() -> None:
    study = study_factory.good(240).study
    first, last = study.steps
    worse = replace(last, error=replace(last.error, rmse=1.1 * first.error.rmse))
    sections = {s.key: s for s in facts(replace(study, steps=(first, worse))).sections}
    assert sections["evidence-of-1"].bullets[0].startswith("Speaks against it: with it the free-run error rises from")
    assert "With extra-lag the free run errs more, 0.0924 for 0.0840 without it." in sections["ladder"].text
    better = {s.key: s for s in facts(study).sections}
    assert better["evidence-of-1"].bullets[0].startswith("Speaks for it: with it the free-run error falls from")
    assert not any("errs more" in words for words in better["ladder"].text)


def test_the_cycles_that_count_are_those_of_the_table_without_its_start() -> None:
    study = study_factory.good(600).study
    cycles = (replace(study.range.cycles[0], u_swing=99.0), *study.range.cycles[1:])
    section = next(s for s in facts(replace(study, range=replace(study.range, cycles=cycles))).sections
                   if s.key == "range")
    summary, rows = section.tables
    assert ("whole cycles that count", str(len(cycles) - 1)) in summary.rows
    marked = [row for row in rows.rows if "start" in row[0]]
    assert [row[2] for row in marked] == ["99.0 %"] and len(rows.rows) == len(cycles)


def test_a_headline_says_how_much_a_poor_model_explains() -> None:
    study = study_factory.modelled().study
    assert "These shares are rough: the model explains more than 99 % of PV" in facts(study).headline
    poor = replace(study.steps[-1], error=replace(study.steps[-1].error, fit_percent=10.0))
    said = facts(replace(study, steps=(*study.steps[:-1], poor)))
    assert said.headline.startswith("What makes the loop swing is not proven, because the model explains only 19 %")
    assert "may move S out of this range" in said.then[0]
    assert "not proven" not in facts(replace(study, steps=(*study.steps[:-1], poor), adequate=True)).headline


@pytest.mark.parametrize("bad", ["forty steps", "long names", "right to left", "effect file missing"])
def test_a_page_of_bad_input_is_whole(bad: str, tmp_path: Path) -> None:
    one = study_factory.modelled()
    base, last = one.study.steps
    names = {"long names": "A" * 200, "right to left": "مضخة שלום FIC-101 " * 11}
    if bad == "forty steps":
        one = replace(one, study=replace(one.study, steps=(base, *(last,) * 39)),
                      curves=(one.curves[0], *one.curves[1:] * 39))
    elif bad in names:
        data = replace(one.study.data, name=names[bad], units=dict.fromkeys(one.study.data.units, names[bad]),
                       columns=dict.fromkeys(one.study.data.columns, names[bad]))
        one = replace(one, study=replace(one.study, data=data))
    else:
        written = {**last.model, "written": {"mine": {"file": "mine.py", "sha256": "0"}}}
        one = gather(replace(one.study, steps=(base, replace(last, added="mine", effects=("mine",), model=written))))
        assert "the effect mine of mine.py, which is not loaded" in one.missing
    page = write_report([one], tmp_path / "r.html")[0].read_text(encoding="utf-8")
    assert page.endswith("</html>\n") and len(page) < 3_000_000
    assert page.count("<section") == page.count("</section>") > 8
    assert (page.count("<figure") > 8) == (bad != "effect file missing")


def test_a_run_that_contradicts_the_record_gives_no_cause() -> None:
    study = study_factory.modelled().study
    why = "not told: by this model a perfect valve would make PV scatter by 5.74 instead of 3.67"
    study = replace(study, swing=replace(study.swing, causes=(), reason=why))
    found = facts(study)
    assert found.headline.startswith("What makes the loop swing can't be told from this record: by this model a")
    said = next(s.text for s in found.sections if s.key == "swing")
    assert said[1].startswith("No share of the swing is given to a cause: by this model") and "not told" not in said[1]


def test_a_j_that_is_unknown_and_an_excluded_s_read_alike_in_every_part_of_the_page() -> None:
    study = study_factory.doubtful().study
    assert study.estimate is not None
    evidence = replace(study.verdict.evidence, S_excluded_above=0.3445)
    study = replace(study, estimate=replace(study.estimate, J_known=False),
                    verdict=replace(study.verdict, evidence=evidence))
    (table,) = sections.parameters(study).tables
    told = {row[1]: row[-1] for row in table.rows if row[0] == "base"}
    assert told["J"].endswith("the record leaves more than half of it open") and "open" not in told["S"]
    rows = dict(sections.method(study).tables[1].rows)
    assert rows["S above this is excluded"] == "0.35" == f"{evidence.S_stated_above:.2g}"
