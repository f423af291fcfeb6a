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
    """Effects that were asked for, best first."""
    table = plain_table("effect", "named", "drop %", "BIC", "would show", title="candidates")
    # The name is never broken: the numbers are narrow, and the last column may be broken.
    table.columns[0].no_wrap = True
    same = study.candidates[0].equivalent_to
    for c in study.candidates:
        named = "yes" if c.accepted else "alike" if c.effect in same else "no"
        table.add_row(safe(c.effect + (f"@{c.variant}" if c.variant else "")), named,
                      number(c.one_step_drop_percent, "", 3), number(c.delta_bic, "", 4),
                      safe(_short(c.detectable_from)))
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


def _short(size: str | None) -> str:
    """A smallest size without its parameter's name, which the JSON has."""
    if not size:
        return "-"
    for word, sign in (("from", ">"), ("down to", "<")):
        if f" {word} " in size:
            return f"{sign} {size.partition(f' {word} ')[2]}"
    return size


def ladder_table(study: Any) -> Any:
    """Errors, S and J of every step."""
    table = plain_table("model", "error", "held out", "one step", "noise", "S", "J", title="ladder")
    for step in study.steps:
        values = {p.name: p.value for p in step.parameters if p.effect is None}
        name = f"+ {safe(step.added)}" + (f" @{safe(step.variant)}" if step.variant else "") if step.added else "base"
        table.add_row(_broken(name), number(step.error.rmse),
                      number(step.error.rmse_holdout), number(step.error.rmse_one_step), number(step.error.noise_sd),
                      number(values.get("S")), number(values.get("J")))
    return table


def _broken(name: str) -> str:
    """A long name in two lines, broken after a hyphen: seven columns leave a name no more room in 80."""
    head, mark, rest = name.partition("-")
    return f"{head}{mark}\n  {rest}" if len(name) > _NAME else name
