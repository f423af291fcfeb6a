"""A manual test as a record: OP stepped by hand in open loop, where nothing oscillates.

The ordinary model fits it: law, first order or integrator, dead time. Only what asks for an oscillation, or for a
controller, is left out. Wrong where OP was moved by a controller: such a record is refused. Source: docs/details.md,
section 9.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import CannotTell
from ..record.controller import ROUNDED
from ..record.loop import Loop
from ..record.study import Range
from ..system.plurals import counted

# Share of the swing of OP that is a step, and the largest share of samples in which OP steps. Unit: 1.
_STEP, _MOVING = 0.01, 0.2


def open_loop(loop: Loop) -> Loop:
    """The record without its setpoint, which nothing follows in manual; the valve follows OP as it was set by hand."""
    return replace(loop, setpoint=None, followed=ROUNDED)


def stepped(loop: Loop, found: Range) -> Range:
    """The range of a test: no cycles, and the reversals of its steps; CannotTell for a record that is no such test."""
    u = loop.output[loop.driven]
    change = np.diff(u)
    ways = np.sign(change[np.abs(change) > _STEP * np.ptp(u)])
    if ways.size > _MOVING * u.size:
        raise CannotTell(f"OP moves in {100 * ways.size / u.size:.0f} % of the samples: that is a loop in automatic, "
                         "or a ramp, no test by hand", "leave --test out, or put the loop in manual and step OP",
                         code="no-manual-test")
    turns = int((np.diff(ways) != 0.0).sum())
    if not turns:
        raise CannotTell(f"OP takes {counted(ways.size, 'step')} in one direction: only after a reversal does PV "
                         "show S", "step OP up, then down in small steps", code="no-reversal")
    return replace(found, oscillating=False, period_s=None, period_median_s=None, s_max=None, cycles=(),
                   reason=f"a manual test: OP takes {ways.size} steps and reverses {counted(turns, 'time')}",
                   reference="mean of y", reversals=turns)
