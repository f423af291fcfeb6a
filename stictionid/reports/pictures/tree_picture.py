"""Picture of a search: each model tried at its error, joined to the model that it was made from.

The error falls to the left, down to the noise. The rows are those of the text tree, best first.
"""

from __future__ import annotations

from ...record.study import Study
from ...record.tree import TreeNode
from ...system.plurals import counted
from .. import wording
from ..tree_text import Shown, tree_of
from .picture import Branch, Panel, Picture, Rule

# Nodes that the picture shows; the JSON has all of them. Unit: rows.
_MOST_NODES = 18
# Dead ends that the text alternative gives with their reason.
_IN_WORDS = 3
# Role and name of each status.
_LOOKS = {"named": ("optimum", "path of the answer"), "equivalent": ("position", "explains the record alike"),
          "expanded": ("pv", "expanded")}
_DEAD_END = ("guide", "dead end")


def tree(study: Study) -> Picture | None:
    """The search as a picture; None without a tree, or where no model has an error."""
    found = tree_of(study, _MOST_NODES)
    if found is None or not any(_error(s.node) for s in found.shown):
        return None
    noise = study.steps[-1].error.noise_sd if study.steps else None
    unit = wording.name(study.data.units.get("process_value") or "units of PV")
    branches = _branches(found.shown, noise, unit)
    rules = (Rule("x", noise, "noise", "bound"),) if noise else ()
    left_out = f" {wording.count(found.more)} more models are in the JSON." if found.more else ""
    return Picture("tree", "Models tried", _alt(study, found.shown, unit),
                   "Each dot is a model at its error beside its noise model; a line leads from the model that it was "
                   "made from, with the effect added (+), dropped (-) or the structure swapped (~). The text below, "
                   f"and the pointer on a dot, say why a search went no further there.{left_out}",
                   (Panel(f"error beside its noise model, {unit}", "", rules=rules, log_x=True, branches=branches),),
                   wide=True)


def _branches(shown: tuple[Shown, ...], noise: float | None, unit: str) -> tuple[Branch, ...]:
    """One row for each node; a node without an error is put below its parent."""
    any_error = next(e for s in shown if (e := _error(s.node)))
    places: dict[int, tuple[float, int]] = {}
    made = []
    for row, s in enumerate(shown):
        from_x, from_row = places.get(s.parent, (None, row)) if s.parent is not None else (None, row)
        x = _error(s.node) or from_x or any_error
        places[s.node.id] = (x, row)
        role, kind = _LOOKS.get(s.node.status, _DEAD_END)
        times = f", {wording.number(s.node.rmse / noise)} times the noise" if s.node.rmse and noise else ""
        error = "no error" if s.node.rmse is None else \
            f"error beside its noise model {wording.with_unit(s.node.rmse, unit)}{times}"
        made.append(Branch(x if from_x is None else from_x, from_row, x, row, s.label,
                           "; ".join(w for w in (s.label, error, s.words) if w), role, kind))
    return tuple(made)


def _error(node: TreeNode) -> float | None:
    """The error of a node where a logarithmic axis can show it."""
    return node.rmse if node.rmse and node.rmse > 0 else None


def _alt(study: Study, shown: tuple[Shown, ...], unit: str) -> str:
    """The path of the answer and what stopped the rest, in words."""
    some = counted(len(study.tree), "model")
    named = [s for s in shown if s.node.status == "named"]
    steps = [f"{s.label} with an error beside its noise model of {wording.with_unit(s.node.rmse, unit)}" for s in named]
    path = f" The answer: {', then '.join(steps)}." if steps else " None of them is the answer."
    dead = [s for s in shown if s.node.status in ("rejected", "failed") and s.words]
    rest = f" Not taken: {'; '.join(f'{s.label} ({s.words})' for s in dead[:_IN_WORDS])}." if dead else ""
    return f"{some} tried.{path}{rest} The text below has the same tree."

