"""Tables of a study on a terminal, its ladder and its candidates, and the study written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from .output import number, plain_table, safe, say
from .tree import print_equivalents

# Characters for a name in the ladder at 80 columns.
_NAME = 19


def write_study(study: Any, place: Path, force: bool, quiet: bool) -> None:
    """Write study.json whole, and say so."""
    from ...record.study import to_json
    from ...system.files import write_whole

    write_whole(place, to_json(study), force=force, kind=b"{")
    say(f"wrote {place}", quiet=quiet)


def candidates_table(study: Any) -> Any:
    """Effects that were asked for, ranked by what they explain beyond noise, with the reason of each answer."""
    from ...reports.ranking import table as ranking

    found = ranking(study)
    table = plain_table(*found.columns[:-1], title="candidates")
    table.columns[0].no_wrap, table.columns[-1].justify = True, "left"
    for row in found.rows:
        table.add_row(*map(safe, row[:-1]))
    return table


def print_outcome(study: Any, console: Any, *, applied: bool) -> None:
    """The ladder, the effects named, the reason, and the models that explain the record alike."""
    if len(study.steps) > 1:
        console.print(ladder_table(study))
    if study.missing:
        console.print(("added: " if applied else "missing: ") + ", ".join(study.missing))
    else:
        console.print("missing: nothing" + (f", {study.adequate_reason}" if study.adequate else
                                            "; nothing in the catalogue helps enough"))
    if study.missing_reason:
        console.print(safe(study.missing_reason))
    print_equivalents(study, console)


def ladder_table(study: Any) -> Any:
    """Errors, S and J of every step."""
    table = plain_table("model", "error", "held out", "one step", "noise", "S", "J", title="ladder")
    for step in study.steps:
        values = {p.name: p.value for p in step.parameters if p.effect is None}
        name = f"+ {safe(step.added)}" + (f" @{safe(step.variant)}" if step.variant else "") if step.added else "base"
        table.add_row(_broken(name), number(step.error.rmse),
                      number(step.error.rmse_holdout), number(step.error.rmse_one_step), number(step.error.noise_sd),
                      number(values.get("S")),
                      number(values.get("J")) if study.estimate is None or study.estimate.J_known else "unknown")
    return table


def _broken(name: str) -> str:
    """A long name in two lines, broken after a hyphen: seven columns leave a name no more room in 80."""
    head, mark, rest = name.partition("-")
    return f"{head}{mark}\n  {rest}" if len(name) > _NAME else name
