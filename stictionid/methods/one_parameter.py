"""Method `one-parameter`: Stenman's law with S = J = d on a grid of d, ARMAX with a scan of the delay, order by AIC.

Every d of a grid up to S_max gives a valve position (u_v(0) = u(0)) and, by least squares without C, a delay and an
error. The cost is jagged in d, so the grid is fine. For the best tenth an ARMAX model of every order is fitted, and AIC
chooses the order. The d with the smallest AIC is the answer, after a finer grid around it.

Wrong wherever J differs from S: d then lands between them or beside both. Wrong where the record does not start right
after a jump: u_v(0) = u(0) then locks the valve out of step (docs/details.md, section 6.1). Like every method that uses
the one-step error it takes noise for dynamics when the record is sampled fast. Source: Srinivasan, Rengaswamy,
Narasimhan and Miller 2005; ARMAX is Shang et al., Eq. 4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import CannotTell
from ..fit.context import Run
from ..fit.points.arx_cost import Arx, check_rows
from ..model.model import Model
from ..model.spec import Spec
from ..numerics.armax import Armax, Regression, armax
from ..typing import FloatArray
from .contract import Method, Outcome

# Points of the first grid over d, how many of them get an ARMAX model, and points of the finer grid around the best.
_GRID, _KEPT, _FINE = 400, 40, 21
# Orders tried where none is given.
_ORDERS = (1, 2, 3)


def _run(run: Run) -> Outcome:
    model = run.model(Spec(law=run.law))
    delays = run.delays()
    orders = (run.options.order,) if run.options.order else _ORDERS
    check_rows(model.good(), max(orders))
    first = max(model.skip, max(orders) + max(delays) + 1)
    run.tell("scanning d", 0.2)
    coarse = np.linspace(0.0, run.s_max, _GRID + 1)[1:]
    best, fit = _scan(model, coarse, orders, delays, first)
    if fit is None:
        raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                         code="valve-never-moves")
    run.tell("scanning d more finely", 0.6)
    cell = run.s_max / _GRID
    near = np.linspace(max(best - cell, 0.01 * run.s_max), min(best + cell, run.s_max), _FINE)
    finer, better = _scan(model, near, (fit.a.size,), delays, first)
    if better is not None and better.aic <= fit.aic:
        best, fit = finer, better
    held = run.with_valve(best, best)
    step = run.step(held, None)
    step = replace(step, error=replace(step.error, rmse_one_step=float(np.sqrt(fit.sse / max(fit.rows, 1)))),
                   model={**step.model, "armax": {"a": fit.a.tolist(), "b": fit.b[:, 0].tolist(),
                                                  "c": fit.c.tolist(), "delay": fit.delay}})
    return Outcome((step,), (held,))


def _scan(model: Model, sizes: FloatArray, orders: tuple[int, ...], delays: tuple[int, ...],
          first: int) -> tuple[float, Armax | None]:
    """The size d of a grid with the smallest AIC, and its model; no model where no valve moves."""
    values = np.zeros((model.space.size, sizes.size))
    values[0] = values[1] = sizes
    positions = model.positions(values)
    cost, delay = Arx(model, max(orders), delays).costs(values)
    best: tuple[float, Armax | None] = (0.0, None)
    for i in np.argsort(cost, kind="stable")[:_KEPT]:
        if not np.isfinite(cost[i]):
            break
        regression = Regression(model.context.process_value, positions[:, i], good=model.good())
        for order in orders:
            fit = armax(regression, order=order, delay=int(delay[i]), first=first)
            if np.isfinite(fit.sse) and (best[1] is None or fit.aic < best[1].aic):
                best = float(sizes[i]), fit
    return best


METHOD = Method(
    name="one-parameter",
    summary="Stenman's law, grid over d, ARMAX with delay scan and order by AIC",
    equation="A(q) y = B(q) q^-tau u_v(d) + C(q) xi; d with the smallest AIC, S = J = d",
    source="Srinivasan, Rengaswamy, Narasimhan and Miller 2005",
    checked="reconstructed from the descriptions of it; the print has not been seen",
    cannot="J other than S",
    run=_run, options=frozenset({"order", "delay"}), law="stenman",
)
