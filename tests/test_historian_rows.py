"""Nothing is dropped silently: rows in the file = rows used + rows listed by reason, whatever the damage."""

from __future__ import annotations

import io

import numpy as np
from historian_files import long, paired, record, wide
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from stictionid.errors import StictionidError
from stictionid.historian import ReadOptions, read

R = record(rows=90)
WIDE, LONG, PAIRED = wide(R).splitlines(), long(R).splitlines(), paired(R).splitlines()
GRADED = [f"{line},{'Quality' if i == 0 else 'Bad' if i % 11 == 0 else 'Good'}" for i, line in enumerate(WIDE)]
SHAPES = {"wide": WIDE, "long": LONG, "paired": PAIRED, "graded": GRADED}

# The first row stays whole: one damaged beyond recognition can't be told from a header line (and is shown as one).
DAMAGE = st.lists(
    st.tuples(
        st.sampled_from(["cut", "swap", "twice", "text", "empty", "long", "header", "time", "stamp", "code", "semi"]),
        st.integers(2, 85),
        st.integers(2, 85),
    ),
    max_size=25,
)


def _damaged(lines: list[str], damage) -> list[str]:
    lines = list(lines)
    for kind, i, j in damage:
        cells = lines[i].split(",")
        if kind == "cut":
            lines[i] = ",".join(cells[:-1])
        elif kind == "swap":
            lines[i], lines[j] = lines[j], lines[i]
        elif kind == "twice":
            lines.insert(j, lines[i])
        elif kind == "header":
            lines.insert(j, lines[0])
        elif kind == "semi":
            lines[i] = lines[i].replace(",", ";")
        elif kind == "long":
            lines[i] += ",1,2"
        elif kind == "time" or len(cells) < 3:
            lines[i] = ",".join(["never", *cells[1:]])
        elif kind == "stamp":
            lines[i] = ",".join([lines[j].split(",")[0], *cells[1:]])
        else:
            cells[-1 - j % 2] = {"text": "Bad Input", "empty": "", "code": "-9999"}[kind]
            lines[i] = ",".join(cells)
    return lines


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(damage=DAMAGE, shape=st.sampled_from(list(SHAPES)), start=st.sampled_from([None, "20"]), step=st.sampled_from(
    [None, 2.0]))
def test_rows_add_up_under_random_damage(damage, shape, start, step):
    lines = _damaged(SHAPES[shape], damage)
    try:
        reading = read(io.BytesIO(("\n".join(lines) + "\n").encode()), options=ReadOptions(start=start, step_s=step))
    except StictionidError as refusal:
        assert refusal.message and "\n" not in refusal.message
        return
    rows = reading.rows
    assert rows["in"] == len(lines) - 1
    assert rows["in"] == rows["used"] + sum(v for k, v in rows.items() if k not in ("in", "used"))
    loop = reading.loop
    # PV that is missing beside OP stays in the loop as no number and does not count.
    assert np.isfinite(loop.process_value[loop.used]).all() and np.isfinite(loop.output).all()
    assert sum(s["samples"] for s in reading.segments) == loop.samples


@settings(max_examples=80, deadline=None)
@given(st.binary(max_size=400))
def test_any_bytes_are_read_or_refused(data):
    try:
        read(io.BytesIO(data))
    except StictionidError as refusal:
        assert refusal.hint


@settings(max_examples=80, deadline=None)
@given(
    st.lists(
        st.lists(
            st.sampled_from(
                [
                    "time",
                    "PV",
                    "OP",
                    "1",
                    "2.5",
                    "1,5",
                    "Bad",
                    "",
                    "2024-01-01",
                    "12:00",
                    "Ä",
                    '"',
                    ";",
                    "-",
                    "nan",
                    "1e400",
                ]
            ),
            min_size=1,
            max_size=5,
        ),
        max_size=12,
    ),
    st.sampled_from([",", ";", "\t", " "]),
)
def test_any_table_is_read_or_refused(rows, separator):
    try:
        read(io.BytesIO("\n".join(separator.join(row) for row in rows).encode()))
    except StictionidError as refusal:
        assert refusal.hint
