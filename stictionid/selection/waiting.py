"""Order in which the nodes of a search are asked: the best one with its far looks, new bases, others, far looks.

Source: SELECTION.md section 1; CRITICISM.md section 7.
"""

from __future__ import annotations

from collections.abc import Mapping

from .entry import ADD, Asked, Entry
from .node import depth, key
from .policy import Policy

Memo = Mapping[str, Entry]


def ranked(memo: Memo, *, tentative: bool = False) -> list[Entry]:
    """The entries that passed all gates (or nearly, with `tentative`), best BIC first."""
    entries = [e for e in memo.values() if e.passed or (tentative and e.tentative)]
    reference = entries[0].scored.done
    gains = {key(e.spec): e.scored.done.gain_over(reference) for e in entries}
    return sorted(entries, key=lambda e: -gains[key(e.spec)])


def waiting(memo: Memo, policy: Policy, *, only_some: bool) -> list[Entry]:
    """The nodes to ask: the best one with its far looks, new bases by free run, others by BIC, then far looks.

    Beside a missing effect an autoregression hides which base is right; the free run does not. Bases that do not help
    alone come where nothing else is left: beside one of them another effect may. With `only_some` effects of the
    catalogue none can, so these bases are left out.
    """
    whole = [e for e in ranked(memo, tentative=True) if depth(e.spec) < policy.depth]
    far = [e for e in whole if e.asked == Asked.BY_NEAR]
    rest = [e for e in whole if not e.asked]
    if rest and rest[0].scored.white:
        return rest[:1]
    if rest and rest[0] is whole[0] and depth(whole[0].spec) and whole[0].scored.nearly(policy):
        return [*rest, *far]  # (its free run is hardly more than its innovations: nothing hides a base)
    unasked = [e for e in memo.values() if not e.asked and not e.failed and not depth(e.spec)]
    bases = [e for e in unasked if e.scored.full
             and ((not only_some and e is whole[0]) or better_base(memo, e, policy))]
    least = min((e.scored.rmse for e in bases), default=0.0)
    # Bases whose free runs are about as good come by BIC.
    bases.sort(key=lambda e: (e.scored.rmse > 2 * least, _bic(e)))
    first = [e for e in (_before(memo, e, policy) for e in whole[:1]) if e.asked == Asked.BY_NEAR]
    if first and bases and bases[0].scored.done.gain_over(first[0].scored.done) > 0.0:
        first, bases = bases[:1], [*first, *bases[1:]]
    found = [*first, *bases, *(e for e in rest if depth(e.spec) > 0), *(e for e in far if e not in first)]
    return found or ([] if only_some or ranked(memo)[0].scored.white else sorted(unasked, key=_bic))


def better_base(memo: Memo, entry: Entry, policy: Policy) -> bool:
    """True for a root, and for a node whose free run is clearly better than its parent's."""
    before = memo.get(entry.parent or "")
    return before is None or entry.scored.rmse * policy.better_base < before.scored.rmse


def _before(memo: Memo, entry: Entry, policy: Policy) -> Entry:
    """An entry, or its parent where it hardly lowers the free run, or a rival does as well; of bases the freest."""
    parent, least = memo.get(entry.parent or ""), policy.better_base * entry.scored.rmse
    if depth(entry.spec) and parent is not None and parent.asked == Asked.BY_NEAR:
        rival = any(e.parent == entry.parent and e.op == ADD and e is not entry and not e.failed and e.scored.full
                    and e.scored.rmse < least for e in memo.values())
        entry = parent if rival or (not entry.asked and least > parent.scored.rmse) else entry
    alike = [e for e in memo.values() if e.asked == Asked.BY_NEAR and not e.failed and not depth(e.spec)]
    return min(alike, key=lambda e: e.scored.rmse) if alike and not depth(entry.spec) else entry


def _bic(entry: Entry) -> float:
    return entry.scored.done.bic(entry.scored.done.good)
