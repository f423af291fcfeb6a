"""One cycle, many loops: rhythms of a unit with one sticky valve, and the groups and roles of a batch's summary."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from unit_cycle import STICKY, UNIT, simulated

from stictionid.batch.summary.groups import FOLLOWS, SOURCE, STICKS, grouped, groups_said
from stictionid.batch.summary.page import page_of
from stictionid.batch.summary.rows import COLUMNS, as_csv, as_markdown, as_parquet, rows_of
from stictionid.record.loop import Loop, Origin
from stictionid.record.oscillation import find_range
from stictionid.record.rhythm import Rhythm, rhythm_of
from stictionid.record.study import plain

START = "2026-02-25T06:00:00"


@pytest.fixture(scope="module")
def unit() -> dict[str, Rhythm | None]:
    """The rhythm of every loop of the unit."""
    out = {}
    for name, signals in simulated(samples=1500).items():
        loop = Loop(output=signals["OP"], process_value=signals["PV"], setpoint=signals["SP"], name=name,
                    origin=Origin(start=START))
        found = find_range(loop)
        out[name] = rhythm_of(loop, found.period_median_s) if found.oscillating else None
    return out


def test_a_long_record_is_looked_at_about_its_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    t = np.arange(4001.0)
    loop = Loop(output=np.sin(t), process_value=np.sin(2.0 * np.pi * t / 40.0), origin=Origin(start=START))
    whole = rhythm_of(loop, 40.0)
    monkeypatch.setattr("stictionid.record.rhythm._MOST", 2001)
    part = rhythm_of(loop, 40.0)
    assert whole is not None and part is not None and part.cycles == pytest.approx(50.0, rel=0.01)
    assert part.period_s == pytest.approx(40.0, rel=1e-3) and part.middle_s == whole.middle_s
    # The middle is sample 2000, where 50 periods have just ended.
    assert abs((part.phase + 0.5) % 1.0 - 0.5) < 0.02 and abs((whole.phase + 0.5) % 1.0 - 0.5) < 0.02
    assert whole.harmonics < 1e-6 and rhythm_of(loop, 2000.0) is None and rhythm_of(loop, None) is None


def row(name: str, rhythm: Rhythm | None, verdict: str = "no stiction") -> dict[str, Any]:
    return {"loop": name, "verdict": verdict, "rhythm": plain(rhythm) if rhythm else None}


def test_the_sticky_loop_has_the_strongest_harmonics_and_comes_first(unit: dict[str, Rhythm | None]) -> None:
    rhythms = {name: rhythm for name, rhythm in unit.items() if rhythm}
    assert set(rhythms) == set(UNIT) - {"FIC106"}
    assert np.ptp([r.period_s for r in rhythms.values()]) < 0.1
    source = rhythms.pop(STICKY)
    assert source.harmonics > 2.0 * max(r.harmonics for r in rhythms.values())
    # Phases fall with the way from the source: flow, pressure, temperature, composition.
    assert source.phase > rhythms["PIC105"].phase > rhythms["TIC102"].phase > rhythms["AIC103"].phase


def test_a_group_names_its_source_and_what_follows(unit: dict[str, Rhythm | None]) -> None:
    rows = grouped([row(name, rhythm, "stiction" if name == STICKY else "no stiction")
                    for name, rhythm in unit.items()])
    assert {r["loop"]: (r["group"], r["role"]) for r in rows} == {
        name: (None, None) if name == "FIC106" else (1, SOURCE if name == STICKY else FOLLOWS) for name in UNIT}
    (said,) = groups_said(rows)
    assert said.startswith("Group 1: 5 loops swing with ") and "harmonics are the strongest" in said
    assert "FIC101 may be the source" in said and "it is the first to swing" in said


def test_of_two_sticking_valves_the_one_with_more_harmonics_or_the_first_is_the_source() -> None:
    near = Rhythm(60.0, 40.0, 0.03, 0.4, 0.0)
    for other, source in ((replace(near, harmonics=0.2), "B"), (replace(near, phase=0.5), "B"),
                          (replace(near, phase=0.3), "A"), (replace(near, harmonics=0.001, phase=0.5), "A")):
        rows = grouped([row("A", near, "stiction"), row("B", other, "stiction"), row("C", near)])
        assert {r["loop"]: r["role"] for r in rows} == {
            source: SOURCE, "C": FOLLOWS, ("A" if source == "B" else "B"): STICKS}


def test_other_periods_other_days_and_a_group_without_a_sticking_valve() -> None:
    near = Rhythm(60.0, 40.0, 0.03, 0.4, 0.0)
    for apart in (replace(near, period_s=62.0), replace(near, middle_s=2e5)):
        assert {r["group"] for r in grouped([row("A", near, "stiction"), row("B", apart)])} == {None}
    rows = grouped([row("A", near), row("B", near)])
    assert [r["role"] for r in rows] == [FOLLOWS] * 2 and "may lie elsewhere" in groups_said(rows)[0]


def test_the_summary_has_the_columns_and_the_sentence(unit: dict[str, Rhythm | None]) -> None:
    class Store:
        folder = Path("/nowhere")

        def records(self) -> list[tuple[str, dict[str, Any], bool]]:
            return [(name, {"data": {"name": name}, "range": {}, "rhythm": plain(rhythm),
                            "verdict": {"stiction": "stiction" if name == STICKY else "no stiction"}}, False)
                    for name, rhythm in unit.items()]

        def skipped(self) -> list[Any]:
            return []

    rows = rows_of(Store())  # type: ignore[arg-type]
    assert [name for name in COLUMNS if name in ("group", "role")] == ["group", "role"]
    lines = as_csv(rows).splitlines()
    at = lines[0].split(",").index("group")
    assert lines[1].split(",")[at:at + 2] == ["1", SOURCE] and len(lines) == 7
    assert "FIC101 may be the source" in as_markdown(rows) and "FIC101 may be the source" in page_of(rows)
    groups = pq.read_table(io.BytesIO(as_parquet(rows))).column("group").to_pylist()
    assert groups.count(1) == 5 and groups.count(None) == 1
