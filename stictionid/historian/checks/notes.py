"""Findings about the reading of a file: order of rows, step, gaps, modes (faults of the signals: checks/spoilt.py)."""

from __future__ import annotations

import numpy as np

from ...record.loop import Finding
from ...system.plurals import counted
from ..bytes.options import ReadOptions
from ..grid.align import Aligned
from ..grid.grid import Frame, GridStep
from ..series.shaped import Shaped
from ..words.cells import shown
from ..words.roles import take_apart

MAX_INNOCENT_JITTER = 0.02
"""Jitter below this share of the step is information only."""
MAX_INNOCENT_MASK = 0.1
"""Share of samples left out above which it is a warning."""
MAX_MASK = 0.5
"""Share of frozen, filled or saturated samples above which no verdict is sure."""
MAX_OFFSET_S = 1e-6
"""Offsets between tags below a microsecond are rounding."""

_OBEYS, _CLEARLY = 0.1, 0.5
"""Error of a PI law, as a share of the size of OP's changes, up to which OP obeys it, and share of another law's error
up to which it is clearly the better one."""


def order_findings(shaped: Shaped) -> list[Finding]:
    """Findings on the order of rows: newest first, out of order, duplicates, dropped seconds, folded clock."""
    found = []
    orders = shaped.orders
    duplicates = sum(int(o.duplicates.size) for o in orders)
    if any(o.newest_first for o in orders):
        found.append(Finding("newest-first", "info", "rows stood newest first and were turned round", {}))
    moved = sum(o.out_of_order for o in orders)
    if moved:
        found.append(
            Finding(
                "out-of-order",
                "warning",
                f"the time steps back {_times(moved)}; rows were sorted",
                {"steps_back": moved},
            )
        )
    if duplicates:
        found.append(
            Finding(
                "duplicate-stamps",
                "warning" if duplicates > 10 else "info",
                f"{duplicates:,} row{'s repeat' if duplicates > 1 else ' repeats'} a time stamp; "
                "the good one written last was kept",
                {"rows": duplicates},
            )
        )
    spread = max((o.spread for o in orders), default=0)
    if spread:
        found.append(
            Finding(
                "seconds-dropped",
                "warning",
                f"time stamps lost their seconds ({spread} rows a minute); rows were spread evenly over each minute",
                {"rows_per_minute": spread},
            )
        )
        shaped.guesses.append("rows of one minute spread evenly over it (export with seconds)")
    folded = max((o.folded for o in orders), default=0)
    if folded:
        found.append(
            Finding(
                "clock-fold",
                "warning",
                f"the clock goes back one hour once; the {folded:,} rows after it were moved on by an "
                "hour (end of daylight saving time)",
                {"rows": folded},
            )
        )
        shaped.guesses.append("a step back of one hour taken for the end of daylight saving time (--zone NAME)")
    return found


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count:,} times"


def tag_findings(shaped: Shaped, aligned: Aligned) -> list[Finding]:
    """Findings on tags: offsets between stamps, the slower tag, tags recorded on change, uncertain values."""
    found = []
    offsets = {k: v for k, v in aligned.offsets_s.items() if abs(v) > MAX_OFFSET_S}
    if offsets:
        listed = ", ".join(f"{k.replace('_', ' ')} {v:+g} s" for k, v in offsets.items())
        found.append(
            Finding(
                "tag-offset",
                "warning",
                f"tags are stamped apart (against PV: {listed}); they were paired by the nearest stamp, "
                "so a dead time read from them is off by as much",
                {f"{k}_s": v for k, v in offsets.items()},
                source="docs/traps.md, export trap 15",
            )
        )
    if aligned.thinned > 1:
        found.append(
            Finding(
                "resampled",
                "info",
                f"PV is recorded {aligned.thinned} times as often as OP; the step of OP was taken",
                {"every": aligned.thinned},
            )
        )
    if aligned.on_change:
        listed = ", ".join(sorted(r.replace("_", " ") for r in aligned.on_change))
        found.append(Finding("held-values", "info", f"recorded on change only and held in between: {listed}", {}))
    if shaped.uncertain:
        found.append(
            Finding(
                "uncertain-quality",
                "info",
                f"{shaped.uncertain:,} PV values are marked uncertain and were kept",
                {"rows": shaped.uncertain},
            )
        )
    return found


