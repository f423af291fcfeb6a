"""Faults inside a record are found, reported, and masked or split: never joined, never dropped silently."""

from __future__ import annotations

from datetime import timedelta

import numpy as np
import pytest
from historian_files import R_STAMP, Record, comma, iso, long, record, wide

from stictionid.historian import ReadOptions, read

R = record(rows=400)


def _read(tmp_path, content, **options):
    path = tmp_path / "export.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    reading = read(path, options=ReadOptions(**options))
    rows = reading.rows
    assert rows["in"] == sum(v for k, v in rows.items() if k != "in")
    return reading


def _codes(reading):
    return {f.code for f in reading.findings}


def _with(r: Record, **cells) -> Record:
    """A record with some cells replaced: pv={index: text}."""
    new = {tag: list(getattr(r, tag)) for tag in ("sp", "pv", "op")}
    for tag, changes in cells.items():
        for i, text in changes.items():
            new[tag][i] = text
    return Record(r.stamps, **new)


def _without(r: Record, gone) -> Record:
    keep = [i for i in range(len(r.stamps)) if i not in gone]
    return Record([r.stamps[i] for i in keep], *([getattr(r, t)[i] for i in keep] for t in ("sp", "pv", "op")))


def _mode_file(words, header="time,SP,PV,OP,MODE") -> str:
    return (
        header + "\n" + "".join(f"{iso(m)},{R.sp[i]},{R.pv[i]},{R.op[i]},{words(i)}\n" for i, m in enumerate(R.stamps))
    )


@pytest.mark.parametrize(
    "word",
    [
        "Bad Input",
        "I/O Timeout",
        "No Data",
        "[-11059] No Good Data For Calculation",
        "#N/A",
        "1.#IND",
        "Нет данных",
        "-9999",
        "1E+30",
        "253",
        "NaN",
        "",
        "Inf",
        "Resize to show all values",
    ],
)
def test_states_as_text_and_as_numbers_are_no_measurements(tmp_path, word):
    reading = _read(tmp_path, wide(_with(R, pv={50: word, 200: word, 201: word})))
    assert reading.loop.samples == 400
    assert reading.rows["filled"] == 3
    assert not reading.loop.used[[50, 200, 201]].any()
    values = R.numbers("pv")
    assert reading.loop.process_value[50] == pytest.approx((values[49] + values[51]) / 2)
    assert abs(reading.loop.process_value).max() < 60


def test_a_long_run_of_bad_pv_stays_missing_beside_op(tmp_path):
    reading = _read(tmp_path, wide(_with(R, pv=dict.fromkeys(range(100, 110), "Bad"))))
    assert reading.loop.starts == (0,)
    assert reading.rows["bad"] == 10 and reading.samples["bad"] == 10
    assert {"bad-values", "state-as-text", "process-value-missing"} <= _codes(reading)
    np.testing.assert_array_equal(reading.loop.output, R.numbers("op"))
    gone = np.arange(400) // 10 == 10
    assert np.isnan(reading.loop.process_value[gone]).all() and not reading.loop.used[gone].any()
    np.testing.assert_array_equal(reading.loop.process_value[~gone], R.numbers("pv")[~gone])


def test_a_long_run_of_bad_op_splits_the_record(tmp_path):
    reading = _read(tmp_path, wide(_with(R, op=dict.fromkeys(range(100, 110), "Bad"))))
    assert reading.loop.starts == (0, 100)
    assert reading.rows["bad"] == 10
    np.testing.assert_array_equal(reading.loop.process_value[100:], R.numbers("pv")[110:])


def test_op_is_held_and_never_interpolated(tmp_path):
    reading = _read(tmp_path, wide(_with(R, op={60: "Bad", 61: "Bad"})))
    assert (reading.loop.output[60:62] == R.numbers("op")[59]).all()
    assert _read(tmp_path, wide(_with(R, op=dict.fromkeys(range(60, 63), "Bad")))).loop.starts == (0, 60)


