"""Assembly of aligned series into a loop: window, even grid, filling, scaling, masks, segments, findings."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..errors import DataError, UsageError
from ..record.loop import Finding
from ..typing import BoolArray, FloatArray, IntArray
from .bytes.options import ReadOptions
from .checks import notes
from .checks.codes import blank_codes
from .checks.spoilt import ladder, spoilt_findings
from .checks.texture import Signals
from .grid.align import Aligned, resample
from .grid.grid import Frame, GridStep, driven, fill, find_step, insert_missing, place_on_grid, split
from .grid.held import repeats, slower_output
from .grid.masks import frozen, manual, saturated, startup
from .grid.window import cut_window, stamp_text
from .series.shaped import Shaped
from .table.rows import CODE, RowBook
from .table.table import Table
from .words.modes import fractions
from .words.units import LIVE_ZERO, OTHER, drives_in_milliamperes, output_unit, to_percent

MIN_SAMPLES = 4
"""Least number of samples of a record, whatever the method; identification has further limits of its own."""
ON_CHANGE_SHARE = 0.3
"""Share of empty cells from which OP in a wide table counts as written on change only."""


@dataclass
class Assembled:
    """The parts of a Loop by their names, with times, segments, sample counts by mask, guesses and findings.

    `rows` holds for every source the row of the table behind each sample (samples,), -1 for none.
    """

    parts: dict[str, Any]
    start: str | None
    end: str | None
    time_text: str
    segments: tuple[dict[str, Any], ...]
    samples: dict[str, int]
    rows: tuple[IntArray, ...]
    guesses: list[str] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)


def _left_out(book: RowBook) -> str:
    """Most frequent reason why rows are not used, in words."""
    out = {reason: rows for reason, rows in book.counts().items() if reason not in ("in", "used") and rows}
    reason = max(out, key=lambda r: out[r], default="")
    return f" ({out[reason]:,} of {book.counts()['in']:,} rows are left out as {reason!r})" if reason else ""


def assemble(shaped: Shaped, aligned: Aligned, options: ReadOptions, book: RowBook, table: Table) -> Assembled:
    """The loop of aligned series. DataError where nothing usable is left."""
    frame, guesses, findings = aligned.frame, list[str](), list[Finding]()
    elapsed = shaped.times is None or shaped.times.elapsed
    outside = cut_window(frame, options.start, options.end, elapsed=elapsed)
    for rows in outside:
        book.mark(rows, "outside window")
    if frame.ns.size < MIN_SAMPLES:
        raise DataError(
            f"{table.file} has {frame.ns.size} usable row{'' if frame.ns.size == 1 else 's'}"
            f"{' in the window' if options.start or options.end else ''}, fewer than {MIN_SAMPLES}{_left_out(book)}",
            "check --start and --end" if options.start or options.end else "export a longer window",
        )
    findings += notes.order_findings(shaped) + notes.tag_findings(shaped, aligned) + notes.setpoint_findings(shaped)
    findings += blank_codes(frame, options.sentinels, guesses, findings_of_words=shaped.words)
    step = _even_grid(frame, shaped, aligned, options, book, guesses, findings)
    findings += _fresh_only(frame, step)
    unit_found = _scale(frame, shaped, options, guesses)
    if unit_found is not None:
        findings.append(unit_found)
        if unit_found.code == "output-perhaps-ma":
            guesses.append("OP taken as %, though it could be mA (--span-op 4,20 or --span-op 0,100)")
    filled = fill(frame, aligned.on_change | _written_on_change(frame))
    unclear = _mask(frame, filled, shaped, options)
    findings += notes.mode_findings(unclear, shaped, guesses)
    loop_arrays = _segments(frame, table)
    _book_missing(frame, book, loop_arrays[0])
    return _finish(frame, shaped, options, step, guesses, findings, loop_arrays, elapsed)


def _even_grid(
    frame: Frame,
    shaped: Shaped,
    aligned: Aligned,
    options: ReadOptions,
    book: RowBook,
    guesses: list[str],
    findings: list[Finding],
) -> GridStep:
    """Step of the even grid; the frame is put on it in place, with findings and guesses about it."""
    step = find_step(frame.ns)
    if step.kind == "irregular":
        honest = float(np.quantile(np.diff(frame.ns), 0.9))
        findings.append(notes.irregular(step, honest, frame))
        guesses.append(f"irregular stamps resampled to {honest / 1e9:g} s (--step SECONDS on an even export)")
        old_rows = frame.rows
        left_out = resample(frame, honest, aligned.on_change)
        for rows in old_rows:
            book.mark(rows[left_out], "resampled")
        step = GridStep(honest, "irregular")
    elif step.kind != "even":
        findings.append(notes.jitter(step))
    step = _thin(frame, step, options, book, findings)
    place = place_on_grid(frame, step)
    off_grid = frame.reason == CODE["off grid"]
    if off_grid.any():
        for rows in frame.rows:
            book.mark(rows[off_grid], "off grid")
        frame.take(~off_grid)
        place = place[~off_grid]
    insert_missing(frame, place)
    if shaped.times is not None and len(frame.starts) > 1:
        findings.append(notes.gaps(frame, step, naive=not shaped.times.elapsed and shaped.times.zone is None))
    return step


def _thin(frame: Frame, step: GridStep, options: ReadOptions, book: RowBook, findings: list[Finding]) -> GridStep:
    """Every k-th sample where all signals, or OP alone, repeat k times, or where --step asks for a longer step."""
    every, reason, phase = 1, "repeat", 0
    if options.step_s is not None and abs(options.step_s * 1e9 / step.ns - 1) > 0.01:
        every, reason = round(options.step_s * 1e9 / step.ns), "resampled"
        if every < 1 or abs(every * step.ns / 1e9 / options.step_s - 1) > 0.01:
            raise UsageError(
                f"--step {options.step_s:g} is no multiple of the {step.ns / 1e9:g} s between the time stamps",
                "leave --step out, or give a multiple",
            )
    else:
        every, phase = ladder(frame)
        if every > 1:
            findings.append(notes.oversampled(every, step))
    keep = np.arange(phase, frame.ns.size, every)
    if every == 1 and options.step_s is None and step.kind != "irregular":
        every, fresh, errors = slower_output(frame, step)
        if every > 1:
            findings.append(notes.slower_output(every, step, errors))
            keep, reason = np.flatnonzero(fresh), "resampled"
    if every == 1:
        return step
    gone = np.ones(frame.ns.size, np.bool_)
    gone[keep] = False
    for rows in frame.rows:
        book.mark(rows[gone], reason)
    frame.take(keep)
    return GridStep(step.ns * every, step.kind, step.worst, step.fitting)


def _fresh_only(frame: Frame, step: GridStep) -> list[Finding]:
    """Take away, in place, the values of PV that only repeat an older one beside a moving OP; the finding on it."""
    every, repeated = repeats(frame, step)
    if every == 1:
        return []
    empty = np.isnan(frame.values["process_value"])
    frame.values["process_value"] = np.where(repeated, np.nan, frame.values["process_value"])
    frame.reason[repeated & (frame.reason == 0)] = CODE["repeat"]
    return [notes.held_process_value(every, step, float(repeated.mean()), float(empty.mean()))]


def _scale(frame: Frame, shaped: Shaped, options: ReadOptions, guesses: list[str]) -> Finding | None:
    """OP, SP and PV in their final units, in place; the finding when OP is no per cent. Guesses are added."""
    units, finding = shaped.units, None
    op = frame.values["output"]
    if options.split is not None:
        low, high = options.split
        frame.reason[(frame.reason == 0) & ((op < low) | (op > high))] = CODE["other valve"]
        op = to_percent(op, options.split)
        units["output"] = "%"
    elif options.span_op is not None:
        op = to_percent(op, options.span_op)
        units["output"] = "%"
    elif drives_in_milliamperes(op, units.get("output", "")):
        op = to_percent(op, LIVE_ZERO)
        units["output"] = "%"
        guesses.append("OP in mA is 4 to 20 mA, scaled to % (--span-op 4,20, or --span-op 0,20)")
    else:
        unit, finding = output_unit(op, units.get("output", ""))
        units["output"] = unit if unit == "%" or units.get("output", "") in ("", "%") else units["output"]
    if options.reverse_op:
        op = 100.0 - op
    frame.values["output"] = op
    if options.span_pv is not None:
        for role in ("process_value", "setpoint"):
            if role in frame.values:
                frame.values[role] = to_percent(frame.values[role], options.span_pv)
                units[role] = "%"
    return finding


def _written_on_change(frame: Frame) -> set[str]:
    """Held roles of which so many cells are empty that only changes were written."""
    return {
        role
        for role in ("output", "setpoint", "mode")
        if role in frame.values and ON_CHANGE_SHARE < np.isnan(frame.values[role]).mean() < 1.0
    }


def _mask(frame: Frame, filled: BoolArray, shaped: Shaped, options: ReadOptions) -> dict[str, int]:
    """Set, in place, the reasons of samples that don't count; returns the number of samples of each unclear mode."""
    off, unclear = manual(frame, shaped.modes)
    clamp = saturated(frame.values["output"], percent=shaped.units["output"] == "%")
    for mask, reason in (
        (filled, "filled"),
        (frame.values.get("mask", np.ones(filled.size)) == 0, "masked"),
        (off & (not options.keep_manual), "manual"),
        (startup(frame) if not options.keep_startup else np.zeros(filled.size, np.bool_), "start-up"),
        (frozen(frame), "frozen"),
        (clamp, "saturated"),
    ):
        frame.reason[mask & (frame.reason == 0)] = CODE[reason]
    pv = frame.values["process_value"]
    missing = np.isnan(pv)
    if missing.any() and not missing.all():
        # A sample that does not count for another reason is none whose PV alone is missing: a placeholder says so.
        other = missing & ~np.isin(frame.reason, [0, CODE["filled"], CODE["masked"], CODE["repeat"]])
        if other.any():
            frame.values["process_value"] = np.where(
                other, np.interp(np.arange(pv.size), np.flatnonzero(~missing), pv[~missing]), pv)
        frame.reason[missing & ~other & (frame.reason != CODE["repeat"])] = CODE["bad"]
    return unclear


