"""A valve that changes within a record: friction in two parts, the finding on a study, and the sentence of `agree`.

A repaired valve, identified and told, is in benchmarks/long.
"""

from __future__ import annotations

import numpy as np
import pytest
from test_agreement import MADE, record

from stictionid.laws import catalogue
from stictionid.laws.contract import FD_DRIFT, FS_DRIFT, SINCE, friction_table
from stictionid.model.replay import by_law, replay_slips
from stictionid.process.intersample import interval_means
from stictionid.verbs.agree import agreement
from stictionid.verbs.valve_changes import Change

LAWS = [law for law in catalogue().values() if law.searchable]
COMMAND = 50.0 + 4.0 * np.sin(np.arange(700.0) / 9.0) + 0.3 * np.sin(np.arange(700.0) / 2.3)
# First commands of the change, one a lane: never, at the start, within, beyond the end.
FIRST = np.array([0, 1, 300, 301, 699, 700, 900])
S, J, SHARE = np.full(FIRST.size, 3.0), np.full(FIRST.size, 1.2), np.full(FIRST.size, 0.3)


def changing() -> np.ndarray:
    """Friction (ROWS, P) of valves whose S falls by 2.0 and J by 0.8 %, each from its own command on."""
    table = friction_table(S, J)
    table[FS_DRIFT], table[FD_DRIFT], table[SINCE] = -1.4, -0.6, FIRST
    return table


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_every_valve_has_the_friction_before_and_then_that_behind_its_change(law) -> None:
    table, ones = changing(), np.ones(COMMAND.size)
    found = law.positions(COMMAND, table, profile=ones, share=SHARE)
    assert np.ptp(found, axis=1)[400:].max() > 0.0
    for lane, first in enumerate(np.minimum(FIRST, COMMAND.size)):
        own = np.ascontiguousarray(table[:, lane:lane + 1])
        state = law.start(float(COMMAND[0]), own, SHARE[lane:lane + 1])
        out = np.empty((COMMAND.size, 1))
        law.run(COMMAND[:first], own, 0.0 * ones[:first], state, out[:first])
        law.run(COMMAND[first:], own, ones[first:], state, out[first:])
        np.testing.assert_array_equal(found[:, lane], out[:, 0])


@pytest.mark.parametrize("name", ["chen", "he"])
def test_slips_and_means_of_each_valve_are_those_of_the_valve_alone(name) -> None:
    law, table, ones = catalogue()[name], changing(), np.ones(COMMAND.size)
    whole = law.positions(COMMAND, table, profile=ones, share=SHARE)
    means = whole.copy()
    interval_means(COMMAND, table, ones, means)
    for lane in range(FIRST.size):
        own = np.ascontiguousarray(table[:, lane:lane + 1])
        slips = by_law(law, COMMAND, own, ones, SHARE[:1])
        together = replay_slips(law, COMMAND, table, ones, SHARE, slips)
        alone = replay_slips(law, COMMAND, own, ones, SHARE[:1], slips)
        np.testing.assert_array_equal(alone.position[:, 0], whole[:, lane])
        np.testing.assert_array_equal(together.position[:, lane], alone.position[:, 0])
        np.testing.assert_array_equal(together.forces.margins[:, :, lane], alone.forces.margins[:, :, 0])
        mean = np.ascontiguousarray(whole[:, lane:lane + 1])
        interval_means(COMMAND, own, ones, mean)
        np.testing.assert_array_equal(means[:, lane], mean[:, 0])


def test_agree_says_the_change_in_place_of_a_drift() -> None:
    change = Change("a.csv", 480.0, (471.0, 492.0), None, (3.1, 0.4), None, "S changes from 3.1 to 0.4 % at noon")
    records = [record(S, day=day) for day, S in enumerate((3.1, 2.2, 1.3, 0.4))]
    found = agreement(records, "%", MADE, changes=(change,))
    assert found.changes == (change,) and found.statement.endswith("S changes from 3.1 to 0.4 % at noon")
    assert "per day" not in found.statement and "per day" in agreement(records, "%", MADE).statement
