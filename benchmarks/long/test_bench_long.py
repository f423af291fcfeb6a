"""The valve bench at length: its table fits, and its picture is the same each time."""

from __future__ import annotations

from pathlib import Path

from commands import run

from stictionid.laws import get
from stictionid.model.valve_bench import put_on_bench
from stictionid.reports.pictures.valve_bench import valve_figure


def test_the_bench_shows_in_a_table_that_fits_and_in_a_picture(tmp_path: Path) -> None:
    out = run("laws", "--test", "choudhury", "-o", tmp_path / "bench.png")
    assert out.returncode == 0 and max(map(len, out.stdout.splitlines())) <= 80
    assert "FAILS" in out.stdout and "12 of 22 expectations hold" in out.stdout and "dead band %" in out.stdout
    assert (tmp_path / "bench.png").read_bytes()[:4] == b"\x89PNG"
    assert "all expectations" not in out.stdout
    outcomes = put_on_bench(get("he"), tests=("resume",))
    for kind in ("svg", "png"):
        first = valve_figure(outcomes, kind=kind, title="he")
        assert first == valve_figure(outcomes, kind=kind, title="he")
