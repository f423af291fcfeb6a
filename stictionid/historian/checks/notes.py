"""Findings about the reading of a file: order of rows, step, gaps, modes (faults of the signals: checks/spoilt.py)."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...record.loop import Finding
from ...system.plurals import counted
from ..grid.grid import Frame, GridStep
from ..series.shaped import Shaped
from ..words.cells import shown
from ..words.findings import INFO, WARNING, finding
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
    found, orders = [], shaped.orders
    if any(o.newest_first for o in orders):
        found.append(finding("newest-first"))
    moved = sum(o.out_of_order for o in orders)
    if moved:
        found.append(finding("out-of-order", {"steps_back": moved},
                             times="once" if moved == 1 else f"{moved:,} times"))
    duplicates = sum(int(o.duplicates.size) for o in orders)
    if duplicates:
        found.append(finding("duplicate-stamps", {"rows": duplicates}, WARNING if duplicates > 10 else INFO,
                             rows=duplicates, repeat="rows repeat" if duplicates > 1 else "row repeats"))
    spread = max((o.spread for o in orders), default=0)
    if spread:
        found.append(finding("seconds-dropped", {"rows_per_minute": spread}, rows=spread))
        shaped.guesses.append("rows of one minute spread evenly over it (export with seconds)")
    folded = max((o.folded for o in orders), default=0)
    if folded:
        found.append(finding("clock-fold", {"rows": folded}, rows=folded))
        shaped.guesses.append("a step back of one hour taken for the end of daylight saving time (--zone NAME)")
    return found


def tag_findings(shaped: Shaped, frame: Frame) -> list[Finding]:
    """Findings on tags: offsets between stamps, the slower tag, tags recorded on change, uncertain values."""
    found = []
    offsets = {k: v for k, v in frame.offsets_s.items() if abs(v) > MAX_OFFSET_S}
    if offsets:
        listed = ", ".join(f"{k.replace('_', ' ')} {v:+g} s" for k, v in offsets.items())
        found.append(finding("tag-offset", {f"{k}_s": v for k, v in offsets.items()}, listed=listed))
    if frame.thinned > 1:
        found.append(finding("resampled", {"every": frame.thinned}, every=frame.thinned))
    if frame.on_change:
        listed = ", ".join(sorted(r.replace("_", " ") for r in frame.on_change))
        found.append(finding("held-values", listed=listed))
    if shaped.uncertain:
        found.append(finding("uncertain-quality", {"rows": shaped.uncertain}, rows=shaped.uncertain))
    return found


def setpoint_findings(shaped: Shaped) -> list[Finding]:
    """Finding on a cascade slave without a setpoint: it is the output of its master, perhaps in the same file."""
    modes = shaped.modes
    if "setpoint" in shaped.series or modes is None or "CAS" not in modes.meaning:
        return []
    masters = [n for n in shaped.assignment.unused if take_apart(n).role == "output"]
    listed = f", perhaps {shown(masters[0])} (--sp {masters[0]})" if masters else " (--sp TAG)"
    return [finding("setpoint-absent", {"candidates": masters[:5]}, listed=listed)]


def irregular(step: GridStep, honest: float, frame: Frame) -> Finding:
    """Finding on steps that fit no even grid."""
    low, high = (float(f(np.diff(frame.ns))) / 1e9 for f in (np.min, np.max))
    return finding("irregular-steps", {"share_fitting": step.fitting, "step_s": honest / 1e9}, low=low, high=high,
                   fitting=100 * step.fitting, step=step.ns / 1e9, honest=honest / 1e9)


def jitter(step: GridStep) -> Finding:
    """Finding on steps that are even except for a small deviation."""
    return finding("jitter", {"worst_share_of_step": step.worst, "step_s": step.ns / 1e9,
                              "share_fitting": step.fitting},
                   INFO if step.worst <= MAX_INNOCENT_JITTER else WARNING, worst=100 * step.worst, step=step.ns / 1e9,
                   what="rounded to a coarse clock" if step.kind == "rounded" else "jittering")


def gaps(frame: Frame, step: GridStep, naive: bool) -> Finding:
    """Finding on the gaps at which the record was split."""
    lengths = [(int(frame.ns[i]) - int(frame.ns[i - 1])) / 1e9 for i in frame.starts[1:]]
    hour = naive and any(abs(length - 3600.0 - step.ns / 1e9) < 0.5 * step.ns / 1e9 for length in lengths)
    more = "; one of them is an hour: perhaps the clock was put forward (--zone NAME tells)" if hour else ""
    return finding("gaps", {"gaps": len(lengths), "longest_s": max(lengths), "step_s": step.ns / 1e9},
                   gaps=counted(len(lengths), "gap"), longest=max(lengths), more=more)


def held_process_value(every: int, step: GridStep, share: float, empty: float) -> Finding:
    """Finding on a PV that is repeated, or whose cells are empty, between its measurements while OP moves on.

    `share` and `empty` are the shares of the samples whose PV repeats and whose PV is missing.
    """
    repeats = f"a PV that repeats ({100 * share:.3g} % of the samples) is no measurement and does not count"
    between = f"the PV cells in between are empty ({100 * empty:.3g} % of the samples)"
    slow = every * step.ns / 1e9
    return finding("process-value-held", {"every": every, "step_s": slow, "share": share, "empty": empty}, slow=slow,
                   step=step.ns / 1e9, said="; ".join([repeats] * (share > 0.0) + [between] * (empty > 0.0)))


def mode_findings(unclear: dict[str, int], shaped: Shaped) -> list[Finding]:
    """Finding on modes of unknown meaning."""
    if not unclear:
        return []
    column = shaped.columns.get("mode", "mode")
    listed = ", ".join(f"{w} ({counted(c, 'sample')})" for w, c in unclear.items())
    word = next(iter(unclear))
    shaped.guesses.append(
        f"mode {listed} in {shown(column)} has no known meaning: "
        f"taken as controlling where OP moves (--mode-map {word}=AUTO)"
    )
    constant = shaped.modes is not None and len(shaped.modes.words) == 1
    return [finding("mode-unknown", {"modes": unclear}, INFO if constant else WARNING, column=shown(column),
                    listed=listed, word=word)]


def mask_findings(samples: dict[str, int]) -> list[Finding]:
    """Findings on samples that stay in the loop but do not count."""
    found = []
    for reason, count in samples.items():
        if reason in _MASKS:
            share = count / samples["total"]
            found.append(finding(
                _MASKS[reason],
                {"samples": count, "share": share}, WARNING if share > MAX_INNOCENT_MASK else INFO,
                caps_verdict=share > MAX_MASK and reason in _CAPPING, samples=counted(count, "sample"),
                share=100 * share, do="does" if count == 1 else "do"))
    return found


_MASKS = {"manual": "manual-stretch", "start-up": "start-up", "saturated": "output-saturated", "frozen": "frozen",
          "filled": "filled-samples", "other valve": "other-valve", "bad": "process-value-missing", "masked": "masked"}
"""Code of the finding on each reason for which samples do not count."""
_CAPPING = ("frozen", "filled", "saturated")


def bad_findings(rows: dict[str, int]) -> list[Finding]:
    """Finding on rows without a usable number."""
    bad = rows.get("bad", 0)
    if not bad:
        return []
    share = bad / rows["in"]
    return [finding("bad-values", {"rows": bad, "share": share}, WARNING if share > MAX_INNOCENT_MASK else INFO,
                    rows=counted(bad, "row"), share=100 * share, have="has" if bad == 1 else "have")]


def slower_output(every: int, step: GridStep, errors: tuple[float, float]) -> Finding:
    """Finding on an OP that changes only at every k-th sample, and PV in between.

    `errors` are those of two PI laws: of a controller that sees only the samples at which OP changes, and of one that
    sees all. The first says that nothing is missing, the second that OP was exported less often than it moved.
    """
    slow = every * step.ns / 1e9
    words: dict[str, Any] = {"slow": slow, "step": step.ns / 1e9, "every": every}
    evidence = {"every": every, "step_s": slow}
    by_changes, by_samples = errors
    if by_changes < _OBEYS and by_changes < _CLEARLY * by_samples:
        return finding("output-slower", evidence, **words)
    faster = by_samples < _OBEYS and by_samples < _CLEARLY * by_changes
    return finding("output-sparse", evidence, **words, why="its controller scans faster, so that" if faster else
                   f"unless the controller scans every {slow:g} s,")
