"""Tree of a search in words: the nodes worth showing, best first, and its lines for a terminal or a code block.

The picture of the tree shows the same nodes with the same words.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from ..record.study import Study
from ..record.tree import TreeNode
from . import wording

# Nodes that a text tree shows; the JSON has all of them. Unit: lines, where every reason is short.
MOST_NODES = 12
# Width of the text, and of its columns of error and of multiples of the noise. Unit: characters.
_WIDTH, _ERROR, _TIMES = 80, 9, 8
# Widest column of names, narrowest column of words, and the most lines of words of a node.
_LABEL, _WORDS, _MOST_LINES = 37, 20, 2
_SIGNS = {"add": "+ ", "drop": "- ", "swap": "~ ", "root": "base: "}
# Statuses in the order in which nodes are kept where not all can be shown.
_KEPT = ("named", "equivalent", "expanded", "rejected", "failed", "looked")
_GUIDES, _PLAIN_GUIDES = ("├─ ", "└─ ", "│  "), ("|- ", "`- ", "|  ")


@dataclass(frozen=True, slots=True)
class Shown:
    """One node of a tree as it is shown, in reading order; `last` says of each ancestor if it ends its siblings."""

    node: TreeNode
    parent: int | None
    last: tuple[bool, ...]
    label: str
    words: str


@dataclass(frozen=True, slots=True)
class TreeText:
    """The nodes to show in reading order, the number of those left out, and the largest gain of these in words."""

    shown: tuple[Shown, ...]
    more: int = 0
    rest: str = ""


def tree_of(study: Study, most: int = MOST_NODES) -> TreeText | None:
    """The part of a study's tree to show; None where it has none. A node is shown with all its ancestors."""
    nodes = {n.id: n for n in reversed(study.tree)}
    if not nodes:
        return None
    kept: set[int] = set()
    for node in sorted(nodes.values(), key=lambda n: (n.parent is not None, _KEPT.index(n.status), _rank(n))):
        path = {n.id for n in _upward(node, nodes)}
        if len(kept | path) <= most or not kept:
            kept |= path
    children: dict[int | None, list[TreeNode]] = {}
    for node in sorted((nodes[i] for i in kept), key=_rank):
        children.setdefault(node.parent if node.parent in kept and not _circular(node, nodes) else None,
                            []).append(node)
    hidden = [n for i, n in nodes.items() if i not in kept]
    shown = tuple(_walk(children, None, (), nodes, bool(hidden)))
    return TreeText(shown, len(hidden), _rest(hidden, nodes))


def tree_lines(study: Study, *, plain: bool = False, width: int = _WIDTH) -> tuple[str, ...]:
    """The tree as lines of at most `width` characters, a head line first; `plain` draws its branches in ASCII."""
    found = tree_of(study)
    if found is None:
        return ()
    noise = study.steps[-1].error.noise_sd if study.steps else None
    guides = _PLAIN_GUIDES if plain else _GUIDES
    above = {s.parent for s in found.shown} | ({found.shown[0].node.id} if found.more else set())
    rows = [(*_heads(s.last, guides, s.node.id in above), s.label, wording.number(s.node.rmse),
             _times(s.node.rmse, noise), s.words) for s in found.shown]
    if found.more:
        rows.append((guides[1], "   ", f"{found.more} more", "", "", found.rest))
    unit = wording.clean(study.data.units.get("process_value") or "", 8)
    room = min(max(len(head + label) for head, _, label, *_ in rows), _LABEL, width - _ERROR - _TIMES - 2 - _WORDS)
    head = f"{'model':<{room}}{'error':>{_ERROR}}{'x noise':>{_TIMES}}  beside its noise model"
    head += f", {unit}" if unit and len(head) + len(unit) + 2 <= width else ""
    lines = [head.rstrip()]
    for first, next_head, label, error, times, words in rows:
        folded = _folded(words, max(width - room - _ERROR - _TIMES - 2, _WORDS))
        name = first + wording.clean(label, max(room - len(first), 8))
        lines.append(f"{name:<{room}}{error:>{_ERROR}}{times:>{_TIMES}}  {folded[0]}".rstrip())
        lines += [f"{next_head:<{room + _ERROR + _TIMES}}  {more}" for more in folded[1:]]
    return tuple(lines)


def after_tree(study: Study) -> str:
    """Cost evaluations and what was not asked, in one sentence; empty where the study has neither."""
    parts = [f"{wording.count(study.evaluations)} cost evaluations"] if study.evaluations is not None else []
    parts += ["not asked: " + ", ".join(map(wording.name, study.unasked))] if study.unasked else []
    return "; ".join(parts)


