"""The noise as a step of its own: white, an autoregression of the output error, or a random walk, as the data ask.

Only where nothing else is left to explain: the one-step error with the noise reaches what a free linear model of y and
valve position reaches. Noise taken for white bends the process, and through it S, J and the order; so all of them are
searched anew with it. Slow waves are left to `diagnose`: drift and disturbances look like noise, too.
Source: METHODS.md sections 4 (trap 2) and 5; the paper's C(q) polynomial; Karra and Karim for the walk.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit.add_effect import added
from ..fit.context import WALK, Run
from ..fit.fit import Fitted
from ..fit.moves import descended
from ..fit.noise.prewhitening import ORDER, Whitened, whitened, with_taps
from ..fit.starts.intersample import surely_moves
from ..model.spec import FIRST_ORDER, Spec
from ..numerics.autoregression import CEILING_LAGS, autoregression, filtered
from ..record.loop import Finding
from ..record.study import Step
from .added_steps import STEP_BIC, try_step
from .only_noise import SLOWEST_ROOT, even, only_noise, own_noise, slowest
from .structure import LAG

NOISE = "coloured-noise"
# A walk whose differences have no slower root than this: weaker ones look like a missing effect in a loop that cycles
# (roots of 0.6 to 0.8 met with a drifting valve, a nonlinear gain, a ramp; 0.3 with a walk as strong as the noise).
# It must also lower the one-step error of an autoregression at the white fit by this share. Unit: 1.
_WALK_ROOT, _WALK_DROP = 0.5, 0.05
# Nor does a noise model let the free run go: coloured noise bends a fit that takes it for white, and the right model
# may run freely a little worse than that one does (1.15 times met at a root of 0.95 in 800 samples), not more.
_FREE_RUN = 1.3
# Where no model explains the level, the BIC and the share of the held-out error by which the valve must help to predict
# changes of y (CRITICISM.md section 7, step 7: "named"; as for every step of its own).
_DRIVEN, _PREDICTS = 50.0, 0.03
# Below this share of the scatter of y an error is no noise of a plant.
_NO_NOISE = 0.002


def try_noise(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """An autoregression of the output error, or else a random walk under it, as a step of its own."""
    before = fits[-1]
    spec = before.model.spec
    known = {NOISE, WALK} & set(spec.effects)
    if spec.taps or known or before.best.rmse < _NO_NOISE * float(np.std(run.used_y())):
        return
    local = whitened(before.model, before.values)
    if local.order and not _try_autoregression(run, steps, fits, local):
        _try_walk(run, steps, fits, local)


def try_walk_alone(run: Run, steps: list[Step], fits: list[Fitted]) -> None:
    """A random walk as a step of its own where no model explains the level: y strays as far as it moves otherwise, and
    only changes of y can show the valve.

    It must predict them clearly better than their own past does, which is all that a walk without a valve has.
    """
    spec = fits[-1].model.spec
    if run.options.fixed or {NOISE, WALK} & set(spec.effects):
        return
    if run.options.between == "auto" and not surely_moves(run.loop):
        spec = replace(spec, between="hold", substeps=1)
    counted = np.isfinite(run.loop.process_value) & run.loop.used
    changes, good = filtered(run.loop.process_value, counted, np.array([1.0, -1.0]), run.loop.starts)
    good[list(run.loop.starts)] = False
    taps = autoregression(changes, good, ORDER, run.loop.starts)
    past, good = filtered(changes, good, np.concatenate([[1.0], taps]), run.loop.starts)
    error = float(np.sqrt(np.mean(past[good]**2)))
    first = run.fit(replace(spec, process=FIRST_ORDER, effects=(*_valve(fits), WALK), increments=True,
                            taps=tuple(taps.tolist())))
    some, made = _refitted(run, first.model.spec, whitened(first.model, first.values), WALK)
    last = with_taps(made[-1].model, made[-1].values, np.asarray(made[-1].model.spec.taps))
    rows, more = float(made[-1].best.rows), last.values.size + last.order - taps.size
    gain = 2.0 * rows * float(np.log(error / max(last.innovation_sd, 1e-300))) - more * float(np.log(rows))
    held_out = made[-1].rmse_holdout
    if gain > _DRIVEN and held_out is not None and held_out < (1.0 - _PREDICTS) * error:
        _take(steps, fits, some, made, last)


def ask_noise(run: Run, steps: list[Step], fits: list[Fitted], name: str) -> None:
    """The noise effect that was asked for as a step of its own, whether or not the data speak for it."""
    fits.append(added(fits[-1], name, run.rng))
    steps.append(run.step(fits[-1], name))


def _try_autoregression(run: Run, steps: list[Step], fits: list[Fitted], local: Whitened) -> bool:
    """Whether an autoregression became a step; `local` is the last fit completed with one."""
    if slowest(local) > SLOWEST_ROOT or not even(local, 2.0):
        return False
    some, made = _refitted(run, replace(fits[-1].model.spec, effects=(*_valve(fits), NOISE)), local, NOISE)
    last = own_noise(run, made[-1])
    if last is None or last.rmse > _FREE_RUN * fits[-1].best.rmse:
        return False
    if last.order:
        _settle(run, some, made, last)
    one_step, now = fits[-1].sse / max(fits[-1].best.rows, 1), made[-1].sse / max(made[-1].best.rows, 1)
    rows, more = made[-1].best.rows, len(made[-1].values) - len(fits[-1].values) + last.order
    if not rows * float(np.log(one_step / now)) - more * float(np.log(rows)) > STEP_BIC:
        return False
    _take(steps, fits, some, made, last)
    return True


def _try_walk(run: Run, steps: list[Step], fits: list[Fitted], local: Whitened) -> None:
    """A random walk as a step, where it is strong enough to be told from a missing effect.

    Model and data are fitted in differences; what white measurement noise does to these is an autoregression whose
    roots lie nearer to 0 the stronger the walk is. `local` is the rival, an autoregression of the level.
    """
    spec = fits[-1].model.spec
    if spec.increments or spec.process != FIRST_ORDER:
        return
    walking = replace(spec, effects=(*_valve(fits), WALK), increments=True, taps=())
    model = run.model(walking)
    first = whitened(model, model.vector(fits[-1].best.values))
    if slowest(first) > _WALK_ROOT:
        return
    some, made = _refitted(run, walking, first, WALK)
    last = only_noise(run, made[-1])
    if last is None or slowest(last) > _WALK_ROOT:
        return
    if last.innovation_sd < (1.0 - _WALK_DROP) * local.innovation_sd:
        _settle(run, some, made, last)
        _take(steps, fits, some, made, last)


def _refitted(run: Run, spec: Spec, noise: Whitened, name: str) -> tuple[list[Step], list[Fitted]]:
    """Steps and fits of a spec searched anew with a noise model, a further lag among them where it helps."""
    found = _noisy(run, spec, noise)
    some, made = [run.step(found, name)], [found]
    if LAG not in spec.effects:
        try_step(run, some, made, LAG)
    return some, made


def _settle(run: Run, some: list[Step], made: list[Fitted], last: Whitened) -> None:
    """The last fit searched anew with the noise that it asks for itself; the first, searched from nothing already, only
    where that is another one."""
    if len(made) == 1 and last.model is made[0].model:
        return
    made[-1] = _noisy(run, made[-1].model.spec, last)
    some[-1] = run.step(made[-1], some[-1].added)


def _valve(fits: list[Fitted]) -> tuple[str, ...]:
    """The effects of the last fit without a lag that was added: the noise, taken for white, bends the process."""
    base = fits[0].model.spec.effects
    return tuple(name for name in fits[-1].model.spec.effects if name in base or name != LAG)


def _take(steps: list[Step], fits: list[Fitted], some: list[Step], made: list[Fitted], noise: Whitened) -> None:
    """Put the steps with a noise model in place: what was added for white noise gives way to what this noise asks for.
    """
    taps, sd = np.asarray(made[-1].model.spec.taps), noise.innovation_sd
    how = ("white steps that add up (standard deviation "
           f"{sd / abs(1.0 + float(taps.sum())):.3g} a sample) under measurement noise"
           if made[-1].model.spec.increments else f"an autoregression of order {taps.size}")
    if (pace := made[-1].model.pace) > 1.0:
        how += f", from one PV to the next, which is {pace * made[-1].model.step_s:.3g} s on average,"
    floor = some[-1].error.noise_sd
    said = Finding("noise-model", "info",
                   f"the noise is not white but {how}: the one-step error with it is {sd:.4g}, the irreducible noise "
                   f"{floor:.4g} by a free linear model of y and valve position ({CEILING_LAGS} lags of each)",
                   {"innovation_sd": sd, "noise_sd": floor, "order": int(taps.size),
                    "kind": "random walk" if made[-1].model.spec.increments else "autoregression"}, (),
                   "METHODS.md section 4, trap 2")
    some[-1] = replace(some[-1], findings=(*some[-1].findings, said))
    kept = 1 + sum(fit.model.spec.effects == _valve(fits) for fit in fits[1:])
    steps[kept:], fits[kept:] = some, made


def _noisy(run: Run, spec: Spec, noise: Whitened) -> Fitted:
    """The fit of a spec with the noise model of a whitened model, from that model's own point and from nothing."""
    noisy = replace(spec, taps=tuple(noise.model.spec.taps))
    model = run.model(noisy)
    start = model.cube(model.vector(noise.model.named(noise.values))[:, None])
    local = descended(model, start)
    return run.fit(noisy, before=(local.points, local.costs))
