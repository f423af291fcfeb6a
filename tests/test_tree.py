"""The tree of a search: its JSON, its lines on a terminal and in markdown, its picture."""

from __future__ import annotations

import json
import re
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path
from unittest import mock

import pytest
import study_factory
from commands import run
from study_factory import node, searched

from stictionid.errors import DataError
from stictionid.fit.study_steps import widen_to_equivalents, with_known_jump
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.record.loop import Finding
from stictionid.record.study import Estimate, Study, study_from_json, to_json
from stictionid.reports.pages.write import write_report
from stictionid.reports.pictures.axes import log_ticks
from stictionid.reports.pictures.figures import figure_bytes
from stictionid.reports.pictures.svg import CHARACTER, SQUARE, WIDE, inline, standalone
from stictionid.reports.pictures.tree_picture import tree
from stictionid.reports.tree_text import MOST_NODES, after_tree, equivalents, tree_lines, tree_of

GOLDEN = Path(__file__).parent / "golden"
RECORD = Path(__file__).parents[1] / "sample_data" / "foptd.csv"


def _study() -> Study:
    return study_from_json((GOLDEN / "study_schema_1_diagnosed.json").read_text(encoding="utf-8"))


def _searched() -> Study:
    return searched(240).study


def test_a_study_with_a_tree_is_written_and_read_again() -> None:
    study = _searched()
    text = to_json(study)
    assert study_from_json(text) == study
    written = json.loads(text)["tree"][1]
    assert list(written) == ["id", "parent", "edge", "effects", "structure", "noise", "parameters", "rmse",
                          "rmse_one_step", "bic", "status", "gates"]
    assert written["edge"] == {"op": "add", "what": "travel-limit"}
    assert list(written["gates"][0]) == ["name", "passed", "reason"]


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
    made = replace(node(0, None, "root", "chen", 1.0, None, "failed"), parameters={"S": 5.0, "J": float("nan")},
                   rmse=float("inf"), bic=float("nan"))
    assert (made.parameters, made.rmse, made.bic) == ({"S": 5.0}, None, None)
    study = replace(_study(), tree=(made,))
    assert study_from_json(to_json(study)) == study


@pytest.mark.parametrize(("field", "value", "said"), [
    ("status", "best", "the status 'best' is none of named, expanded"),
    ("edge", {"op": "flip", "what": "x"}, "the edge 'flip' is none of root, add"),
    ("parent", "none", r"damaged: tree\[0\]\.parent"), ("gates", {}, r"damaged: tree\[0\]\.gates is not a list"),
    ("parameters", {"S": None}, r"damaged: tree\[0\]\.parameters\.S"),
])
def test_a_damaged_tree_is_named(field: str, value: object, said: str) -> None:
    content = json.loads(to_json(_searched()))
    content["tree"][0][field] = value
    with pytest.raises(DataError, match=said):
        study_from_json(json.dumps(content))


def test_lines_fit_80_columns_and_put_the_best_first() -> None:
    study = searched().study
    lines = tree_lines(study)
    assert max(map(len, lines)) <= 80 and lines == tree_lines(study)
    found = tree_of(study)
    assert found is not None and len(found.shown) == MOST_NODES
    assert [s.label for s in found.shown[:5]] == ["base: chen, first-order, hold", "+ travel-limit", "+ extra-lag",
                                                  "+ stiction-drift", "+ extra-lag"]
    rows = [line for line in lines if re.search(r"base:|─ ", line)]
    assert len(rows) == MOST_NODES + 1
    assert all(s.label in line for s, line in zip(found.shown, rows[:-1], strict=True))
    assert rows[0].split()[-3:] == ["1.17", "23.4", "x"]  # 1.168 over a noise of 0.05
    assert "named: 2,740 BIC over its parent" in rows[1] and "named: 150 BIC over its parent" in rows[2]
    assert any("~ integrator" in line and "failed: runs away from y" in line for line in rows)
    assert rows[-1].split("more")[0].strip("└─ ") == "5" and rows[-1].endswith("no better than its parent")


def test_plain_lines_need_no_more_than_ascii() -> None:
    study = searched().study
    study = replace(study, data=replace(study.data, units={}), tree=study.tree[:5])
    assert all(line.isascii() for line in tree_lines(study, plain=True))
    assert [line.replace("|", "│").replace("`- ", "└─ ").replace("│- ", "├─ ")
            for line in tree_lines(study, plain=True)] == list(tree_lines(study))


def test_what_is_left_out_says_what_it_gained() -> None:
    study = searched().study
    hidden = tuple(node(50 + k, 0, "add", f"late-{k}", 1.0, -100.0 - k, "looked") for k in range(30))
    found = tree_of(replace(study, tree=(*study.tree[:8], *hidden)))
    assert found is not None and found.more == 26 and found.rest == "at most 25 BIC over its parent"
    alone = tree_of(replace(study, tree=study.tree[:1]))
    assert alone is not None and (alone.more, alone.rest) == (0, "")


