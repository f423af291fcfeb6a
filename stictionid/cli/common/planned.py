"""Options of the planned test: limits of OP and PV, and the file of its steps."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ...errors import UsageError
from ...record.planned_test import CSV_HEAD
from ...system.files import write_whole
from .output import safe, say
from .reading import span

_PANEL = "Planned test"
OpLimits = Annotated[str | None, typer.Option("--op-limits", metavar="LO,HI", rich_help_panel=_PANEL,
                                              help="OP that a manual test may use, in the unit of OP.")]
PvLimits = Annotated[str | None, typer.Option("--pv-limits", metavar="LO,HI", rich_help_panel=_PANEL,
                                              help="PV that a manual test may reach, in the unit of PV.")]
TestCsv = Annotated[Path | None, typer.Option("--test-csv", metavar="FILE", rich_help_panel=_PANEL,
                                              help="Write the steps of the planned test as CSV.")]


def limits_of(op_limits: str | None, pv_limits: str | None) -> dict[str, tuple[float, float] | None]:
    """Both limits as arguments of `with_plan`; UsageError for a text that is no range."""
    said = {"op_limits": (op_limits, "--op-limits"), "pv_limits": (pv_limits, "--pv-limits")}
    return {name: None if text is None else span(text, flag) for name, (text, flag) in said.items()}


def print_plan(study: Any, console: Any) -> None:
    """The planned test in words; nothing where there is none."""
    from ...reports.test_plan import sentences

    for i, sentence in enumerate(sentences(study)):
        console.print(safe(sentence if i else f"test: {sentence}"))


def write_steps(study: Any, place: Path, *, force: bool, quiet: bool) -> None:
    """Write the steps of the planned test whole; UsageError for a study without one."""
    plan = study.planned_test
    if plan is None or not plan.moves:
        raise UsageError(f"there is no test to write to {place}: {plan.reason if plan else 'no answer is open'}",
                         "give wider --op-limits and --pv-limits" if plan else "leave --test-csv out")
    write_whole(place, plan.csv, force=force, kind=CSV_HEAD.encode())
    say(f"wrote {place}", quiet=quiet)
