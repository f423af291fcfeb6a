"""Tables of a study on a terminal, its ladder, ranking and tree, its answer in words and as exit code; its file."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import typer

from ...system.files import write_whole
from .output import can_write, number, plain_table, safe, say

# Characters for a name in the ladder at 80 columns.
_NAME = 19
# Most effects of a ranking without --details.
_RANKED = 12


def write_study(study: Any, place: Path, force: bool, quiet: bool) -> None:
    """Write study.json whole, and say so."""
    from ...record.study import to_json

    write_whole(place, to_json(study), force=force, kind=b"{")
    say(f"wrote {place}", quiet=quiet)


def leave(study: Any, strict: bool) -> None:
    """Exit with 3 from a study that abstained, and if `strict` with 4 from one that is undecided or not adequate."""
    if study.estimate is None:
        raise typer.Exit(3)
    if strict and (study.verdict.stiction == "undecided" or not study.adequate):
        raise typer.Exit(4)


def print_ranking(study: Any, console: Any, *, whole: bool) -> None:
    """The effects asked for, best first, without the size that would have shown: the first or the `whole` of them."""
    from ...reports.ranking import table as ranking

    if not study.candidates:
        return
    found = ranking(study)
    shown = found.rows if whole else found.rows[:_RANKED]
    table = plain_table(*(name.removesuffix(" beyond noise") for name in found.columns[:-1]), title="effects asked",
                        rows=[[safe(cell) for cell in row[:-1]] for row in shown])
    table.columns[0].no_wrap, table.columns[-1].justify = True, "left"
    console.print(table)
    if len(shown) < len(found.rows):
        console.print(f"and {len(found.rows) - len(shown)} more: --details")
    console.print("gain: BIC over the best model without the effect; 20 name an effect, 10 a lag or a rest")
    console.print("error: free run of a model fitted beside its noise model; one fitted without may err less")


def print_answer(study: Any, console: Any, *, applied: bool, before: Any = None) -> None:
    """The effects named with their numbers, or what else the search found."""
    from ...reports.answer import answers

    for line in answers(study, applied=applied, before=before):
        console.print(safe(line))


def print_table(table: Any, console: Any) -> None:
    """A table of a report, on a terminal."""
    console.print(plain_table(*map(safe, table.columns), title=table.caption,
                              rows=[[safe(cell) for cell in row] for row in table.rows]))


def print_change(before: Any, after: Any, console: Any) -> None:
    """Error, S, J and verdict before and after a change of the model."""
    from ...reports.answer import change

    print_table(change(before, after), console)


def ladder_table(study: Any) -> Any:
    """Errors, S and J of every step."""
    table = plain_table("model", "error", "held out", "one step", "noise", "S", "J", title="ladder")
    for step in study.steps:
        values = {p.name: p.value for p in step.parameters if p.effect is None}
        name = f"+ {safe(step.added)}" + (f" @{safe(step.variant)}" if step.variant else "") if step.added else "base"
        table.add_row(_broken(name), number(step.error.best), held_out_words(step), number(step.error.rmse_one_step),
                      number(step.error.noise_sd), number(values.get("S")),
                      number(values.get("J")) if study.estimate is None or study.estimate.J_known else "unknown")
    return table


def held_out_words(step: Any) -> str:
    """The held-out error of a step in a table."""
    return "extrapolates" if step.extrapolates else number(step.error.rmse_holdout)


def _broken(name: str) -> str:
    """A long name in two lines, broken after a hyphen: seven columns leave a name no more room in 80."""
    head, mark, rest = name.partition("-")
    return f"{head}{mark}\n  {rest}" if len(name) > _NAME else name


def print_tree(study: Any, console: Any) -> None:
    """Print the models tried, best first, then the cost evaluations and what was not asked; nothing without a tree.

    The branches are plain ASCII where stdout is no terminal, or one whose encoding lacks them.
    """
    from ...reports.tree_text import after_tree, tree_lines

    draws = can_write("├─│└…", console.encoding)
    lines = tree_lines(study, plain=not (sys.stdout.isatty() and draws), width=console.width)
    if lines:
        console.print("models tried", style="bold")
    for line in lines:
        console.print(safe(line if draws else line.replace("…", ".")), no_wrap=True, overflow="ignore", crop=False)
    said = after_tree(study)
    if said:
        console.print(said)


def print_plan(study: Any, console: Any) -> None:
    """Print the planned test in words; nothing where there is none."""
    from ...reports.test_plan import sentences

    for i, sentence in enumerate(sentences(study)):
        console.print(safe(sentence if i else f"test: {sentence}"))


def print_equivalents(study: Any, console: Any) -> None:
    """Print one sentence for each model that explains the record alike."""
    from ...reports.tree_text import equivalents

    for said in equivalents(study):
        console.print(safe(said))
