"""The base with a valve that rests at every scan, where a round leaves more than noise: an inertial stem under a held
command does, and neither it nor what else is missing explains the record alone.

Source: METHODS.md sections 2, 4 (trap 1) and 5; CRITICISM.md section 6 (two effects at once).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit.context import Run
from ..fit.fit import Fitted, as_it_stands
from ..fit.moves import descended
from ..fit.noise.completion import quick
from ..fit.starts.basins import with_process
from ..fit.starts.beside_effect import RESTING, undisturbed
from ..fit.starts.windows import resting_valves
from ..model.model import Model
from ..model.spec import FIRST_ORDER, INTEGRATOR, Spec
from ..typing import FloatArray
from .structure import SOFT

# Effects on how the valve moves that are tried together with the rest: beside one of these a valve that only rests
# fits nowhere.
_BESIDE = ((), ("asymmetric-stiction",), ("stiction-drift",), ("slew-limit",))
# BIC below the goal from which no other effect is tried beside the rest: what is only just below may be chance.
_CLEARLY = 50.0


def resting_valve(run: Run, fit: Fitted, goal: float, carried: tuple[float, float] | None = None) -> Fitted | None:
    """The base with a valve that rests, where that, or an effect on friction more, brings the BIC below a goal.

    The valve is found whatever the process does, and then the process that goes with it. None where the base has such
    a valve, or a command that moves between samples; or where S and J in % that a noise model has `carried` do as well.
    """
    spec = fit.model.spec
    if fit.model.law.sliding_state is None or not spec.held or spec.fixed or RESTING in spec.effects:
        return None
    found: list[tuple[float, Model, FloatArray]] = []
    for more in _BESIDE:
        if not set(more) & set(spec.effects):
            found += _with_processes(run, fit, more, carried)
        if carried and not found:
            return None
        if min((f[0] for f in found), default=np.inf) < goal - _CLEARLY:
            break
    best, model, values = min(found, key=lambda f: f[0], default=(np.inf, None, None))
    if best >= goal or model is None or values is None:
        return None
    bare = run.model(replace(model.spec, effects=(*spec.effects, RESTING)))
    return as_it_stands(bare, bare.vector(model.named(values)))


def _with_processes(run: Run, fit: Fitted, more: tuple[str, ...],
                    carried: tuple[float, float] | None) -> list[tuple[float, Model, FloatArray]]:
    """BIC, model and values (d,) of a valve that rests, with some effects on friction more, for each process."""
    names = (*fit.model.spec.effects, RESTING, *more)
    plain = undisturbed(run.model(_spec(fit.model.spec, fit.model.spec.process, names)), fit.model, fit.values)
    rivals = fit.values[:, None].repeat(2, axis=1)
    rivals[:2, 1] = rivals[:2, 0] if carried is None else carried
    valves = plain.values(resting_valves(plain, more, plain.rows_of(RESTING), run.rng, rival=(fit.model, rivals)))
    if not valves.size:
        return []
    known, out = fit.model.named(fit.values), []
    for process in (FIRST_ORDER, INTEGRATOR):
        model = run.model(_spec(fit.model.spec, process, names))
        starts = np.stack([model.vector({**known, **plain.named(column)}) for column in valves.T], axis=1)
        near = descended(model, with_process(model, model.cube(starts)))
        values = model.values(near.points[:1])[:, 0]
        completed = quick(model, values)
        out.append((completed.bic(completed.good), model, values))
    return out


def _spec(before: Spec, process: str, names: tuple[str, ...]) -> Spec:
    whole = process == INTEGRATOR
    return replace(before, process=process, effects=names, increments=whole, taps=SOFT if whole else (), guides=())
