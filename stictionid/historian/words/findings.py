"""Findings of the reader: severity, statement and source of each, by its code.

A severity that depends on the numbers is given where the finding is made. `caps_verdict` is true where a finding
forbids a sure verdict; so does severity "serious".
"""

from __future__ import annotations

from typing import Any

from ...record.loop import Finding

INFO, WARNING, SERIOUS = "info", "warning", "serious"
_TRAP, _METHOD = "docs/traps.md, export trap ", "docs/details.md, section 13"
_UNCOUNTED = "{samples} ({share:.1f} %) {do} not count: "

FINDINGS: dict[str, tuple[str, str, str]] = {
    "averaged": (WARNING, "values look like averages over {step:g} s, not snapshots ({why}): slips are smeared, J "
                 "comes out too small, and whether a stamp means the begin or the end of its interval is not known: a "
                 "dead time is uncertain by {step:g} s", _TRAP + "14"),
    "bad-values": (INFO, "{rows} ({share:.1f} %) {have} no usable PV or OP; longer runs without OP split the record",
                   ""),
    "clipped": (WARNING, "PV sits at its {word} value {limit:g} in {share:.1f} % of the samples: the range of the "
                "transmitter ends there; the slips that show there are cut off, J comes out too small", ""),
    "clock-fold": (WARNING, "the clock goes back one hour once; the {rows:,} rows after it were moved on by an hour "
                   "(end of daylight saving time)", ""),
    "code-as-number": (WARNING, "{role}: {count:,} values are codes, not measurements, and were blanked: {listed}",
                       "docs/traps.md, export traps 2 and 3"),
    "compressed": (WARNING, "{share:.0f} % of the {signal} samples lie on straight lines: compressed with a deadband "
                   "of about {deadband:.2g}, or interpolated; smaller moves are gone{unless}", _TRAP + "11"),
    "damaged-rows": (WARNING, "{rows} {have} a wrong number of cells, the first in line {line:,}: {text}", ""),
    "dead-signal": (SERIOUS, "{role} does not vary (from {low:.6g} to {high:.6g}): nothing about the valve can be "
                    "learnt from it", ""),
    "duplicate-stamps": (INFO, "{rows:,} {repeat} a time stamp; the good one written last was kept", ""),
    "excel-cut": (WARNING, "the file ends exactly where a spreadsheet does ({rows:,} rows): more was probably cut off",
                  ""),
    "filled-samples": (INFO, _UNCOUNTED + "a missing value was filled in", ""),
    "frozen": (INFO, _UNCOUNTED + "every signal stands still (frozen record)", ""),
    "gaps": (WARNING, "{gaps} of more than two samples, longest {longest:g} s: the record was split, never joined"
             "{more}", ""),
    "held-values": (INFO, "recorded on change only and held in between: {listed}", ""),
    "identical-signals": (SERIOUS, "process value {one} is {role} {other} in another unit, to the last digit: one tag "
                          "was exported twice, and S and J would mean nothing", ""),
    "irregular-steps": (SERIOUS, "time steps run from {low:g} to {high:g} s and only {fitting:.0f} % fit multiples of "
                        "{step:g} s: resampled to {honest:g} s; shorter slips are lost, S and J come out too small",
                        _TRAP + "11"),
    "jitter": (INFO, "time stamps are {what}: up to {worst:.2g} % of the step of {step:.6g} s; taken as even", ""),
    "kept-by-exception": (WARNING, "{signal} is held until it changes by {deadband:.3g}, in {share:.0f} % of the "
                          "samples: kept by exception; smaller moves are gone{unless}", _TRAP + "11"),
    "manual-stretch": (INFO, _UNCOUNTED + "the controller is in manual", ""),
    "masked": (INFO, _UNCOUNTED + "the file marks them as unused", ""),
    "mode-unknown": (WARNING, "{column} has modes of unknown meaning, {listed}: samples count where OP moves; say "
                     "what they mean with --mode-map {word}=AUTO", _METHOD),
    "newest-first": (INFO, "rows stood newest first and were turned round", ""),
    "other-valve": (INFO, _UNCOUNTED + "OP drives the other valve", ""),
    "out-of-order": (WARNING, "the time steps back {times}; rows were sorted", ""),
    "output-not-percent": (WARNING, "OP runs from {low:g} to {high:g} and is not taken as % of travel: {why}; S and J "
                           "are in the unit of OP (to scale: {hint})", _METHOD),
    "output-perhaps-ma": (INFO, "OP stays within 4 to 20 (from {low:g} to {high:g}) and was taken as %: if these are "
                          "mA, S and J are 6.25 times larger (--span-op 4,20, or --span-op 0,100 if it is %)", _METHOD),
    "output-saturated": (INFO, _UNCOUNTED + "OP stands at its limit: what the valve does there says nothing about S "
                         "and J", ""),
    "output-slower": (INFO, "OP changes only every {slow:g} s, PV every {step:g} s: its controller scans every "
                      "{slow:g} s, so that no move of OP is missing; one of {every} rows was kept", ""),
    "output-sparse": (WARNING, "OP changes only every {slow:g} s, PV every {step:g} s: {why} OP was exported too "
                      "seldom and the valve's moves in between are missing; export OP as often as PV; one of {every} "
                      "rows was kept", ""),
    "oversampled": (WARNING, "all signals repeat {every} times: recorded every {step:g} s but updated every {slow:g} "
                    "s; one of {every} rows was kept", _TRAP + "13"),
    "process-value-held": (INFO, "PV changes only every {slow:g} s, OP every {step:g} s: {said}; the valve runs on by "
                           "OP", _TRAP + "15"),
    "process-value-missing": (INFO, _UNCOUNTED + "PV is missing there; the valve runs on by OP", ""),
    "quantised": (WARNING, "{signal} moves in steps of {resolution:.4g} over a range of {span:.4g}: S and J are known "
                  "no more finely than that, unless the law of the controller gives back its digits", ""),
    "re-ranged": (SERIOUS, "PV jumps by a factor of {factor:.4g} at sample {sample} and its noise with it: range or "
                  "unit were changed; gain, S and J mean nothing over both sides: use one only (--start or --end)", ""),
    "resampled": (INFO, "PV is recorded {every} times as often as OP; the step of OP was taken", ""),
    "seconds-dropped": (WARNING, "time stamps lost their seconds ({rows} rows a minute); rows were spread evenly over "
                        "each minute", ""),
    "setpoint-absent": (INFO, "no setpoint, and the loop runs in cascade: its setpoint is the output of its master"
                        "{listed}", _TRAP + "18"),
    "short-segments": (INFO, "{stretches} between gaps too short to use", ""),
    "start-up": (INFO, _UNCOUNTED + "PV is far from where the record is run, and on its way there or away "
                 "(--keep-startup)", ""),
    "state-as-text": (INFO, "{role}: {count:,} cells hold no number that can be used: {listed}", _TRAP + "1"),
    "swapped-roles": (SERIOUS, "{one} and {other} look swapped: {why}; S and J would be meaningless ({flags} settle "
                      "it)", _TRAP + "18"),
    "tag-offset": (WARNING, "tags are stamped apart (against PV: {listed}); they were paired by the nearest stamp, so "
                   "a dead time read from them is off by as much", _TRAP + "15"),
    "uncertain-quality": (INFO, "{rows:,} PV values are marked uncertain and were kept", ""),
    "unreadable-stamps": (WARNING, "{rows:,} {have} no time stamp that can be read ({share:.2g} %) and {be} left out; "
                          "the first, {at}, {what} (--time-format says how stamps are written)", ""),
}


def finding(code: str, evidence: dict[str, Any] | None = None, severity: str = "", *,
            caps_verdict: bool | None = None, **words: Any) -> Finding:
    """The finding of a code with the words of its statement filled in; `severity` where it is not the usual one."""
    usual, statement, source = FINDINGS[code]
    return Finding(code, severity or usual, statement.format(**words), evidence or {}, source=source,
                   caps_verdict=caps_verdict)
