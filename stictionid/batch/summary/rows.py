"""Rows of the summary, one per loop and the worst first, made only from the studies and failure records on disk."""

from __future__ import annotations

import csv
import io
import json
import os
from typing import Any

import pyarrow as pa

from ...effects import built_in
from ...record.swing import BANDS
from ...reports import wording
from ...system.csv_safety import harmless
from ...system.plurals import counted
from ..task import ABSTAINED, FAILED, OK, SKIPPED, Skipped
from ..work.store import Store, status_of
from .groups import grouped, groups_said

# Columns in order; True for numbers. Whole ones, and those that the markdown shows, below.
COLUMNS = {
    "rank": True, "loop": False, "file": False, "status": False, "message": False, "verdict": False,
    "confidence": True, "S": True, "S_low": True, "S_high": True, "J": True, "J_low": True, "J_high": True,
    "unit": False, "period_s": True, "period_median_s": True, "s_max": True, "oscillating": False,
    "group": True, "role": False,
    "missing": False, "rmse_before": True, "rmse_after": True, "noise_sd": True, "adequate": False,
    "friction_share": True, "study": False,
}
_WHOLE = ("rank", "group")
_SHOWN = ("rank", "loop", "status", "verdict", "S", "J", "friction_share", "period_median_s", "group", "role",
          "missing", "rmse_before", "rmse_after", "adequate", "message")
_DIGITS = 4
_LONGEST_MESSAGE = 160
_MEASURED = built_in(lambda effect: "extra" in effect.needs)

Row = dict[str, Any]

_VERDICTS = {"stiction": 0, "undecided": 1, "no stiction": 2}
_NO_VERDICT = 3
_LAST = {ABSTAINED: 1, FAILED: 2, SKIPPED: 3}
_BANDS = ", ".join(f"{word} from {low:g} %" for (low, _), (_, word)
                   in zip(BANDS[-2::-1], BANDS[:0:-1], strict=True))
# The rule in words; `rank_key` is the rule.
RULE = (f"Worst first: valves that stick, then undecided ones, then the others. Among them the band of S decides "
        f"({_BANDS}), within a band the share of PV's swing about its setpoint that a perfect valve would take away, "
        "then S. Loops without an answer and failed ones come last.")


def rank_key(row: Row) -> tuple[Any, ...]:
    """Sort key of summary rows, as `RULE` says; skipped files stand last."""
    S = row["S"] or 0.0
    return (_LAST.get(row["status"], 0), _VERDICTS.get(row["verdict"] or "", _NO_VERDICT),
            -sum(limit <= S for limit, _ in BANDS),
            *(-(row[name] or 0.0) for name in ("friction_share", "S", "J")), row["loop"])


def rows_of(store: Store) -> list[Row]:
    """All rows, worst loop first, skipped files last; the same rows for the same files.

    Beside its columns a row holds the loop's `rhythm`, from which groups are made, and the tag that is its `driver`.
    """
    rows = [_failed(key, content) if failure else _done(key, content) for key, content, failure in store.records()]
    rows += [_skipped(file) for file in store.skipped()]
    rows.sort(key=rank_key)
    return [{**row, "rank": i} for i, row in enumerate(grouped(rows), 1)]


def counts_of(rows: list[Row]) -> dict[str, int]:
    """Number of rows with each status."""
    return {status: sum(row["status"] == status for row in rows) for status in (OK, ABSTAINED, FAILED, SKIPPED)}


def counts_said(rows: list[Row]) -> str:
    """The counts in words: `8 loops: 5 studied, 2 abstained, 1 failed; 3 files skipped`."""
    counts = counts_of(rows)
    skipped = counts[SKIPPED]
    return (f"{counted(len(rows) - skipped, 'loop')}: {counts[OK]} studied, {counts[ABSTAINED]} abstained, "
            f"{counts[FAILED]} failed" + (f"; {counted(skipped, 'file')} skipped" if skipped else ""))


def _skipped(file: Skipped) -> Row:
    return _row(loop=os.path.basename(file.file) or file.file, file=file.file, status=SKIPPED,
                message=file.reason + (f"; {file.hint}" if file.hint else ""))


def _row(**values: Any) -> Row:
    return {**dict.fromkeys(COLUMNS), "rhythm": None, "driver": None, **values}


def _failed(key: str, record: dict[str, Any]) -> Row:
    return _row(loop=str(record.get("loop") or key), file=record.get("file") or None, status=FAILED,
                message=str(record.get("message") or ""), study=f"failures/{key}.json")


