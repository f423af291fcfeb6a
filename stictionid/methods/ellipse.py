"""Method `ellipse`: S is the width along OP of the ellipse fitted to the PV-OP plot.

PV and OP are reduced to the oscillation and its first harmonics, and an ellipse is fitted to their plot. Its chord
through the centre along the OP axis is the apparent stiction S. The method says nothing about J: the estimate holds J =
0 with the interval 0 to S, and a finding says so. A process that fits this valve is added for the curves.

Wrong in every loop that turns the plot by itself: the width mixes the valve with the phase of process and controller.
An integrating process draws an ellipse without any stiction. The result is the apparent S of this loop and tuning.
Source: Shoukat Choudhury, Jain and Shah 2008, after Choudhury, Shah, Thornhill and Shook 2006. The ellipse is fitted in
record/pv_op_ellipse.py.
"""

from __future__ import annotations

from dataclasses import replace

from ..errors import CannotTell
from ..fit.context import Run
from ..record.loop import Finding
from ..record.pv_op_ellipse import pv_op_ellipse
from .contract import Method, Outcome

_FEWEST_CYCLES = 3


def _run(run: Run) -> Outcome:
    run.tell("fitting the ellipse", 0.3)
    if run.found.period_median_s is None or len(run.found.cycles) < _FEWEST_CYCLES:
        raise CannotTell(f"the ellipse needs an oscillation: {run.found.reason}",
                         "use --method auto, which does without", code="no-oscillation")
    ellipse = pv_op_ellipse(run.loop, run.found.period_median_s)
    if ellipse is None:
        raise CannotTell("the filtered PV-OP plot is no ellipse: its points lie on a line",
                         "use --method auto", code="no-ellipse")
    S = ellipse.width
    fit = run.with_valve(S, 0.0)
    fit = replace(fit, intervals={"J": (0.0, S)})
    step = run.step(fit, None)
    said = Finding("jump-not-given", "warning",
                   f"an ellipse gives S only: J is not estimated and stands at 0, anything from 0 to {S:.4g} % is "
                   "possible", {"S": S, "J_interval": [0.0, S]}, (), "Choudhury, Jain and Shah 2008")
    rows = tuple(replace(p, identifiable=False) if p.name == "J" else p for p in step.parameters)
    step = replace(step, parameters=rows, findings=(said,),
                   model={**step.model, "ellipse": {"width": S, "extent": ellipse.extent, "a": ellipse.a,
                                                    "b": ellipse.b, "c": ellipse.c, "centre": list(ellipse.centre)}})
    return Outcome((step,), (fit,), gives_jump=False)


METHOD = Method(
    name="ellipse",
    summary="S is the width along OP of the ellipse fitted to the filtered PV-OP plot",
    equation="S = 2 m n / sqrt(m^2 sin^2 alpha + n^2 cos^2 alpha), half axes m, n at the angle alpha",
    source="Shoukat Choudhury, Jain and Shah 2008; Fitzgibbon, Pilu and Fisher 1999",
    checked="reconstructed from the descriptions of it; the print has not been seen",
    cannot="J; a loop whose process or controller turns the plot; records without an oscillation",
    run=_run, options=frozenset(), gives=("S",),
)
