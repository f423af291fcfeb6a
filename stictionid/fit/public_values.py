"""Fitted parameters of effects under the names of the command line and the JSON, sizes and noise included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import parse
from ..model.model import Model
from ..model.spec import Evaluated
from ..record.study import ParameterValue
from ..typing import FloatArray
from .noise.load import LOAD, residual_load
from .points.fitted import Fitted

# Costs that differ by no more than this share belong to the same valve path.
_SAME = 1e-9


def values_of(name: str, model: Model, values: FloatArray, evaluated: Evaluated) -> dict[str, float]:
    """Public values of one physical effect, from its searched and its linear parameters."""
    effect, _ = parse(name)
    named = model.named(values)
    mine = {k.rpartition(":")[2]: v for k, v in named.items() if k.startswith(name + ":")}
    y, counted = model.context.process_value, model.context.process_value[model.good()]
    ends = {"lowest": float(y.min()), "highest": float(y.max()),
            "lowest_counted": float(counted.min(initial=np.inf)),
            "highest_counted": float(counted.max(initial=-np.inf))}
    return effect.public_values(mine, model.sizes_of(name, values, evaluated.own),
                                {**named, "length_s": model.context.length_s, **ends})


def noise_values(name: str, model: Model, evaluated: Evaluated, taps: FloatArray, increments: bool,
                 innovation_sd: float) -> dict[str, float]:
    """A noise effect's public numbers from the autoregression (taps after the leading 1) of a model's residual."""
    kind, step_s, pace = parse(name)[0].noise, model.step_s, model.pace
    polynomial = np.concatenate([[1.0], taps])
    if kind == LOAD:
        load = residual_load(model, evaluated, increments)
        return {} if load is None else {
            "root": load.root, "innovation_sd": innovation_sd / load.scale / max(abs(evaluated.gain), 1e-12)}
    if kind == "random-walk":
        # The walk's steps are what is left of the differences at frequency zero.
        return {"innovation_sd": innovation_sd / max(abs(float(polynomial.sum())), 1e-12) / float(np.sqrt(pace))}
    roots = np.roots(polynomial) if taps.size else np.zeros(1)
    if kind == "resonant":
        turning = roots[np.abs(roots.imag) > 1e-9]
        if turning.size:
            z = turning[np.abs(turning).argmax()]
            period = 2.0 * np.pi / abs(float(np.angle(z))) * step_s * pace
            forgets = -step_s * pace / max(np.log(max(abs(z), 1e-9)), -50.0) if abs(z) < 1.0 else np.inf
            return {"period_s": period, "coherence_cycles": float(forgets / period)}
        return {}
    largest = roots[np.abs(roots).argmax()]
    return {"root": float(np.sign(largest.real) * abs(largest) ** (1.0 / pace)), "innovation_sd": innovation_sd}


def rows_for(name: str, numbers: dict[str, float]) -> tuple[ParameterValue, ...]:
    """Rows of a study for the values of an effect."""
    known = {p.name: p for p in parse(name)[0].parameters}
    return tuple(ParameterValue(parse(name)[0].name, key, value, known[key].unit if key in known else "",
                                meaning=known[key].meaning if key in known else "")
                 for key, value in numbers.items())


def rows_in(name: str, model: Model, values: FloatArray, evaluated: Evaluated) -> tuple[ParameterValue, ...]:
    """Rows for the values of one physical effect in a model; those that change nothing in it are not identifiable."""
    idle = _idle_parameters(model, values)
    return tuple(replace(row, identifiable=f"{name}:{row.name}" not in idle)
                 for row in rows_for(name, values_of(name, model, values, evaluated)))


def public_parameters(fit: Fitted, rows: Sequence[ParameterValue]) -> tuple[ParameterValue, ...]:
    """A step's rows with every effect's public values; intervals stay where a value was searched itself."""
    out = [r for r in rows if r.effect is None]
    model = fit.model
    innovation = float(np.sqrt(fit.sse / max(fit.best.rows, 1)))
    idle = _idle_parameters(model, fit.values)
    for name in model.spec.effects:
        if parse(name)[0].noise is not None:
            numbers = noise_values(name, model, fit.best, np.array(model.spec.taps), model.spec.increments, innovation)
        else:
            numbers = values_of(name, model, fit.values, fit.best)
        searched = {r.name: r for r in rows if r.effect == name}
        for row in rows_for(name, numbers):
            old = searched.get(row.name)
            if f"{name}:{row.name}" in idle:
                out.append(replace(row, identifiable=False))
            else:
                out.append(replace(row, interval=old.interval, at_bound=old.at_bound) if old else row)
    return tuple(out)


def _idle_parameters(model: Model, values: FloatArray) -> set[str]:
    """Parameters of effects that change nothing in the model of values (d,), such as a limit that the stem never meets.
    """
    neutral = [(f"{name}:{p.name}", at, p.neutral)
               for name, effect, rows in zip(model.names, model.effects, model.effect_rows, strict=True)
               for at, p in enumerate(effect.parameters_for(model.context), rows.start)]
    if not neutral:
        return set()
    trial = np.repeat(values[:, None], 1 + len(neutral), axis=1)
    for lane, (_, at, value) in enumerate(neutral, 1):
        trial[at, lane] = value
    costs = model.costs_of(trial).tolist()
    # (a valve that never moves has an infinite cost, whatever its effects)
    return {name for (name, _, _), cost in zip(neutral, costs[1:], strict=True)
            if cost == costs[0] or abs(cost - costs[0]) <= _SAME * costs[0]}
