"""Method `polynomial`: a Hammerstein model with a static polynomial and ARMAX, which cannot represent stiction.

The valve is u_v = sum_i gamma_i u^i (Eq. 3), the process ARMAX (Eq. 4). The products gamma_i b_j are fitted as free
parameters (Eq. 5, 6) and split by their singular value decomposition. A polynomial has no memory: it passes the same
position on the way up and on the way down. Its best fit of a sticking valve is nearly a straight line, and gives no S
and no J. The method returns the reason, with three free-run errors: the best first-order process behind a polynomial,
behind a straight line, and behind a valve that sticks.

The ARMAX model itself may come out unstable. In a closed loop without noise a regression of y on u finds the inverse of
the controller as readily as the process. Its poles are in the evidence. Source: Shang et al., Eq. 3 to 6; the split is
Bai 1998.
"""

from __future__ import annotations

import numpy as np

from ..fit.context import Run
from ..fit.fit import one_run
from ..fit.points.arx_cost import check_rows
from ..model.model import Model
from ..model.spec import Spec
from ..numerics.armax import Armax, Regression, armax
from ..numerics.population import refine
from ..process.linear import Dynamics, free_run, transient
from ..record.evidence import Evidence
from ..record.study import Verdict
from ..typing import FloatArray
from .contract import Method, Outcome

# Degree k of Eq. 3; higher ones only follow the noise within the swing of one cycle.
DEGREE = 3
_ORDERS = (1, 2, 3)
# Grid of time constants and dead times before the polish.
_GRID = 20
_LANES = 32


def _run(run: Run) -> Outcome:
    run.tell("fitting the polynomial", 0.3)
    model = run.model(Spec(law=run.law))
    u, good = model.context.command, model.good()
    centre, scale = float(u[good].mean()), float(np.ptp(u[good])) / 2.0
    powers = np.stack([((u - centre) / scale) ** i for i in range(1, DEGREE + 1)], axis=1)
    curved = _armax(run, model, powers)
    left, sizes, right = np.linalg.svd(curved.b, full_matrices=False)
    top = right[0][np.abs(right[0]).argmax()]
    run.tell("comparing with a line and with a sticking valve", 0.6)
    point, _ = one_run(model, run.rng)
    sticking = model.evaluate(model.values(point[None])[:, 0]).rmse
    errors = [_free_run_error(run, model, powers[:, :count]) for count in (DEGREE, 1)]
    evidence = Evidence(code="polynomial-has-no-memory", further={
        "gamma": (right[0] / top).tolist(), "gamma_of": f"((u - {centre:.6g}) / {scale:.6g})^i", "a": curved.a.tolist(),
        "b": (left[:, 0] * sizes[0] * top).tolist(), "c": curved.c.tolist(), "delay": curved.delay,
        "poles": sorted(np.abs(np.roots(np.concatenate([[1.0], curved.a]))).tolist(), reverse=True),
        "rmse_one_step": float(np.sqrt(curved.sse / max(curved.rows, 1))),
        "rmse_polynomial": errors[0], "rmse_straight_line": errors[1], "rmse_sticking": sticking,
    })
    reason = (f"a static polynomial has no memory, so it holds no S and no J: the free-run error is {errors[0]:.4g} "
              f"with a polynomial, {errors[1]:.4g} with a straight line, {sticking:.4g} with a sticking valve "
              f"({run.law}); use --method auto")
    return Outcome((), (), verdict=Verdict("undecided", reason, 0.0, evidence))


def _armax(run: Run, model: Model, inputs: FloatArray) -> Armax:
    """The ARMAX model with the smallest AIC over orders and delays, all on the same rows."""
    delays = run.delays()
    orders = (run.options.order,) if run.options.order else _ORDERS
    first = max(model.skip, max(orders) + max(delays) + 1)
    regression = Regression(model.context.process_value, inputs, good=model.good())
    check_rows(model.good(), max(orders))
    # The delay follows from plain least squares (no C), as cheap as it is decisive; the order from AIC.
    delay = min(delays, key=lambda d: armax(regression, order=max(orders), delay=d, noise_order=0, first=first).sse)
    return min((armax(regression, order=order, delay=delay, first=first) for order in orders), key=lambda f: f.aic)


def _free_run_error(run: Run, model: Model, inputs: FloatArray) -> float:
    """Free-run error in the unit of y of the best first-order process behind gamma_1 x_1 + ... of inputs (n, m)."""
    n, count = inputs.shape
    offsets = tuple(i * n for i in range(count + 1))

    def cost(points: FloatArray) -> FloatArray:
        cube = np.zeros((len(points), model.space.size))
        cube[:, 3:5] = points
        T, L = model.values(cube)[3:5]
        out = np.empty(len(points))
        for a in range(0, len(points), _LANES):
            lags = Dynamics(T[a:a + _LANES], L[a:a + _LANES], np.zeros(T[a:a + _LANES].size), False)
            base = np.empty(((count + 1) * n, lags.dead_time_s.size))
            for i in range(count):
                base[i * n:(i + 1) * n] = free_run(inputs[:, i:i + 1], lags, step_s=model.step_s)
            transient(lags.time_constant_s, base[count * n:], step_s=model.step_s)
            out[a:a + _LANES] = model.shared.costs(base, offsets)
        return out

    T, L = np.meshgrid(np.linspace(0.05, 0.95, _GRID), np.linspace(0.0, 0.95, _GRID), indexing="ij")
    grid = np.stack([T.ravel(), L.ravel()], axis=1)
    starts = grid[np.argsort(cost(grid), kind="stable")[:2]]
    best = refine(cost, starts, run.rng, spread=0.03, rounds=40, settle=1e-4)
    return float(np.sqrt(best.costs[0] / max(model.shared.rows, 1)))


METHOD = Method(
    name="polynomial",
    summary="Hammerstein with a static polynomial and ARMAX: the baseline that can't see stiction",
    equation="A(q) y = B(q) q^-tau sum_i gamma_i u^i + C(q) xi (Eq. 3 to 6)",
    source="Shang et al., Eq. 3 to 6",
    checked="print read",
    cannot="stiction: a static curve has no memory, so it gives neither S nor J",
    run=_run, options=frozenset({"order", "delay"}), gives=(),
)
