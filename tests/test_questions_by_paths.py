"""When a search asks for valves along paths: where PV moved the slips of its answer, and where a level wanders."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from real_nodes import SAMPLES, recorded, scored, search_among

from stictionid.fit.noise.completion import Refit
from stictionid.model.spec import Spec
from stictionid.selection.entry import Entry
from stictionid.selection.node import node
from stictionid.selection.score import Scored
from stictionid.selection.search import Search

NOISE = 0.05


def moved(scored_node: Scored, by_pv: bool) -> Scored:
    """The same node, told whether PV moved many of its slips."""
    found = replace(scored_node)
    found.__dict__["by_pv"] = by_pv
    return found


def asking(monkeypatch: pytest.MonkeyPatch, found: list[Refit]) -> list[tuple[int, bool]]:
    """The knots beside which a search sought valves, and whether it sought the other kind alone; it finds these."""
    asked: list[tuple[int, bool]] = []

    def valves(self: Search, entry: Entry, knots: int = 0, *, other: bool = False) -> list[Refit]:
        asked.append((knots, other))
        return found

    monkeypatch.setattr(Search, "_valves_by_paths", valves)
    return asked


@pytest.mark.parametrize("by_pv", [False, True])
def test_a_base_at_its_noise_is_doubted_where_pv_moved_its_slips(monkeypatch: pytest.MonkeyPatch, by_pv: bool) -> None:
    loop = recorded(NOISE * np.random.default_rng(4).standard_normal(SAMPLES))
    entry = Entry(node(Spec()), moved(scored(loop), by_pv))
    asked, search = asking(monkeypatch, []), search_among(entry)
    assert not search._is_far(entry)
    search._ask_by_paths(entry)
    search._ask_by_paths(entry)
    assert asked == [(0, True)] * by_pv


@pytest.mark.parametrize("wanders", [False, True])
def test_looks_beside_a_wandering_level_follow_where_it_explains_something(monkeypatch: pytest.MonkeyPatch,
                                                                            wanders: bool) -> None:
    noise = NOISE * np.random.default_rng(4).standard_normal(SAMPLES)
    loop = recorded(noise + 3.0 * np.sin(np.arange(SAMPLES) / 250.0))
    base, far = scored(loop), scored(loop, values={"S": 7.0, "J": 1.0})
    entry, other = (Entry(node(Spec()), s) for s in ((far, base) if wanders else (base, far)))
    within = search_among(entry).policy.within
    assert (other.scored.done.gain_over(entry.scored.done) > -within) == wanders
    looked: list[str] = []
    monkeypatch.setattr(Search, "_remember_valve", lambda self, *given: looked.append("valve") or given[0])
    monkeypatch.setattr(Search, "ask_along", lambda self, *given: looked.append("along"))
    monkeypatch.setattr(Search, "_look_beside_wander", lambda self, *given: looked.append("looks"))
    monkeypatch.setattr("stictionid.selection.search.look_beside_wander", lambda fit: fit)
    asked = asking(monkeypatch, [other.scored.done])
    search_among(entry)._ask_beside_wander(entry)
    assert len(asked) == 1 and looked == ["valve", "along", "looks"] * wanders
