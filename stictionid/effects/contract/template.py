"""Template of a user-written effect: a worn trim, whose flow does not change between two positions."""

from __future__ import annotations

_TEMPLATE = '''"""Worn trim: the flow does not change between two valve positions.

flow = position up to start, start up to start + width, position - width beyond.
"""

import numpy as np

NAME = "{name}"

# Unit, range of the search and the value at which the effect vanishes, of every parameter of the function below.
PARAMETERS = {{
    "start": {{"unit": "%", "range": (0, 100), "neutral": 50, "meaning": "position where the worn part begins"}},
    "width": {{"unit": "%", "range": (0, 20), "neutral": 0, "meaning": "travel over which nothing changes"}},
}}


# One of valve(position, time_s, ...), process(input, time_s, ...) with gain 1, tf(...) or ss(...) with gain 1, and
# disturbance(time_s, ...). Arrays have one number a sample; return a new array of that shape.
def valve(position, time_s, start, width):
    return position - np.clip(position - start, 0, width)


# Starting points of the search; without this function they are spread over the ranges. `record` has command,
# process_value, setpoint, time_s, step_s, period_s and s_max (the swing of the command).
def guess(record):
    places = np.quantile(record.command, [0.1, 0.3, 0.5, 0.7, 0.9])
    return [{{"start": place, "width": share * record.s_max}} for place in places for share in (0.1, 0.3)]
'''


def template(name: str) -> str:
    """The text of a file with a worn trim as an effect of this name."""
    return _TEMPLATE.format(name=name)
