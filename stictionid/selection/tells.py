"""Which measurement would settle it: for effects that look alike in u and y, the test in which they differ.

Source: CRITICISM.md section 8, column "what separates".
"""

from __future__ import annotations

from ..effects import parse

_PAIRS: dict[frozenset[str], str] = {
    frozenset({"valve-characteristic", "gain-nonlinearity"}):
        "setpoint moves that carry OP over more than 15 %: then the error follows the valve or the PV, not both",
    frozenset({"travel-limit", "valve-characteristic"}):
        "a step in manual beyond the suspected limit: a limited valve moves no further",
    frozenset({"travel-limit", "gain-nonlinearity"}):
        "a step in manual beyond the suspected limit: a limited valve moves no further",
    frozenset({"extra-lag", "slew-limit"}):
        "two steps in manual of different size: a lag takes the same time for both, a slew limit longer for the larger",
    frozenset({"slip-overshoot", "extra-lag"}): "the measured valve position, sampled faster than the slip",
    frozenset({"re-sticking", "slip-overshoot"}): "the measured valve position, sampled faster than the scan",
    frozenset({"re-sticking", "asymmetric-stiction"}):
        "the measured valve position, or a slow ramp in manual both ways",
    frozenset({"re-sticking", "stiction-drift"}): "the measured valve position, or a second record some hours later",
    frozenset({"asymmetric-stiction", "stiction-drift"}):
        "a second record some hours later: asymmetry stays, a drift goes on",
    frozenset({"step-disturbance", "ramp-disturbance"}): "a longer record after the change",
    frozenset({"step-disturbance", "random-walk-disturbance"}): "a longer record, or the loop in manual for a while",
    frozenset({"ramp-disturbance", "random-walk-disturbance"}): "a longer record, or the loop in manual for a while",
    frozenset({"coloured-noise", "random-walk-disturbance"}):
        "a longer record with the loop in manual: noise has a level, a walk has none",
    frozenset({"sinusoidal-disturbance", "narrow-band-disturbance"}):
        "a longer record, or other loops of the same time that show the oscillation",
}
# For an effect whose rival is none of its listed pairs.
_ALONE = {
    "asymmetric-stiction": "the measured valve position, or a slow ramp in manual both ways",
    "stiction-drift": "a second record some hours later",
    "re-sticking": "the measured valve position, sampled faster than the scan",
    "slip-overshoot": "the measured valve position, sampled faster than the scan",
    "travel-limit": "a step in manual beyond the suspected limit",
    "slew-limit": "two steps in manual of different size",
    "valve-characteristic": "steps in manual at both ends of the range",
    "gain-nonlinearity": "setpoint moves to both ends of the range",
    "extra-lag": "the measured valve position: it tells a lag before the valve from one behind it",
    "sinusoidal-disturbance": "the loop in manual: an oscillation from elsewhere goes on",
    "narrow-band-disturbance": "the loop in manual: an oscillation from elsewhere goes on",
    "step-disturbance": "a tag of the suspected load, read with --extra",
    "ramp-disturbance": "a tag of the suspected load, or a check of the sensor's zero",
    "random-walk-disturbance": "a tag of the suspected load, read with --extra",
    "coloured-noise": "a record with the loop in manual",
    "measured-disturbance": "a deliberate move of that tag",
}


def settling(name: str, rivals: tuple[str, ...]) -> str:
    """One test in words that tells an effect from its rivals; empty where nothing rivals it."""
    mine = parse(name)[0].name
    for rival in rivals:
        other = parse(rival)[0].name
        if other == mine:
            return "a tag of the suspected load, or a step of OP in manual: it shows how a load enters"
        if (pair := frozenset({mine, other})) in _PAIRS:
            return _PAIRS[pair]
    return _ALONE.get(mine, "") if rivals else ""
