"""Benchmarks on real and half-real loops: labels, disturbances from real process values, tables, runs continued.

A row of verdicts, and a scoreboard of a data base, are in benchmarks/long.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import half_real
import isdb
import numpy as np
import pytest
import reliability
import rows as store
from loops import sticky

scipy_io = pytest.importorskip("scipy.io")


@pytest.mark.parametrize("words, label", [
    ("Flow control, stiction", "stiction"), ("Level control; valve stiction (likely)", "stiction"),
    ("No stiction; tight tuning", "no stiction"), ("faulty steam sensor (no valve stiction)", "no stiction"),
    ("Disturbance (likely)", "no stiction"), ("non-stiction", "no stiction"), ("concentration control", "unknown")])
def test_labels_are_read_from_the_comments(words, label):
    assert isdb.label_of(words) == label


def test_real_process_values_are_cut_into_stretches():
    loop = sticky(10_001).loop
    u = np.where(np.arange(loop.samples) < 500, 50.0, loop.output)
    assert [y.size for y in half_real.stretches(loop, True)] == [loop.samples]
    quiet = half_real.stretches(replace(loop, output=u), False)
    assert quiet and 500 <= quiet[0].size <= 520
    np.testing.assert_array_equal(quiet[0][:500], loop.process_value[:500])


def test_a_half_real_loop_is_the_same_for_a_seed_and_has_the_truth_asked_for():
    real = [np.cumsum(np.random.default_rng(3).standard_normal(700))]
    for sticks in (True, False):
        (one, setting, share), (two, _, _) = (half_real.drawn(real, 5, sticks) for _ in range(2))
        np.testing.assert_array_equal(one.process_value, two.process_value)
        assert (setting.S > 0) == sticks and one.samples == 700 and one.position is None and share > 0.0


def _row(truth, verdict, confidence=0.95, S_error=None):
    return {"truth": truth, "verdict": verdict, "confidence": confidence, "S_error": S_error}


def test_the_table_counts_what_is_missed(capsys):
    good, bad = _row("stiction", "stiction", S_error=0.01), _row("stiction", "undecided", S_error=0.2)
    false = _row("no stiction", "stiction")
    missed = half_real.table([row | {"before": row} for row in (good, bad, false)])
    assert [m.split(":")[0] for m in missed] == ["sticking", "sticking", "healthy"]
    assert half_real.table([good | {"before": bad}]) == []
    assert "0.0 %     100.0 %" in capsys.readouterr().out


def test_overconfidence_is_missed_in_bins_of_a_hundred():
    rows = [_row("stiction", "stiction" if k % 5 else "no stiction", 0.92) for k in range(100)]
    assert len(reliability.table(rows)) == 1
    assert reliability.table(rows[:99]) == []
    assert reliability.table([_row("stiction", "stiction", 0.92)] * 100) == []


def _task(number: int) -> dict:
    return {"number": number}


def test_a_run_is_continued(tmp_path):
    given = argparse.Namespace(out=str(tmp_path / "rows.jsonl"), minutes=1.0, jobs=1)
    Path(given.out).write_text(json.dumps({"key": "a", "number": 7}) + "\n{\"key\": \"b\", \"num")
    rows = store.run([("a", (1,)), ("b", (2,))], _task, given)
    assert [(r["key"], r["number"]) for r in rows] == [("a", 7), ("b", 2)]


def test_the_stages_that_are_timed_are_functions_of_the_package() -> None:
    import importlib

    import where

    for _, module, function in where.STAGES:
        assert callable(getattr(importlib.import_module(f"stictionid.{module}"), function)), (module, function)
    page = (Path(__file__).parent.parent / "docs" / "time.md").read_text(encoding="utf-8")
    for name in ("limit", "identify", "hidden", "diagnose", "start"):
        body = page.partition(f"<!-- {name} -->\n```text\n")[2].partition("```")[0]
        assert body.strip() and all(len(line) <= 110 for line in body.splitlines()), name
