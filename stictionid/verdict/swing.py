"""Causes of a swing: the loop run again with a perfect valve, each of its inputs alone.

With a perfect valve the loop is linear, so that its answers to setpoint, disturbances and noise add up. The valve's
share is the variance that a perfect valve ends. Wrong where the controller is no PI law, or an effect makes the process
far from linear, and where y is one sine: a model of u and y may then take the controller for the process. Source:
docs/details.md, section 13; Desborough and Miller 2002 (a perfect valve as the reference).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit.points.fitted import Fitted
from ..model.parts import join_parts, parts_of
from ..process.controller_law import usual_law
from ..record.controller import Controller
from ..record.loop import Loop, bridged
from ..record.study import Estimate, Verdict
from ..record.swing import Severity, Share, Swing
from ..typing import FloatArray
from .severity import perfect_valve, severity, without_gaps

# Share of the variance of the swing, without the noise, that a perfect valve leaves: from the first the swing goes on,
# up to the second it ends. Unit: 1; half the variance is 70 % of the amplitude, a tenth is 30 %.
_GOES_ON, _ENDS = 0.5, 0.1
# Valve's share of the variance from which the run contradicts another cause, and below whose negative the run with a
# perfect valve swings more than the record, so that the model fails in the closed loop. Unit: 1.
_CONTRADICTS = 0.1


def meaning_of(loop: Loop, estimate: Estimate, fit: Fitted, verdict: Verdict) -> tuple[Severity, Swing]:
    """Severity of the S and J of a fit, and what makes its loop swing.

    Of several segments the longest is simulated, where the loop ran on. A cause that the verdict names beside a valve
    that is not proven contradicts a run that blames the valve: neither is then shown. Nor is a run that swings more
    with a perfect valve than the record does.
    """
    best, rows, held = fit.best, loop.longest, fit.model.spec.between == "hold"
    parts, piece = parts_of(fit.model, fit.values), loop.longest_segment()
    outside = {p.name: np.where(best.counted > 0, p.curve, np.nan)[rows] for p in parts
               if p.name not in (Share.VALVE, Share.START)}
    found = severity(piece, estimate, np.sum(list(outside.values()), axis=0), best.stem[rows], held=held)
    own = Swing(tuple(Share(p.name, p.share) for p in join_parts(parts)), reason=found.statement)
    law = usual_law(piece, held=held)
    if found.pv_sd_repaired is None or law is None:
        return found, own
    causes = _causes(piece, estimate, law, own, outside)
    other = verdict.evidence.looks_like or ""
    share = causes.causes[0].share if causes.causes else 0.0
    reason = f"not simulated: {other}" if other and share > _CONTRADICTS else ""
    if share < -_CONTRADICTS:
        reason = ("not told: by this model a perfect valve would make PV scatter about its setpoint by "
                  f"{causes.sd_perfect:.3g} instead of {causes.sd:.3g}, so that the model fails in the closed loop")
    if reason:
        # Another cause by the look of the record is named only where the valve is denied.
        known = other if other and verdict.stiction == "no stiction" else reason
        return replace(found, pv_sd_repaired=None, share_of_pv_variance=None, travel_per_day_repaired=None,
                       statement=reason), replace(own, reason=known)
    return found, causes


def _causes(loop: Loop, estimate: Estimate, law: Controller, own: Swing, outside: dict[str, FloatArray]) -> Swing:
    """Shares of the causes in the variance of y about its setpoint."""
    assert loop.setpoint is not None
    y, rest = bridged(loop.process_value), np.zeros(loop.samples)
    r = np.where(np.isfinite(loop.setpoint), loop.setpoint, y) - y[0]
    good = loop.used & np.all([np.isfinite(d) for d in outside.values()], axis=0)
    answers = {Share.SETPOINT: perfect_valve(loop, estimate, law, r, rest)[0] - r}
    for name, curve in outside.items():
        answers[name] = perfect_valve(loop, estimate, law, rest, without_gaps(loop, curve))[0]
    left, power = np.sum(list(answers.values()), axis=0)[good], float(np.var((y - r)[good]))
    if not power > 0.0:
        return replace(own, reason="the process value does not leave the setpoint")
    shares = {name: float((a[good] - a[good].mean()) @ (left - left.mean())) / left.size / power
              for name, a in answers.items()}
    valve = 1.0 - float(np.var(left)) / power
    # The noise is no swing: the other parts decide whether the swing goes on.
    swing = 1.0 - shares[Share.NOISE]
    lasting = 1.0 - valve / swing if swing > 0.0 else 1.0
    return Swing(own.parts, (Share(Share.VALVE, valve), *(Share(name, share) for name, share in shares.items())),
                 float(np.sqrt(power)), float(np.std(left)),
                 True if lasting >= _GOES_ON else False if lasting <= _ENDS else None)
