"""Agreement at length: normalised data are never labelled percent."""

from __future__ import annotations

import json

import numpy as np
from commands import run
from quick_loops import identified_once
from test_agreement import SAMPLE

from stictionid.historian import read_loop
from stictionid.reports.facts import facts
from stictionid.verbs.agree import compare_records
from stictionid.verbs.identify import Options, identify


def test_normalised_data_are_never_labelled_percent(tmp_path) -> None:
    loop = read_loop(SAMPLE / "foptd_scanned.parquet")
    columns = [loop.time_s, *((x - loop.process_value.mean()) / loop.process_value.std()
                              for x in (loop.setpoint, loop.process_value)),
               (loop.output - loop.output.mean()) / loop.output.std()]
    np.savetxt(tmp_path / "n.csv", np.stack(columns, axis=1), delimiter=",", header="time_s,SP,PV,OP", comments="")
    study = identify(read_loop(tmp_path / "n.csv"), options=Options(base_only=True))
    assert study.estimate.unit == "unit of OP" and study.severity.band is None
    units = {p.name: p.unit for p in study.steps[0].parameters}
    assert (units["S"], units["J"], units["gain"]) == ("unit of OP", "unit of OP", "unit of y / unit of OP")
    # Shares stay in %, travel does not.
    assert "unit of OP a day" in study.severity.statement and "% a day" not in study.severity.statement
    size = next(s for s in facts(study).sections if s.key == "size")
    assert not any("below 0.5 %" in line for line in size.text)
    found = compare_records([read_loop(tmp_path / "n.csv")], count=2, options=Options(base_only=True))
    assert all(f"{s.name} lies between" in s.statement and "unit of OP" in s.statement for s in found.spreads)


def test_the_command_writes_table_picture_and_json(tmp_path) -> None:
    out = tmp_path / "a.md"
    with identified_once():
        done = run("agree", SAMPLE / "foptd_scanned.parquet", "--windows", "2", "--base-only", "-q", "--json",
                   "-o", out, "--figures", "png")
    content = json.loads(done.stdout)
    assert (done.returncode, done.stderr) == (0, "")
    assert content["schema"] == "stictionid.agreement/1" and content["agree"] is True
    assert (tmp_path / "a-drift.png").read_bytes().startswith(b"\x89PNG")
    text = out.read_text()
    assert "](a-drift.png)" in text and "| window 2 |" in text
    alone = run("agree", SAMPLE / "foptd.csv")
    assert alone.returncode == 2 and "--windows 3" in alone.stderr
    head, *rows = (SAMPLE / "foptd.csv").read_text().splitlines(keepends=True)
    (tmp_path / "few.csv").write_text(head + "".join(rows[500:]))
    few = run("agree", tmp_path / "few.csv", "--windows", "2")
    assert few.returncode == 3 and "whole cycles" in few.stderr