def _done(key: str, study: dict[str, Any]) -> Row:
    """A study's row; every part of the study may be absent."""
    verdict, estimate = study.get("verdict") or {}, study.get("estimate") or {}
    data, found, steps = study.get("data") or {}, study.get("range") or {}, study.get("steps") or []
    status = status_of(study)
    S, J = estimate.get("S_interval") or (None, None), estimate.get("J_interval") or (None, None)
    errors = [step.get("error") or {} for step in steps] or [{}]
    return _row(
        loop=str(data.get("name") or key), file=data.get("file"), status=status,
        message=str(verdict.get("reason") or "") if status == ABSTAINED else "", verdict=verdict.get("stiction"),
        confidence=verdict.get("confidence"), S=estimate.get("S"), S_low=S[0], S_high=S[1], J=estimate.get("J"),
        J_low=J[0], J_high=J[1], unit=estimate.get("unit"), period_s=found.get("period_s"),
        period_median_s=found.get("period_median_s"), s_max=found.get("s_max"),
        oscillating=_yes(found.get("oscillating")), missing="; ".join(study.get("missing") or ()),
        rmse_before=errors[0].get("rmse"), rmse_after=errors[-1].get("rmse"), noise_sd=errors[-1].get("noise_sd"),
        adequate=_yes(study.get("adequate")), friction_share=_share(study),
        rhythm=study.get("rhythm"), driver=_driver(study), study=f"studies/{key}.json")


def _driver(study: dict[str, Any]) -> str | None:
    """The tag that drives a loop, by its accepted candidates; None where none does."""
    return next((str(c["variant"]) for c in study.get("candidates") or ()
                 if c.get("accepted") and c.get("effect") == _MEASURED), None)


def _yes(value: Any) -> str | None:
    return None if value is None else "yes" if value else "no"


def as_csv(rows: list[Row]) -> str:
    """CSV at full precision; text that a spreadsheet would run is neutralised, an absent value is an empty cell."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(COLUMNS)
    writer.writerows(["" if row[n] is None else repr(row[n]) if number else harmless(str(row[n]))
                      for n, number in COLUMNS.items()] for row in rows)
    return _utf8(text.getvalue())


def as_parquet(rows: list[Row]) -> bytes:
    """Parquet with text unchanged and numbers as float64 (rank int64)."""
    import pyarrow.json as pj
    import pyarrow.parquet as pq

    kinds = {n: pa.int64() if n in _WHOLE else pa.float64() if number else pa.string()
             for n, number in COLUMNS.items()}
    schema = pa.schema(list(kinds.items()))
    if rows:
        # Through JSON: arrays made from Python lists would load pandas, which costs most of a second.
        lines = "".join(json.dumps({n: _utf8(v) if isinstance(v, str) else v for n, v in row.items() if n in COLUMNS},
                                   ensure_ascii=False) + "\n" for row in rows).encode()
        table = pj.read_json(pa.BufferReader(lines), pj.ReadOptions(use_threads=False, block_size=len(lines) + 1),
                             pj.ParseOptions(explicit_schema=schema))
    else:
        table = schema.empty_table()
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


def as_markdown(rows: list[Row]) -> str:
    """Counts, the rule of ranking and a table."""
    from ...reports.pages.markdown import escape

    sticks = sum(row["verdict"] == "stiction" for row in rows)
    lines = ["# Batch summary", "",
             f"{counts_said(rows)}; {counted(sticks, 'sticks', 'stick')}. {RULE} `summary.csv` and "
             "`summary.parquet` hold all columns.", "",
             *(line for said in groups_said(rows) for line in (escape(said), "")),
             "| " + " | ".join(_SHOWN) + " |",
             "|" + "|".join("---:" if COLUMNS[n] else "---" for n in _SHOWN) + "|"]
    lines += ["| " + " | ".join(_cell(row, n, escape) for n in _SHOWN) + " |" for row in rows]
    return _utf8("\n".join(lines) + "\n")


def shown(row: Row, name: str) -> str:
    """A value for display: numbers at four digits, the period as in a report, a long message cut."""
    value = row[name]
    if value is None:
        return ""
    if name == "period_median_s":
        return wording.number(value)
    if COLUMNS[name]:
        return f"{value:.{_DIGITS}g}" if name not in _WHOLE else str(value)
    text = " ".join(str(value).split())
    return text if len(text) <= _LONGEST_MESSAGE else text[:_LONGEST_MESSAGE - 1] + "…"


def _cell(row: Row, name: str, escape: Any) -> str:
    return escape(shown(row, name)) if not COLUMNS[name] else shown(row, name)


def _utf8(text: str) -> str:
    """Text without halves of surrogate pairs, which UTF-8 cannot hold."""
    return text.encode("utf-8", "replace").decode("utf-8")


def _share(study: dict[str, Any]) -> float | None:
    """Share of PV's swing about its setpoint that goes away with a perfect valve; None where it is not known."""
    causes = (study.get("swing") or {}).get("causes") or ()
    return next((cause["share"] for cause in causes if cause.get("part") == "valve"), None)
