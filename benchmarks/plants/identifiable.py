"""Identifiability of a hidden effect: loss in BIC of the true model, fitted to the exported samples, without it.

The true specification is polished from the true values. The one without the effect is polished from there, from other
lags, and by one search of its own. An effect whose loss is below `MARGIN` can't be asked for.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.signal import lfilter

from stictionid.effects import get
from stictionid.fit.fit import one_run
from stictionid.fit.noise.completion import Refit, better_refit, complete_quickly
from stictionid.fit.points.moves import descend_model, first_force
from stictionid.model.model import Model
from stictionid.model.segments import bind_model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.loop import Loop
from stictionid.record.oscillation import find_range
from stictionid.record.preconditions import swing_of, time_scale_s
from stictionid.selection.node import node

from .design import plain
from .draw import Plant
from .score import NOISES, loop_of
from .simulate import INERTIAL, FloatArray

MARGIN = 50.0
_FORCES = np.linspace(-0.98, 0.98, 99)
_LAGS = np.array([1.0, 1.5, 2.5])
# Numbers of a noise model, as BIC counts them.
_NUMBERS = 2
# Restick speed of a valve that rests at every scan, in %/s.
_ALWAYS = 1e9
# Stribeck velocities below which a stem sticks and slips.
_STRIBECKS = 3.0


def losses(plant: Plant) -> tuple[dict[str, float], float, float]:
    """Loss in BIC of dropping each hidden effect from the true model; that model's error over the noise, and its S.

    S is given as its relative error. Nothing that is fitted to these samples can be expected to come closer.
    """
    loop, noise = loop_of(plant), _noise_of(plant)
    effects = _true_effects(plant)
    whole = _completed(loop, plant, effects, noise)
    sd = max(float(plant.record.noise.std()), plant.truth["noise_sd"])
    lost = {name: _loss(loop, plant, effects, whole, name) for name in plant.setting.effects}
    return lost, whole.evaluated.rmse / sd, whole.evaluated.values["S"] / plant.truth["S"] - 1.0


def true_model(plant: Plant) -> tuple[Model, FloatArray, float]:
    """The true model fitted from the true values, in the form in which it is searched; its values (d,), and the noise.

    An integrator is searched in differences of y.
    """
    whole = _completed(loop_of(plant), plant, _true_effects(plant), _noise_of(plant))
    before = whole.model
    model = bind_model(before.loop, node(before.spec), s_max=before.s_max, period_s=before.period_s,
                       residual=whole.evaluated.left)
    values = model.vector(before.named(whole.values))
    return model, values, max(float(plant.record.noise.std()), plant.truth["noise_sd"])


def error_with_scans(plant: Plant) -> float | None:
    """Error over the noise of the true model under the true command at every scan; None for a command that moves.

    Beside the error of the true model it tells what the exported samples lack: the command between them.
    """
    if plant.setting.moving:
        return None
    loop = loop_of(plant)
    fitted = _fitted(loop, plant, _true_effects(plant), search=False, command=plant.record.command)
    return fitted[0].evaluate(fitted[1]).rmse / max(float(plant.record.noise.std()), plant.truth["noise_sd"])


def error_without_hidden_noise(plant: Plant) -> float | None:
    """Error over the noise of the true model under the true command less what noise at unseen scans did to it.

    No rebuilding of the scans can do better: that noise is in no sample. None for a command that moves, one exported
    at its scans, and a controller with a gap, which is not linear.
    """
    setting, controller = plant.setting, plant.setting.controller
    if setting.moving or setting.export == 1 or controller.gap:
        return None
    scan = np.arange(setting.setpoint.size)
    seen = scan % setting.export == 0
    lost = np.where(seen, 0.0, plant.record.scan_noise - np.interp(scan, scan[seen], plant.record.scan_noise[seen]))
    did = controller.gain * lost
    if controller.integral_time_s:
        did += controller.gain * np.cumsum(lost) / controller.integral_time_s
    if controller.derivative_time_s:
        keep = np.exp(-1.0 / controller.filter_s)
        smooth = lfilter([1.0 - keep], [1.0, -keep], lost)
        did += controller.gain * controller.derivative_time_s * np.diff(smooth, prepend=0.0)
    # The samples show the output itself, so that what is left of it begins and ends there.
    did -= np.interp(scan, scan[seen], did[seen])
    fitted = _fitted(loop_of(plant), plant, _true_effects(plant), search=False, command=plant.record.command + did)
    return fitted[0].evaluate(fitted[1]).rmse / max(float(plant.record.noise.std()), plant.truth["noise_sd"])


def _loss(loop: Loop, plant: Plant, effects: dict[str, dict[str, Any]], whole: Refit, name: str) -> float:
    if name in NOISES:
        # The noise itself tells best: a true model fitted to slow samples leaves errors that a noise model takes up.
        rows, variance = plant.record.noise.size, plant.truth["innovation_sd"] ** 2
        whole_variance = float(np.var(plant.record.noise)) + plant.setting.rounding**2 / 12.0
        return rows * float(np.log(whole_variance / variance)) - _NUMBERS * float(np.log(rows))
    rest = {n: v for n, v in effects.items() if plain(n) != name}
    loss = float(whole.gain_over(_completed(loop, plant, rest, _noise_of(plant))))
    if loss < MARGIN:
        return loss
    return min(loss, float(whole.gain_over(_completed(loop, plant, rest, _noise_of(plant), search=True))))


def _completed(loop: Loop, plant: Plant, effects: dict[str, dict[str, Any]], noise: str, *,
               search: bool = False) -> Refit:
    """A specification fitted and completed with its noise; for an integrator in levels or in differences of y.

    Errors of slips add up in an integrator. Differences, softened by the noise model, leave them behind.
    """
    found = complete_quickly(*_fitted(loop, plant, effects, search=search), noise=noise)
    if not plant.setting.process.integrating:
        return found
    other = complete_quickly(*_fitted(loop, plant, effects, search=search, increments=True), noise=noise)
    return better_refit(found, other)


def _noise_of(plant: Plant) -> str:
    """Noise model of the truth; an autoregression where no other is hidden (of order 0 for white noise)."""
    kinds = [get(name).noise for name in plant.setting.effects if name in NOISES]
    return next((kind for kind in kinds if kind), "autoregressive")


def _true_effects(plant: Plant) -> dict[str, dict[str, Any]]:
    """Effects of the true model as a specification spells them; noise is left to the completion."""
    out: dict[str, dict[str, Any]] = {}
    for name, given in plant.setting.effects.items():
        if name in NOISES:
            continue
        values = {key: value for key, value in given.items() if key != "at"}
        spelt = f"{name}@{given['at']}" if "at" in given else name
        out[f"{name}:D1" if name == "measured-disturbance" else spelt] = values
    second = plant.setting.process.second_time_constant_s
    if second:
        out.setdefault("extra-lag", {"second_time_constant_s": second})
    if plant.truth["rests"]:
        # Under a moving command a stem with mass slides where the command is much faster than the Stribeck velocity.
        slides = plant.setting.moving and plant.setting.valve.kind == INERTIAL
        speed = _STRIBECKS * plant.setting.valve.stribeck if slides else _ALWAYS
        out.setdefault("re-sticking", {"restick_speed": speed})
    return out


def _bound(loop: Loop, plant: Plant, effects: dict[str, dict[str, Any]], increments: bool,
           command: FloatArray | None) -> Model:
    n, found = plant.setting.export, find_range(loop)
    between, parts = ("corner", 8) if plant.setting.moving else ("decimated", min(n, 10)) if n > 1 else ("hold", 1)
    process = INTEGRATOR if plant.setting.process.integrating else FIRST_ORDER
    spec = Spec(process=process, effects=tuple(effects), between=between if command is None else "hold",
                substeps=parts if command is None else n, increments=increments)
    return bind_model(loop, spec, s_max=max(swing_of(loop, found), plant.truth["S"]),
                      period_s=time_scale_s(loop, found), command=command)


def _fitted(loop: Loop, plant: Plant, effects: dict[str, dict[str, Any]], *, search: bool, increments: bool = False,
            command: FloatArray | None = None) -> tuple[Model, Any]:
    """A specification polished from the true values, or by a search of its own where that is better.

    `command` (scans,) takes the place of the one that the specification rebuilds between samples.
    """
    model = _bound(loop, plant, effects, increments, command)
    S, J = plant.truth["S"], plant.truth["J"]
    values: dict[str, float] = {}
    for name, given in effects.items():
        effect = get(plain(name))
        parameters, numbers = effect.parameters_for(model.context), dict(given)
        if effect.setting:
            theta, S, J = effect.setting(given, S, J)
            numbers |= dict(zip((p.name for p in parameters), theta[:, 0], strict=True))
        values |= {f"{name}:{p.name}": float(numbers.get(p.name, p.neutral)) for p in parameters}
    process = plant.setting.process
    values |= {"S": S, "J": J, "initial_residual_force": 0.0, "time_constant_s": process.time_constant_s,
               "dead_time_s": process.dead_time_s}
    starts = model.vector(values)[:, None].repeat(_LAGS.size, axis=1)
    starts[3] *= _LAGS
    points = np.clip(model.cube(starts), 0.0, 1.0)
    found = descend_model(model, first_force(model, points, _FORCES)[0])
    point, cost = found.points[0], float(found.costs[0])
    if search:
        other, its = one_run(model, np.random.default_rng(0))
        point = other if its < cost else point
    return model, model.values(point[None])[:, 0]
