"""First looks at edges and full fits of nodes: pure functions of a ground, so that they run in any process.

Every task has its own random generator, made from the seed and the node's key.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.noise.completion import Refit, better_refit, place_slips, restore_refit
from ..fit.points.fitted import Fitted, as_it_stands
from ..fit.points.moves import beginning_of, descend_model, with_start
from ..fit.starts.basins import grow_starts, with_process
from ..fit.starts.beside_effect import (
    RESTING,
    SECOND_LAG,
    on_valve,
    open_valves,
    resting_valves,
    starting_pool,
    take_out_disturbances,
)
from ..fit.starts.intersample import QUICK_SETTLE, QUICK_TURNS, let_command_move
from ..fit.valves_by_paths import look_beside_wander
from ..fit.with_effect import (
    Scouted,
    likeliest_point,
    look_along,
    look_under,
    polish_look,
    scout_effect,
    settle_look,
    settle_scouted,
    widen_by,
)
from ..model.model import Model
from ..model.segments import rebind_model
from ..model.spec import BASE, INTEGRATOR, Spec
from ..numerics.population import join_found
from ..record.loop import Loop
from ..system import evaluations
from ..typing import FloatArray
from .node import (
    additions,
    is_local,
    key,
    kind_of,
    node,
    other_process,
    physical_effects,
    valve_effects,
    with_effect,
)
from .policy import Policy
from .score import WALKING, Scored, complete_as_is, complete_fit, complete_look, complete_with_noise

# Points of a look on a part of the record that are polished on all of it.
_CARRIED = 2
# Stages of a task: a search for valves, and one for valves that rest at some speeds only; a look that starts from known
# values, and one that also starts from new valves; the polish of a look; a look in place of a level that wandered, and
# one along a path alone.
VALVES, SPEEDS, NEAR, FAR, CLOSER = "valves", "speeds", "near", "far", "closer"
BESIDE, ALONG = "beside", "along"


@dataclass(frozen=True, slots=True)
class Ground:
    """The fit of a parent node, starts (k, 5), seed and policy: what all tasks of one expansion share."""

    fit: Fitted
    pool: FloatArray
    seed: int
    policy: Policy
    # Named values of valves, by the effects on the valve that they have (see `kind_of`).
    valves: Mapping[str, tuple[dict[str, float], ...]] = field(default_factory=dict)

    def by_law(self) -> Ground:
        """The ground with a valve that slips where its law says, at the same values."""
        fit = self.fit
        if fit.model.spec.paths is None:
            return self
        model = bound_as(fit, replace(fit.model.spec, paths=None))
        return replace(self, fit=as_it_stands(model, model.vector(fit.model.named(fit.values))))


@dataclass(frozen=True, slots=True)
class Task:
    """One edge to look at, or one look to fit in full: the child, the effect added, and the stage."""

    spec: Spec
    added: str = ""
    stage: str = NEAR
    look: Packed | None = None
    # Number of a replicate of the record, for a p-value.
    draw: int = 0

    @property
    def on_valve(self) -> bool:
        """True where the effect added acts on the valve."""
        return bool(self.added) and on_valve(parse(self.added)[0])

    @property
    def searches_drift(self) -> bool:
        """True for a look from new valves at friction that drifts."""
        return self.stage == FAR and bool(self.added) and parse(self.added)[0].drifts

    def for_valves(self, beside_noise: bool) -> list[Task]:
        """The searches for valves of the child: two where a rest is its only effect on the valve.

        Under a command that moves between samples they differ in their random numbers alone. A parent that leaves
        noise alone (`beside_noise`) gets one there.
        """
        twice = valve_effects(self.spec) == [RESTING] and (self.spec.held or not beside_noise)
        return [replace(self, stage=stage) for stage in (VALVES, SPEEDS)[:1 + twice]]


@dataclass(frozen=True, slots=True)
class Packed:
    """A look or a fit without its arrays, small enough to pass between processes; `failed` says why there is none."""

    spec: Spec
    added: str = ""
    model_spec: Spec | None = None
    values: FloatArray | None = None
    taps: FloatArray | None = None
    own: tuple[float, ...] = ()
    increments: bool = False
    noise_numbers: int = 0
    residual: FloatArray | None = None
    prior: float = 0.0
    points: FloatArray | None = None
    cost: float = np.inf
    # Gain of the free run in 2 log L, and its least error in the unit of y: the noise model may prefer another point.
    gain: float = 0.0
    rmse: float = np.inf
    full: bool = False
    failed: str = ""
    spent: int = 0
    # Searches that several tasks share, with the samples that each took.
    questions: Mapping[str, int] = field(default_factory=dict)
    # Named values of the valves that a search for valves found.
    valves: tuple[dict[str, float], ...] = ()

    @property
    def along(self) -> bool:
        """True for a look at a parent with a path, also where the child's own slips follow the law.

        Such a look has a fit, but no points from which a search could continue.
        """
        return self.model_spec is not None and self.points is None

    def score_again(self, fit: Fitted) -> Scored:
        """The score of the fit, its arrays rebuilt by one run of the model without a search."""
        assert self.model_spec is not None and self.values is not None and self.taps is not None
        model = rebind_model(fit.model, self.model_spec, self.residual)
        done = restore_refit(model, self.values, self.taps, own=self.own, increments=self.increments,
                             numbers=self.noise_numbers, prior=self.prior)
        return Scored(done, self.full, self.rmse)


def edge_adding(spec: Spec, name: str) -> Task:
    """The edge that adds an effect to a node.

    The child is fitted to levels of y where a random walk, fitted to differences, may imitate the effect.
    """
    soft = spec.increments and WALKING not in parse(name)[0].confused_with
    return Task(node(with_effect(spec, name), soft=soft), name)


def keep_followed_tags(ground: Ground, tasks: Sequence[Task]) -> list[Task]:
    """The tasks; of those that add a tag only the few whose tag correlates best with the residual.

    A wrong base may hide the source of a disturbance, so there is no least correlation.
    """
    seen = {}
    for task in tasks:
        effect, option = parse(task.added) if task.added else (None, "")
        if effect is not None and effect.shown is not None:
            seen[task.added] = effect.shown(replace(ground.fit.model.context_of(option),
                                                    residual=ground.fit.best.left))
    if not seen:
        return list(tasks)
    out = sorted(seen, key=lambda name: -seen[name])[ground.policy.finalists + 1:]
    return [t for t in tasks if t.added not in out]


def edges(spec: Spec, loop: Loop, only: Iterable[str] | None, commands: Iterable[Spec]) -> list[Task]:
    """The edges of a node: effects of the catalogue (or of `only` these), the other process, other commands."""
    tasks = [edge_adding(spec, name) for name in additions(spec, loop, only)]
    # A node with effects has a known valve. Without any, another process or command may need a valve far from it.
    stage = NEAR if physical_effects(spec) else FAR
    if not spec.fixed:
        tasks.append(Task(other_process(spec), stage=stage))
    return tasks + [Task(replace(spec, between=c.between, substeps=c.substeps), stage=stage) for c in commands
                    if c.between != spec.between]


def perform_task(ground: Ground, task: Task) -> Packed:
    """The answer to one task; it says so where the numbers of a fit break down."""
    before = evaluations.samples_spent()
    evaluations.answers()
    try:
        fit = ground.fit
        if task.added and task.stage != BESIDE and fit.model.spec.increments != task.spec.increments:
            # A child that is fitted to levels of y needs its parent refitted to levels, too.
            ground = replace(ground, fit=as_it_stands(bound_as(fit, node(fit.model.spec)), fit.values))
        found = (_pack_answer(task, look_beside_wander(ground.fit, task.added)) if task.stage == BESIDE else
                 _polish_look(ground, task) if task.stage == CLOSER else
                 _fit_in_full(ground, task) if task.look is not None else
                 _valves(ground, task) if task.stage in (VALVES, SPEEDS) else look_at(ground, task))
    except (ModelError, np.linalg.LinAlgError) as error:
        found = Packed(task.spec, task.added, failed=f"its refit did not converge ({error})")
    spent = (evaluations.samples_spent() - before) // ground.policy.unit
    return replace(found, spent=spent, questions=evaluations.answers())


def pool_of(fit: Fitted, seed: int) -> FloatArray:
    """Starting values (k, 5) of the base for all children of a node."""
    # All nodes use one generator, so that nodes with the same disturbances start from the same valves.
    return starting_pool(fit.model, fit.values, rng_of(seed, "pool", 0))


def rng_of(seed: int, name: str, stage: int) -> np.random.Generator:
    """The random generator of a task; it does not depend on the tasks before."""
    return np.random.default_rng([seed, stage, zlib.crc32(name.encode())])


def look_at(ground: Ground, task: Task) -> Packed:
    """A first look at one edge: an effect added, another process, or another course of the command."""
    if ground.fit.model.spec.paths is not None and task.added and ground.fit.model.spec.increments == \
            task.spec.increments:
        fit, done = ground.fit, look_along(ground.fit, task.added)
        off_valve = parse(task.added)[0].friction is None
        if task.stage == ALONG or (off_valve and done.gain_over(complete_fit(fit)) > 0.0):
            return _pack_answer(task, done)
        # PV may have moved slips to where the missing effect puts them: a valve that slips by its law shows more.
        free = look_at(ground.by_law(), replace(task, stage=FAR) if parse(task.added)[0].drifts else task)
        return free if not free.failed and free.score_again(ground.fit).done.gain_over(done) > 0.0 else \
            _pack_answer(task, done)
    rng = rng_of(ground.seed, key(task.spec), 1)
    found = (_look_at_effect(ground, task, rng) if task.added else
             _look_at_process(ground, task, rng) if task.spec.process != ground.fit.model.spec.process else
             _look_at_command(ground, task, rng))
    if not np.isfinite(found.cost):
        return Packed(task.spec, task.added, failed="its refit found no model whose valve moves")
    done, points = complete_look(found.model, found.values, ground.fit, ground.policy), found.points[:8]
    rmse = done.evaluated.rmse
    if task.on_valve and done.taps.size:
        done, points = _better_at(ground, found, likeliest_point(found, done), done, points)
    if task.added and (before := complete_fit(ground.fit)).taps.size and not before.increments and \
            before.gain_over(done) > ground.policy.margin:
        # Beside coloured noise the least free-run error lies far from the likeliest values, which are near the parent.
        # (an autoregression that stands for a wrong valve keeps that valve, but not its free-run error)
        done, points = _better_at(ground, found, look_under(before, found.model, task.added), done, points,
                                  most=ground.policy.better_base * done.evaluated.rmse)
    if task.searches_drift:
        # (PV placed the slips of the model so far, too)
        done = place_slips(done)
        points, rmse = _before_points(found, done.values, points), min(rmse, done.evaluated.rmse)
    return _pack_answer(task, done, points=points, cost=found.cost, gain=found.gain, rmse=rmse)


def _better_at(ground: Ground, found: Scouted, values: FloatArray, done: Refit, points: FloatArray,
               most: float = np.inf) -> tuple[Refit, FloatArray]:
    """A look completed at values (d,), and its points (k, d), if likelier with at most this error; else as before."""
    other = complete_look(found.model, values, ground.fit, ground.policy)
    better = other.gain_over(done) > 0.0 and other.evaluated.rmse <= most
    return (other, _before_points(found, values, points)) if better else (done, points)


def _before_points(found: Scouted, values: FloatArray, points: FloatArray) -> FloatArray:
    """Points (k, d) of a look, that of values (d,) of its model first."""
    return np.concatenate([found.model.cube(values[:, None]), points])


def _polish_look(ground: Ground, task: Task) -> Packed:
    """A look polished with a population, on the part of a long record that a search needs."""
    look = task.look
    assert look is not None and look.points is not None and look.values is not None
    rng = rng_of(ground.seed, f"{CLOSER} {key(task.spec)}", 1)
    short = _part_to_search(ground.fit, task.spec, ground.policy)
    model = widen_by(short, task.added)
    points = look.points
    if short is not ground.fit:
        whole = widen_by(ground.fit, task.added)
        points = model.cube(np.array([model.vector(whole.named(v)) for v in whole.values(points).T]).T)
    neutral, cost = model.costs(np.concatenate([model.cube(model.vector(short.model.named(short.values))[:, None]),
                                                points[:1]])).tolist()
    name = task.added if task.on_valve else ""
    found = polish_look(Scouted(model, points, cost, neutral, name), task.added, rng)
    if short is not ground.fit:
        found = _polish_on_all(found, ground.fit, task.added)
    done = complete_look(found.model, found.values, ground.fit, ground.policy)
    before = look.score_again(ground.fit).done
    points, rmse = found.points[:8], done.evaluated.rmse
    if before.gain_over(done) > 0.0:
        # (the polished valve is better in levels only, not under the noise model)
        done, points = before, _before_points(found, look.values, points)
    return _pack_answer(task, done, points=points, cost=found.cost, gain=found.gain, rmse=rmse)


def _open_rng(ground: Ground, task: Task) -> np.random.Generator:
    """A generator for valves with no process assumed, the same for nodes with the same effects on the valve."""
    return rng_of(ground.seed, f"{FAR} {' + '.join(valve_effects(task.spec))} {task.spec.between}", 1)


def _valves(ground: Ground, task: Task) -> Packed:
    """Resting valves of the child's kind, found on growing parts of the record.

    An integrator adds up its slips, so a valve found on a short part may miss slips in the others.
    """
    model, policy = ground.fit.model, ground.policy
    samples = policy.fit_samples if task.spec.process == INTEGRATOR else \
        max(int(policy.periods * model.period_s / model.step_s), policy.valve_samples)
    changes = any(parse(name)[0].profile is not None for name in task.spec.effects)
    fit = ground.fit if changes else beginning_of(ground.fit, samples)
    wider = widen_by(fit, task.added)
    rng = _open_rng(ground, task) if task.stage == SPEEDS else rng_of(ground.seed, kind_of(task.spec), 1)
    if sum(map(on_valve, wider.effects)) > 1:
        found = [wider.named(column) for column in wider.values(open_valves(wider, task.added, fit, rng)).T]
    else:
        found = resting_valves(take_out_disturbances(wider, fit.model, fit.values), rng,
                               sometimes=task.stage == SPEEDS)
    return Packed(task.spec, task.added, valves=tuple(found))


def _part_to_search(fit: Fitted, spec: Spec, policy: Policy) -> Fitted:
    """The fit on the part of a long record that a search needs: all of it where an effect acts at one place."""
    return fit if any(is_local(parse(name)[0]) for name in spec.effects) else beginning_of(fit, policy.fit_samples)


def _polish_on_all(found: Scouted, fit: Fitted, name: str) -> Scouted:
    """A look that was found on the beginning of a long record, polished on all of it."""
    model = widen_by(fit, name)
    here = fit.model.named(fit.values)
    vectors = [model.vector({**here, **found.model.named(column)})
               for column in found.model.values(found.points[:_CARRIED]).T]
    cube = model.cube(np.array([model.vector(here), *vectors]).T)
    neutral = float(model.costs(cube[:1])[0])
    near = descend_model(model, with_start(model, cube), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    return Scouted(model, near.points, float(near.costs[0]), neutral, found.name)


def _look_at_effect(ground: Ground, task: Task, rng: np.random.Generator) -> Scouted:
    """A look at one effect more, on the beginning of a long record unless the effect acts at a place of it."""
    short = _part_to_search(ground.fit, task.spec, ground.policy)
    if short is ground.fit:
        return _look(ground, task, rng)
    return _polish_on_all(_look(replace(ground, fit=short), task, rng), ground.fit, task.added)


def _look(ground: Ground, task: Task, rng: np.random.Generator) -> Scouted:
    wider = widen_by(ground.fit, task.added)
    known = ground.valves.get(kind_of(task.spec), ()) if task.on_valve else ()
    here = ground.fit.model.named(ground.fit.values)
    mine = {n for n in wider.names if on_valve(parse(n)[0])}
    valves = [wider.vector({**here, **{n: v for n, v in named.items() if n in BASE or n.partition(":")[0] in mine}})
              for named in known]
    far = task.stage == FAR
    # Nodes with the same effects on the valve share one search for valves.
    rng = _open_rng(ground, task) if far else rng
    found = scout_effect(ground.fit, task.added, ground.pool, rng,
                         valves=np.array(valves).reshape(-1, wider.space.size), far=far, polish=False)
    return settle_scouted(found, task.added, rng) if task.searches_drift else found


def _look_at_process(ground: Ground, task: Task, rng: np.random.Generator) -> Scouted:
    """A look at the other process: the valves of the pool, each with the process of a grid."""
    model = bound_as(ground.fit, task.spec)
    known = ground.fit.model.named(ground.fit.values)
    values = np.stack([model.vector({**known, **dict(zip(BASE, base, strict=True))}) for base in ground.pool], axis=1)
    starts = with_process(model, model.cube(values))
    if task.spec.process == INTEGRATOR and SECOND_LAG in known:
        # The integrator takes the place of the longer of two lags; the other one stays.
        values[3] = known[SECOND_LAG]
        starts = np.concatenate([model.cube(values), starts])
    if task.stage != NEAR:
        starts = np.concatenate([starts, grow_starts(model, rng)])
    found = descend_model(model, with_start(model, starts), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    return Scouted(model, found.points, float(found.costs[0]), float(found.costs[0]))


def _look_at_command(ground: Ground, task: Task, rng: np.random.Generator) -> Scouted:
    """A look at another course of the command between samples, from the parent's point; a far one from new valves, too.
    """
    fit = ground.fit
    model = bound_as(fit, task.spec)
    if task.spec.held:
        start = model.cube(fit.values[:, None])
        found = descend_model(model, with_start(model, start), turns=QUICK_TURNS, settle=QUICK_SETTLE)
    else:
        found = let_command_move(fit.model, fit.values, task.spec)
    if task.stage != NEAR:
        fresh = with_start(model, grow_starts(model, rng))
        found = join_found(found, descend_model(model, fresh, turns=QUICK_TURNS, settle=QUICK_SETTLE))
    return Scouted(model, found.points, float(found.costs[0]), float(found.costs[0]))


def bound_as(fit: Fitted, spec: Spec) -> Model:
    """The model of a node on the record of a fit, with the residual of that fit for guesses."""
    return rebind_model(fit.model, spec, fit.best.left)


def _fit_in_full(ground: Ground, task: Task) -> Packed:
    assert task.look is not None and task.look.residual is not None
    if task.look.along:
        done = place_slips(task.look.score_again(ground.fit).done)
        return replace(_pack_answer(task, done), full=True)
    assert task.look.points is not None
    rng = rng_of(ground.seed, key(task.spec), 2)
    model = bound_as(ground.fit, task.spec)
    name = task.added if task.on_valve else ""
    look = Scouted(model, task.look.points, task.look.cost, np.inf, name)
    short = _part_to_search(as_it_stands(model, look.values), task.spec, ground.policy)
    if short.model is model:
        model, values, cost = settle_look(look, rng)
    else:
        piece = short.model
        piece, values, _ = settle_look(Scouted(piece, piece.cube(short.values[:, None]), np.inf, np.inf, name), rng)
        known = {**model.named(look.values), **piece.named(values)}
        cube = np.concatenate([look.points[:1], model.cube(model.vector(known)[:, None])])
        near = descend_model(model, with_start(model, cube))
        values, cost = model.values(near.points[:1])[:, 0], float(near.costs[0])
    if not np.isfinite(cost):
        return Packed(task.spec, task.added, failed="its refit did not converge")
    done = complete_with_noise(model, values, rng, ground.policy, lambda: ground.pool)
    first = complete_as_is(model, look.values)
    if first.gain_over(done) > 0.0:
        # A fit that ends worse than its look has moved to another valve, with a smaller error in levels only.
        done = better_refit(done, complete_with_noise(model, first.values, rng, ground.policy, lambda: ground.pool))
    return replace(_pack_answer(task, done, cost=cost), full=True)


def _pack_answer(task: Task, done: Refit, *, points: FloatArray | None = None, cost: float = np.inf,
                 gain: float = 0.0, rmse: float = np.inf) -> Packed:
    if not np.isfinite(done.innovation_sd):
        return Packed(task.spec, task.added, failed="its refit did not converge")
    return Packed(task.spec, task.added, done.model.spec, done.values, done.taps, done.own, done.increments,
                  done.noise_numbers, done.evaluated.left, done.prior, points, cost, gain, rmse)
