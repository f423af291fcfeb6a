"""Options that several commands share, each with one help text, and the policy that two of them ask for."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ...errors import UsageError
from ...selection.policy import Policy, read_policy, with_budget
from .completion import effect_names, law_names

MOST_JOBS = 512
"""Processes that can be asked for: each takes 200 MB, and all may be started at once."""


def _seed(value: int) -> int:
    if value < 0:
        raise UsageError(f"--seed {value} is negative", "give a whole number, 0 or more")
    return value


JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout, nothing else there.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress, findings or hints on stderr.")]
ForceOption = Annotated[bool, typer.Option("--force", help="Replace an existing file of another kind.")]
SeedOption = Annotated[int, typer.Option("--seed", callback=_seed,
                                         help="Seed of everything random; same seed, same bytes.")]
JobsOption = Annotated[int | None, typer.Option("--jobs", min=1, max=MOST_JOBS,
                                                help="Processes; as many as there are cores.")]
PolicyOption = Annotated[Path | None, typer.Option("--policy", metavar="FILE.toml",
                                                   help="Numbers of the search over models, one entry a line.")]
BudgetOption = Annotated[int | None, typer.Option("--budget", metavar="N", show_default=False,
                                                  help="Cost evaluations after which the search stops, 1 or more.")]
LawOption = Annotated[str | None, typer.Option("--law", autocompletion=law_names, show_default="chen",
                                               help="Stiction law, see stictionid laws.")]
WithOption = Annotated[list[str] | None, typer.Option(
    "--with", metavar="EFFECT", autocompletion=effect_names,
    help="Put an effect into the model from the start; repeatable.")]
BaseOnlyOption = Annotated[bool, typer.Option("--base-only", help="Stop at the base model.")]
NoIntervalsOption = Annotated[bool, typer.Option(
    "--no-intervals", help="Leave intervals out: S, J and the process alone, in less time.")]
BetweenOption = Annotated[str, typer.Option("--between", help="What the output did between samples: as identify.")]
ScanOption = Annotated[float, typer.Option("--scan", metavar="SECONDS", help="Scan of the controller: as identify.")]
StrictOption = Annotated[bool, typer.Option("--strict", help="Exit 4 when undecided or the model is not adequate.")]
FiguresOption = Annotated[str, typer.Option("--figures", help="Pictures beside markdown: svg or png.")]
ChangedOption = Annotated[Path | None, typer.Option("--output", "-o", help="Write here instead of in place.")]


def policy_of(file: Path | None, budget: int | None) -> Policy | None:
    """The policy that the two options ask for, None where neither is given; the budget option goes before the file."""
    if file is None and budget is None:
        return None
    policy = Policy() if file is None else read_policy(file)
    return policy if budget is None else with_budget(policy, budget)