def test_gaps_split_and_single_missing_rows_are_filled(tmp_path):
    reading = _read(tmp_path, wide(_without(R, {30, 80, 81, *range(200, 240)})))
    assert reading.loop.starts == (0, 200)
    assert reading.loop.samples == 360
    assert not reading.loop.used[[30, 80, 81]].any()
    assert reading.loop.used.sum() == 357
    assert "gaps" in _codes(reading)


def test_duplicates_disorder_and_repeated_headers(tmp_path):
    lines = wide(R).splitlines()
    text = (
        "\n".join([*lines[:100], lines[99], lines[0], *lines[100:150], lines[160], *lines[150:160], *lines[161:]])
        + "\n"
    )
    reading = _read(tmp_path, text)
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert reading.rows["duplicate"] == 1
    assert reading.rows["repeated header"] == 1
    assert {"out-of-order", "duplicate-stamps"} <= _codes(reading)


def test_damaged_rows_are_listed(tmp_path):
    lines = wide(R).splitlines()
    lines[50] = "2024-05-31 14:00:49,5"
    lines[51] += ",7,8"
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    assert reading.rows["damaged"] == 2
    assert next(f for f in reading.findings if f.code == "damaged-rows").evidence["line"] == 51


@pytest.mark.parametrize(
    "auto, man",
    [("AUTO", "MAN"), ("Automatik", "Hand"), ("自动", "手动"), ("АВТ", "РУЧ"), ("CAS", "OOS"), ("Auto", "Manuel")],
)
def test_manual_stretches_are_masked_in_several_languages(tmp_path, auto, man):
    text = _mode_file(lambda i: man if 100 <= i < 150 else auto)
    for encoding in ("utf-8", *(("cp1251",) if auto == "АВТ" else ("gbk",) if auto == "自动" else ())):
        reading = _read(tmp_path, text.encode(encoding))
        assert reading.loop.samples == 400
        assert (~reading.loop.used).sum() == 50
        assert reading.rows["manual"] == 50
    assert _read(tmp_path, text, keep_manual=True).loop.used.all()


def test_unknown_mode_numbers_are_said_and_can_be_mapped(tmp_path):
    text = _mode_file(lambda i: 3 if 100 <= i < 150 else 7)
    reading = _read(tmp_path, text)
    assert "mode-unknown" in _codes(reading)
    assert any("--mode-map" in a for a in reading.assumptions)
    assert _read(tmp_path, text, mode_map={"3": "MAN", "7": "AUTO"}).rows["manual"] == 50


@pytest.mark.parametrize(
    "header, good, bad",
    [
        ("Quality", "Good", "Bad"),
        ("Quality", "192", "0"),
        ("Quality", "216", "24"),
        ("Confidence", "100", "20"),
        ("Status", "0", "2"),
        ("Quality", "良好", "坏"),
        ("good", "True", "False"),
    ],
)
def test_quality_columns(tmp_path, header, good, bad):
    lines = [
        f"{iso(m)},{R.sp[i]},{R.pv[i]},{R.op[i]},{bad if i in (70, 71, 72) else good}" for i, m in enumerate(R.stamps)
    ]
    reading = _read(tmp_path, f"time,SP,PV,OP,{header}\n" + "\n".join(lines) + "\n")
    assert reading.rows["bad"] == 3
    assert reading.loop.starts == (0, 70)


def test_saturated_output_is_masked(tmp_path):
    reading = _read(tmp_path, wide(_with(R, op=dict.fromkeys(range(100, 130), "100.00"))))
    assert reading.rows["saturated"] == 30
    assert "output-saturated" in _codes(reading)


def test_frozen_record_is_masked_but_a_stuck_pv_alone_is_truth(tmp_path):
    still = range(100, 160)
    everything = _with(R, pv=dict.fromkeys(still, R.pv[99]), op=dict.fromkeys(still, R.op[99]))
    assert _read(tmp_path, wide(everything)).rows["frozen"] == 60
    assert "frozen" not in _read(tmp_path, wide(_with(R, pv=dict.fromkeys(still, R.pv[99])))).rows


