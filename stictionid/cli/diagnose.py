"""`stictionid diagnose`, `add` and `remove`: the effect that is missing, the study with it, or without one."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .app import app
from .common.outcomes import outcome
from .common.output import (
    ForceOption,
    JobsOption,
    JsonOption,
    Progress,
    QuietOption,
    SeedOption,
    cores,
    out_console,
    print_json,
    safe,
    say,
)
from .common.policy import BudgetOption, PolicyOption, policy_of
from .common.study_files import DataArgument, StudyArgument, open_data, open_study
from .common.study_tables import candidates_table, ladder_table, print_outcome, write_study
from .common.tree import print_tree
from .common.user_files import EffectsOption, LawsOption

if TYPE_CHECKING:
    from ..record.study import Study


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def diagnose(
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    apply: Annotated[bool, typer.Option("--apply", help="Add what is accepted and repeat until nothing is.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Refit the catalogue even when the model is adequate.")]
    = False,
    jobs: JobsOption = None,
    bootstrap: Annotated[int, typer.Option("--bootstrap", min=0, max=100_000, metavar="N", help="Replicates for a "
                                           "p-value of the named effect, 99 or more; about half a second each.")] = 0,
    policy: PolicyOption = None, budget: BudgetOption = None, effects: EffectsOption = None, laws: LawsOption = None,
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
    write_study(after, output or study, force, quiet)
    if as_json:
        print_json(after)
        return
    console = out_console()
    if after.candidates:
        console.print(candidates_table(after))
    print_tree(after, console)
    for c in after.candidates:
        if c.accepted:
            console.print(safe(c.statement))
    print_outcome(after, console, applied=apply)
    for step in after.steps[-1:]:
        for f in step.findings:
            if f.code in ("better-optimum", "gave-way", "rounded-output"):
                say(f"{f.severity}: {f.statement}", quiet=quiet)
    if after.missing and not apply:
        say(f"next: stictionid add {after.missing[0]} {output or study}", quiet=quiet)


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="Name of an effect; see stictionid effects.")],
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    prune: Annotated[bool, typer.Option("--prune", help="Leave out earlier effects that it makes superfluous.")]
    = False, effects: EffectsOption = None, laws: LawsOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Refit the model with one more effect, show the error before and after, and judge it.

    The gates are those of diagnose: the effect is supported, not supported, or the record can't tell.

    Example: stictionid add extra-lag study.json
    """
    from ..effects import parse
    from ..system.files import ensure_writable
    from ..verbs.add import add as run
    from ..verbs.support import CODES

    parse(effect)
    if output is not None:
        ensure_writable(output, force=force, kind=b"{")
    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = run(loop, before, effect, seed=seed, prune=prune, progress=progress)
    _show_ladder(after, output or study, (*CODES, "worse", "superfluous", "gave-way"), force, quiet, as_json)


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def remove(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", help="Name of an effect that the study has.")],
    study: StudyArgument, file: DataArgument = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")] = None,
    effects: EffectsOption = None, laws: LawsOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Take one effect out of the model again, refit the others, and show the error before and after.

    Example: stictionid remove extra-lag study.json
    """
    from ..system.files import ensure_writable
    from ..verbs.remove import remove as run

    if output is not None:
        ensure_writable(output, force=force, kind=b"{")
    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = run(loop, before, effect, seed=seed, progress=progress)
    _show_ladder(after, output or study, ("removed", "gave-way"), force, quiet, as_json)


def _show_ladder(after: Study, path: Path, codes: tuple[str, ...], force: bool, quiet: bool, as_json: bool) -> None:
    """Write a study that has other steps now, and show its ladder and the findings with some codes, or its JSON."""
    from ..reports.effect_words import named_in, sentence

    write_study(after, path, force, quiet)
    if as_json:
        print_json(after)
        return
    console = out_console()
    console.print(ladder_table(after))
    if (added := after.steps[-1].added) is not None:
        console.print(safe(sentence(after, named_in(after.steps[-1]) or added)))
    for f in after.steps[-1].findings:
        if f.code in codes:
            console.print(f"{f.severity}: {safe(f.statement)}")
