"""One round over the catalogue, and the same round on another base where that explains the record better.

A base that lacks a further lag, has the wrong process, or holds a command that moves, hides the effect that is missing:
each is tried where a round leaves more than noise. Source: CRITICISM.md sections 6 and 7; METHODS.md section 4, traps 4
and 5.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..errors import CannotTell
from ..fit.add_effect import carrier, polished
from ..fit.context import Run
from ..fit.fit import Fitted, as_it_stands, polish_smooth
from ..fit.moves import descended
from ..fit.noise.completion import AUTOREGRESSIVE, RANDOM_WALK, Refit, at_noise, has_noise, quick
from ..fit.starts.beside_effect import RESTING
from ..fit.starts.intersample import as_moving, may_move, moved
from ..model.model import Model
from ..model.segments import bound
from ..model.spec import INTEGRATOR, Spec
from ..record.loop import Finding, Loop
from ..record.study import Study
from ..typing import Progress
from .judge import HALVED, halves, holds, winner_of
from .resting import resting_valve
from .steps import finished_step, opened, with_steps
from .structure import LAG, other_process
from .tries import NAMED, Round, Tried, try_all

# What a lag and another effect must gain in BIC over the best one alone (CRITICISM.md section 7, step 7: "named").
_JOINT = 50.0
# Another structure gets a round of its own where its base, noise model included, is at most so much less likely in BIC,
# or leaves at most the share below of the free-run error.
_AS_LIKELY = 100.0
# A random walk gets a round of its own where it gains this share of what the best candidate does.
_WALKS = 0.5


@dataclass(frozen=True, slots=True)
class Looked:
    """One round over the catalogue: on which study, and what won; `stays` where the study is best left as it was.

    `notes` say what was changed in the base before the round: such a base replaces the study's last model. `followed`
    is the study that adding the winner, and all that is named after it, ended in, where that was walked already;
    `others` are rounds on other bases that did not settle it. `bases` are bases of another structure that explain the
    record nearly as well, where they were asked for; `onward` is what adding the winner came to, where that was tried.
    """

    study: Study
    run: Run
    found: Round
    winner: Tried | None
    stays: bool = False
    notes: tuple[Finding, ...] = ()
    followed: Study | None = None
    others: tuple[Looked, ...] = ()
    bases: tuple[Fitted, ...] | None = None
    onward: Onward | None = None

    @property
    def next(self) -> Onward | None:
        """What adding the winner came to, where that was tried, and the round is still the same."""
        return self.onward if self.onward is not None and self.onward.found is self.found else None

    @property
    def best(self) -> Refit:
        """What the round ends with: the winner's refit, or the base where nothing won."""
        return self.found.reference if self.winner is None or self.winner.refit is None else self.winner.refit

    @property
    def settled(self) -> bool:
        """Whether a physical effect brings the free run to the noise: nothing is left that another base could do."""
        return self.winner is not None and self.winner.refit is not None and at_noise(self.winner.refit)

    @property
    def halved(self) -> bool:
        """Whether a physical effect takes half of the free-run error away, which chance does not."""
        return self.winner is not None and not self.winner.noise and halves(self.winner, self.found)

    @property
    def white(self) -> bool:
        """Whether what the base leaves is noise: nothing gains what another base would have to, or a noise of short
        memory, or a walk, explains it all.

        In changes of y and in levels: both are tried where an integrator is completed.
        """
        if self.winner is not None:
            kinds = {parse(name)[0].noise for name in (*self.found.fit.model.spec.effects, self.winner.name)}
            return (AUTOREGRESSIVE in kinds and self.best.noise_alone) or (
                RANDOM_WALK in kinds and self.best.walk_alone)
        return max((t.delta_bic for t in self.found.tried), default=np.inf) < _JOINT


@dataclass(frozen=True, slots=True)
class Onward:
    """The study that the winner of a round (`found`) was added to, what the round had added before it, the study with
    the winner, and the round after."""

    found: Round
    began: Study
    first: tuple[str, ...]
    study: Study
    looked: Looked


