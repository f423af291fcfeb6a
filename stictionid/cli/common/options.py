"""Options that several commands share, each with one help text, and the policy and the limits that they ask for."""

from __future__ import annotations

import importlib
import os
from pathlib import Path
from typing import Annotated

import typer

from ...errors import UsageError
from ...selection.policy import Policy, read_policy, with_budget
from .completion import effect_names, law_names
from .reading import span

MOST_JOBS = 512
"""Processes that can be asked for: each takes 200 MB, and all may be started at once."""


def _seed(value: int) -> int:
    if value < 0:
        raise UsageError(f"--seed {value} is negative", "give a whole number, 0 or more")
    return value


def _load(context: typer.Context, option: typer.CallbackParam, places: list[Path] | None) -> list[Path] | None:
    """Add the entries of files and folders to the catalogue that an option names, and name them to worker processes."""
    if not places or context.resilient_parsing:
        return places  # the catalogues take a second to load, which help and completion do without
    room = importlib.import_module(f"stictionid.{option.opts[0].removeprefix('--')}")
    room.use(places)
    # Workers that are spawned read them from the environment, the only place they share with this process.
    have = os.environ.get(room.VARIABLE, "")
    os.environ[room.VARIABLE] = os.pathsep.join([*([have] if have else []), *(str(p.resolve()) for p in places)])
    return places


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
EffectsOption = Annotated[list[Path] | None, typer.Option(
    "--effects", metavar="FILE|FOLDER", callback=_load, is_eager=True, show_default=False,
    help="User-written effects, Python files; repeatable. Their code is run.")]
LawsOption = Annotated[list[Path] | None, typer.Option(
    "--laws", metavar="FILE|FOLDER", callback=_load, is_eager=True, show_default=False,
    help="User-written stiction laws, Python files; repeatable. Their code is run.")]
_TEST = "Planned test"
OpLimits = Annotated[str | None, typer.Option("--op-limits", metavar="LO,HI", rich_help_panel=_TEST,
                                              help="OP that a manual test may use, in the unit of OP.")]
PvLimits = Annotated[str | None, typer.Option("--pv-limits", metavar="LO,HI", rich_help_panel=_TEST,
                                              help="PV that a manual test may reach, in the unit of PV.")]


def policy_of(file: Path | None, budget: int | None) -> Policy | None:
    """The policy that the two options ask for, None where neither is given; the budget option goes before the file."""
    if file is None and budget is None:
        return None
    policy = Policy() if file is None else read_policy(file)
    return policy if budget is None else with_budget(policy, budget)


def limits_of(op_limits: str | None, pv_limits: str | None) -> dict[str, tuple[float, float] | None]:
    """Both limits as arguments of `with_plan`; UsageError for a text that is no range."""
    said = {"op_limits": (op_limits, "--op-limits"), "pv_limits": (pv_limits, "--pv-limits")}
    return {name: None if text is None else span(text, flag) for name, (text, flag) in said.items()}
