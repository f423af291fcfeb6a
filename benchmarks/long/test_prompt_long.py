"""Commands at length: an effect is taken out again, before and after another one."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest
from commands import run
from quick_loops import WORDS
from test_prompt import SAMPLE, in_terminal


def test_remove_takes_an_effect_out_again(tmp_path: Path) -> None:
    for arguments in (("simulate", *WORDS, "-o", "a.csv"),
                      ("identify", "a.csv", "--base-only", "--between", "hold", "-o", "a.json"),
                      ("add", "extra-lag", "a.json", "-o", "b.json"),
                      ("add", "coloured-noise", "b.json", "-o", "c.json")):
        assert run(*arguments, "-q", cwd=tmp_path).returncode == 0
    shutil.copy(tmp_path / "b.json", tmp_path / "d.json")
    done = run("remove", "extra-lag", "d.json", cwd=tmp_path)
    assert done.returncode == 0 and "info: extra-lag was taken out by hand" in " ".join(done.stdout.split())
    before, after = (json.loads((tmp_path / f"{n}.json").read_text()) for n in "ad")
    assert [s["added"] for s in after["steps"]] == [None] and after["candidates"] == []
    assert after["steps"][0]["model"]["effects"] == [] and after["adequate"]
    low, high = before["estimate"]["S_interval"]
    assert after["estimate"]["S"] == pytest.approx(before["estimate"]["S"], abs=0.1 * (high - low))
    assert after["estimate"]["S_interval"] == pytest.approx(before["estimate"]["S_interval"], rel=1e-3)
    done = run("remove", "extra-lag", "c.json", "-o", "e.json", "--json", "-q", cwd=tmp_path)
    later = json.loads(done.stdout)
    assert [s["added"] for s in later["steps"]] == [None, "coloured-noise"]
    assert later["steps"][1]["model"]["effects"] == ["coloured-noise"]
    refused = run("remove", "travel-limit", "c.json", cwd=tmp_path)
    assert refused.returncode == 2 and "extra-lag, coloured-noise" in refused.stderr


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals here")
def test_commands_in_a_terminal_fit_it(tmp_path: Path) -> None:
    """Tables of identify, range and batch; messages for scripts are lines of their own length."""
    loops = [str(SAMPLE.parent / name) for name in ("healthy.csv", "foptd_scanned.parquet")]
    batch = ["batch", *loops, "-o", str(tmp_path / "out"), "-q", "--level", "screen", "--jobs", "1"]
    shown = in_terminal([(columns, words) for columns in (200, 60) for words in (
        ["identify", str(SAMPLE), "-q", "--base-only", "--no-intervals"], ["range", str(SAMPLE), "-q"],
        batch if columns == 200 else [*batch, "--resume"])])
    assert set(shown) == {200, 60}
    for columns, lines in shown.items():
        assert max(map(len, lines)) <= columns
        assert {"estimate", "error", "worst first"} <= set(lines)
        assert any(line.startswith("verdict: ") for line in lines)
