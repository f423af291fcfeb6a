"""Reader of historian exports: from the bytes of a file to one loop, with every guess and every row left out listed.

A file passes through these subpackages: `bytes` (content, unpacking, limits, encoding) → `table` (separator, header,
decimal mark, columns) → `series` (wide, long or paired table, roles) with `words` (names, cells, states, modes,
quality) and `time` (stamps, dates, zones, order) → `grid` (alignment, window, even grid, masks) with `checks` (spoilt
data, findings) → Loop. `folder` and `dataset` read one file per tag and partitioned Parquet. In `table/rows.py` every
row of the file is either used or listed under one reason. `reading` runs the whole.

Findings (code, severity, meaning):

===================== ================ ==========================================================================
code                  severity         meaning
===================== ================ ==========================================================================
averaged              warning          values are means over the interval: slips smeared, J too small
bad-values            info, warning    rows without a usable PV or OP; long runs without OP split the record
clipped               warning          PV sits at its highest or lowest value: end of the transmitter's range
clock-fold            warning          the clock goes back one hour; later rows were moved on
code-as-number        warning          sentinels or system states written as numbers were blanked
compressed            warning, serious PV lies on straight lines: slips and reversals are lost, S and J wrong
damaged-rows          warning          rows with a wrong number of cells
dead-signal           serious          PV or OP does not vary (relative to its magnitude)
duplicate-stamps      info, warning    several rows with one stamp; the good one written last was kept
excel-cut             warning          the file ends exactly where a spreadsheet does
filled-samples        info, warning    at most two missing samples in a row were filled; they do not count
frozen                info, warning    all signals stand still in a record with live noise; masked
gaps                  warning          longer gaps; the record was split there
held-values           info             tags recorded on change only, held in between
identical-signals     serious          PV is OP or SP in another unit: one tag exported twice
irregular-steps       serious          stamps fit no even grid; resampled to the coarsest honest step
jitter                info, warning    stamps even but for a little, or rounded to a coarse clock
manual-stretch        info, warning    the controller was in manual, off or tracking; masked
masked                info, warning    the file itself (a cleaned loop) marks samples as unused
mode-unknown          info, warning    a mode whose meaning is not known here
newest-first          info             rows were turned round
other-valve           info, warning    split range: OP drives the other valve; masked
out-of-order          warning          the time steps back; rows were sorted
output-not-percent    warning          OP is no per cent of travel: S and J are in the unit of OP
output-perhaps-ma     info             OP stays within 4 to 20 and was taken as %
output-saturated      info, warning    OP stands at its limit; masked
output-slower         info             OP changes at every k-th sample, as its controller scans; one row of k kept
output-sparse         warning          OP changes at every k-th sample, PV in between; one row of k was kept
oversampled           warning          all signals repeat k times; one row of k was kept
process-value-held    info             PV repeats between its measurements while OP moves; the cost skips repeats
process-value-missing info, warning    PV is missing beside OP; the valve runs through, the cost skips
quantised             warning          PV or OP moves in coarse steps
re-ranged             serious          level and noise change by one factor: range or unit changed
resampled             info             the slower tag set the step
seconds-dropped       warning          stamps without seconds; rows spread over each minute
setpoint-absent       info             a cascade slave without a setpoint: it is its master's output
short-segments        info             stretches between gaps too short to use
start-up              info, warning    PV on its way to (or from) where the record is run; masked
state-as-text         info             system states where numbers belong
swapped-roles         serious          PV and SP, or PV and OP, look as if they stood in each other's columns
tag-offset            warning          tags are stamped apart: a dead time read from them is off by as much
uncertain-quality     info             values marked uncertain were kept
unreadable-stamps     warning          rows whose time stamp can't be read; left out
===================== ================ ==========================================================================

`evidence["caps_verdict"]` is true where a finding forbids a sure verdict; so does severity "serious".
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .bytes.options import ReadOptions, options_from
    from .reading import Reading, loops_in, read, read_frame, read_loop

_HOME = {
    "ReadOptions": "bytes.options",
    "options_from": "bytes.options",
    "Reading": "reading",
    "loops_in": "reading",
    "read": "reading",
    "read_frame": "reading",
    "read_loop": "reading",
}

__all__ = ["ReadOptions", "Reading", "loops_in", "options_from", "read", "read_frame", "read_loop"]

if not TYPE_CHECKING:  # or an import of a name that is not there would pass
    def __getattr__(name: str) -> Any:
        """Load public names on first use, so that importing the package is fast."""
        if name not in _HOME:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        return getattr(import_module(f".{_HOME[name]}", __name__), name)
