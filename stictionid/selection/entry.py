"""Memory of the nodes of the search: their best fits, edges and gates, and the order in which they are asked.

New bases are asked by free run, then the others by score. Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

from ..fit.noise.completion import stroke_score
from ..fit.starts.beside_effect import LAG, RESTING
from ..model.spec import Spec
from ..record.tree import Gate
from .gates import FREE_RUN, GAIN, Edge, chance_limit, judge_change, judge_drop, judge_edge
from .looks import Packed, Task
from .node import depth, drop_from, key, physical_effects, slips_like_rests, what_of, with_effect
from .policy import Policy
from .score import Scored

ROOT, ADD, DROP, SWAP = "root", "add", "drop", "swap"


@dataclass(slots=True)
class Entry:
    """Memory of one node: specification, best fit, parent and edge; `Memo.gates` says which gates it meets."""

    spec: Spec
    scored: Scored
    parent: str | None = None
    op: str = ROOT
    what: str = ""
    look: Packed | None = None
    # The gates met last, and the scores that they compared: the entry's, its parent's, and the last sound one's.
    gates: tuple[Gate, ...] = ()
    compared: tuple[Scored, ...] = ()
    # True for a node that the decision put in the place of one that passed.
    stands_in: bool = False
    # True where looks were taken from the node, and where they were taken along its path.
    asked: bool = False
    along: bool = False
    settled: bool = False
    # The score whose slips were all moved together already.
    moved: Scored | None = None
    failed: str = ""

    def debit(self, memo: Memo) -> float:
        """BIC taken off an entry's score before nodes are ranked.

        Slip overshoot ranks behind a resting valve that passed its gates too, unless the strokes tell them apart. Until
        its command catches up, a stem that overshot rests. Neither model holds the other, so no margin compares them.
        Source: Vuong 1989, section 5.
        """
        if not (slips := slips_like_rests(self.spec)):
            return 0.0
        rests = memo.get(key(with_effect(drop_from(self.spec, (slips,)), RESTING)))
        if rests is None or not memo.passed(rests) or \
                stroke_score(rests.scored.done, self.scored.done) >= chance_limit(memo.policy):
            return 0.0
        return memo.policy.margin + max(self.scored.done.gain_over(rests.scored.done), 0.0)

    def tentative(self, memo: Memo) -> bool:
        """True for a full fit that is no answer, but that may become one together with a further effect.

        It is a base that fails only the gate of the free run, which a missing load bends. Or it has effects that halve
        the free-run error and fails only the gate of the gain, which slips at wrong times bend.
        """
        missed = [g.name for g in memo.gates(self) if not g.passed]
        return missed == [FREE_RUN] if not depth(self.spec) else missed == [GAIN] and _halves_free_run(memo, self)

    def is_near_noise(self, parent: str, before: Scored, policy: Policy) -> bool:
        """True for a full child of a node (its key and score) that is worth another fit.

        It gains over the node, its free-run error is close to its innovations, and it was not fitted again yet. Its
        innovations are white, or it needs no noise model.
        """
        scored = self.scored
        return (self.parent == parent and scored.full and not self.settled
                and (scored.white or scored.free_run_at_noise)
                and scored.done.gain_over(before.done) >= policy.structure_margin and scored.leaves_little(policy))


class Memo(dict[str, Entry]):
    """Nodes by key, and the gates that each of them meets with the fits that the memo has now.

    So a better fit of a node, or of its parent, changes these gates at once. `blurred` is True where the output was
    computed between the samples, too.
    """

    __slots__ = ("_open", "blurred", "policy")

    def __init__(self, policy: Policy, blurred: bool = False, entries: Iterable[Entry] = ()) -> None:
        super().__init__((key(e.spec), e) for e in entries)
        self.policy, self.blurred, self._open = policy, blurred, set[str]()

    def passed(self, entry: Entry) -> bool:
        """True for a full fit that passes every gate; a root meets none. It has not passed while its gates are asked.
        """
        return entry.scored.full and key(entry.spec) not in self._open and all(g.passed for g in self.gates(entry))

    def gates(self, entry: Entry) -> tuple[Gate, ...]:
        """Gates of an entry, met anew where a score that they compare was replaced; a stand-in and a root meet none."""
        parent = self.get(entry.parent or "")
        if entry.stands_in or entry.op == ROOT:
            return ()
        if parent is None or entry.failed or not entry.scored.full:
            return entry.gates
        self._open.add(key(entry.spec))
        edge = self.edge(parent, entry.what, entry.scored)
        self._open.discard(key(entry.spec))
        compared = edge.child, edge.parent, edge.sound or edge.parent
        known = entry.compared or (compared if entry.gates else ())  # (a tree keeps gates, not what they compared)
        if [*map(id, known)] != [*map(id, compared)]:
            entry.gates = {ADD: judge_edge, DROP: judge_drop}.get(entry.op, judge_change)(edge)
        entry.compared = compared
        return entry.gates

    def edge(self, parent: Entry, name: str, child: Scored) -> Edge:
        """The edge from a node to a child of a name and a score."""
        return Edge(name, child, parent.scored, self.policy, self.blurred, self.last_passed(parent).scored)

    def last_passed(self, entry: Entry) -> Entry:
        """The nearest ancestor that passes every gate, or the entry itself."""
        return next(filter(self.passed, self._lineage(entry)), entry)

    def _lineage(self, entry: Entry) -> Iterator[Entry]:
        """An entry, its parent, and so on; two that are parents of each other come once."""
        met: set[str] = set()
        found: Entry | None = entry
        while found is not None and key(found.spec) not in met:
            yield found
            met.add(key(found.spec))
            found = self.get(found.parent or "")


def new_entry(parent: Entry, task: Task, scored: Scored, look: Packed | None = None) -> Entry:
    """The entry of the node that a task leads to from its parent."""
    return Entry(task.spec, scored, key(parent.spec), ADD if task.added else SWAP,
                 task.added or what_of(task.spec, parent.spec), look=look)


def failed_entry(parent: Entry, task: Task, answer: Packed) -> Entry:
    """The entry of an edge whose fit failed, with the score of its parent, which is none of its own."""
    return replace(new_entry(parent, task, replace(parent.scored, full=False)), failed=answer.failed,
                   gates=(Gate("fit", False, answer.failed),))


def remember(memo: Memo, parent: Entry, task: Task, answer: Packed, scored: Scored) -> None:
    """Put an answer in the memo where it is better than the fit that its node has there.

    A look never replaces a full fit, and of two looks one whose free run is clearly better may lie in another basin. A
    node that passed its gates keeps the edge by which it passed.
    """
    name, known, policy = key(task.spec), memo.get(key(task.spec)), memo.policy
    if known is not None and not known.failed:
        gain = scored.done.gain_over(known.scored.done)
        freer = scored.least_rmse**2 * policy.better_base < known.scored.least_rmse**2
        if known.scored.full:
            if not scored.full:
                return
            if gain <= 0.0 or (known.op != DROP and memo.passed(known)):
                if gain > (policy.better_fit if known.op == ROOT else 0.0):
                    known.scored, known.look = scored, answer
                return
        elif not scored.full and gain <= 0.0 and not freer:
            return
    memo[name] = replace(new_entry(parent, task, scored, answer), asked=known is not None and known.asked)


def children_of(memo: Memo, entry: Entry) -> list[Entry]:
    """The children of a node whose fit did not fail."""
    return [e for e in memo.values() if e.parent == key(entry.spec) and not e.failed]


def rank_entries(memo: Memo, *, tentative: bool = False) -> list[Entry]:
    """The entries that pass all gates, and with `tentative` also the tentative ones, best BIC first."""
    entries = [e for e in memo.values() if memo.passed(e) or (tentative and e.tentative(memo))]
    reference = entries[0].scored.done
    gains = {key(e.spec): e.scored.done.gain_over(reference) - e.debit(memo) for e in entries}
    return sorted(entries, key=lambda e: -gains[key(e.spec)])


def nodes_to_ask(memo: Memo, *, only_some: bool) -> list[Entry]:
    """The nodes to expand next, in order: new bases by free-run error, then the others by BIC.

    While an effect is missing, an autoregression hides which base is right; the free-run error shows it. Structure
    changes that do not help alone are expanded last: one may help together with an effect. They are left out where the
    search may use `only_some` effects of the catalogue.
    """
    whole = [e for e in rank_entries(memo, tentative=True) if depth(e.spec) < memo.policy.depth]
    queue = [e for e in whole if not e.asked]
    if queue and queue[0].scored.only_noise(memo.policy):
        return queue[:1]
    free = [e for e in queue if depth(e.spec) and _halves_free_run(memo, e)]
    if free or (queue and depth(queue[0].spec) and queue[0].scored.leaves_little(memo.policy)):
        return [*free, *(e for e in queue if e not in free)]  # (no missing effect hides a base)
    unasked = [e for e in memo.values() if not e.asked and not e.failed and not depth(e.spec)]
    bases = [e for e in unasked if e.scored.full
             and ((not only_some and e is whole[0]) or better_base(memo, e))]
    least = min((e.scored.rmse for e in bases), default=0.0)
    # Bases with similar free-run errors are ordered by BIC. Under a random walk the free-run error tells nothing.
    bases.sort(key=lambda e: (e.scored.rmse > 2 * least and not e.scored.done.increments, _bic(e)))
    found = [*bases, *(e for e in queue if depth(e.spec) > 0)]
    return found or ([] if only_some else sorted(unasked, key=_bic))


def _halves_free_run(memo: Memo, entry: Entry) -> bool:
    """True where the free run of an entry is half of that of every base, or less."""
    bases = [e.scored.rmse for e in memo.values() if not depth(e.spec) and e.scored.full]
    return 2 * entry.scored.rmse <= min(bases, default=0.0)


def better_base(memo: Memo, entry: Entry) -> bool:
    """True for a root, and for a node whose free run is clearly better than that of its parent and of asked bases."""
    before = memo.get(entry.parent or "")
    if before is None:
        return True
    asked = [e.scored.rmse for e in memo.values() if e.asked and not depth(e.spec)]
    return entry.scored.rmse * memo.policy.better_base < min([before.scored.rmse, *asked])


def other_structures(memo: Memo, entry: Entry, best: Entry) -> list[Entry]:
    """Nodes of another process, lag or command with the effects of an entry, not far behind the best one."""
    effects = {*physical_effects(entry.spec)} - {LAG}
    return [e for e in memo.values() if (e.what == LAG or e.op == SWAP)
            and {*physical_effects(e.spec)} - {LAG} == effects and not e.failed
            and e.scored.done.gain_over(best.scored.done) > -memo.policy.within]


def _bic(entry: Entry) -> float:
    return entry.scored.done.bic(entry.scored.done.good)
