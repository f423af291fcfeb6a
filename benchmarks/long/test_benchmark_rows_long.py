"""Benchmarks at length: a row of verdicts holds its outcome."""

from __future__ import annotations

import json

import isdb
import reliability
import verdicts
from quick_loops import quick
from test_benchmark_rows import scipy_io


def test_a_row_of_verdicts_holds_its_outcome() -> None:
    row = verdicts.row(10_008, True, 600, True, False)
    again = json.loads(json.dumps(row))
    found = verdicts.outcome_of(again)
    assert row["truth"] == "stiction" == found.cause and found.verdict == row["verdict"]
    assert found.groups and set(found.holds) >= {"S", "J", "gain"}
    assert found.base_s > 0.0 and found.cpu_s > 0.0
    assert verdicts.verdict_table([found]) == [] and reliability.table([again]) == []


def test_a_file_of_the_data_base_gives_a_scoreboard(tmp_path, capsys):
    loop = quick()
    one = {"Comments": "Flow control; stiction", "Ts": 1.0, "t": loop.time_s, "SP": loop.setpoint,
           "PV": loop.process_value, "OP": loop.output}
    short = one | {"Comments": "No stiction", **{k: one[k][:40] for k in ("t", "SP", "PV", "OP")}}
    scipy_io.savemat(tmp_path / "isdb.mat", {"cdata": {"chemicals": {"loop1": one}, "power": {"loop2": short}}})
    found = [isdb.one(str(tmp_path / "isdb.mat"), name, False) for name in ("chemicals.loop1", "power.loop2")]
    assert [(r["truth"], r["verdict"]) for r in found] == [("stiction", "stiction"), ("no stiction", "undecided")]
    isdb.scoreboard(found, {"chemicals.loop1": {"loop": "chemicals.loop1", "ellipse": "no stiction"}})
    printed = capsys.readouterr().out
    assert "stictionid        1 right    0 wrong    0 open of   1      0 right    0 wrong    1 open of   1" in printed
    assert "ellipse           0 right    1 wrong    0 open of   1" in printed
