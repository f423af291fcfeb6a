"""Method `jelali`: first guess from an ellipse or a relay, pattern search over (S, J), separable least squares.

One guess for S is the width along OP of the ellipse through the filtered PV-OP plot. The other one treats the valve as
a relay with hysteresis: the swing of the command over a cycle. Each is tried with several J, and the best few start. A
pattern search polls the eight neighbours of the best point and halves its mesh when none is better. For each point the
linear model follows by least squares (ARX with a scan of the delay and a constant), u_v(0) = u(0).

Wrong where the guess lies in another basin than the answer: a pattern search does not leave the one it starts in. With
noise the one-step error pulls J low (docs/details.md, section 6.2). Source: Jelali 2008, "Estimation of valve stiction
in control loops using separable least-squares and global search algorithms". The inner model is ARX here, since C(q)
changes the ranking of (S, J) little and costs a hundredfold.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import CannotTell
from ..fit.context import Run
from ..fit.points.arx_cost import Arx, check_rows
from ..model.response import S_OVER_S_MAX
from ..model.spec import Spec
from ..numerics.population import Cost
from ..record.pv_op_ellipse import pv_op_ellipse
from ..typing import FloatArray
from .contract import Method, Outcome

# First slip jumps tried, as shares of S; first and last mesh, as shares of S_max.
_SHARES = np.linspace(0.1, 1.0, 10)
_FIRST_MESH, _LAST_MESH = 0.1, 1e-4
_POLL = np.array([(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j], dtype=np.float64)
_MOST_ROUNDS = 200
# Number of pattern searches, from as many of the best first guesses.
_STARTS = 6


def _run(run: Run) -> Outcome:
    model = run.model(Spec(law=run.law))
    check_rows(model.good(), run.order)
    arx = Arx(model, run.order, run.delays())

    def cost(points: FloatArray) -> FloatArray:
        """Cost (P,) of points (P, 2) of S and J in %; inf outside 0 < S <= 1.2 S_max, 0 <= J <= S."""
        inside = (points[:, 0] > 0) & (points[:, 0] <= S_OVER_S_MAX * run.s_max)
        inside &= (points[:, 1] >= 0) & (points[:, 1] <= points[:, 0])
        values = np.zeros((model.space.size, len(points)))
        values[0] = np.where(inside, points[:, 0], run.s_max)
        values[1] = np.where(inside, points[:, 1], 0.0)
        return np.where(inside, arx.costs(values)[0], np.inf)

    run.tell("first guess from ellipse and relay", 0.2)
    guesses = {name: min(S, S_OVER_S_MAX * run.s_max) for name, S in _guesses(run).items()}
    starts = np.array([(S, S * share) for S in guesses.values() for share in _SHARES])
    first = cost(starts)
    if not np.isfinite(first).any():
        raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                         code="valve-never-moves")
    run.tell("pattern search", 0.4)
    order = np.argsort(first, kind="stable")[:_STARTS]
    ends = [(*_pattern_search(cost, starts[i], float(first[i]), run.s_max), int(i)) for i in order]
    best, value, chosen = min(ends, key=lambda end: end[1])
    fit = run.with_valve(float(best[0]), float(best[1]))
    step = run.step(fit, None)
    step = replace(step, error=replace(step.error, rmse_one_step=float(np.sqrt(value / max(arx.shared.rows, 1)))),
                   model={**step.model, "start": {"guesses": guesses, "S": float(starts[chosen][0]),
                                                  "J": float(starts[chosen][1])}})
    return Outcome((step,), (fit,))


def _guesses(run: Run) -> dict[str, float]:
    """First guesses for S in % by name: the relay's, and the ellipse's where the record draws one."""
    found = run.found
    swings = [c.u_swing for c in found.cycles[1:] or found.cycles]
    guesses = {"relay": float(np.median(swings)) if swings else 0.5 * run.s_max}
    ellipse = pv_op_ellipse(run.loop, run.period_s) if found.cycles else None
    if ellipse is not None:
        guesses["ellipse"] = ellipse.width
    return guesses


def _pattern_search(cost: Cost, start: FloatArray, value: float, s_max: float) -> tuple[FloatArray, float]:
    """Best point (2,) and cost of polling eight neighbours on a mesh that doubles on success and halves on failure."""
    best, mesh = start, _FIRST_MESH
    for _ in range(_MOST_ROUNDS):
        trial = best + mesh * s_max * _POLL
        costs = cost(trial)
        at = int(costs.argmin())
        if costs[at] < value:
            best, value, mesh = trial[at], float(costs[at]), min(2.0 * mesh, _FIRST_MESH)
        else:
            mesh *= 0.5
            if mesh < _LAST_MESH:
                break
    return best, value


METHOD = Method(
    name="jelali",
    summary="ellipse or relay as the start, pattern search over (S, J), separable least squares",
    equation="min over (S, J) of min over (a, b) ||y - Phi(S, J) theta||^2, polled on a shrinking mesh",
    source="Jelali 2008",
    checked="reconstructed from the descriptions of it; the print has not been seen",
    cannot="a basin other than that of its first guess; J under measurement noise (too low)",
    run=_run, options=frozenset({"law", "order", "delay"}),
)
