"""Stiction law of He 2007: the valve stops at every sample and jumps when the force exceeds static friction.

|e| > f_s: u_v = u - sign(e) f_d, else hold, with e = u(k) - u_v(k-1).

A slow ramp of the command gives a staircase with steps of J, where a real stem driven by a continuous command slides.
Right where a held (scanned) command lets a fast stem come to rest between two scans.

This law is Chen's with an infinite re-stick speed, and it runs in the kernel of that law. The re-stick row and the
crossing row have no meaning here. With the overshoot row off its neutral 1, this is the law of He and Wang (he-wang);
the other rows act as in every law.

Source: He et al. 2007, docs/details.md, section 3 (their u_r and cum_u are u - u_v and e). The print has not been seen.
"""

from __future__ import annotations

import numpy as np

from ..typing import FloatArray
from .chen import LAW as CHEN
from .contract import CROSSES, RESTICK, Law


def _run(command: FloatArray, friction: FloatArray, profile: FloatArray, state: FloatArray,
         position: FloatArray) -> None:
    table = friction.copy()
    table[RESTICK], table[CROSSES] = np.inf, 0.0
    CHEN.run(command, table, profile, state, position)


LAW = Law(
    name="he",
    summary="the valve rests at every sample and jumps when the force exceeds static friction",
    equation="|e| > f_s -> u_v = u - sign(e) f_d, else hold",
    source="He et al. 2007",
    checked="reconstructed (from the description in Shang et al.; the print has not been seen)",
    cannot="sliding: a slow ramp gives a staircase of steps J; inertia; viscous friction",
    run=_run, start=CHEN.start, sliding_state=None, slips="rests",
)