def test_a_dropped_effect_says_what_it_costs() -> None:
    tree = (node(0, None, "root", "base", 1.0, -100.0, "named"), node(1, 0, "drop", "extra-lag", 1.0, -98.0, "named"))
    found = tree_of(replace(_study(), tree=tree))
    assert found is not None
    assert [(s.label, s.words) for s in found.shown] == [("base: chen, first-order, hold", ""),
                                                         ("- extra-lag", "named: 2 BIC under its parent")]


@pytest.mark.parametrize("parents", [[1, 0], [0], [7], [None, None], [2, 0, 1], [1, 2, 1]], ids=str)
def test_a_tree_without_a_sound_root_shows_every_node_once(parents: list[int | None]) -> None:
    tree = tuple(node(k, parent, "add", f"e{k}", 1.0, None, "rejected") for k, parent in enumerate(parents))
    found = tree_of(replace(_study(), tree=tree))
    assert found is not None
    assert sorted(s.node.id for s in found.shown) == list(range(len(parents)))
    assert len(tree_lines(replace(_study(), tree=tree))) == 1 + len(parents)


def test_a_deep_tree_and_a_wide_one_end() -> None:
    deep = tuple(node(k, k - 1 if k else None, "add", "extra-lag", 1.0, -float(k), "expanded") for k in range(1500))
    assert 0 < len(tree_lines(replace(_study(), tree=deep))) <= 2 * MOST_NODES + 2
    wide = tuple(node(k, 0 if k else None, "add", "extra-lag", 1.0, -float(k), "looked") for k in range(20_000))
    assert len(tree_lines(replace(_study(), tree=wide))) == MOST_NODES + 2


def test_a_study_without_a_tree_shows_nothing_new(tmp_path: Path) -> None:
    case = study_factory.good(240)
    assert (tree_of(case.study), tree_lines(case.study), after_tree(case.study), equivalents(case.study)) == \
        (None, (), "", ())
    assert tree(case.study) is None
    write_report([case], tmp_path / "r.html")
    assert "Models tried" not in (tmp_path / "r.html").read_text(encoding="utf-8")


def test_evaluations_and_what_was_not_asked_stand_in_one_line() -> None:
    study = searched().study
    assert after_tree(study) == "12,345 cost evaluations; not asked: gain-nonlinearity"
    assert after_tree(replace(study, unasked=())) == "12,345 cost evaluations"
    assert after_tree(replace(study, evaluations=None)) == "not asked: gain-nonlinearity"


def test_models_alike_say_what_would_tell_them_apart() -> None:
    assert equivalents(searched().study) == (
        "explained alike by extra-lag and slip-overshoot: S 4.40 %, J 2.30 %; what would tell them apart: a bump in "
        "MAN of 5 %",)


def test_the_picture_has_a_row_for_each_model_and_its_gate() -> None:
    picture = tree(searched().study)
    assert picture is not None
    panel = picture.panels[0]
    assert [b.row for b in panel.branches] == list(range(len(panel.branches))) and len(panel.branches) == 17
    by_label = {b.label: b for b in reversed(panel.branches)}
    root, stop, away = (by_label[name] for name in ("base: chen, first-order, hold", "+ travel-limit", "~ integrator"))
    assert (root.x, root.from_x) == (1.168, 1.168) and (stop.from_x, stop.from_row, stop.x) == (1.168, 0, 0.0604)
    assert (stop.role, by_label["+ stiction-drift"].role, by_label["+ slip-overshoot"].role) == \
        ("optimum", "guide", "position")
    assert away.x == root.x and "failed: runs away from y" in away.note and "no error" in away.note
    assert "23.4 times the noise" in root.note
    assert panel.rules[0].value == 0.05 and panel.log_x
    assert "+ extra-lag with an error beside its noise model of 0.0504 m³/h" in picture.alt
    assert "runs away from y" not in picture.caption


def test_a_picture_needs_an_error() -> None:
    study = searched().study
    failed = tuple(replace(n, rmse=None) for n in study.tree)
    assert tree(replace(study, tree=failed)) is None
    zero = tree(replace(study, tree=(replace(study.tree[0], rmse=0.0), study.tree[1])))
    assert zero is not None and [b.x for b in zero.panels[0].branches] == [0.0604, 0.0604]


def test_drawings_keep_labels_and_reasons_as_text() -> None:
    picture = tree(searched().study)
    assert picture is not None
    drawing = ElementTree.fromstring(standalone(picture).decode())
    titles = [t.text or "" for t in drawing.iter("{http://www.w3.org/2000/svg}title")]
    assert sum("the gain of 2 BIC is below the margin" in t for t in titles) == 1
    texts = [t.text for t in drawing.iter("{http://www.w3.org/2000/svg}text")]
    assert {"+ travel-limit", "~ integrator", "noise", "dead end"} <= set(texts)
    assert figure_bytes(picture, "png") == figure_bytes(picture, "png")