def _segments(frame: Frame, table: Table) -> tuple[IntArray, list[int], int]:
    pv, op = frame.values["process_value"], frame.values["output"]
    valid = driven(frame)
    if not valid.any():
        empty = "PV" if np.isnan(pv).all() else "OP" if np.isnan(op).all() else "PV and OP together"
        raise DataError(f"{table.file}: no row has a usable number for {empty}", "check the columns with --pv and --op")
    return split(frame, valid)


def _measured(signals: Signals) -> Signals:
    """The samples that have a PV, as far apart as they are on average."""
    there = np.flatnonzero(~np.isnan(signals.process_value))
    if there.size == signals.process_value.size:
        return signals
    setpoint = None if signals.setpoint is None else signals.setpoint[there]
    starts = np.unique(np.searchsorted(there, signals.starts))
    return Signals(signals.output[there], signals.process_value[there], setpoint,
                   signals.step_s * signals.process_value.size / there.size,
                   tuple(int(s) for s in starts if s < there.size))


def _book_missing(frame: Frame, book: RowBook, keep: IntArray) -> None:
    """Book the rows of every sample: masked ones by their reason, left-out ones as bad or as a short segment."""
    codes = frame.reason.copy()
    bad = np.isnan(frame.values["process_value"]) | np.isnan(frame.values["output"])
    left_out = np.ones(codes.size, np.bool_)
    left_out[keep] = False
    codes[left_out & ~bad] = CODE["short segment"]
    codes[bad & (codes != CODE["repeat"])] = CODE["bad"]
    for rows in frame.rows:
        book.mark_codes(rows, codes)


