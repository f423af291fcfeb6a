"""A p-value for the named effect: how often does the same look gain as much on records without it?

Replicates keep the command and the model's output and draw new innovations; the base is polished again on each, and the
effect gets the same first look. A neutral value on the edge of its range makes χ² wrong, so p comes from here or is not
given. Source: docs/details.md, section 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..fit.noise.completion import complete_quickly
from ..fit.noise.draws import draw_residual
from ..fit.points.fitted import as_it_stands
from ..fit.points.moves import descend_model, with_start
from ..model.segments import bind_model
from ..typing import Progress
from .crew import Crew
from .entry import Entry
from .looks import Ground, Packed, Task, look_at
from .node import node, with_effect
from .score import point_in_search_form
from .search import Search


def p_of(search: Search, parent: Entry, name: str, count: int, tell: Progress) -> float:
    """The share of `count` records without an effect on which a first look at it gains as much as on this one."""
    fit = point_in_search_form(parent.scored, parent.spec)
    ground = Ground(fit, fit.values[None, :fit.model.head], search.seed, search.policy)
    seen = gain_of(ground, name)
    tasks = [Task(parent.spec, name, draw=i) for i in range(1, count + 1)]
    as_much = 1
    with Crew(ground, search.jobs) as crew:
        for i, answer in enumerate(crew.map(tasks, replicate)):
            as_much += answer.gain >= seen
            tell(f"replicate {i + 1} of {count}", i / count)
    return as_much / (count + 1)


def gain_of(ground: Ground, name: str) -> float:
    """BIC that a first look at an effect gains over the model of a ground, both completed as they are."""
    fit = ground.fit
    spec = node(with_effect(fit.model.spec, name), soft=fit.model.spec.increments)
    look = look_at(ground, Task(spec, name))
    return -np.inf if look.failed else look.score_again(fit).done.gain_over(complete_quickly(fit.model, fit.values))


def replicate(ground: Ground, task: Task) -> Packed:
    """One record without the effect: new innovations through the noise model of the base, and the look's gain on it."""
    fit = ground.fit
    rng = np.random.default_rng([ground.seed, task.draw])
    null = complete_quickly(fit.model, fit.values)
    loop = replace(fit.model.loop, process_value=null.evaluated.model + draw_residual(null, rng))
    model = bind_model(loop, fit.model.spec, s_max=fit.model.s_max, period_s=fit.model.period_s)
    near = descend_model(model, with_start(model, model.cube(fit.values[:, None])))
    again = as_it_stands(model, model.values(near.points[:1])[:, 0])
    gain = gain_of(Ground(again, again.values[None, :model.head], ground.seed, ground.policy), task.added)
    return Packed(task.spec, task.added, gain=gain)