@pytest.mark.parametrize("width", [SQUARE, WIDE])
def test_labels_stay_in_the_frame(width: int) -> None:
    picture = tree(searched().study)
    assert picture is not None
    drawing = inline(picture, "p", narrow=width == SQUARE)
    found = re.findall(r'<text class="halo[^"]*" x="([\d.]+)" y="[\d.]+" text-anchor="(\w+)">([^<]+)<', drawing)
    assert len(found) == 17
    for x, anchor, label in found:
        size = CHARACTER * len(label)
        low, high = (float(x) - size, float(x)) if anchor == "end" else (float(x), float(x) + size)
        assert low >= 0 and high <= width, label


def test_an_axis_of_less_than_a_factor_of_two_has_ticks() -> None:
    assert log_ticks(0.05, 1.2) == [0.05, 0.1, 0.2, 0.5, 1.0]
    assert log_ticks(1.05, 1.4) == pytest.approx([1.1, 1.2, 1.3, 1.4])


def test_diagnose_and_identify_print_the_tree_on_request(tmp_path: Path) -> None:
    study = searched().study
    file = tmp_path / "study.json"
    file.write_text(to_json(study), encoding="utf-8")
    with mock.patch("stictionid.verbs.diagnose.diagnose", return_value=study), \
            mock.patch("stictionid.cli.diagnose.open_data"):
        answered, shown = (run("diagnose", file, "-q", *options) for options in ((), ("--details",)))
        told = run("diagnose", file, "--json")
    assert shown.returncode == told.returncode == 0, shown.stderr + told.stderr
    assert len(json.loads(told.stdout)["tree"]) == len(study.tree)
    with mock.patch("stictionid.verbs.identify.identify", return_value=study):
        bare, asked = (run("identify", RECORD, "-q", *options) for options in ((), ("--tree",)))
    for out in (shown, asked):
        assert "|- + travel-limit" in out.stdout and "12,345 cost evaluations; not asked:" in out.stdout
    assert "travel-limit" not in bare.stdout
    assert not any(words in answered.stdout for words in ("travel-limit", "12,345", "gain-nonlinearity"))
    for out in (shown, answered, asked, bare):
        assert max(map(len, out.stdout.splitlines())) <= 80
        assert "explained alike by extra-lag and slip-overshoot" in out.stdout
    assert "a stop of the valve cuts the peaks of PV" in " ".join(answered.stdout.split())


def test_the_page_has_the_picture_the_text_and_the_reasons(tmp_path: Path) -> None:
    write_report([searched()], tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text(encoding="utf-8")
    assert 'id="s1-tree"' in page and 'id="s1-equivalents"' in page
    assert '<pre class="aligned" role="region" tabindex="0" aria-labelledby="s1-tree-lines">model ' in page
    assert page.count("the gain of 2 BIC is below the margin</title>") == 2  # wide and narrow
    assert "gain beyond noise</th>" in page and "the gain of 0.5 BIC is below the margin</td>" in page


def test_j_is_unknown_where_a_finding_withholds_its_interval() -> None:
    loop = simulate(Setting(Plant(1.0, 10.0, 3.0), Controller(0.5, 20.0), duration_s=200.0)).loop
    bare = Estimate(4.0, 2.0, "%", None, None, 0.9, "chen", 1.0, (10.0,), 2.0, False, 0.0)
    step = replace(searched().study.steps[-1], findings=())
    unseen = replace(step, findings=(Finding("scans-unseen", "warning", "", no_intervals=True),))
    assert with_known_jump(bare, loop, [step]).J_known and not with_known_jump(bare, loop, [step, unseen]).J_known
    # An interval that is given all the same is an answer.
    given = replace(bare, S_interval=(3.9, 4.2), J_interval=(1.9, 2.1))
    assert with_known_jump(given, loop, [unseen]).J_known
    assert not with_known_jump(replace(given, J_interval=(1.0, 2.1)), loop, [step]).J_known


def test_the_intervals_reach_to_the_equivalents() -> None:
    estimate = Estimate(4.0, 2.0, "%", (3.9, 4.1), (1.9, 2.1), 0.9, "chen", 1.0, (10.0,), 2.0, False, 0.0)
    reach = {"S": ((4.3, 4.6),), "J": ((2.05, 2.4),)}
    wide = widen_to_equivalents(estimate, reach)
    assert wide.S_interval == (3.9, 4.6) and wide.J_interval == (1.9, 2.4)
    assert wide.S_pieces == ((3.9, 4.1), (4.3, 4.6)) and wide.J_pieces is None
    without = replace(estimate, S_interval=None, J_interval=None)
    assert widen_to_equivalents(without, reach) == without and widen_to_equivalents(estimate, {}) == estimate
