"""Contract of an identification method: one new file in this folder with a constant `METHOD` is enough.

The method's `run(run)` gets everything that an identification shares: record, oscillation, options, random generator,
progress (see fit/context.py). It returns an `Outcome`: the steps of the study with the fits behind them. `identify`
adds the verdict, the comparison with a measured position, the cost map and the study for every method alike.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from ..fit.points.fitted import Fitted
from ..options import USUAL_ORDER
from ..record.intervals import Span
from ..record.study import Step, Verdict
from ..record.tree import Equivalent, TreeNode
from ..record.unexplained import Unexplained

# Options that only some methods use, and how the command line spells them.
SPELLING = {
    "law": "--law", "effects": "--with", "base_only": "--base-only", "between": "--between",
    "scan": "--scan",
    "fixed": "a fixed plant (--gain, --time-constant, --dead-time, --step-test)", "order": "--order",
    "delay": "--delay", "policy": "--policy or --budget", "test": "--test",
}


@dataclass(frozen=True, slots=True)
class Process:
    """The process as a method estimates it, where it is not the one of the free-run model; seconds, gain per %."""

    gain: float
    time_constants_s: tuple[float, ...]
    dead_time_s: float
    integrating: bool


@dataclass(frozen=True, slots=True)
class Outcome:
    """Result of a method: steps and fits of equal length, of which the last ones count.

    A method without S and J returns no steps and a `verdict` with the reason. `gives_jump` is False for a method that
    says nothing about J; the estimate then holds J = 0 and the interval 0 to S. `reach` holds the pieces of S and J
    that the equivalents do not exclude.
    """

    steps: tuple[Step, ...]
    fits: tuple[Fitted, ...]
    process: Process | None = None
    verdict: Verdict | None = None
    gives_jump: bool = True
    tree: tuple[TreeNode, ...] = ()
    evaluations: int | None = None
    unasked: tuple[str, ...] = ()
    equivalents: tuple[Equivalent, ...] = ()
    reach: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)
    missing_reason: str = ""
    unexplained: Unexplained | None = None


@dataclass(frozen=True, slots=True)
class Method:
    """One identification method: its summary, equation and source, what it cannot see, and the options that apply.

    `options` are keys of SPELLING; any other option given with this method is refused. With "policy" among them `run`
    takes the policy of the search as its second argument. `law` is its default law, and its only one where "law" is not
    among the options. `gives` names what it estimates. `restarts` marks a method that
    fits several segments of a record together; any other method gets the longest segment alone.
    """

    name: str
    summary: str
    equation: str
    source: str
    checked: str
    cannot: str
    run: Callable[..., Outcome]
    options: frozenset[str]
    law: str = "chen"
    order: int = USUAL_ORDER
    gives: tuple[str, ...] = ("S", "J")
    restarts: bool = False
