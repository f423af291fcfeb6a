"""Method `arx`, the paper as published: ARX of given order, particle swarm over (S, J), 0 < S <= S_max, 0 <= J <= S.

For given (S, J) the position follows from the command with u_v(0) = u(0). The ARX coefficients then follow by linear
least squares (Eq. 18); the swarm minimises the mean squared one-step error (Eq. 19). Signals are deviations from the
mean of the samples used, since Eq. 9 has no constant. A free-run process is added for the curves; S and J stay as
found.

Wrong with measurement noise: the one-step error then pulls J low. Wrong where the start of the valve matters: u_v(0) =
u(0) can lock the model in a false stuck state. See docs/details.md, sections 6.1 and 6.2. Source: Shang et al., Eq. 7
to 21 with the misprints corrected as in fit/points/arx_cost.py.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit.context import Run
from ..fit.fit import finish_fit
from ..fit.points.arx_cost import Arx, check_rows, continuous_process
from ..fit.starts.basins import with_process
from ..model.model import Model
from ..model.response import J_OVER_S, S_OVER_S_MAX
from ..model.spec import INTEGRATOR, Spec
from ..numerics.population import swarm
from ..typing import FloatArray
from .contract import Method, Outcome, Process


def _run(run: Run) -> Outcome:
    model = run.model(Spec(law=run.law))
    check_rows(model.good(), run.order)
    arx = Arx(model, run.order, run.delays(), constant=False)
    middle = np.zeros(model.space.size)
    middle[2:5] = 0.5

    def cube_of(points: FloatArray) -> FloatArray:
        cube = middle[None].repeat(len(points), 0)
        cube[:, 0] = points[:, 0] / S_OVER_S_MAX
        cube[:, 1] = points[:, 1] / J_OVER_S
        return cube

    run.tell("searching (S, J) by particle swarm", 0.3)
    found = swarm(lambda c: arx.costs(model.values(cube_of(c)))[0], 2, run.rng, groups=4, particles=24, rounds=50)
    best = cube_of(found.points[:1])
    values = model.values(best)
    _, delay = arx.costs(values)
    a, b, mse = arx.coefficients(values[:, 0], int(delay[0]))
    gain, lags, integrating = continuous_process(a, b, run.loop.step_s)
    cube, costs = _free_run(run, model, cube_of(found.points), lags, int(delay[0]), integrating)
    fit = finish_fit(model if not integrating else run.model(Spec(law=run.law, process=INTEGRATOR, increments=True)),
                     cube, costs, run.rng, rounds=1, holdout=False)
    exact = replace(fit, values=np.concatenate([values[:3, 0], fit.values[3:]]))
    near = np.abs(found.points - found.points[0]).max(axis=1) < 0.02
    exact = replace(exact, best=exact.model.evaluate(exact.values), runs=4, agree=int(min(4, max(1, near.sum() // 12))))
    step = run.step(exact, None)
    step = replace(step, error=replace(step.error, rmse_one_step=float(np.sqrt(mse))),
                   model={**step.model, "arx": {"a": a.tolist(), "b": b.tolist(), "delay": int(delay[0])}})
    return Outcome((step,), (exact,), Process(gain, lags, float(delay[0]) * run.loop.step_s, integrating))


def _free_run(run: Run, model: Model, cube: FloatArray, lags: tuple[float, ...], delay: int,
              integrating: bool) -> tuple[FloatArray, FloatArray]:
    """A free-run process for the ARX answer, for the curves; S and J stay as ARX found them."""
    target = model if not integrating else run.model(Spec(law=run.law, process=INTEGRATOR, increments=True))
    values = model.values(cube[:1])
    values[3] = np.clip(max(lags, default=run.loop.step_s), 0.03 * run.loop.step_s, 19 * run.period_s)
    values[4] = delay * run.loop.step_s
    points = with_process(target, target.cube(values))
    return points, target.costs(points)


METHOD = Method(
    name="arx",
    summary="Shang et al. exactly: ARX by least squares, particle swarm over (S, J)",
    equation="A(q) y = q^-tau B(q) u_v(S, J) + xi; min over (S, J) of Eq. 19, S <= S_max, J <= S",
    source="Shang et al., Eq. 7 to 21",
    checked="print read; misprints corrected as in arx.py",
    cannot="J under measurement noise (too low); a start other than u_v(0) = u(0)",
    run=_run, options=frozenset({"law", "order", "delay"}),
)
