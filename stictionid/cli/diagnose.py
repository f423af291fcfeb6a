"""`stictionid diagnose` and `stictionid add`: the effect that is missing, and the study with it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from .app import app
from .common.output import (
    ForceOption,
    JobsOption,
    JsonOption,
    Progress,
    QuietOption,
    SeedOption,
    cores,
    number,
    out_console,
    plain_table,
    print_json,
    safe,
    say,
)
from .common.policy import BudgetOption, PolicyOption, policy_of
from .common.study_files import DataArgument, StudyArgument, open_data, open_study
from .common.tree import print_equivalents, print_tree

# Characters for a name in the ladder at 80 columns.
_NAME = 19


@app.command()
def diagnose(
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    apply: Annotated[bool, typer.Option("--apply", help="Add what is accepted and repeat until nothing is.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Refit the catalogue even when the model is adequate.")]
    = False,
    jobs: JobsOption = None,
    bootstrap: Annotated[int, typer.Option("--bootstrap", min=0, max=100_000, metavar="N", help="Replicates for a "
                                           "p-value of the named effect, 99 or more; about half a second each.")] = 0,
    policy: PolicyOption = None, budget: BudgetOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Rank the physical effects that the model may be missing, and name the one to add next.

    Example: stictionid diagnose study.json
    """
    from ..system.files import ensure_writable
    from ..verbs.diagnose import diagnose as run

    steered = policy_of(policy, budget)
    if output is not None:
        ensure_writable(output, force=force, kind=b"{")
    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = run(loop, before, everything=everything, apply=apply, seed=seed, jobs=jobs or cores(),
                    bootstrap=bootstrap, policy=steered, progress=progress)
    _write(after, output or study, force, quiet)
    if as_json:
        print_json(after)
        return
    console = out_console()
    if after.candidates:
        console.print(_candidates(after))
    print_tree(after, console)
    for c in after.candidates:
        if c.accepted:
            console.print(safe(c.statement))
    if len(after.steps) > 1:
        console.print(_ladder(after))
    if after.missing:
        console.print(("added: " if apply else "missing: ") + ", ".join(after.missing))
    else:
        console.print("missing: nothing" + (f", {after.adequate_reason}" if after.adequate else
                                            "; nothing in the catalogue helps enough"))
    if after.missing_reason:
        console.print(safe(after.missing_reason))
    print_equivalents(after, console)
    for step in after.steps[-1:]:
        for f in step.findings:
            if f.code in ("better-optimum", "gave-way", "rounded-output"):
                say(f"{f.severity}: {f.statement}", quiet=quiet)
    if after.missing and not apply:
        say(f"next: stictionid add {after.missing[0]} {output or study}", quiet=quiet)


@app.command()
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="Name of an effect; see stictionid effects.")],
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    prune: Annotated[bool, typer.Option("--prune", help="Leave out earlier effects that it makes superfluous.")]
    = False,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Refit the model with one more effect, and show the error before and after.

    Example: stictionid add extra-lag study.json
    """
    from ..effects import parse
    from ..system.files import ensure_writable
    from ..verbs.add import add as run

    parse(effect)
    if output is not None:
        ensure_writable(output, force=force, kind=b"{")
    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = run(loop, before, effect, seed=seed, prune=prune, progress=progress)
    _write(after, output or study, force, quiet)
    if as_json:
        print_json(after)
        return
    console = out_console()
    console.print(_ladder(after))
    for f in after.steps[-1].findings:
        if f.code in ("superfluous", "pruned", "entering-elsewhere"):
            console.print(f"{f.severity}: {safe(f.statement)}")


def _write(study: Any, place: Path, force: bool, quiet: bool) -> None:
    from ..record.study import to_json
    from ..system.files import write_whole

    write_whole(place, to_json(study), force=force, kind=b"{")
    say(f"wrote {place}", quiet=quiet)


def _candidates(study: Any) -> Any:
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


def _short(size: str | None) -> str:
    """A smallest size without its parameter's name, which the JSON has."""
    if not size:
        return "-"
    for word, sign in (("from", ">"), ("down to", "<")):
        if f" {word} " in size:
            return f"{sign} {size.partition(f' {word} ')[2]}"
    return size


def _ladder(study: Any) -> Any:
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
