"""The options `--policy` and `--budget`, shared by the commands that search over models."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ...selection.policy import Policy

PolicyOption = Annotated[Path | None, typer.Option("--policy", metavar="FILE.toml",
                                                   help="Numbers of the search over models, one entry a line.")]
BudgetOption = Annotated[int | None, typer.Option("--budget", metavar="N", show_default=False,
                                                  help="Cost evaluations after which the search stops, 1 or more.")]


def policy_of(file: Path | None, budget: int | None) -> Policy | None:
    """The policy that the two options ask for, None where neither is given; the budget option goes before the file."""
    if file is None and budget is None:
        return None
    from ...selection.policy import Policy, read_policy, with_budget

    policy = Policy() if file is None else read_policy(file)
    return policy if budget is None else with_budget(policy, budget)