def test_oversampled_record_is_thinned(tmp_path):
    r = Record(
        [R_STAMP + timedelta(seconds=i) for i in range(400)],
        *([c for c in getattr(R, t)[:80] for _ in range(5)] for t in ("sp", "pv", "op")),
    )
    reading = _read(tmp_path, wide(r))
    assert reading.loop.step_s == 5.0
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv")[:80])
    assert reading.rows["repeat"] == 320


def test_compressed_record_is_found_and_clean_ones_are_not(tmp_path):
    rng = np.random.default_rng(3)
    corners = np.sort(rng.choice(np.arange(1, 399), 70, replace=False))
    corners = np.concatenate([[0], corners, [399]])
    pv = np.interp(np.arange(400), corners, R.numbers("pv")[corners])
    squeezed = Record(R.stamps, R.sp, [f"{v:.8f}" for v in pv], R.op)
    finding = next(f for f in _read(tmp_path, wide(squeezed)).findings if f.code == "compressed")
    assert finding.evidence["share"] > 0.3
    assert "compressed" not in _codes(_read(tmp_path, wide(R)))


def test_noise_free_ramps_of_an_integrator_are_not_taken_for_compression(tmp_path):
    t = np.arange(400)
    pv = 50 + 2 * np.arcsin(np.sin(t / 12))
    op = 50 + np.cumsum(50 - pv) * 0.1
    loop = Record(R.stamps, ["50"] * 400, [repr(float(v)) for v in pv], [repr(float(v)) for v in op])
    assert "compressed" not in _codes(_read(tmp_path, wide(loop)))


def test_averages_by_name(tmp_path):
    assert "averaged" in _codes(_read(tmp_path, wide(R, names="time,A.SP,A.PV (1min avg),A.OP")))


def test_coarse_clipped_and_re_ranged_signals(tmp_path):
    coarse = Record(R.stamps, R.sp, [f"{round(v * 2) / 2:.1f}" for v in R.numbers("pv")], R.op)
    assert "quantised" in _codes(_read(tmp_path, wide(coarse)))
    clip = Record(R.stamps, R.sp, [f"{min(v, 51.9):.3f}" for v in R.numbers("pv")], R.op)
    assert "clipped" in _codes(_read(tmp_path, wide(clip)))
    ranged = _with(R, pv={i: f"{v * 3.6:.3f}" for i, v in enumerate(R.numbers("pv")) if i >= 200})
    assert "re-ranged" in _codes(_read(tmp_path, wide(ranged)))


@pytest.mark.parametrize(
    "factor, offset, unit, span",
    [(0.01, 0.0, "", (0.0, 1.0)), (100.0, 0.0, "", (0.0, 10_000.0))],
)
def test_output_in_other_ranges_is_said_and_scaled_on_request(tmp_path, factor, offset, unit, span):
    op = R.numbers("op")
    other = Record(R.stamps, R.sp, R.pv, [f"{offset + factor * v:.6f}" for v in op])
    text = wide(other, names=f"time,SP,PV,OP{f' [{unit}]' if unit else ''}")
    reading = _read(tmp_path, text)
    finding = next(f for f in reading.findings if f.code == "output-not-percent")
    assert reading.loop.units["output"] != "%"
    assert f"--span-op {span[0]:g},{span[1]:g}" in finding.statement
    scaled = _read(tmp_path, text, span_op=span)
    np.testing.assert_allclose(scaled.loop.output, op, atol=1e-3)
    assert scaled.loop.units["output"] == "%"


def test_pv_span_reverse_and_split_range(tmp_path):
    reading = _read(tmp_path, wide(R), span_pv=(0.0, 200.0), reverse_op=True)
    np.testing.assert_allclose(reading.loop.process_value, R.numbers("pv") / 2)
    np.testing.assert_allclose(reading.loop.setpoint, R.numbers("sp") / 2)
    np.testing.assert_allclose(reading.loop.output, 100 - R.numbers("op"))
    half = _read(tmp_path, wide(R), split=(42.0, 100.0))
    assert half.rows["other valve"] == int((R.numbers("op") < 42).sum())