def look_at(loop: Loop, study: Study, seed: int, jobs: int, tell: Progress, noise_sd: float = np.inf) -> Looked:
    """A round on a study's last model; `noise_sd` (unit of y) is what an effect must come near to get a full refit."""
    run, fit = opened(loop, study, seed)
    found = try_all(run.loop, fit, seed, jobs, tell, noise_sd)
    return Looked(study, run, found, winner_of(found))


def beside_lag(looked: Looked, seed: int, jobs: int, tell: Progress, *, moving: bool = False) -> Looked:
    """The same round beside a further lag, where that names an effect which explains the record better.

    A process of second order hides a valve effect, and that effect the lag: neither helps alone. `moving`: see
    `try_all`.
    """
    run, found, winner = looked.run, looked.found, looked.winner
    lag = next((t.refit for t in found.tried if t.name == LAG and t.refit is not None), None)
    if lag is None or looked.settled or looked.white:
        return looked
    before = found.fit.model
    model = bound(run.loop, replace(before.spec, effects=(*before.spec.effects, LAG)), s_max=before.s_max,
                  period_s=before.period_s, residual=before.context.residual)
    fit = as_it_stands(model, model.vector(lag.model.named(lag.values)))
    deeper = try_all(run.loop, fit, seed, jobs, tell, moving=moving)
    top, rival = winner_of(deeper), looked.best
    # What won without the lag, too, needs none to be named.
    if top is None or top.noise or top.refit is None or _same(top, winner):
        return looked
    good = top.refit.good & rival.good
    if top.refit.bic(good) > rival.bic(good) - _JOINT:
        return looked
    alone = _alone(run, before, top)
    if alone.bic(good) <= top.refit.bic(good) + NAMED:
        # The round beside the lag has only found the better basin: the effect explains as much without.
        top = replace(top, refit=alone, delta_bic=alone.gain_over(found.reference))
        others = (t for t in found.tried if t.name != top.name)
        return replace(looked, winner=top, found=replace(found, tried=(top, *others)))
    said = Finding("joint", "info", f"{LAG} and {top.name} explain together what neither explains alone",
                   {"effects": [LAG, top.name]}, (), "CRITICISM.md section 6")
    study = _one_step_on(looked, deeper.fit, LAG, said)
    return Looked(study, run, replace(deeper, better=False), top, notes=looked.notes)


def _same(top: Tried, winner: Tried | None) -> bool:
    """Whether a round beside something names what won without it."""
    return winner is not None and top.name == winner.name


def _one_step_on(looked: Looked, fit: Fitted, name: str, *findings: Finding) -> Study:
    """The study of a round with one step more: the base that a deeper round was made on, polished."""
    after = polished(fit.model, fit.values, looked.run.rng)
    step = finished_step(looked.run, after, name, findings)
    return with_steps(looked.study, looked.run, (*looked.study.steps, step), after)


def beside_walk(looked: Looked, seed: int, jobs: int, tell: Progress, rival: Refit | None = None) -> Looked:
    """The same round beside a random walk, where that names an effect and both leave nothing but noise.

    A free run that strays is fitted to where it strays, by every effect in another way; changes of y, in which a walk
    is noise, show the valve. Not where the walk by itself does far worse than the best so far, or than a `rival`; what
    won without it must do far better beside it, or it is added first.
    """
    run, found = looked.run, looked.found
    walk = next((t for t in found.tried if parse(t.name)[0].noise == RANDOM_WALK and t.refit is not None), None)
    if walk is None or walk.refit is None or looked.settled or looked.white or has_noise(found.fit.model.spec) \
            or found.reference.own or walk.delta_bic < _WALKS * max(t.delta_bic for t in found.tried) \
            or (rival is not None and walk.refit.gain_over(rival) < -_AS_LIKELY):
        return looked
    fit = as_it_stands(carrier(walk.refit, walk.name, found.fit.model), walk.refit.values)
    tell("trying the catalogue beside a random walk", 0.5)
    deeper = try_all(run.loop, fit, seed, jobs, tell)
    top = winner_of(deeper)
    if top is None or top.noise or top.refit is None or not top.refit.walk_alone \
            or top.refit.gain_over(looked.best) < (_JOINT if _same(top, looked.winner) else NAMED):
        return looked
    study = _one_step_on(looked, deeper.fit, walk.name)
    return Looked(study, run, replace(deeper, better=False), top, notes=looked.notes)


