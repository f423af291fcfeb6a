"""`stictionid diagnose`, `add` and `remove`: the effect that is missing, the study with it, or without one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .app import app, outcome
from .common.completion import effect_names
from .common.next_step import next_step, remove_step
from .common.options import (
    BudgetOption,
    ChangedOption,
    EffectsOption,
    ForceOption,
    JobsOption,
    JsonOption,
    LawsOption,
    OpLimits,
    PolicyOption,
    PvLimits,
    QuietOption,
    SeedOption,
    limits_of,
    policy_of,
)
from .common.output import Progress, cores, out_console, print_json, safe, say
from .common.study_files import DataArgument, StudyArgument, check_study_place, open_data, open_study
from .common.study_tables import (
    print_answer,
    print_change,
    print_equivalents,
    print_plan,
    print_ranking,
    print_tree,
    write_study,
)

if TYPE_CHECKING:
    from rich.console import Console

    from ..record.study import Step, Study


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def diagnose(
    study: StudyArgument, file: DataArgument = None,
    output: ChangedOption = None,
    apply: Annotated[bool, typer.Option("--apply", help="Add what is accepted and repeat until nothing is.")] = False,
    everything: Annotated[bool, typer.Option("--all", help="Refit the catalogue even when the model is adequate.")]
    = False,
    jobs: JobsOption = None,
    bootstrap: Annotated[int, typer.Option("--bootstrap", min=0, max=100_000, metavar="N", help="Replicates for a "
                                           "p-value of the named effect, 99 or more; about half a second each.")] = 0,
    details: Annotated[bool, typer.Option("--details", help="Show every effect asked, the models tried, those not "
                                          "asked, and the counts of work.")] = False,
    op_limits: OpLimits = None, pv_limits: PvLimits = None,
    policy: PolicyOption = None, budget: BudgetOption = None, effects: EffectsOption = None, laws: LawsOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Rank the physical effects that the model may be missing, and name the one to add next.

    Example: stictionid diagnose study.json
    """
    from ..verbs.diagnose import diagnose as run

    steered = policy_of(policy, budget)
    before, after, place, console = _changed(
        partial(run, everything=everything, apply=apply, seed=seed, jobs=jobs or cores(), bootstrap=bootstrap,
                policy=steered), study, file, output, limits=limits_of(op_limits, pv_limits), force=force,
        as_json=as_json, quiet=quiet)
    print_answer(after, console, applied=apply, before=before)
    print_ranking(after, console, whole=details)
    if apply and after.missing:
        print_change(before, after, console)
    print_equivalents(after, console)
    print_plan(after, console)
    if details:
        print_tree(after, console)
    for step in after.steps[-1:]:
        for f in step.findings:
            if f.code in ("better-optimum", "gave-way"):
                say(f"{f.severity}: {f.statement}", quiet=quiet)
    say(f"next: {next_step(after, place, data=file, effects=effects, laws=laws, asked=True)}", quiet=quiet)


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def add(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", autocompletion=effect_names,
                                           help="Name of an effect; see stictionid effects.")],
    study: StudyArgument, file: DataArgument = None,
    output: ChangedOption = None,
    prune: Annotated[bool, typer.Option("--prune", help="Leave out earlier effects that it makes superfluous.")]
    = False, effects: EffectsOption = None, laws: LawsOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Refit the model with one more effect, show the error before and after, and judge it.

    The gates are those of diagnose: the effect is supported, not supported, or the record can't tell.

    Example: stictionid add extra-lag study.json
    """
    from ..effects import parse
    from ..reports.effect_words import named_in, sentence
    from ..verbs.add import add as run
    from ..verbs.support import CODES

    wanted, _ = parse(effect)
    before, after, place, console = _changed(partial(run, effect=effect, seed=seed, prune=prune), study, file, output,
                                             force=force, as_json=as_json, quiet=quiet)
    step = next((s for s in reversed(after.steps) if s.added == wanted.name), after.steps[-1])
    name = named_in(step)
    grew = any(f.code == "worse" for f in step.findings)
    _print_findings(step, ("worse",), console)
    console.print(safe(sentence(after, name)))
    print_change(before, after, console)
    _print_findings(step, CODES, console, "answer")
    _print_findings(step, ("superfluous",), console)
    _print_findings(after.steps[-1], ("gave-way",), console)
    said = remove_step(name, place, data=file, effects=effects, laws=laws) if grew else \
        next_step(after, place, data=file, effects=effects, laws=laws, asked=False)
    say(f"next: {said}", quiet=quiet)


@app.command(epilog=outcome("the study, in place or to -o", json="schema stictionid.study/1"))
def remove(
    effect: Annotated[str, typer.Argument(metavar="EFFECT", autocompletion=effect_names,
                                           help="Name of an effect that the study has.")],
    study: StudyArgument, file: DataArgument = None,
    output: ChangedOption = None,
    effects: EffectsOption = None, laws: LawsOption = None,
    seed: SeedOption = 0, force: ForceOption = False, as_json: JsonOption = False, quiet: QuietOption = False,
) -> None:
    """Take one effect out of the model again, refit the others, and show the error before and after.

    Example: stictionid remove extra-lag study.json
    """
    from ..verbs.remove import remove as run

    before, after, place, console = _changed(partial(run, effect=effect, seed=seed), study, file, output, force=force,
                                             as_json=as_json, quiet=quiet)
    print_change(before, after, console)
    _print_findings(after.steps[-1], ("removed", "gave-way"), console)
    say(f"next: {next_step(after, place, data=file, effects=effects, laws=laws, asked=False)}", quiet=quiet)


def _changed(change: Callable[..., Study], study: Path, file: Path | None, output: Path | None, *, force: bool,
             as_json: bool, quiet: bool, limits: Mapping[str, Any] | None = None) -> tuple[Study, Study, Path, Console]:
    """The study before and after a change, its place and a console; with `as_json` it is printed, and that is all."""
    from ..verdict.planned_test import with_plan

    if output is not None:
        check_study_place(output, force=force)
    before = open_study(study)
    loop = open_data(before, study, file)
    with Progress(quiet or as_json) as progress:
        after = with_plan(change(loop, before, progress=progress), loop, **(limits or {}))
    place = output or study
    write_study(after, place, force, quiet)
    if as_json:
        print_json(after)
        raise typer.Exit
    return before, after, place, out_console()


def _print_findings(step: Step, codes: tuple[str, ...], console: Any, word: str = "") -> None:
    """The findings of a step with some codes, one line each, led by a word or by their severity."""
    for f in step.findings:
        if f.code in codes:
            console.print(f"{word or f.severity}: {safe(f.statement)}")