def _finish(
    frame: Frame,
    shaped: Shaped,
    options: ReadOptions,
    step: GridStep,
    guesses: list[str],
    findings: list[Finding],
    kept: tuple[IntArray, list[int], int],
    elapsed: bool,
) -> Assembled:
    keep, starts, short = kept
    whole = keep.size == frame.ns.size

    def part(values: Any) -> Any:
        return values if whole else values[keep]

    reason, ns = part(frame.reason), part(frame.ns)
    arrays: dict[str, FloatArray] = {k: part(v) for k, v in frame.values.items()}
    used = reason == 0
    setpoint = arrays.get("setpoint")
    if setpoint is not None and np.isnan(setpoint).all():
        setpoint = None
    step_s = round(step.ns) / 1e9 if step.kind == "even" else step.ns / 1e9
    units = {k: v for k, v in shaped.units.items() if v and not k.startswith("extra:")}
    units.setdefault("output", OTHER)
    findings += notes.short_segments(short)
    signals = _measured(Signals(arrays["output"], arrays["process_value"], setpoint, step_s, tuple(starts)))
    hints = [*shaped.columns.values(), *shaped.described.values()]
    modes = shaped.modes
    spoilt = spoilt_findings(signals, name_hints=hints, names=shaped.columns, fractions=fractions(modes))
    findings += spoilt
    guesses += [f"roles as named, though {f.statement}" for f in spoilt if f.code == "swapped-roles"]
    for array in (*arrays.values(), used):
        if array.base is None:
            array.setflags(write=False)  # no other reference exists: the loop need not copy it
    parts = {
        "output": arrays["output"],
        "process_value": arrays["process_value"],
        "setpoint": setpoint,
        "position": arrays.get("position"),
        "extras": {k[6:]: v for k, v in arrays.items() if k.startswith("extra:")},
        "step_s": step_s,
        "used": used,
        "starts": tuple(starts),
        "begins_s": tuple(float(ns[i] - ns[0]) / 1e9 for i in starts) if len(starts) > 1 else (),
        "units": units,
    }
    zone = shaped.times.zone if shaped.times else None
    texts = [stamp_text(int(n), elapsed, zone) for n in (ns[0], ns[-1])]
    segments = tuple(
        {"start": stamp_text(int(ns[first]), elapsed, zone), "first": first, "samples": end - first}
        for first, end in zip(starts, [*starts[1:], reason.size], strict=True)
    )
    names = {code: name for name, code in CODE.items()}
    counts = np.bincount(reason, minlength=1)
    samples = {"total": int(reason.size), "used": int(used.sum())} | {
        names[c]: int(n) for c, n in enumerate(counts) if c and n
    }
    findings += notes.mask_findings(samples)
    time_text = notes.time_text(shaped, options)
    return Assembled(parts, texts[0], texts[1], time_text, segments, samples, tuple(part(r) for r in frame.rows),
                     guesses, findings)
