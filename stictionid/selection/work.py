"""The refits themselves, one task an effect: the same answer in this process or in others, in whatever order they end.

Every task has its own random generator, made from the seed and the effect's name. Other processes are forked, so they
inherit kernels, data and model at no cost; where the system can't fork everything runs in this process.
"""

from __future__ import annotations

import multiprocessing
import signal
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.cross_validation import Held, held_out
from ..fit.fit import Fitted
from ..fit.moves import search_model
from ..fit.noise.completion import Refit, complete, quick, restored
from ..fit.starts.beside_effect import changes
from ..fit.with_effect import Scouted, beside_others, scout, settled
from ..model.segments import bound
from ..model.spec import BASE, Spec
from ..typing import FloatArray


@dataclass(frozen=True, slots=True)
class Ground:
    """What all tasks of one round share: the model so far, starting values (k, 5) of its base, and the seed.

    `near` says that looks need no basins beyond those: noise alone, or a look before, explains what the model leaves.
    """

    fit: Fitted
    pool: FloatArray
    seed: int
    near: bool = False


@dataclass(frozen=True, slots=True)
class Answer:
    """A refit without its arrays, small enough to travel; `failed` says why there is none."""

    name: str
    spec: Spec | None = None
    values: FloatArray | None = None
    taps: FloatArray | None = None
    own: tuple[float, ...] = ()
    increments: bool = False
    noise_numbers: int = 0
    residual: FloatArray | None = None
    points: FloatArray | None = None
    cost: float = np.inf
    held: Held | None = None
    failed: str = ""
    # What a first look gained over the model so far: twice the log-likelihood of the free run.
    gain: float = 0.0

    def refit(self, ground: Ground) -> Refit:
        """The refit with its arrays again; one run of the model, no search."""
        assert self.spec is not None and self.values is not None and self.taps is not None
        before = ground.fit.model
        model = bound(before.loop, self.spec, s_max=before.s_max, period_s=before.period_s, residual=self.residual)
        return restored(model, self.values, self.taps, own=self.own, increments=self.increments,
                        numbers=self.noise_numbers)


def look(ground: Ground, name: str) -> Answer:
    """A first look at one physical effect."""
    rng = _rng(ground, name, 1)
    try:
        found = scout(ground.fit, name, ground.pool, rng, far=not ground.near)
    except ModelError as error:
        return Answer(name, failed=error.message)
    if not np.isfinite(found.cost):
        return Answer(name, failed="its refit found no model whose valve moves")
    return _looked(found, name)


def _looked(found: Scouted, name: str) -> Answer:
    return replace(_packed(name, quick(found.model, found.values), points=found.points[:8], cost=found.cost),
                   gain=found.gain)


def look_beside(ground: Ground, seen: Answer) -> Answer:
    """A second look at an effect on the valve, together with those that the model has; the first where it is better."""
    if seen.failed or seen.points is None:
        return seen
    found = beside_others(ground.fit, seen.name, seen.points, _rng(ground, seen.name, 4))
    return seen if found is None or not found.cost < seen.cost else _looked(found, seen.name)


def look_in_windows(ground: Ground, seen: Answer) -> Answer:
    """A second look at friction that changes with time, from windows of the record; the first where it is better.

    Beside a walk no part that grows from the beginning shows it for long: what y strays by adds up.
    """
    if seen.failed or not changes(seen.name):
        return seen
    found = scout(ground.fit, seen.name, ground.pool, _rng(ground, seen.name, 5), windows=True)
    return _looked(found, seen.name) if found.cost < seen.cost else seen


def finish(ground: Ground, seen: Answer) -> Answer:
    """The full refit of an effect that is worth it, completed with its noise, and its held-out errors."""
    rng = _rng(ground, seen.name, 2)
    before = ground.fit.model
    assert seen.spec is not None and seen.points is not None
    spec = replace(before.spec, effects=(*before.spec.effects, seen.name))
    model = bound(before.loop, spec, s_max=before.s_max, period_s=before.period_s,
                  residual=ground.fit.best.left)
    model, values, cost = settled(Scouted(search_model(model), model, seen.points, seen.cost, seen.cost, seen.name
                                           if parse(seen.name)[0].kind in "FT" else ""), rng)
    if not np.isfinite(cost):
        return Answer(seen.name, failed="its refit did not converge")
    done = complete(model, values, None, rng)
    return _packed(seen.name, done, cost=cost, held=held_out(done))


def noise(ground: Ground, name: str) -> Answer:
    """The model so far with a noise model."""
    rng = _rng(ground, name, 3)
    kind = parse(name)[0].noise
    assert kind is not None
    done = complete(ground.fit.model, ground.fit.values, ground.pool, rng, noise=kind)
    return _packed(name, done, held=held_out(done))


def _packed(name: str, done: Refit, *, points: FloatArray | None = None, cost: float = np.inf,
            held: Held | None = None) -> Answer:
    if not np.isfinite(done.innovation_sd):
        return Answer(name, failed="its refit did not converge")
    return Answer(name, done.model.spec, done.values, done.taps, done.own, done.increments, done.noise_numbers,
                  done.evaluated.left, points, cost, held)


def base_values(answer: Answer) -> FloatArray:
    """The base's own values (5,) in a refit: what to hand back to the model without the effect."""
    assert answer.values is not None
    return answer.values[:len(BASE)]


def without_it(answer: Answer, ground: Ground) -> FloatArray:
    """What a refit made of the model so far, values (d,): an effect that is in it may have been in a wrong basin."""
    assert answer.values is not None
    return ground.fit.model.vector(answer.refit(ground).model.named(answer.values))


def _rng(ground: Ground, name: str, stage: int) -> np.random.Generator:
    return np.random.default_rng([ground.seed, stage, zlib.crc32(name.encode())])


_GROUND: Ground | None = None


def _enter(ground: Ground) -> None:
    global _GROUND
    _GROUND = ground
    # The parent answers an interrupt for all.
    signal.signal(signal.SIGINT, signal.SIG_IGN)


def _call(work: Callable[[Ground, Any], Answer], task: Any) -> Answer:
    assert _GROUND is not None
    return _answered(work, _GROUND, task)


def _answered(work: Callable[[Ground, Any], Answer], ground: Ground, task: Any) -> Answer:
    try:
        return work(ground, task)
    except (ModelError, np.linalg.LinAlgError) as error:
        return Answer(task if isinstance(task, str) else task.name, failed=f"its refit did not converge ({error})")


class Workers:
    """Runs tasks over one ground, in `jobs` processes or in this one; answers come in the order of the tasks."""

    def __init__(self, ground: Ground, jobs: int) -> None:
        self.ground = ground
        self._pool: ProcessPoolExecutor | None = None
        if jobs > 1 and "fork" in multiprocessing.get_all_start_methods():
            self._pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("fork"), _enter, (ground,))

    def map(self, work: Callable[[Ground, Any], Answer], tasks: Sequence[Any]) -> Iterator[Answer]:
        """The answers of one kind of work; one whose numbers break down says so, and the others go on."""
        if self._pool is None:
            return (_answered(work, self.ground, task) for task in tasks)
        return self._pool.map(_call, [work] * len(tasks), tasks)

    def __enter__(self) -> Workers:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(wait=kind is None, cancel_futures=True)