def setpoint_findings(shaped: Shaped) -> list[Finding]:
    """Finding on a cascade slave without a setpoint: it is the output of its master, perhaps in the same file."""
    modes = shaped.modes
    if "setpoint" in shaped.series or modes is None or "CAS" not in modes.meaning:
        return []
    masters = [n for n in shaped.assignment.unused if take_apart(n).role == "output"]
    listed = f", perhaps {shown(masters[0])} (--sp {masters[0]})" if masters else " (--sp TAG)"
    return [
        Finding(
            "setpoint-absent",
            "info",
            f"no setpoint, and the loop runs in cascade: its setpoint is the output of its master{listed}",
            {"candidates": masters[:5]},
            source="docs/traps.md, export trap 18",
        )
    ]


def irregular(step: GridStep, honest: float, frame: Frame) -> Finding:
    """Finding on steps that fit no even grid."""
    low, high = (float(f(np.diff(frame.ns))) / 1e9 for f in (np.min, np.max))
    return Finding(
        "irregular-steps",
        "serious",
        f"time steps run from {low:g} to {high:g} s and only {100 * step.fitting:.0f} % fit multiples of "
        f"{step.ns / 1e9:g} s: resampled to {honest / 1e9:g} s; shorter slips are lost, S and J come out too small",
        {"share_fitting": step.fitting, "step_s": honest / 1e9},
        source="docs/traps.md, export trap 11",
    )


def jitter(step: GridStep) -> Finding:
    """Finding on steps that are even except for a small deviation."""
    what = "rounded to a coarse clock" if step.kind == "rounded" else "jittering"
    return Finding(
        "jitter",
        "info" if step.worst <= MAX_INNOCENT_JITTER else "warning",
        f"time stamps are {what}: up to {100 * step.worst:.2g} % of the step of {step.ns / 1e9:.6g} s; taken as even",
        {"worst_share_of_step": step.worst, "step_s": step.ns / 1e9, "share_fitting": step.fitting},
    )


def gaps(frame: Frame, step: GridStep, naive: bool) -> Finding:
    """Finding on the gaps at which the record was split."""
    count = len(frame.starts) - 1
    at = frame.starts[1:]
    lengths = [(int(frame.ns[i]) - int(frame.ns[i - 1])) / 1e9 for i in at]
    hour = naive and any(abs(length - 3600.0 - step.ns / 1e9) < 0.5 * step.ns / 1e9 for length in lengths)
    return Finding(
        "gaps",
        "warning",
        f"{counted(count, 'gap')} of more than two samples, longest {max(lengths):g} s: the record was split, "
        "never joined"
        + ("; one of them is an hour: perhaps the clock was put forward (--zone NAME tells)" if hour else ""),
        {"gaps": count, "longest_s": max(lengths), "step_s": step.ns / 1e9},
    )


def oversampled(every: int, step: GridStep) -> Finding:
    """Finding on a record in which every value is repeated k times."""
    return Finding(
        "oversampled",
        "warning",
        f"all signals repeat {every} times: recorded every {step.ns / 1e9:g} s but updated every "
        f"{every * step.ns / 1e9:g} s; one of {every} rows was kept",
        {"repeats": every},
        source="docs/traps.md, export trap 13",
    )


def held_process_value(every: int, step: GridStep, share: float, empty: float) -> Finding:
    """Finding on a PV that is repeated, or whose cells are empty, between its measurements while OP moves on.

    `share` and `empty` are the shares of the samples whose PV repeats and whose PV is missing.
    """
    repeats = f"a PV that repeats ({100 * share:.3g} % of the samples) is no measurement and does not count"
    between = f"the PV cells in between are empty ({100 * empty:.3g} % of the samples)"
    return Finding(
        "process-value-held",
        "info",
        f"PV changes only every {every * step.ns / 1e9:g} s, OP every {step.ns / 1e9:g} s: "
        f"{'; '.join([repeats] * (share > 0.0) + [between] * (empty > 0.0))}; "
        "the valve runs on by OP",
        {"every": every, "step_s": every * step.ns / 1e9, "share": share, "empty": empty},
        source="docs/traps.md, export trap 15",
    )


def short_segments(count: int) -> list[Finding]:
    """Finding on stretches too short to use."""
    if not count:
        return []
    return [
        Finding(
            "short-segments",
            "info",
            f"{count} stretch{'es' * (count > 1)} between gaps too short to use",
            {"segments": count},
        )
    ]


