"""Tree of the models that a search tried, as frozen dataclasses: edges, gates, nodes, and models that explain alike.

`record/study.py` holds them and writes them as JSON. A number that is not finite does not exist and is dropped.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from .as_json.shape import left_out

OPERATIONS = ("root", "add", "drop", "swap")
STATUSES = ("named", "expanded", "equivalent", "rejected", "looked", "failed")


@dataclass(frozen=True, slots=True)
class Edge:
    """Difference between a node and its parent: `op` is one of OPERATIONS, `what` is the effect or the structure."""

    op: str
    what: str

    def __post_init__(self) -> None:
        if self.op not in OPERATIONS:
            raise ValueError(f"the edge {self.op!r} is none of {', '.join(OPERATIONS)}")


@dataclass(frozen=True, slots=True)
class Gate:
    """One test that a node had to pass: its name, the outcome, and the reason in words.

    A test that compares one number has its `statistic` and the `threshold` that it was compared with.
    """

    name: str
    passed: bool
    reason: str
    statistic: float | None = field(default=None, metadata=left_out())
    threshold: float | None = field(default=None, metadata=left_out())


@dataclass(frozen=True, slots=True)
class TreeNode:
    """One model that the search tried, with its fitted numbers, its errors in the unit of y and its status.

    `status` is "named" (on the path of the answer), "expanded", "equivalent", "rejected", "looked" (a first look only)
    or "failed". `structure` is a text such as "chen, first-order, hold". `noise` names the completion. `id` is unique
    in the tree; `parent` is the id of the node that the edge starts from, null for the root.
    """

    id: int
    parent: int | None
    edge: Edge
    effects: tuple[str, ...]
    structure: str
    noise: str
    parameters: dict[str, float]
    rmse: float | None
    rmse_one_step: float | None
    bic: float | None
    status: str
    gates: tuple[Gate, ...] = ()

    def __post_init__(self) -> None:
        if self.status not in STATUSES:
            raise ValueError(f"the status {self.status!r} is none of {', '.join(STATUSES)}")
        finite = {name: float(value) for name, value in self.parameters.items() if math.isfinite(value)}
        object.__setattr__(self, "parameters", finite)
        for name in ("rmse", "rmse_one_step", "bic"):
            value = getattr(self, name)
            if value is not None and not math.isfinite(value):
                object.__setattr__(self, name, None)


def drop_percent(before: float, after: float) -> float | None:
    """Fall from one error to another in %; None where the first is 0."""
    return 100.0 * (1.0 - after / before) if before else None


@dataclass(frozen=True, slots=True)
class Equivalent:
    """A model that explains the record as well as the answer does: its node, effects, S, J and BIC.

    `what_would_tell` names the data or the test that would tell it from the answer.
    """

    node: int
    effects: tuple[str, ...]
    S: float
    J: float
    bic: float
    what_would_tell: str