def test_tags_stamped_apart_are_paired_and_the_offset_said(tmp_path):
    lines = ["Tag,Time,Value"]
    for i in range(len(R.stamps)):
        m10 = R_STAMP + timedelta(seconds=10 * i)
        lines += [f"A.PV,{iso(m10)},{R.pv[i]}", f"A.OP,{iso(m10 + timedelta(seconds=1))},{R.op[i]}"]
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    finding = next(f for f in reading.findings if f.code == "tag-offset")
    assert finding.evidence["output_s"] == 1.0
    np.testing.assert_array_equal(reading.loop.output, R.numbers("op"))
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))


def test_setpoint_and_mode_written_on_change_are_held(tmp_path):
    lines = [
        "Tag,Time,Value",
        f"A.SP,{iso(R.stamps[0])},50",
        f"A.SP,{iso(R.stamps[200])},51",
        f"A.MODE,{iso(R.stamps[0])},AUTO",
        f"A.MODE,{iso(R.stamps[300])},MAN",
    ]
    lines += [f"A.{t},{iso(m)},{getattr(R, t.lower())[i]}" for i, m in enumerate(R.stamps) for t in ("PV", "OP")]
    loop = _read(tmp_path, "\n".join(lines) + "\n").loop
    assert (loop.setpoint[:200] == 50).all() and (loop.setpoint[200:] == 51).all()
    assert loop.used[:300].all() and not loop.used[300:].any()


def test_slower_output_sets_the_step(tmp_path):
    lines = ["Tag,Time,Value"] + [f"A.PV,{iso(m)},{R.pv[i]}" for i, m in enumerate(R.stamps)]
    lines += [f"A.OP,{iso(m)},{R.op[i]}" for i, m in enumerate(R.stamps) if i % 5 == 0]
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    assert reading.loop.step_s == 5.0
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv")[::5])
    assert reading.rows["resampled"] == 320


def test_jitter_is_tolerated_and_said_irregular_is_resampled_and_serious(tmp_path):
    rng = np.random.default_rng(1)
    shaken = Record([m + timedelta(milliseconds=int(rng.integers(-80, 80))) for m in R.stamps], R.sp, R.pv, R.op)
    text = wide(shaken, stamp=lambda m: m.isoformat(sep=" ", timespec="milliseconds"))
    reading = _read(tmp_path, text)
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert "jitter" in _codes(reading)
    wild = Record([R_STAMP + timedelta(seconds=int(s)) for s in np.cumsum(rng.integers(1, 30, 400))], R.sp, R.pv, R.op)
    reading = _read(tmp_path, wide(wild))
    assert next(f for f in reading.findings if f.code == "irregular-steps").severity == "serious"
    assert reading.loop.step_s > 20


def test_stamps_rounded_to_seconds_of_a_faster_scan(tmp_path):
    r = Record([R_STAMP + timedelta(seconds=int(1.5 * i)) for i in range(400)], R.sp, R.pv, R.op)
    reading = _read(tmp_path, wide(r))
    assert reading.loop.samples == 400
    assert reading.loop.step_s == pytest.approx(1.5, rel=0.01)


def test_the_hour_that_comes_twice(tmp_path):
    naive = [
        R_STAMP.replace(month=10, day=27, hour=2, minute=50) + timedelta(seconds=10 * i - (3600 if i >= 60 else 0))
        for i in range(400)
    ]
    text = wide(Record(naive, R.sp, R.pv, R.op))
    reading = _read(tmp_path, text)
    assert "clock-fold" in _codes(reading)
    said = _read(tmp_path, text, zone="Europe/Berlin")
    for one in (reading, said):
        np.testing.assert_array_equal(one.loop.process_value, R.numbers("pv"))
        assert one.loop.starts == (0,)
    assert said.loop.origin.start == "2024-10-27T00:50:00Z"


