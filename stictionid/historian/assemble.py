"""Assembly of aligned series into a loop: window, even grid, filling, scaling, masks, segments, findings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import DataError, UsageError
from ..record.loop import Finding
from ..typing import BoolArray, IntArray
from .bytes.options import ReadOptions
from .checks import notes
from .checks.codes import blank_codes
from .checks.spoilt import ladder, spoilt_findings
from .checks.texture import Signals
from .grid.align import resample
from .grid.grid import Frame, GridStep, driven, fill, find_step, insert_missing, place_on_grid, split
from .grid.held import repeats, slower_output
from .grid.masks import frozen, manual, saturated, startup
from .grid.window import outside, stamp_text
from .series.shaped import Shaped
from .table.rows import CODE, REASONS, RowBook
from .table.table import Table
from .words.findings import finding
from .words.modes import fractions
from .words.units import LIVE_ZERO, OTHER, drives_in_milliamperes, output_unit, to_percent

MIN_SAMPLES = 4
"""Least number of samples of a record, whatever the method; identification has further limits of its own."""
ON_CHANGE_SHARE = 0.3
"""Share of empty cells from which OP in a wide table counts as written on change only."""


@dataclass
class Assembled:
    """The parts of a Loop by their names, with times, segments and sample counts by mask.

    `rows` holds for every source the row of the table behind each sample (samples,), -1 for none.
    """

    parts: dict[str, Any]
    start: str
    end: str
    segments: tuple[dict[str, Any], ...]
    samples: dict[str, int]
    rows: tuple[IntArray, ...]


def _left_out(book: RowBook) -> str:
    """Most frequent reason why rows are not used, in words."""
    out = {reason: rows for reason, rows in book.counts().items() if reason not in ("in", "used") and rows}
    reason = max(out, key=lambda r: out[r], default="")
    return f" ({out[reason]:,} of {book.counts()['in']:,} rows are left out as {reason!r})" if reason else ""


def assemble(shaped: Shaped, frame: Frame, options: ReadOptions, book: RowBook, table: Table) -> Assembled:
    """The loop of aligned series; guesses and findings are added to `shaped`. DataError where nothing is usable."""
    _leave_out(frame, book, outside(frame, options.start, options.end, elapsed=shaped.times.elapsed), "outside window")
    if frame.ns.size < MIN_SAMPLES:
        raise DataError(
            f"{table.file} has {frame.ns.size} usable row{'' if frame.ns.size == 1 else 's'}"
            f"{' in the window' if options.start or options.end else ''}, fewer than {MIN_SAMPLES}{_left_out(book)}",
            "check --start and --end" if options.start or options.end else "export a longer window",
        )
    shaped.findings += [*notes.order_findings(shaped), *notes.tag_findings(shaped, frame),
                        *notes.setpoint_findings(shaped), *blank_codes(frame, shaped, options.sentinels)]
    step = _even_grid(frame, shaped, options, book)
    shaped.findings += _fresh_only(frame, step)
    _scale(frame, shaped, options)
    filled = fill(frame, frame.on_change | _written_on_change(frame))
    shaped.findings += notes.mode_findings(_mask(frame, filled, shaped, options), shaped)
    keep, starts, short = _segments(frame, table)
    _book_missing(frame, book, keep)
    if short:
        stretches = f"{short} stretch{'es' * (short > 1)}"
        shaped.findings.append(finding("short-segments", {"segments": short}, stretches=stretches))
    return _finish(frame, shaped, step, keep, starts)


def _leave_out(frame: Frame, book: RowBook, gone: BoolArray, reason: str) -> None:
    """Take samples out of the frame, in place, and book their rows."""
    if gone.any():
        for rows in frame.rows:
            book.mark(rows[gone], reason)
        frame.take(~gone)


def _even_grid(frame: Frame, shaped: Shaped, options: ReadOptions, book: RowBook) -> GridStep:
    """Step of the even grid; the frame is put on it in place, with findings and guesses about it."""
    step = find_step(frame.ns)
    if step.kind == "irregular":
        honest = float(np.quantile(np.diff(frame.ns), 0.9))
        shaped.findings.append(notes.irregular(step, honest, frame))
        shaped.guesses.append(f"irregular stamps resampled to {honest / 1e9:g} s (--step SECONDS on an even export)")
        old_rows = frame.rows
        left_out = resample(frame, honest)
        for rows in old_rows:
            book.mark(rows[left_out], "resampled")
        step = GridStep(honest, "irregular")
    elif step.kind != "even":
        shaped.findings.append(notes.jitter(step))
    step = _thin(frame, step, shaped, options, book)
    place = place_on_grid(frame, step)
    off_grid = frame.reason == CODE["off grid"]
    _leave_out(frame, book, off_grid, "off grid")
    insert_missing(frame, place[~off_grid])
    if len(frame.starts) > 1:
        shaped.findings.append(notes.gaps(frame, step, naive=not shaped.times.elapsed and shaped.times.zone is None))
    return step


def _thin(frame: Frame, step: GridStep, shaped: Shaped, options: ReadOptions, book: RowBook) -> GridStep:
    """Every k-th sample where all signals, or OP alone, repeat k times, or where --step asks for a longer step."""
    reason, phase = "repeat", 0
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
            shaped.findings.append(finding("oversampled", {"repeats": every}, every=every, step=step.ns / 1e9,
                                           slow=every * step.ns / 1e9))
    kept = np.arange(frame.ns.size) % every == phase
    if every == 1 and options.step_s is None and step.kind != "irregular":
        every, kept, errors = slower_output(frame, step)
        reason = "resampled"
        if every > 1:
            shaped.findings.append(notes.slower_output(every, step, errors))
    if every == 1:
        return step
    _leave_out(frame, book, ~kept, reason)
    return GridStep(step.ns * every, step.kind, step.worst, step.fitting)


def _fresh_only(frame: Frame, step: GridStep) -> list[Finding]:
    """Take away, in place, the values of PV that only repeat an older one beside a moving OP; the finding on it."""
    every, repeated = repeats(frame, step)
    if every == 1:
        return []
    pv = frame.values["process_value"]
    frame.values["process_value"] = np.where(repeated, np.nan, pv)
    frame.reason[repeated & (frame.reason == 0)] = CODE["repeat"]
    return [notes.held_process_value(every, step, float(repeated.mean()), float(np.isnan(pv).mean()))]


def _scale(frame: Frame, shaped: Shaped, options: ReadOptions) -> None:
    """OP, SP and PV in their final units, in place, with guesses, and a finding when OP is no per cent."""
    units, op = shaped.units, frame.values["output"]
    said = units.get("output", "")
    span = options.split or options.span_op
    if options.split is not None:
        low, high = options.split
        frame.reason[(frame.reason == 0) & ((op < low) | (op > high))] = CODE["other valve"]
    if span is None and drives_in_milliamperes(op, said):
        span = LIVE_ZERO
        shaped.guesses.append("OP in mA is 4 to 20 mA, scaled to % (--span-op 4,20, or --span-op 0,20)")
    if span is not None:
        op = to_percent(op, span)
        units["output"] = "%"
    else:
        unit, found = output_unit(op, said)
        units["output"] = unit if unit == "%" or said in ("", "%") else said
        if found is not None:
            shaped.findings.append(found)
            if found.code == "output-perhaps-ma":
                shaped.guesses.append("OP taken as %, though it could be mA (--span-op 4,20 or --span-op 0,100)")
    frame.values["output"] = 100.0 - op if options.reverse_op else op
    if options.span_pv is not None:
        for role in ("process_value", "setpoint"):
            if role in frame.values:
                frame.values[role] = to_percent(frame.values[role], options.span_pv)
                units[role] = "%"


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
    for mask, reason in (
        (filled, "filled"),
        (frame.values.get("mask", np.ones(filled.size)) == 0, "masked"),
        (off & (not options.keep_manual), "manual"),
        (startup(frame) if not options.keep_startup else np.zeros(filled.size, np.bool_), "start-up"),
        (frozen(frame), "frozen"),
        (saturated(frame.values["output"], percent=shaped.units["output"] == "%"), "saturated"),
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
    """Samples kept, starts of their segments, and number of segments too short. DataError where none is usable."""
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


def _finish(frame: Frame, shaped: Shaped, step: GridStep, keep: IntArray, starts: list[int]) -> Assembled:
    """The samples kept as parts of a Loop, with the findings on their signals."""
    if keep.size < frame.ns.size:
        frame.take(keep)
    reason, ns, arrays = frame.reason, frame.ns, frame.values
    used = reason == 0
    setpoint = arrays.get("setpoint")
    if setpoint is not None and np.isnan(setpoint).all():
        setpoint = None
    step_s = round(step.ns) / 1e9 if step.kind == "even" else step.ns / 1e9
    units = {k: v for k, v in shaped.units.items() if v and not k.startswith("extra:")}
    units.setdefault("output", OTHER)
    signals = _measured(Signals(arrays["output"], arrays["process_value"], setpoint, step_s, tuple(starts)))
    hints = [*shaped.columns.values(), *shaped.described.values()]
    spoilt = spoilt_findings(signals, name_hints=hints, names=shaped.columns, fractions=fractions(shaped.modes))
    shaped.guesses.extend([f"roles as named, though {f.statement}" for f in spoilt if f.code == "swapped-roles"])
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
    stamps = {i: stamp_text(int(ns[i]), shaped.times.elapsed, shaped.times.zone) for i in (*starts, -1)}
    segments = tuple({"start": stamps[first], "first": first, "samples": end - first}
                     for first, end in zip(starts, [*starts[1:], reason.size], strict=True))
    counts = np.bincount(reason, minlength=len(REASONS)).tolist()
    by_reason = {name: count for name, count in zip(REASONS, counts, strict=True) if count and name != "used"}
    samples = {"total": int(reason.size), "used": counts[0], **by_reason}
    shaped.findings += spoilt + notes.mask_findings(samples)
    return Assembled(parts, stamps[0], stamps[-1], segments, samples, tuple(frame.rows))
