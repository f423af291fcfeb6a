"""Order in which the nodes of a search are asked: new bases by free run, then the others by score.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

from collections.abc import Mapping

from ..fit.starts.beside_effect import LAG
from .entry import SWAP, Entry
from .node import depth, key, physical_effects
from .policy import Policy

Memo = Mapping[str, Entry]


def rank_entries(memo: Memo, policy: Policy, *, tentative: bool = False) -> list[Entry]:
    """The entries that passed all gates, and with `tentative` also the tentative ones, best BIC first."""
    entries = [e for e in memo.values() if e.passed or (tentative and e.tentative)]
    reference = entries[0].scored.done
    gains = {key(e.spec): e.scored.done.gain_over(reference) + e.credit(memo, policy) for e in entries}
    return sorted(entries, key=lambda e: -gains[key(e.spec)])


def nodes_to_ask(memo: Memo, policy: Policy, *, only_some: bool) -> list[Entry]:
    """The nodes to expand next, in order: new bases by free-run error, then the others by BIC.

    While an effect is missing, an autoregression hides which base is right; the free-run error shows it. Structure
    changes that do not help alone are expanded last: one may help together with an effect. They are left out where the
    search may use `only_some` effects of the catalogue.
    """
    whole = [e for e in rank_entries(memo, policy, tentative=True) if depth(e.spec) < policy.depth]
    queue = [e for e in whole if not e.asked]
    if queue and queue[0].scored.only_noise(policy):
        return queue[:1]
    free = [e for e in queue if depth(e.spec) and _halves_free_run(memo, e)]
    if free or (queue and queue[0] is whole[0] and depth(whole[0].spec) and whole[0].scored.leaves_little(policy)):
        return [*free, *(e for e in queue if e not in free)]  # (no missing effect hides a base)
    unasked = [e for e in memo.values() if not e.asked and not e.failed and not depth(e.spec)]
    bases = [e for e in unasked if e.scored.full
             and ((not only_some and e is whole[0]) or better_base(memo, e, policy))]
    least = min((e.scored.rmse for e in bases), default=0.0)
    # Bases with similar free-run errors are ordered by BIC. Under a random walk the free-run error tells nothing.
    bases.sort(key=lambda e: (e.scored.rmse > 2 * least and not e.scored.done.increments, _bic(e)))
    found = [*bases, *(e for e in queue if depth(e.spec) > 0)]
    return found or ([] if only_some or rank_entries(memo, policy)[0].scored.white else sorted(unasked, key=_bic))


def _halves_free_run(memo: Memo, entry: Entry) -> bool:
    """True where the free run of an entry is half of that of every base, or less."""
    bases = [e.scored.rmse for e in memo.values() if not depth(e.spec) and not e.failed and e.scored.full]
    return 2 * entry.scored.rmse <= min(bases, default=0.0)


def better_base(memo: Memo, entry: Entry, policy: Policy) -> bool:
    """True for a root, and for a node whose free run is clearly better than that of its parent and of asked bases."""
    before = memo.get(entry.parent or "")
    if before is None:
        return True
    asked = [e.scored.rmse for e in memo.values() if e.asked and not depth(e.spec) and not e.failed]
    return entry.scored.rmse * policy.better_base < min([before.scored.rmse, *asked])


def other_structures(memo: Memo, entry: Entry, best: Entry, policy: Policy) -> list[Entry]:
    """Nodes of another process, lag or command with the effects of an entry, not far behind the best one."""
    effects = {*physical_effects(entry.spec)} - {LAG}
    return [e for e in memo.values() if (e.what == LAG or e.op == SWAP)
            and {*physical_effects(e.spec)} - {LAG} == effects and not e.failed
            and e.scored.done.gain_over(best.scored.done) > -policy.within]


def _bic(entry: Entry) -> float:
    return entry.scored.done.bic(entry.scored.done.good)
