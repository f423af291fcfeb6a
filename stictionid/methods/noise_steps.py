"""The noise as a step of its own: an autoregression of the output error, where nothing else is left to explain.

Source: METHODS.md sections 4 (trap 2) and 5; the paper's C(q) polynomial.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit import Fitted, descended
from ..results import Step
from ..spec import Spec
from ..whitened import Whitened, whitened
from .added_steps import STEP_BIC, try_step
from .run import ADEQUATE, Run
from .structure import LAG

# A noise of its own has no root beyond this: slower, it is a disturbance. Unit: 1.
NOISE, _SLOWEST_ROOT = "coloured-noise", 0.97
# Its innovations have no kurtosis beyond this (3 if normal), and no stretch of so many is louder by more than this.
_HEAVY, _UNEVEN, _STRETCHES = 4.5, 2.0, 10
# Below this share of the scatter of y an error is no noise of a plant.
_NO_NOISE = 0.002


def try_noise(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """An autoregression of the output error as a step of its own, where nothing but noise is left to explain.

    That is where the one-step error with it reaches what a free linear model of y and valve position reaches. Noise
    taken for white bends the process, and through it S, J and the order; so all of them are searched anew with it.
    Slow waves (a root near 1) are left to `diagnose`: drift and disturbances look like noise, too.
    """
    before = fits[-1]
    spec = before.model.spec
    if spec.taps or NOISE in spec.effects or before.best.rmse < _NO_NOISE * float(np.std(run.used_y())):
        return
    local = whitened(before.model, before.values)
    if not local.order or _slowest(local) > _SLOWEST_ROOT or not _even(local, 2.0):
        return
    base = tuple(name for name in fits[0].model.spec.effects)
    found = _noisy(run, replace(spec, effects=(*base, NOISE)), local)
    some, made = [run.step(found, NOISE)], [found]
    if LAG not in base:
        try_step(run, some, made, LAG)
    last = whitened(made[-1].model, made[-1].values)
    floor = run.floor(made[-1].best.position_means, made[-1].best.values["dead_time_s"])
    if floor is None or last.innovation_sd > ADEQUATE * floor or _slowest(last) > _SLOWEST_ROOT or not _even(last):
        return
    if last.order:
        made[-1] = _noisy(run, made[-1].model.spec, last)
        some[-1] = run.step(made[-1], some[-1].added)
    one_step, now = fits[-1].sse / max(fits[-1].best.rows, 1), made[-1].sse / max(made[-1].best.rows, 1)
    rows, more = made[-1].best.rows, len(made[-1].values) - len(fits[-1].values) + last.order
    if rows * float(np.log(one_step / now)) - more * float(np.log(rows)) > STEP_BIC:
        # What was added for white noise gives way to what coloured noise asks for.
        steps[1:], fits[1:] = some, made


def _noisy(run: Run, spec: Spec, noise: Whitened) -> Fitted:
    """The fit of a spec with the noise model of a whitened model, from that model's own point and from nothing."""
    noisy = replace(spec, taps=tuple(noise.model.spec.taps))
    model = run.model(noisy)
    start = model.cube(model.vector(noise.model.named(noise.values))[:, None])
    local = descended(model, start)
    return run.fit(noisy, before=(local.points, local.costs))


def _even(noise: Whitened, slack: float = 1.0) -> bool:
    """Whether innovations look like noise all along: no heavy tails, no stretch much louder than another.

    `slack` widens both limits: before the model was fitted with the noise its slips, too, are in the innovations.

    What physics leaves unexplained sits in places (at a travel limit, after a step, at the slips): a kurtosis of 9.6
    and a ratio of 12 were met where a travel limit was missing, 3.2 and 1.6 at most in simulated coloured noise.
    """
    x = noise.innovation[noise.good]
    loud = [float(np.mean(part**2)) ** 0.5 for part in np.array_split(x, _STRETCHES)]
    tails = float(np.mean(x**4)) / max(float(np.mean(x**2)) ** 2, 1e-300)
    return tails <= slack * _HEAVY and max(loud) <= slack * _UNEVEN * min(loud)


def _slowest(noise: Whitened) -> float:
    """The largest root of a noise model, by modulus."""
    return float(np.abs(np.roots(np.concatenate([[1.0], noise.model.spec.taps]))).max()) if noise.order else 0.0