def on_other_base(looked: Looked, seed: int, jobs: int, tell: Progress) -> Looked:
    """The same round on a base of another structure, where that brings a physical effect to the noise, or to a walk's.

    A missing effect bends the choice of the structure: a ramp or a limited slew rate made first orders integrators, a
    gain that depends on y hid that the command moves between samples.
    """
    found = looked.found
    if looked.settled or looked.white or has_noise(found.fit.model.spec):
        return looked
    others: tuple[Looked, ...] = ()
    for fit in _likely_bases(looked, tell) if looked.bases is None else looked.bases:
        # What wins must be at the noise, and leave less than the best so far.
        moving = not fit.model.spec.held
        other = try_all(looked.run.loop, fit, seed, jobs, tell, looked.best.innovation_sd, moving=moving)
        changed = replace(looked, found=replace(other, better=False), winner=winner_of(other))
        if moving and not changed.settled:
            # How the command moved is seen beside a lag only where there is one.
            changed = beside_lag(changed, seed, jobs, tell, moving=True)
        # A walk looks like an integrator, in whose levels the effect beside it is not seen.
        changed = beside_walk(changed, seed, jobs, tell, looked.best)
        ends = changed.settled or changed.best.walk_alone
        if changed.winner is None or not ends or changed.best.gain_over(looked.best) < _JOINT:
            others += (changed,)
            continue
        return replace(changed, notes=(other_structure(found.fit, other.fit, (changed.winner.name,), changed.best),))
    return replace(looked, others=others)


def _likely_bases(looked: Looked, tell: Progress) -> Iterator[Fitted]:
    """Bases of another structure that go with the record nearly as well as that of a round, or leave far less."""
    fit = looked.found.fit
    likely = _beside_noise(fit) + _AS_LIKELY
    for base in (_other_process, _moving_command):
        tell("trying another structure of the base", 0.5)
        other = base(looked.run, fit)
        # (What a noise model carries beside the wrong process may be more than the right one leaves without.)
        if other is not None and (_beside_noise(other) <= likely or other.best.rmse <= HALVED * fit.best.rmse):
            yield other


def may_go_on(looked: Looked, tell: Progress) -> Looked:
    """The round, with the bases of another structure that are likely (`bases`, empty where none is) where adding its
    winner may be worth a try before any other base is asked; as it was elsewhere.

    Physics that is far ahead of every noise model and does not reach the noise is one of two in most loops, and the
    round beside it names the other. Not where the base may be of another structure: what is added to the wrong one
    only mends it.
    """
    winner, found = looked.winner, looked.found
    if winner is None or winner.noise or winner.refit is None or looked.settled or has_noise(found.fit.model.spec) \
            or winner.delta_bic < found.noise_gain + _JOINT:
        return looked
    return replace(looked, bases=tuple(_likely_bases(looked, tell)))


def on_every_base(looked: Looked, seed: int, jobs: int, tell: Progress, *, rest: bool = True, lag: bool = True,
                  carried: tuple[float, float] | None = None) -> Looked:
    """The same round beside a walk, on another structure, beside a `rest` and a `lag`, each where what came before
    leaves more than noise; beside the lag first where that won. `carried` is told in `beside_rest`.
    """
    won = lag and looked.winner is not None and looked.winner.name == LAG
    if won:
        looked = beside_lag(looked, seed, jobs, tell)
    asked = looked
    looked = on_other_base(beside_walk(looked, seed, jobs, tell), seed, jobs, tell)
    if rest:
        looked = beside_rest(looked, seed, jobs, tell, carried)
    return beside_lag(looked, seed, jobs, tell) if lag and not (won and looked is asked) else looked


def other_structure(before: Fitted, after: Fitted, names: Sequence[str], end: Refit) -> Finding:
    """What is said where a base of another structure takes the place of one, for what effects leave beside it."""
    was, now = (_structure(f.model.spec) for f in (before, after))
    return Finding("other-structure", "warning",
                   f"the base is taken as {now} and no more as {was}: with {' and '.join(names)} that explains the "
                   f"record better, the free-run error falls from {before.best.rmse:.4g} to {end.evaluated.rmse:.4g}",
                   {"before": was, "structure": now, "effects": [*names]}, (),
                   "METHODS.md section 4, traps 4 and 5; CRITICISM.md section 6")


