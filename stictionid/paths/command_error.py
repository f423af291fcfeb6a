"""Error of a command that a record does not show: that of its digits, and that of what came between its samples.

Source: docs/details.md, section 14.
"""

from __future__ import annotations

import numpy as np

from ..model.model import Model
from ..process.rounded import command_sd
from ..process.scan import DECIMATED, SLOWEST_SCAN_S, hidden_noise, unseen_noise
from ..record.loop import bridged, fingerprint
from ..record.oscillation import noise_of
from ..typing import FloatArray

# Least errors of a command that was rebuilt between samples, as shares of the break-away force.
_LEAST = (1e-3, 3e-4)
# Error of a command somewhere between two samples with which a search begins, as a share of its change from one to the
# next: an even spread errs by 0.29 of it from the middle, and by 0.58 from the later sample.
_BETWEEN = 0.4
# Largest error of a command that was rebuilt by its law, in what the noise of PV does to it at unseen scans. It was 0.3
# to 2 of these at the true values of nine loops of benchmarks/plants (seed 146000).
_REBUILT = 3.0
# Standard deviation of an instant that may be anywhere between two others, as a share of their distance.
_ANYWHERE = 1.0 / np.sqrt(12.0)


def likely_errors(model: Model, values: FloatArray) -> tuple[float, ...]:
    """Standard deviations in % of what is unknown of the command, the first to try first.

    A record that shows every scan has its rounding only. A command that was rebuilt at unseen scans lacks their noise.
    Another held command that moved between its samples errs by a part of its changes; how large a part is sought (see
    `error_range`). A command that moves has hardly any error; where it was rebuilt it is nearly exact, but for corners,
    and for the noise that it has from sample to sample.
    """
    known, (least, most) = command_sd(model.loop), error_range(model, values)
    if errs_by_scan(model):
        return (max(_unseen(model), known, _LEAST[0] * _break_away(model, values)),)
    if model.spec.held:
        return (max(min(_BETWEEN * _moves(model), most), least) if most else known,)
    fs, noise = _break_away(model, values), noise_of(bridged(model.loop.output))
    return tuple(dict.fromkeys((max(known, _LEAST[0] * fs), _LEAST[1] * fs, max(noise, known, _LEAST[0] * fs))))


def error_range(model: Model, values: FloatArray) -> tuple[float, float]:
    """Least and largest error in % of a held command whose error is sought; zeros where it is known or not sought.

    The controller moved the output from one sample to the next, so that it was off by no more than that change. A
    command that was rebuilt by its law lacks the noise of PV at the scans between samples, and errs by little more.
    """
    if not hides_scans(model) or errs_by_scan(model):
        return 0.0, 0.0
    least = max(command_sd(model.loop), _LEAST[0] * _break_away(model, values))
    law = hidden_noise(model.loop, model.spec.substeps) if model.spec.between == DECIMATED else None
    return least, max(least, min(_moves(model), np.inf if law is None else _REBUILT * law))


def likely_jitter(model: Model) -> float:
    """Standard deviation of the time of a slip, as a share of the time from one value of the command to the next.

    A held command that the controller moved in between slips the stem anywhere there.
    """
    return _ANYWHERE if hides_scans(model) else 0.0


def numbers_of_path(model: Model, values: FloatArray) -> int:
    """Fitted numbers of a model's path: the scatter, and the error of the command where that was sought."""
    paths = model.spec.paths
    if paths is None:
        return 0
    sought = hides_scans(model) and not paths.by_scan
    return 1 + (sought or paths.error > likely_errors(model, values)[0])


def hides_scans(model: Model) -> bool:
    """True where a held command moved unseen: it was rebuilt, or the record is slower than every usual scan."""
    return model.spec.held and (model.spec.substeps > 1 or model.step_s > SLOWEST_SCAN_S)


def errs_by_scan(model: Model) -> bool:
    """True where a held command was rebuilt at scans whose noise no row tells."""
    return model.spec.between == DECIMATED and _unseen(model) > 0.0


def _unseen(model: Model) -> float:
    """The noise of the command at scans in no sample, in %; every path of a record asks for it."""
    loop, scans = model.loop, model.spec.substeps
    question = fingerprint(("unseen", scans, loop.starts), loop.output, loop.process_value, loop.setpoint, loop.used)
    return loop.memory.answer(question, lambda: unseen_noise(loop, scans))


def _moves(model: Model) -> float:
    """Root mean square in % of the changes of the output from one sample to the next."""
    return float(np.sqrt(np.mean(np.diff(bridged(model.loop.output))**2)))


def _break_away(model: Model, values: FloatArray) -> float:
    return 0.5 * float(values[0] + (values[0] if model.law.one_parameter else values[1]))
