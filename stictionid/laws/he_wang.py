"""Stiction law of He and Wang 2010 (semi-physical): He's law with every slip longer by the factor K.

|e| > f_s: u_v = u_v(k-1) + K (e - sign(e) f_d), else hold. K = 1 is He 2007. K = 1 + exp(-pi z / sqrt(1 - z^2)) with
z = F_v / (2 sqrt(k m)) is the first swing of an underdamped stem, 1.99 almost undamped.

K is the row OVERSHOOT of the friction table, so this file has no kernel of its own: `Law.friction` sets the row to
the parameter `overshoot`, by default 1.37 (z = 0.3, a lightly damped stem). A table made without it has K = 1
and is He's law. The effect slip-overshoot supplies the same row and replaces the default. Re-stick has no meaning.

Wrong where the stem slides under a continuous command (a staircase appears, as with He's law). Large K times J - S
can move the stem so far that it slips back at the next sample.

Source: He and Wang 2010, docs/details.md, section 3. The print has not been seen.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from ..errors import ModelError
from ..numerics.parameters import Parameter
from ..typing import FloatArray
from .contract import OVERSHOOT
from .he import LAW as HE

# K of a lightly damped stem, z = 0.3. A choice of this program: the source leaves K to the valve. Unit: 1.
DEFAULT_K = 1.37
_K = Parameter("overshoot", "-", 1.0, 2.0, 1.0, "K: how far the stem shoots per unit of its way at a slip, 1 = none")


def _supply(table: FloatArray, values: Mapping[str, float], step_s: float, held: bool) -> FloatArray:
    K = values["overshoot"]
    if not _K.low <= K <= _K.high:
        raise ModelError(f"He and Wang's overshoot K = {K:g} is not between 1 (damped) and 2 (undamped)",
                         f"give a K from 1 to 2, for example {DEFAULT_K:g}")
    table[OVERSHOOT] = K
    return table


LAW = replace(
    HE,
    name="he-wang",
    summary="He's law with a stem that overshoots at every slip by the factor K",
    equation="|e| > f_s -> u_v = u_v(k-1) + K (e - sign(e) f_d), else hold; K = 1 + exp(-pi z / sqrt(1 - z^2)), "
             "z = F_v / (2 sqrt(k m))",
    source="He and Wang 2010",
    checked="reconstructed (from the description in Shang et al.; the print has not been seen)",
    cannot="sliding: a slow ramp gives a staircase; the way the stem swings, only where it ends",
    parameters=(_K,), defaults={"overshoot": DEFAULT_K}, supply=_supply,
)
