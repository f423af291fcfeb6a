"""`stictionid range`: period, S_max and the cycles behind them."""

from __future__ import annotations

from typing import Any

from ..historian.bytes.options import ReadOptions
from .app import app, outcome
from .common.options import JsonOption, QuietOption
from .common.output import number, out_console, plain_table, print_json, say
from .common.reading import FileArgument, read_file, reads_file

_SHOWN = 12


@app.command("range", epilog=outcome("nothing", json="oscillating, period_s, s_max, cycles, reason"))
@reads_file
def range_(file: FileArgument, reading: ReadOptions, as_json: JsonOption = False, quiet: QuietOption = False) -> None:
    """Does the loop oscillate, how fast, and how far does the controller output swing.

    Period T is the longest whole cycle (Shang et al., Eq. 20), S_max the largest swing of the output within one (Eq.
    21): the stickband S is searched below it. Without a setpoint the mean of y is the reference.

    Example: stictionid range sample_data/foptd.csv
    """
    from ..record.oscillation import find_range, holds_start

    loop = read_file(file, reading, quiet=quiet).loop
    found = find_range(loop)
    if as_json:
        print_json(found)
        return
    console = out_console()
    console.print(_summary(found))
    if found.cycles:
        console.print(_cycles(found, holds_start(found.cycles)))
        if len(found.cycles) > _SHOWN:
            say(f"the first {_SHOWN} of {len(found.cycles)} cycles; --json lists all", quiet=quiet)


def _summary(found: Any) -> Any:
    return plain_table("what", "value", title="range", rows=(
        ("oscillating", "yes" if found.oscillating else "no"), ("because", found.reason),
        ("period T (longest)", number(found.period_s, "s")), ("period (median)", number(found.period_median_s, "s")),
        ("S_max", number(found.s_max, found.unit)), ("reference", found.reference),
        ("output reversals", str(found.reversals))))


def _cycles(found: Any, start: bool) -> Any:
    """The first cycles; a `start` that the first one holds is said."""
    rows = [(f"{i}{' (start)' if i == 1 and start else ''}", f"{cycle.start_s:.6g}", f"{cycle.period_s:.5g}",
             f"{cycle.u_swing:.4g}") for i, cycle in enumerate(found.cycles[:_SHOWN], 1)]
    return plain_table("cycle", "start s", "period s", f"swing of u {found.unit}", title="whole cycles", rows=rows)