def equivalents(study: Study) -> tuple[str, ...]:
    """One sentence for each model that explains the record alike: its effects, S, J, and what would tell it apart."""
    unit = study.estimate.unit if study.estimate is not None else "%"
    said = []
    for e in study.equivalents:
        name = wording.listed([wording.name(effect) for effect in e.effects]) or "the base model"
        tell = f"; what would tell them apart: {wording.clean(e.what_would_tell)}" if e.what_would_tell else ""
        said.append(f"explained alike by {name}: S {wording.with_unit(e.S, unit)}, J {wording.with_unit(e.J, unit)}"
                    + tell)
    return tuple(said)


def label_of(node: TreeNode) -> str:
    """The edge that leads to a node as a sign and a name, such as "+ travel-limit"; its structure for the root."""
    return _SIGNS[node.edge.op] + wording.name(node.structure if node.edge.op == "root" else node.edge.what)


def _rank(node: TreeNode) -> tuple[bool, bool, bool, float, float, int]:
    """Named first, then fitted in full, then a first look, then failed; the better BIC first."""
    return (node.status != "named", node.status == "failed", node.status == "looked",
            float("inf") if node.bic is None else node.bic, float("inf") if node.rmse is None else node.rmse, node.id)


def _upward(node: TreeNode, nodes: dict[int, TreeNode]) -> Iterator[TreeNode]:
    """The node and its ancestors; it ends where a parent is absent or met before."""
    seen: set[int] = set()
    at: TreeNode | None = node
    while at is not None and at.id not in seen:
        seen.add(at.id)
        yield at
        at = nodes.get(at.parent) if at.parent is not None else None


def _circular(node: TreeNode, nodes: dict[int, TreeNode]) -> bool:
    """True where the ancestors of a node lead back to it and it is the first of them: a damaged tree has no root."""
    path = list(_upward(node, nodes))
    back = path[-1].parent in {n.id for n in path}
    return back and node.id == min(n.id for n in path)


def _walk(children: dict[int | None, list[TreeNode]], parent: int | None, last: tuple[bool, ...],
          nodes: dict[int, TreeNode], more: bool) -> Iterator[Shown]:
    """Nodes in reading order, those of a deep tree too; `more` says that a line follows the children of the root."""
    waiting = [(node, parent, last) for node in reversed(children.get(parent, []))]
    while waiting:
        node, above, flags = waiting.pop()
        yield Shown(node, above, flags, label_of(node), _words(node, _gain(node, nodes)))
        below = children.get(node.id, [])
        waiting += [(child, node.id, (*flags, k == len(below) - 1 and not (more and not flags)))
                    for k, child in reversed(list(enumerate(below)))]


def _heads(last: tuple[bool, ...], guides: Sequence[str], parent: bool) -> tuple[str, str]:
    """The branches before a node's name, and those before the next line of its words; `parent` has nodes below it."""
    below = guides[2] if parent else ""
    if not last:
        return "", below
    above = "".join("   " if ended else guides[2] for ended in last[:-1])
    return above + guides[1 if last[-1] else 0], above + ("   " if last[-1] else guides[2]) + below


def _gain(node: TreeNode, nodes: dict[int, TreeNode]) -> float | None:
    parent = nodes.get(node.parent) if node.parent is not None else None
    return None if parent is None or parent.bic is None or node.bic is None else parent.bic - node.bic


def _words(node: TreeNode, gain: float | None) -> str:
    """The status of a node in words, with the reason of the first gate that it failed."""
    failed = next((wording.clean(g.reason) or wording.name(g.name) for g in node.gates if not g.passed), "")
    if node.status == "named":
        if gain is None:
            return "" if node.parent is None else "named"
        return f"named: {gain:,.0f} BIC over its parent" if gain >= 0 else f"named: {-gain:,.0f} BIC under its parent"
    if node.status == "looked":
        return "first look only"
    if node.status == "equivalent":
        return "explains the record alike"
    if node.status == "rejected":
        return failed or "rejected"
    return node.status + (f": {failed}" if failed else "")


def _rest(hidden: Sequence[TreeNode], nodes: dict[int, TreeNode]) -> str:
    """Largest gain of the nodes left out, in words."""
    gains = [gain for n in hidden if (gain := _gain(n, nodes)) is not None]
    if not gains:
        return ""
    return "no better than its parent" if max(gains) < 1 else f"at most {max(gains):,.0f} BIC over its parent"


def _times(rmse: float | None, noise: float | None) -> str:
    return f"{wording.times(rmse, noise)} x" if rmse is not None and noise else ""


def _folded(words: str, room: int) -> list[str]:
    """Words in at most _MOST_LINES lines of `room` characters, the last one cut."""
    lines = textwrap.wrap(words, room) or [""]
    if len(lines) > _MOST_LINES:
        lines = [*lines[:_MOST_LINES - 1], " ".join(lines[_MOST_LINES - 1:])]
        lines[-1] = lines[-1][:room - 1] + "…"
    return lines