def mode_findings(unclear: dict[str, int], shaped: Shaped, guesses: list[str]) -> list[Finding]:
    """Finding on modes of unknown meaning."""
    if not unclear:
        return []
    column = shaped.columns.get("mode", "mode")
    listed = ", ".join(f"{w} ({counted(c, 'sample')})" for w, c in unclear.items())
    word = next(iter(unclear))
    guesses.append(
        f"mode {listed} in {shown(column)} has no known meaning: "
        f"taken as controlling where OP moves (--mode-map {word}=AUTO)"
    )
    constant = shaped.modes is not None and len(shaped.modes.words) == 1
    return [
        Finding(
            "mode-unknown",
            "info" if constant else "warning",
            f"{shown(column)} has modes of unknown meaning, {listed}: samples count where OP moves; "
            f"say what they mean with --mode-map {word}=AUTO",
            {"modes": unclear},
            source="docs/method.md, section 13",
        )
    ]


def time_text(shaped: Shaped, options: ReadOptions) -> str:
    """Description of the time column in one phrase."""
    if shaped.times is None:
        return f"no time column, {options.step_s:g} s per row as said"
    zone = (
        ""
        if shaped.times.elapsed
        else f", {shaped.times.zone}"
        if shaped.times.zone
        else ", naive local time (no zone known)"
    )
    return shaped.times.text + zone


def mask_findings(samples: dict[str, int]) -> list[Finding]:
    """Findings on samples that stay in the loop but do not count."""
    words = {
        "manual": "the controller is in manual",
        "start-up": "PV is far from where the record is run, and on its way there or away (--keep-startup)",
        "saturated": "OP stands at its limit: what the valve does there says nothing about S and J",
        "frozen": "every signal stands still (frozen record)",
        "filled": "a missing value was filled in",
        "other valve": "OP drives the other valve",
        "bad": "PV is missing there; the valve runs on by OP",
        "masked": "the file marks them as unused",
    }
    codes = {
        "manual": "manual-stretch",
        "start-up": "start-up",
        "saturated": "output-saturated",
        "frozen": "frozen",
        "filled": "filled-samples",
        "other valve": "other-valve",
        "bad": "process-value-missing",
        "masked": "masked",
    }
    found = []
    for reason, count in samples.items():
        if reason in words:
            share = count / samples["total"]
            found.append(
                Finding(
                    codes[reason],
                    "warning" if share > MAX_INNOCENT_MASK else "info",
                    f"{counted(count, 'sample')} ({100 * share:.1f} %) {'does' if count == 1 else 'do'} not count: "
                    f"{words[reason]}",
                    {"samples": count, "share": share, "caps_verdict": share > MAX_MASK and reason in _CAPPING},
                )
            )
    return found


_CAPPING = ("frozen", "filled", "saturated")


def bad_findings(rows: dict[str, int]) -> list[Finding]:
    """Finding on rows without a usable number."""
    bad = rows.get("bad", 0)
    if not bad:
        return []
    share = bad / rows["in"]
    return [
        Finding(
            "bad-values",
            "warning" if share > MAX_INNOCENT_MASK else "info",
            f"{counted(bad, 'row')} ({100 * share:.1f} %) {'has' if bad == 1 else 'have'} no usable PV or OP; longer "
            "runs without OP split the record",
            {"rows": bad, "share": share},
        )
    ]


def slower_output(every: int, step: GridStep, errors: tuple[float, float]) -> Finding:
    """Finding on an OP that changes only at every k-th sample, and PV in between.

    `errors` are those of two PI laws: of a controller that sees only the samples at which OP changes, and of one that
    sees all. The first says that nothing is missing, the second that OP was exported less often than it moved.
    """
    slow, evidence = f"{every * step.ns / 1e9:g} s", {"every": every, "step_s": every * step.ns / 1e9}
    said = f"OP changes only every {slow}, PV every {step.ns / 1e9:g} s: "
    tail = f"; one of {every} rows was kept"
    by_changes, by_samples = errors
    if by_changes < _OBEYS and by_changes < _CLEARLY * by_samples:
        return Finding("output-slower", "info", f"{said}its controller scans every {slow}, so that no move of OP is "
                       f"missing{tail}", evidence)
    faster = by_samples < _OBEYS and by_samples < _CLEARLY * by_changes
    why = "its controller scans faster, so that" if faster else f"unless the controller scans every {slow},"
    return Finding("output-sparse", "warning", f"{said}{why} OP was exported too seldom and the valve's moves in "
                   f"between are missing; export OP as often as PV{tail}", evidence)