def test_tag_rows_of_others_are_listed(tmp_path):
    reading = _read(tmp_path, long(R) + "".join(f"TI9.PV,{iso(m)},5,Good\n" for m in R.stamps))
    assert reading.rows["other tag"] == 400


def test_decimal_comma_in_a_semicolon_file_with_three_decimals_is_a_said_guess(tmp_path):
    lines = [f"{iso(m)};{comma(R.pv[i])};{comma(R.pv[-i])}" for i, m in enumerate(R.stamps)]
    reading = _read(tmp_path, "time;PV;OP\n" + "\n".join(lines) + "\n")
    np.testing.assert_array_equal(reading.loop.process_value, R.numbers("pv"))
    assert any("decimal comma" in a for a in reading.assumptions)


def test_position_and_extras_come_along(tmp_path):
    lines = [f"{iso(m)},{R.sp[i]},{R.pv[i]},{R.op[i]},{R.op[-i]},{i}.5" for i, m in enumerate(R.stamps)]
    text = "time,F1.SP,F1.PV,F1.OP,ZI-1 (%),TI9\n" + "\n".join(lines) + "\n"
    reading = _read(tmp_path, text, extra=("TI9",))
    assert reading.loop.position[0] == float(R.op[0]) and reading.loop.position[1] == float(R.op[-1])
    assert reading.loop.units["position"] == "%"
    assert reading.loop.extras["TI9"][3] == 3.5
    assert reading.columns["TI9"] == "TI9"
    chosen = _read(tmp_path, text, position="TI9", pv="3", op="f1_op")
    assert chosen.loop.position[3] == 3.5


def test_quality_beside_each_tag(tmp_path):
    lines = [f"{iso(m)},{R.pv[i]},{'Bad' if i == 50 else 'Good'},{R.op[i]},Good" for i, m in enumerate(R.stamps)]
    reading = _read(tmp_path, "time,F1.PV,F1.PV Status,F1.OP,F1.OP Status\n" + "\n".join(lines) + "\n")
    assert reading.rows["filled"] == 1 and not reading.loop.used[50]


def test_spreadsheet_limit_is_said(tmp_path):
    text = "time_s,PV,OP\n" + "".join(f"{i},{i % 7}.5,{40 + i % 5}\n" for i in range(65_535))
    assert "excel-cut" in _codes(_read(tmp_path, text))


def test_paired_columns_of_different_length_are_booked_by_their_pv(tmp_path):
    lines = ["t1,F1.PV,t2,F1.OP"]
    for i, m in enumerate(R.stamps):
        other = f"{iso(R.stamps[5 * i])},{R.op[5 * i]}" if 5 * i < len(R.stamps) else ","
        lines.append(f"{iso(m)},{R.pv[i]},{other}")
    reading = _read(tmp_path, "\n".join(lines) + "\n")
    assert reading.loop.step_s == 5.0
    assert reading.rows == {"in": 400, "used": 80, "resampled": 320}
    np.testing.assert_array_equal(reading.loop.output, R.numbers("op")[::5])


@pytest.mark.parametrize("empty", [True, False])
def test_output_exported_less_often_than_pv_is_said(tmp_path, empty):
    rng = np.random.default_rng(1)
    pv, op = rng.standard_normal(600), np.cumsum(rng.standard_normal(600))

    def write(every_pv, every_op):
        rows = ["time_s,PV,OP"]
        for i in range(600):
            pairs = ((pv, every_pv), (op, every_op))
            cells = [f"{x[i - i % k]:.4f}" if not (empty and i % k) else "" for x, k in pairs]
            rows.append(f"{i},{cells[0]},{cells[1]}")
        (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
        return read(tmp_path / "a.csv")

    sparse = [f for f in write(1, 10).findings if f.code == "output-sparse"]
    assert len(sparse) == 1 and sparse[0].evidence["every"] == 10 and "OP as often as PV" in sparse[0].statement
    assert not [f for f in write(10, 1).findings if f.code == "output-sparse"]
    assert not [f for f in write(1, 1).findings if f.code == "output-sparse"]