def beside_rest(looked: Looked, seed: int, jobs: int, tell: Progress,
                carried: tuple[float, float] | None = None) -> Looked:
    """The same round beside a valve that rests at every scan, where that explains the record far better.

    An inertial valve under a held command needs that to be near its basin at all, whatever else is missing. Not where
    a noise model has `carried` a valve, its S and J in %, that goes with the record as well as one that rests.
    """
    fit = looked.found.fit
    if looked.settled or looked.white or has_noise(fit.model.spec):
        return looked
    tell("trying a valve that rests between scans", 0.5)
    base = resting_valve(looked.run, fit, _beside_noise(fit), carried)
    if base is None:
        return looked
    found = try_all(looked.run.loop, base, seed, jobs, tell)
    changed = Looked(looked.study, looked.run, replace(found, better=False), winner_of(found))
    alone = found.reference.gain_over(looked.best) >= _JOINT and holds(found.held, looked.found.held)
    if not (alone or changed.settled or _far_less(changed, looked)) or changed.best.gain_over(looked.best) < _JOINT:
        return looked
    return replace(changed, study=_one_step_on(looked, found.fit, RESTING))


def _far_less(changed: Looked, looked: Looked) -> bool:
    """Whether noise is all that one base finds missing, and the other needs far less of it: half the free run.

    A noise model carries a wrong valve nearly as well as a right one, whose own free run without it may be no better.
    Nor need physics that the other base finds missing reach the noise at once: the next round sees what is left.
    """
    if changed.winner is None or (looked.winner is not None and not looked.winner.noise):
        return False
    before = looked.found.held if looked.winner is None else looked.winner.held
    return changed.best.evaluated.rmse <= HALVED * looked.best.evaluated.rmse and holds(changed.winner.held, before)


def _other_process(run: Run, fit: Fitted) -> Fitted | None:
    """The base as an integrator instead of a first order, or the other way."""
    spec = fit.model.spec
    if "time_constant_s" in spec.fixed:
        return None
    tried = other_process(run, spec)
    if tried.evaluated is None:
        return None
    try:
        return run.fit(tried.spec, before=(tried.point[None], np.array([tried.cost])))
    except CannotTell:
        return None


def _moving_command(run: Run, fit: Fitted) -> Fitted | None:
    """The base with a command that moves between samples instead of a held one."""
    spec = fit.model.spec
    if spec.between != "hold" or not may_move(run.loop):
        return None
    moving = as_moving(spec)
    found = moved(fit.model, fit.values, moving)
    try:
        return run.fit(moving, before=(found.points[:1], found.costs[:1]))
    except CannotTell:
        return None


def _structure(spec: Spec) -> str:
    kind = "an integrator" if spec.process == INTEGRATOR else "a first order"
    return f"{kind} under a command that {'is held' if spec.held else 'moves'} between samples"


def _beside_noise(fit: Fitted) -> float:
    """BIC of a base with the noise model that its residual asks for."""
    refits = [quick(fit.model, fit.values, noise=noise) for noise in (AUTOREGRESSIVE, RANDOM_WALK)]
    return min(r.bic(r.good) for r in refits)


def _alone(run: Run, before: Model, top: Tried) -> Refit:
    """The refit of an effect found beside a further lag, polished without the lag."""
    assert top.refit is not None
    model = bound(run.loop, replace(before.spec, effects=(*before.spec.effects, top.name)), s_max=before.s_max,
                  period_s=before.period_s, residual=top.refit.evaluated.left)
    named = top.refit.model.named(top.refit.values)
    # Either lag may have taken what the process does.
    other = named.get(f"{LAG}:second_time_constant_s", 0.0)
    starts = [named, {**named, "time_constant_s": max(other, named["time_constant_s"])}]
    near = descended(model, model.cube(np.stack([model.vector(start) for start in starts], axis=1)))
    point, _ = polish_smooth(model, near.points[0])
    return quick(model, model.values(point[None])[:, 0])


