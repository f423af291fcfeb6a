"""Nodes of a search made without one: models at known values on short records, completed with their noise.

The record holds PV of a model at `TRUE` values plus chosen errors, so that the residual of each node is known.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from stictionid.fit.cross_validation import Held
from stictionid.fit.noise.completion import complete_quickly
from stictionid.model.closed_loop import Controller, Plant, Setting, simulate
from stictionid.model.model import Model
from stictionid.model.segments import bind_model
from stictionid.model.spec import FIRST_ORDER, INTEGRATOR, Spec
from stictionid.record.loop import Loop
from stictionid.selection.entry import Entry
from stictionid.selection.gates import GATES, Compared, Edge
from stictionid.selection.node import key
from stictionid.selection.policy import Policy
from stictionid.selection.score import Scored
from stictionid.selection.search import Search
from stictionid.typing import FloatArray

POLICY = Policy()
SAMPLES, PERIOD_S = 1500, 60.0
SETTINGS = {
    FIRST_ORDER: Setting(Plant(2.5, 17.0, 5.0), Controller(0.35, 14.0, scan_s=1.0), S=3.6, J=2.6),
    INTEGRATOR: Setting(Plant(0.02, 4.0, 3.0, integrating=True), Controller(1.5, 80.0, scan_s=1.0), S=3.6, J=2.6),
}
# Times in s and sizes in the unit of y: the setpoint moves up for 100 s, so that some strokes go further than others.
MOVES = ((0.0, 5.0), (700.0, 4.0), (800.0, -4.0))
Values = dict[str, float]


def true_values(process: str = FIRST_ORDER) -> Values:
    """Named values of the base that the records are made with."""
    setting = SETTINGS[process]
    return {"S": setting.S, "J": setting.J, "initial_residual_force": 0.3,
            "time_constant_s": setting.plant.time_constant_s, "dead_time_s": setting.plant.dead_time_s}


@cache
def simulated(process: str = FIRST_ORDER, samples: int = SAMPLES) -> Loop:
    """The closed loop without noise, whose output moves the models."""
    setting = replace(SETTINGS[process], duration_s=float(samples), setpoint_moves=MOVES)
    return replace(simulate(setting).loop, position=None)


def model_on(loop: Loop, spec: Spec, residual: FloatArray | None = None) -> Model:
    """A model of the given structure on a record."""
    return bind_model(loop, spec, s_max=8.0, period_s=PERIOD_S, residual=residual)


def recorded(errors: FloatArray, spec: Spec | None = None, values: Values | None = None) -> Loop:
    """A record whose PV is that of a model at its true values plus errors (n,)."""
    spec = spec or Spec()
    loop = simulated(spec.process, errors.size)
    model = model_on(loop, spec)
    true = model.evaluate(model.vector({**true_values(spec.process), **(values or {})}))
    return replace(loop, process_value=true.model + errors, used=np.isfinite(errors))


def scored(loop: Loop, spec: Spec | None = None, values: Values | None = None, *, full: bool = True) -> Scored:
    """A node at the true values, some of them changed, completed with the noise that its residual shows."""
    spec = spec or Spec()
    model = model_on(loop, spec)
    return Scored(complete_quickly(model, model.vector({**true_values(spec.process), **(values or {})})), full)


def holding(node: Scored, errors: Held) -> Scored:
    """The same node with these held-out errors."""
    node = replace(node)
    node.__dict__["held"] = errors
    return node


def search_among(*entries: Entry, policy: Policy = POLICY, only: frozenset[str] | None = None, slow: bool = False,
                 blurred: bool = False) -> Search:
    """A search that holds these nodes."""
    search = Search(entries[0].scored.done.model.loop, policy, 0, 1, lambda words, share: None, only=only, slow=slow,
                    blurred=blurred)
    search.memo.update({key(e.spec): e for e in entries})
    return search


def gate(name: str, edge: Edge) -> str:
    """Words of one gate; empty where it passes."""
    said = dict(GATES)[name](edge)
    return said.reason if isinstance(said, Compared) else said
