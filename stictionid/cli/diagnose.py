"""`stictionid diagnose` and `stictionid add`: which effect is missing, and the study with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from . import app
from ._shared import (
    ForceOption,
    JsonOption,
    Progress,
    QuietOption,
    SeedOption,
    number,
    out_console,
    plain_table,
    print_json,
    safe,
    say,
)
from ._study import DataArgument, StudyArgument, open_data, open_study

_SHOWN = 8


@app.command()
def diagnose(
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    apply: Annotated[bool, typer.Option("--apply", help="Add what is accepted and repeat until nothing is.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Refit the catalogue even when the model is adequate.")]
    = False,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Rank the physical effects that the model may be missing, and name the one to add next.

    Example: stictionid diagnose study.json
    """
    from ..diagnose import diagnose as run

    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = run(loop, before, everything=everything, apply=apply, seed=seed, progress=progress)
    _write(after, output or study, force, quiet)
    if as_json:
        print_json(after)
        return
    console = out_console()
    if after.candidates:
        console.print(_candidates(after))
    if len(after.steps) > 1:
        console.print(_ladder(after))
    if after.missing:
        console.print(("added: " if apply else "missing: ") + ", ".join(after.missing))
    else:
        console.print("missing: nothing" + (f", {after.adequate_reason}" if after.adequate else
                                            "; nothing in the catalogue helps enough"))
    if after.missing and not apply:
        say(f"next: stictionid add {after.missing[0]} {output or study}", quiet=quiet)


@app.command()
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="Name of an effect; see stictionid effects.")],
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Refit the model with one more effect, and show the error before and after.

    Example: stictionid add extra-lag study.json
    """
    from ..diagnose import add as run

    before = open_study(study)
    loop = open_data(before, study, file)
    after = run(loop, before, effect, seed=seed)
    _write(after, output or study, force, quiet)
    if as_json:
        print_json(after)
    else:
        out_console().print(_ladder(after))


def _write(study: Any, place: Path, force: bool, quiet: bool) -> None:
    from ..files import write_whole
    from ..results import to_json

    write_whole(place, to_json(study), force=force, kind=b"{")
    say(f"wrote {place}", quiet=quiet)


def _candidates(study: Any) -> Any:
    table = plain_table("effect", "named", "one-step drop %", "free-run drop %", "BIC gain", title="candidates")
    for c in study.candidates[:_SHOWN]:
        table.add_row(safe(c.effect), "yes" if c.accepted else "no", number(c.one_step_drop_percent, "", 3),
                      number(c.error_drop_percent, "", 3), number(c.delta_bic, "", 4))
    return table


def _ladder(study: Any) -> Any:
    table = plain_table("model", "error", "held out", "one step", "noise", "S", "J", title="ladder")
    for step in study.steps:
        values = {p.name: p.value for p in step.parameters if p.effect is None}
        table.add_row(f"+ {safe(step.added)}" if step.added else "base", number(step.error.rmse),
                      number(step.error.rmse_holdout), number(step.error.rmse_one_step), number(step.error.noise_sd),
                      number(values.get("S")), number(values.get("J")))
    return table
