"""Files of one simulated loop in the shapes and locales of historians, for the tests of reading."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta
from decimal import Decimal

import numpy as np

START = R_STAMP = datetime(2024, 5, 31, 14, 0, 0)
ROWS = 120


@dataclass(frozen=True)
class Record:
    """Text cells of a loop (so that what a file holds is known to the last digit) and the numbers they stand for."""

    stamps: list[datetime]
    sp: list[str]
    pv: list[str]
    op: list[str]

    def numbers(self, tag: str) -> np.ndarray:
        return np.array([float(c) for c in getattr(self, tag)])


def record(rows: int = ROWS, step: float = 1.0, start: datetime = START, seed: int = 7, level: float = 50.0) -> Record:
    """A sticky-looking loop with noise: PV with three decimals, OP with two, one setpoint step."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows)
    pv = level + 2.0 * np.sign(np.sin(t / 9.0)) + 0.3 * rng.standard_normal(rows)
    op = 42.0 + 3.0 * np.arcsin(np.sin(t / 9.0 + 1.0)) + 0.1 * rng.standard_normal(rows)
    sp = np.where(t < rows // 2, level, level + 1.5)
    stamps = [start + timedelta(seconds=step * int(i)) for i in t]
    return Record(stamps, [f"{v:.1f}" for v in sp], [f"{v:.3f}" for v in pv], [f"{v:.2f}" for v in op])


def iso(stamp: datetime) -> str:
    return stamp.strftime("%Y-%m-%d %H:%M:%S")


def comma(text: str, thousands: str = "") -> str:
    """A number with a decimal comma, with thousands marks where wanted."""
    whole, _, fraction = text.partition(".")
    if thousands:
        sign, digits = ("-", whole[1:]) if whole.startswith("-") else ("", whole)
        whole = sign + f"{int(digits):,}".replace(",", thousands)
    return f"{whole},{fraction}" if fraction else whole


def wide(
    r: Record,
    *,
    sep: str = ",",
    names: str | None = "timestamp,FIC101.SP,FIC101.PV,FIC101.OP",
    stamp=iso,
    cell=str,
    end: str = "\n",
    above: tuple[str, ...] = (),
    below: tuple[str, ...] = (),
) -> str:
    """A wide table; `names` are joined by commas whatever `sep` is; `above` and `below` are whole lines."""
    lines = list(above)
    if names is not None:
        lines.append(sep.join(names.split(",")))
    for i, moment in enumerate(r.stamps):
        lines.append(sep.join([stamp(moment), cell(r.sp[i]), cell(r.pv[i]), cell(r.op[i])]))
    return end.join([*lines, *below]) + end


def long(
    r: Record,
    *,
    sep: str = ",",
    header: str | None = "Tag,Time,Value,Quality",
    good: str = "Good",
    loop: str = "FIC101",
) -> str:
    """A long table, tag after tag at each stamp."""
    lines = [] if header is None else [sep.join(header.split(","))]
    for i, moment in enumerate(r.stamps):
        for tag, cells in (("SP", r.sp), ("PV", r.pv), ("OP", r.op)):
            lines.append(
                sep.join(
                    [f"{loop}.{tag}", iso(moment), cells[i], *([good] if header is None or "Quality" in header else [])]
                )
            )
    return "\n".join(lines) + "\n"


def paired(r: Record, *, sep: str = ",") -> str:
    """Paired columns, each tag with stamps of its own."""
    lines = [sep.join(["FIC101.SP time", "FIC101.SP", "FIC101.PV time", "FIC101.PV", "FIC101.OP time", "FIC101.OP"])]
    for i, moment in enumerate(r.stamps):
        lines.append(sep.join([iso(moment), r.sp[i], iso(moment), r.pv[i], iso(moment), r.op[i]]))
    return "\n".join(lines) + "\n"


def html(r: Record) -> str:
    rows = "".join(
        f"<tr><td>{iso(m)}</td><td>{r.sp[i]}</td><td>{r.pv[i]}</td><td>{r.op[i]}</td></tr>"
        for i, m in enumerate(r.stamps)
    )
    head = "".join(f"<th>{name}</th>" for name in ("Time", "FIC101.SP", "FIC101.PV", "FIC101.OP"))
    return f"<html><body><table><tr>{head}</tr>{rows}</table></body></html>"


def excel_serial(moment: datetime, epoch: datetime = datetime(1899, 12, 30)) -> str:
    days = Decimal(int((moment - epoch).total_seconds())) / Decimal(86400)
    return f"{days:.9f}"


def epoch(moment: datetime, per_second: int = 1) -> str:
    return str(int((moment - datetime(1970, 1, 1)).total_seconds()) * per_second)


def filetime(moment: datetime) -> str:
    return str(int((moment - datetime(1601, 1, 1)).total_seconds()) * 10_000_000)
