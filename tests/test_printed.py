"""The comparison of printed text finds what changed, and passes over what another processor may change."""

from __future__ import annotations

import pytest
from printed import said, same_text

SHOWN = """verdict: stiction, because friction lowers the error from 2.548 to 0.5815 in 5 of 5 blocks
+-------------------------------------------+
|model          |     S |  interval | restarts|
|---------------+-------+-----------+---------|
|base: chen,    | 4.001 | 3.9 to 5.1|   2 of 2|
|first order    |       |           |         |
+-------------------------------------------+
|effect      | gain | answer                 |
|------------+------+------------------------|
|travel-limit|  900 | named                  |
|extra-lag   |   -3 | it gains too little,   |
|            |      | 10 name an effect      |
|slew-limit  | -4.1 | only a look            |
+-------------------------------------------+
base: chen, hold      0.662  13.3 x  rejected
|- + re-sticking      0.607  12.2 x  -14 BIC
|  |                               beyond noise
|  `- + travel-limit  0.049  0.99 x  named
`- 10 more                           nothing
309,368 cost evaluations
"""
# What another processor prints: wider columns, other work, other refits of what was not named, last digits.
ELSEWHERE = """verdict: stiction, because friction lowers the error from 2.547 to 0.5816 in 5 of
5 blocks
+-------------------------------------------------------+
|model                    |     S |  interval | restarts|
|-------------------------+-------+-----------+---------|
|base: chen, first order  |     4 | 3.9 to 5.1|   2 of 3|
+-------------------------------------------------------+
|effect      | gain | answer                 |
|------------+------+------------------------|
|travel-limit|  901 | named                  |
|slew-limit  | -2.0 | only a look            |
|extra-lag   |   -6 | it gains too little    |
+-------------------------------------------+
base: chen, hold      0.662  13.3 x  rejected
|- + re-sticking      0.501  11.2 x  -9 BIC beyond noise
|  `- + travel-limit  0.049  0.99 x  named
|- + extra-lag        0.607  12.2 x  -14 BIC
`- 9 more                            nothing
1,309,195 cost evaluations
"""


def test_another_processor_says_the_same() -> None:
    same_text(SHOWN, SHOWN)
    same_text(SHOWN, ELSEWHERE)


@pytest.mark.parametrize(("old", "new"), [
    ("verdict: stiction", "verdict: undecided"), ("5 of 5 blocks", "4 of 5 blocks"), ("0.5815", "0.6015"),
    ("4.001", "4.101"), ("3.9 to", "3.5 to"), ("  900", "  950"), ("extra-lag   |", "dead-time   |"),
    ("0.049  0.99 x  named", "0.055  0.99 x  named"), ("13.3 x", "14.3 x"), (" cost evaluations", " evaluations"),
    ("| named   ", "| rejected"), ("|first order    ", "|second order   "), ("2.548", "-2.548")])
def test_what_changed_is_found(old: str, new: str) -> None:
    assert old in SHOWN
    with pytest.raises(AssertionError):
        same_text(SHOWN, SHOWN.replace(old, new))


def test_intervals_count_where_nothing_is_missing() -> None:
    wide = SHOWN.replace("3.9 to 5.1", "3.9 to 8.1")
    with pytest.raises(AssertionError):
        same_text(SHOWN, wide)
    missing = "adequate: no, something is missing\n"
    same_text(SHOWN + missing, wide + missing)


def test_a_text_that_ends_early_is_found() -> None:
    with pytest.raises(AssertionError):
        same_text(SHOWN, SHOWN.rpartition("309")[0])
    assert said("a\n+---+\n|b |\n+---+") == ["a", "b"]
