"""Agreement over records: spread, chance, drift against worked numbers; windows, reasons and files of the command.

Normalised data, which have no percent, and the files of the command are in benchmarks/long.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quick_loops import identified_once

from stictionid.errors import UsageError
from stictionid.historian import read_loop
from stictionid.record.loop import Loop, Origin
from stictionid.record.study import CreatedBy
from stictionid.reports.pages.agreement import drift_picture
from stictionid.verbs.agree import RecordResult, agreement, cannot, compare_records, windows
from stictionid.verbs.identify import Options

SAMPLE = Path(__file__).parent.parent / "sample_data"
MADE = CreatedBy("0", 0, "", "", "")
DAY = 86400.0
Z = 1.6448536269514722


def record(S: float, half: float | None = 0.1, *, day: float | None = 0.0, J: float = 2.0, **more) -> RecordResult:
    span = None if half is None else (S - half, S + half)
    return RecordResult(f"r{S}", None, None, None if day is None else day * DAY, "stiction", 0.9, S, J, span,
                  None if half is None else (J - half, J + half), 60.0, True, "because", **more)


def test_spread_is_the_chi_square_of_the_weighted_mean() -> None:
    values, halves = np.array([4.0, 4.2, 4.5]), np.array([0.1, 0.2, 0.4])
    found = agreement([record(v, h) for v, h in zip(values, halves, strict=True)], "%", MADE)
    S = found.spreads[0]
    weight = (Z / halves) ** 2
    mean = float(weight @ values / weight.sum())
    assert S.common == pytest.approx(mean, abs=1e-9)
    assert S.chi_square == pytest.approx(float(weight @ (values - mean) ** 2), rel=1e-9)
    assert S.chance == pytest.approx(float(np.exp(-S.chi_square / 2)), rel=1e-9)  # two degrees of freedom
    assert (S.agree, found.agree, S.overlap) == (True, True, (pytest.approx(4.1), pytest.approx(4.1)))
    assert cannot(found) is None


def test_records_that_scatter_more_than_their_intervals_differ() -> None:
    found = agreement([record(4.0), record(4.6)], "%", MADE)
    assert found.agree is False and found.spreads[0].overlap is None and "differ in S" in found.statement
    assert found.spreads[1].agree
    # What no method tells apart is no difference, however narrow the intervals.
    assert agreement([record(4.0, 1e-4), record(4.02, 1e-4)], "%", MADE).agree


def test_a_side_of_an_interval_counts_for_its_own_side_only() -> None:
    wide_up = replace(record(4.0), S_interval=(3.95, 5.0))
    assert agreement([wide_up, record(4.6)], "%", MADE).spreads[0].agree
    wide_down = replace(record(4.0), S_interval=(3.0, 4.05))
    assert not agreement([wide_down, record(4.6)], "%", MADE).spreads[0].agree


def test_drift_is_the_slope_with_its_interval() -> None:
    days = [0.0, 30.0, 60.0, 120.0]
    found = agreement([record(4.0 + 0.01 * d, 0.1, day=d) for d in days], "%", MADE)
    S, J = found.drifts
    assert (S.per, S.drifts, J.drifts) == ("30 days", True, False)
    assert S.slope == pytest.approx(0.3) and S.change == pytest.approx(1.2) and S.start == pytest.approx(4.0)
    t = np.array(days) / 30.0
    half = 0.1 / float(np.sqrt(np.sum((t - t.mean()) ** 2)))  # 90 % half widths of the values make that of the slope
    assert S.slope_interval == pytest.approx((0.3 - half, 0.3 + half), rel=1e-6)
    assert "S rises by" in found.statement
    panels = drift_picture(found).panels
    assert [line.name for line in panels[0].lines] == ["interval", "drift", "S"]
    line = panels[0].lines[1]
    assert np.diff(line.y)[0] / np.diff(line.x)[0] == pytest.approx(0.01)  # % a day, on an axis in days


def test_scatter_beyond_the_intervals_widens_the_drift() -> None:
    values = [4.0, 4.5, 4.0, 4.5, 4.1]
    found = agreement([record(v, 0.05, day=d) for d, v in enumerate(values)], "%", MADE)
    assert found.agree is False and not found.drifts[0].drifts


def test_without_a_clock_records_are_counted_off() -> None:
    found = agreement([record(v, day=None) for v in (4.0, 4.2, 4.4)], "%", MADE)
    assert found.drifts[0].per == "record" and found.drifts[0].slope == pytest.approx(0.2)


def test_too_few_records_can_not_be_compared() -> None:
    found = agreement([record(4.0), record(4.6, None)], "%", MADE)
    assert found.agree is None and cannot(found).code == "too-few-records" and not found.drifts
    assert agreement([], "%", MADE).agree is None and drift_picture(agreement([], "%", MADE)) is None


def still(n: int = 300, **more) -> Loop:
    return Loop(np.full(n, 50.0), np.linspace(0.0, 1.0, n), **more)


def test_windows_keep_the_clock_over_gaps_and_abstentions_their_reason() -> None:
    origin = Origin(start="2024-01-01T00:00:00", segment_starts=("2024-01-01T00:00:00", "2024-02-01T00:00:00"))
    found = compare_records([still(starts=(0, 200), origin=origin)], count=3, unreadable=[("c.csv", "it is empty")])
    assert [r.middle for r in found.records] == ["2024-01-01T00:00:50", "2024-01-01T00:02:30", "2024-02-01T00:00:50",
                                                 None]
    assert [r.code for r in found.records] == ["constant-output"] * 3 + ["unreadable"]
    assert all(r.reason and not r.counted for r in found.records)


def test_files_without_a_calendar_have_no_common_clock() -> None:
    found = compare_records([still(name="a"), still(name="b")])
    assert [r.at_s for r in found.records] == [None, None]


@pytest.mark.parametrize(("loops", "count", "said"), [
    ([still()], 1, "nothing to agree with"), ([still()], 0, "--windows 0"), ([still(2)], 3, "2 samples"),
    ([still(), still(units={"output": "bar"})], 1, "different units"),
    ([still(origin=Origin(file="a", sha256="x")), still(origin=Origin(file="b", sha256="x"))], 1, "same bytes"),
])
def test_what_can_not_be_compared_is_refused(loops, count, said) -> None:
    with pytest.raises(UsageError, match=said):
        compare_records(loops, count=count)


def test_windows_of_one_valve_agree_with_the_truth() -> None:
    loop = read_loop(SAMPLE / "foptd_scanned.parquet")
    assert [w.samples for w in windows(loop, 3)] == [333, 333, 334]
    with identified_once():
        found = compare_records([loop], count=2, options=Options(base_only=True))
    assert found.agree and [r.counted for r in found.records] == [True, True]
    assert found.spreads[0].common == pytest.approx(4.0, rel=0.01)
