"""Error of a command that a record does not show: that of its digits, and that of what came between its samples.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

from ..model.model import Model
from ..process.rounded import command_sd
from ..process.scan import DECIMATED, SLOWEST_SCAN_S
from ..record.loop import bridged
from ..record.oscillation import noise_of
from ..typing import FloatArray

# Least errors of a command that was rebuilt between samples, as shares of the break-away force.
_LEAST = (1e-3, 3e-4)


def likely_errors(model: Model, values: FloatArray) -> tuple[float, ...]:
    """Standard deviations in % of what is unknown of the command, the likeliest first.

    A record that shows every scan has its rounding only. Between its samples a command errs by the noise that it has
    from sample to sample: the controller saw as much noise there. A command that moves has hardly any of it; where it
    was rebuilt it is nearly exact, but for corners. Measured on 18 slow loops of benchmarks/plants: the error was 0.6
    to 2.4 times that noise on 13, and more where a corner fell between two samples.
    """
    known = command_sd(model.loop)
    if model.spec.held and model.spec.substeps == 1 and model.step_s <= SLOWEST_SCAN_S:
        return (known,)
    fs = 0.5 * float(values[0] + (values[0] if model.law.one_parameter else values[1]))
    noise = noise_of(bridged(model.loop.output))
    if model.spec.held or model.spec.between == DECIMATED:
        return tuple(dict.fromkeys((max(noise, known, _LEAST[0] * fs), max(known, _LEAST[0] * fs))))
    return tuple(dict.fromkeys((max(known, _LEAST[0] * fs), _LEAST[1] * fs, max(noise, known, _LEAST[0] * fs))))
