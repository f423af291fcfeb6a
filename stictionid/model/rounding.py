"""Motion of a model's y within the rounding of a recorded output.

Where a stem stops follows from the output at its turn, and when it slips from the output against its stop: both are
known to half a step only, which moves y for a whole stroke. Outputs that would have been recorded alike are run through
the model as it is. Wrong for an output that the controller itself rounds: such a record is exact, and its model leaves
noise.

Source: Widrow and Kollar 2008 (rounding errors as uniform draws, one for every run of equal outputs).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..process.rounded import FINE, command_sd
from ..record.loop import Loop
from ..typing import FloatArray
from .model import Model
from .restore import described, rebuild_model
from .segments import bound
from .spec import Evaluated

# Outputs that are drawn, and the quantile of what they move y by: a slip that nearly did not happen is lost by any
# small change, and is the record's own where the model has it.
_DRAWS, _QUANTILE = 8, 0.25
# Longest scan of a usual DCS in seconds. Second: error of a rebuilt command at slips, as a share of its move from
# sample to sample (benchmarks/verdicts.py, seeds below 1000).
_SLOWEST_SCAN_S, _REBUILT = 2.0, 0.35


def moved_by_rounding(loop: Loop, description: Mapping[str, Any], seed: int = 0) -> float:
    """Motion of y of a described model within the rounding of its output (see `moved_within`)."""
    piece, _ = described(loop, dict(description))
    return moved_within(*rebuild_model(piece, dict(description)), seed)


def moved_within(model: Model, values: FloatArray, seed: int = 0) -> float:
    """Motion of y of a model at values (d,) within the rounding of its output, in the unit of y.

    It is a root mean square, and the lower quartile of several draws; 0 where the output is not rounded, or finely.

    Equal outputs in a row are shifted alike, so that every rise and fall of the record stays one. A rebuilt output
    moves within its own error.
    """
    loop, step = model.loop, float(np.sqrt(12.0)) * command_sd(model.loop)
    if step <= FINE * float(values[0]):
        return 0.0
    now, counted = model.evaluate(values).model, model.good() & ~model.starting()
    run = np.cumsum(np.diff(loop.output, prepend=loop.output[0]) != 0.0)
    rng = np.random.default_rng(seed)
    found = []
    for shift in rng.uniform(-0.5 * step, 0.5 * step, (_DRAWS, int(run[-1]) + 1)):
        other = bound(replace(loop, output=loop.output + shift[run]), model.spec, s_max=model.s_max,
                      period_s=model.period_s)
        found.append(float(np.sqrt(np.mean((other.evaluate(values).model - now)[counted]**2))))
    return float(np.quantile(found, _QUANTILE))


def between_samples(model: Model, best: Evaluated) -> float:
    """Uncertainty of S and J in % from slips between two samples, where the command is not known.

    A record as fast as the scans of a DCS knows its command. A slower one knows the command at a slip to within its
    move from one sample to the next. A command rebuilt between samples (or at the scans there) is known to a share of
    that move.
    """
    share = _REBUILT if model.spec.between != "hold" else 1.0 if model.step_s > _SLOWEST_SCAN_S else 0.0
    moves = []
    for position, output in zip(model.split(best.stem), model.split(model.loop.output), strict=True):
        moved = np.abs(np.diff(position)) > 1e-9
        moves.append(np.abs(np.diff(output))[np.flatnonzero(moved[1:] & ~moved[:-1]) + 1])
    slips = np.concatenate(moves)
    return share * float(np.median(slips)) if slips.size and share else 0.0
