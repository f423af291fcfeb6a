"""Refitting a model with one more effect, and completing any model with the noise that its residual asks for.

An effect's refit starts warm from the model so far and fresh from new basins, because a missing effect moves S and J
into a wrong basin. Completion fits an autoregression to the free-run residual and, where there is one, refits the model
in prewhitened form, so that all models are compared by their innovations, noise model included.
Source: METHODS.md section 6; CRITICISM.md sections 1 and 7.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from .arx import Arx
from .effects import noises_in, parse
from .effects.contract import Effect, Place
from .explained import noise_alone, only_noise
from .fit import Fitted, polish_smooth
from .grown import distinct, grown_beside, grown_valves
from .herd import ALONE, PATIENCE, beyond_rest, herded
from .loop import BoolArray, FloatArray
from .model import Model
from .moves import descended, longest_piece, search_model, spreads, with_start
from .noise import autoregression, filtered
from .resonance import NUMBERS, resonance
from .restarts import bound
from .ridge import followed, ridge_of
from .search import Found, refine, swarm, together
from .spec import BASE, INTEGRATOR, Evaluated, Spec
from .starts import along_ridge, basins, with_other_start, with_process
from .windows import resting_valves, windowed_valves

_ROAM, _SCOUTS = 2, 500
_SETTLED = 1e-4
# Turns of descent from every start, when one has settled, starts that get a population after it, and twice the
# log-likelihood that must have been gained by then for one.
_GLANCE, _GLANCED, _KEPT, _PROMISING = 3, 1e-2, 4, 3.0
# Basins of the base that refits start from: by swarms, and by a search that grows with the record.
_SWARMED, _GROWN = 2, 2
# Rounds of the first look at an effect and of its swarms, and most guesses that get a swarm of their own.
_LOOK, _SWARM, _GUESSES = 25, 14, 6
# Further polishes go on while each lowers the cost by this share, at most so often.
_WORTH, _TURNS = 0.01, 4
# A scan across valves: shares of S, of J as a share of S, and steps of the effect (shares of its range).
_ACROSS_STEP = 0.01
_ACROSS_S = 1.0 + _ACROSS_STEP * np.arange(-16, 17)
_ACROSS_J, _ACROSS_EFFECT = np.array([0.7, 0.85, 1.0, 1.15, 1.35]), np.array([-0.1, -0.04, -0.015, 0.015, 0.04, 0.1])
# A scan for another S of a valve that rests: shares of S and of J.
_BAND_S, _BAND_J = np.exp(0.004 * np.arange(-30, 31)), np.array([0.97, 0.985, 1.0, 1.015, 1.03])
# Searches along a ridge; the share of the cost of the model so far under which the first must be for another, or J as a
# share of S in that model (J > S is a kinetic friction below 0).
_GROWTHS, _PROMISES, _BEYOND = 3, 0.8, 0.9
# Fine scans of S for the interval that all slips allow: reach either way (share), points, and slip jumps tried.
_THRESHOLD_REACH, _THRESHOLDS = (0.02, 0.003), 241
_THRESHOLD_J = np.array([0.95, 1.0, 1.06])
# Polishes on the model's own y, for effects that follow it.
_FOLLOWED = 3
# Points of a herd that get the interval of S that all slips allow; turns of scans along a ridge.
_HERDED, _RIDGED = 2, 4
# Share of the range of its speed from which a valve that re-sticks rests at every scan.
_RESTS = 0.9
# Steps along the ridge of dead time and break-away in a full refit.
_RIDGE_TURNS = 3
# The effect of a valve that rests between the scans of a held command.
RESTING = "re-sticking"
AUTOREGRESSIVE, RANDOM_WALK, RESONANT = "autoregressive", "random-walk", "resonant"
LARGEST_ORDER = 8
# Rounds of noise model and refit; the second rarely matters.
_COMPLETIONS = 2
BLOCKS = 5
# A free run within this share of its innovations is at the noise.
_WHITE = 1.1


@dataclass(frozen=True, slots=True)
class Refit:
    """A model at its best point (d,), completed with its noise; `innovation` (n,) is white where it is adequate.

    `taps` are those of the fitted noise model, beside the prewhitening `own` of the fit of the process.
    """

    model: Model
    values: FloatArray
    evaluated: Evaluated
    taps: FloatArray
    increments: bool
    innovation: FloatArray
    good: BoolArray
    parameters: int
    noise_numbers: int = 0
    own: tuple[float, ...] = ()

    @property
    def innovation_sd(self) -> float:
        """Standard deviation of the innovations, in the unit of y."""
        return float(np.sqrt(np.mean(self.innovation[self.good] ** 2)))

    @property
    def spec(self) -> Spec:
        """The model's spec with the noise model in it."""
        taps = tuple(_joined(self.own, self.taps)[1:].tolist())
        return replace(self.model.spec, taps=taps, increments=self.increments)

    def white_model(self) -> Model:
        """The model in its prewhitened form, whose cost is the sum of squared innovations."""
        spec = self.spec
        if spec == self.model.spec:
            # An effect that follows y follows the model's own, whatever the search followed.
            return self.model.guided(self.evaluated.guide) if self.model.follows_y else self.model
        return bound(self.model.loop, spec, s_max=self.model.s_max, period_s=self.model.period_s,
                     residual=self.evaluated.left)

    @property
    def noise_alone(self) -> bool:
        """Whether model and noise model leave nothing but noise, and the latter is no disturbance itself.

        Not known where the model is fitted in changes of y, which hide whatever is slow.
        """
        return not self.increments and not self.own and noise_alone(
            self.model, self.taps, self.evaluated.position, self.innovation, self.good)

    @property
    def walk_alone(self) -> bool:
        """Whether model and random walk leave nothing but noise in the changes of y."""
        return self.increments and not self.own and noise_alone(
            self.model, self._polynomial()[1:], self.evaluated.position, self.innovation, self.good, walk=True)

    @property
    def white(self) -> bool:
        """Whether the innovations pass every test for chance, whatever the noise model that left them.

        A noise model may hide what is slow in a root near 1, or in changes of y, but not what valve and process do.
        """
        return only_noise(self.model, self._polynomial(), self.taps.size, self.evaluated.position, self.innovation,
                          self.good)

    def _polynomial(self) -> FloatArray:
        """What the errors are passed through to be innovations."""
        return _whitening(self.own, self.taps, self.increments)

    def bic(self, good: BoolArray) -> float:
        """BIC of the innovations on common samples (n,)."""
        rows = float(good.sum())
        sse = float(np.sum(self.innovation[good] ** 2))
        return rows * float(np.log(max(sse, 1e-300) / rows)) + self.parameters * float(np.log(rows))

    def gain_over(self, other: Refit) -> float:
        """BIC by which this model does better than another on the samples that both predict."""
        both = self.good & other.good
        return other.bic(both) - self.bic(both)


def starting_pool(model: Model, values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Values (k, 5) of the base parameters to start refits from: the fit so far and fresh basins."""
    spec = Spec(law=model.spec.law, process=model.spec.process, between=model.spec.between,
                substeps=model.spec.substeps, increments=model.spec.increments, taps=own_taps(model.spec),
                fixed=model.spec.fixed, guides=model.spec.guides)
    base = bound(model.loop, spec, s_max=model.s_max, period_s=model.period_s)
    # Swarms on the one-step error, and a search that asks for no process: where one is misled the other is not.
    plain = undisturbed(base, model, values)
    far = np.concatenate([basins(plain, rng)[:_SWARMED], grown_valves(plain, _valve_of(base, ()), rng)[:_GROWN]])
    fresh = base.values(with_process(base, far))[:len(BASE)].T
    friction = tuple(x.name for x in model.effects if x.friction is not None)
    if friction:
        # A valve that rests has other basins than one that slides.
        own = bound(model.loop, replace(spec, effects=friction), s_max=model.s_max, period_s=model.period_s)
        plain = undisturbed(own, model, values)
        found = with_process(own, grown_valves(plain, _valve_of(plain, friction), rng)[:_GROWN])
        fresh = np.concatenate([own.values(found)[:len(BASE)].T, fresh])
    return np.concatenate([values[None, :len(BASE)], fresh])


def _valve_of(model: Model, names: Sequence[str]) -> list[int]:
    """Columns of the unit cube that say how the valve moves, the numbers of some effects among them."""
    rows = (model.rows_of(name) for name in names)
    return [0, 1, model.forces[longest_piece(model)], *(i for r in rows for i in range(r.start, r.stop))]


def undisturbed(model: Model, before: Model, values: FloatArray) -> Model:
    """A model without its linear effects, on the record less what those of `before`, values (d,), put into y.

    A search that asks for no process knows no disturbances either: a sine that is known already would mislead it.
    """
    known = {name for name, effect in zip(before.names, before.effects, strict=True) if effect.columns}
    if not known:
        return model
    loop = model.loop
    rest = loop.process_value - before.disturbance(values, before.evaluate(values).own)
    return bound(replace(loop, process_value=rest),
                 replace(model.spec, effects=tuple(name for name in model.spec.effects if name not in known)),
                 s_max=model.s_max, period_s=model.period_s)


@dataclass(frozen=True, slots=True)
class Scouted:
    """A first look at one more effect: the model to search on, the one to finish on, and points (k, d), best first.

    `neutral` is the cost of the model so far, where the effect vanishes, on the model to search on.
    """

    coarse: Model
    model: Model
    points: FloatArray
    cost: float
    neutral: float
    name: str = ""

    @property
    def gain(self) -> float:
        """Twice the log-likelihood of the free run that the effect has gained so far."""
        return self.model.shared.rows * float(np.log(max(self.neutral, 1e-300) / max(self.cost, 1e-300)))

    @property
    def values(self) -> FloatArray:
        """Values (d,) of the best point so far."""
        return self.coarse.values(self.points[:1])[:, 0]


def scout(fit: Fitted, name: str, pool: FloatArray, rng: np.random.Generator, *, far: bool = True,
          windows: bool = False) -> Scouted:
    """The model with effect `name` added, searched far enough to see whether it is worth a full refit.

    Starts are the neutral effect in the model so far, guesses of the effect in all basins of the pool, and unless `far`
    is False swarms over valve and effect on the one-step error, and a swarm over everything. Friction that changes
    with time is looked for in `windows` of the record, too, where that is asked for.
    """
    before = fit.model
    spec = replace(before.spec, effects=(*before.spec.effects, name))
    model = bound(before.loop, spec, s_max=before.s_max, period_s=before.period_s,
                  residual=fit.best.left)
    coarse = search_model(model)
    effect, option = parse(name)
    guesses = effect.guess(model._context(option)) if effect.guess else np.zeros((1, 0))
    others = fit.best.values
    starts = [coarse.vector(others)]
    for base in pool:
        for guess in guesses:
            vector = coarse.vector({**others, **dict(zip(BASE, base, strict=True))})
            vector[coarse.rows_of(name)] = guess
            starts.append(vector)
    cube = coarse.cube(np.array(starts).T)
    costs = coarse.costs(cube)
    neutral = float(costs[0])
    # The best guess of each base: beside the wrong size of an effect the right valve costs more than a wrong one.
    each = costs[1:].reshape(len(pool), len(guesses))
    best = 1 + np.arange(len(pool)) * len(guesses) + each.argmin(axis=1)
    warm = cube[np.append(best, 0)]
    fresh = roam = np.empty((0, model.space.size))
    if far:
        if effect.kind in "FT" and guesses.size:
            fresh = _valve_basins(coarse, name, guesses, fit, rng, windows)
        roam = swarm(coarse.costs, coarse.space.size, rng, groups=1, particles=40, rounds=_SWARM,
                     scouts=_SCOUTS).points[:_ROAM]
    near = descended(coarse, with_start(coarse, np.concatenate([warm, fresh, roam])), turns=_GLANCE, settle=_GLANCED)
    if len(fresh) and effect.friction is not None and spec.held:
        near = together(near, refine(coarse.costs, with_start(coarse, fresh[:_KEPT]), rng, spread=spreads(coarse),
                                     rounds=_LOOK, population=14, settle=_SETTLED))
    found = Scouted(coarse, model, near.points, float(near.costs[0]), neutral,
                    name if effect.kind in "FT" else "")
    if not found.gain > _PROMISING:
        return found
    polish = refine(coarse.costs, near.points[:_KEPT], rng, spread=spreads(coarse), rounds=_LOOK, population=14,
                    settle=_SETTLED)
    points, cost = polish.points, float(polish.costs[0])
    if effect.kind in "FT" and spec.held and cost < neutral * (1.0 - _SETTLED):
        # The effect helps, so the process it was fitted with may be wrong: one step along the ridge.
        beside = refine(coarse.costs, np.concatenate([along_ridge(coarse, points[:2])[:3],
                                                      _across(coarse, points[0], name, 3),
                                                      with_other_start(coarse, points[0], 2)]), rng,
                        spread=spreads(coarse, 0.5), rounds=_LOOK, population=14, settle=_SETTLED)
        both = together(polish, beside)
        points, cost = both.points, float(both.costs[0])
    return replace(found, points=points, cost=cost)


def beside_others(fit: Fitted, name: str, look: FloatArray, rng: np.random.Generator) -> Scouted | None:
    """A look at effect `name` whose size is searched together with S, J and those of the effects on the valve that the
    model has already; points (k, d) of a first `look` take part. None without such effects, or under a command that
    moves between samples.

    Of two effects on a valve each is far from its size, and S and J from theirs, where the other is missing: no search
    that holds the first meets the second.
    """
    before = fit.model
    model = bound(before.loop, replace(before.spec, effects=(*before.spec.effects, name)), s_max=before.s_max,
                  period_s=before.period_s, residual=fit.best.left)
    plain = undisturbed(model, before, fit.values)
    others = [n for n, effect in zip(plain.names, plain.effects, strict=True) if n != name and on_valve(effect)]
    effect, option = parse(name)
    still: slice | None = None
    if RESTING in others and before.cube(fit.values[:, None])[0, before.rows_of(RESTING)][0] > _RESTS:
        others.remove(RESTING)
        still = plain.rows_of(RESTING)
    if not others or not plain.spec.held or not on_valve(effect):
        return None
    rows = [0, 1, *(i for n in (*others, name) for i in range(plain.rows_of(n).start, plain.rows_of(n).stop))]
    far = with_process(model, _as_in(model, plain, windowed_valves(
        plain, rows, still, rng, known=(plain.vector(fit.best.values), plain.rows_of(name))), fit))
    guesses = effect.guess(model._context(option)) if effect.guess else np.zeros((1, 0))
    near = model.vector(fit.best.values)[:, None].repeat(len(guesses), axis=1)
    near[model.rows_of(name)] = guesses.T
    starts = np.concatenate([far, look, with_start(model, model.cube(near))])
    found = _herded_along(model, descended(model, starts, turns=_GLANCE).points, rng)
    herd = found.points
    ends = sorted((at_thresholds(model, point, rng) for point in herd[:_HERDED]), key=lambda end: end[1])
    points = np.concatenate([np.stack([point for point, _ in ends]), herd[_HERDED:]])
    neutral = float(model.costs(model.cube(model.vector(fit.best.values)[:, None]))[0])
    return Scouted(model, model, points, ends[0][1], neutral, name)


def together_on_valve(model: Model, values: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Values (d,) of a model with two or more effects on the valve, all searched together from where they are, and for
    longer where innovations are no noise; as they are under a command that moves between samples.

    Effects that were found one after the other are each as the others were then: slips a sample late, for a dead time
    a sample short, look like one more effect.
    """
    if not model.spec.held or has_noise(model.spec) or sum(map(on_valve, model.effects)) < 2:
        return values
    patience = PATIENCE if quick(model, values).white else ALONE
    best, _ = at_thresholds(model, _herded_along(model, model.cube(values[:, None]), rng, patience).points[0], rng)
    return model.values(best[None])[:, 0]


def _herded_along(model: Model, points: FloatArray, rng: np.random.Generator, patience: int = PATIENCE) -> Found:
    """A herd about points (k, d), and one beyond where a drifting valve rests; where the valve has a ridge scans along
    it: a herd spreads there step by step, a scan takes more of the way at once."""
    found = herded(model, points, rng, patience)
    beyond = beyond_rest(model, found.points[0], rng)
    if len(beyond):
        near = descended(model, beyond, turns=_GLANCE, settle=_GLANCED).points
        found = together(found, herded(model, near, rng, patience))
    for _ in range(_RIDGED if ridge_of(model) is not None else 0):
        before, along = found.costs[0], followed(model, found.points[:_KEPT], rng).points[:_KEPT]
        found = herded(model, np.concatenate([along, found.points]), rng)
        if found.costs[0] > before * (1.0 - _WORTH):
            break
    return found


def changes(name: str) -> bool:
    """Whether an effect is friction that changes along the record."""
    return parse(name)[0].profile is not None


def on_valve(effect: Effect) -> bool:
    """Whether an effect acts on the valve: on its friction, its stem or its trim."""
    return effect.place.value <= Place.TRIM.value


def settled(look: Scouted, rng: np.random.Generator) -> tuple[Model, FloatArray, float]:
    """The scouted model at its best: values (d,) and cost."""
    coarse, model = look.coarse, look.model
    if model.follows_y:
        # The first look followed the y of the model without the effect, which may be far off.
        own = model.evaluate(look.values).guide
        coarse, model = coarse.guided(own), model.guided(own)
    found = refine(coarse.costs, look.points[:6], rng, spread=spreads(coarse, 0.5), rounds=20, population=14,
                   settle=_SETTLED)
    points = found.points
    if model.spec.held and look.name and parse(look.name)[0].natural is not None:
        points = followed(coarse, points[:_KEPT], rng).points
    # A valve that rests was found beside what was still missing, which then bent its S by several slips.
    others = _stickbands(coarse, points[0]) if model.spec.held and RESTING in model.spec.effects else points[:0]
    for _ in range(_RIDGE_TURNS if model.spec.held else 1):
        near = np.concatenate([with_start(coarse, points[:2]), others])
        if model.spec.held:
            near = np.concatenate([near, along_ridge(coarse, points[:1])[:4], with_other_start(coarse, points[0], 2)])
            if look.name:
                near = np.concatenate([near, _across(coarse, points[0], look.name, 4)])
        last = refine(coarse.costs, near, rng, spread=spreads(coarse, 0.4), rounds=50, population=14, settle=_SETTLED)
        before, after = coarse.costs(np.stack([points[0], last.points[0]]))
        points = last.points
        if after > before * (1.0 - _WORTH):
            break
    best, cost = polish_smooth(coarse, with_start(coarse, last.points[:1])[0])
    for _ in range(_TURNS):
        again = refine(coarse.costs, with_start(coarse, best[None]), rng, spread=spreads(coarse, 0.2), rounds=60,
                       population=16, settle=_SETTLED)
        best, now = polish_smooth(coarse, with_start(coarse, again.points[:1])[0])
        if now > cost * (1.0 - _WORTH):
            break
        cost = now
    if model.spec.held:
        best, cost = at_thresholds(coarse, best, rng)
    if coarse is not model:
        final = refine(model.costs, best[None], rng, spread=spreads(model, 0.1), rounds=60, population=16,
                       settle=_SETTLED)
        best, cost = polish_smooth(model, final.points[0])
    return (*_following(model, model.values(best[None])[:, 0]), cost)


def _following(model: Model, values: FloatArray) -> tuple[Model, FloatArray]:
    """A model and its values (d,), polished on the y that it makes itself where an effect follows y."""
    if not model.follows_y:
        return model, values
    ends = []
    # Either reading of a disturbance at the output has an optimum of its own.
    for best in model.readings(values):
        at = values
        for _ in range(_FOLLOWED):
            own = model.guided(best.guide)
            point, _ = polish_smooth(own, own.cube(at[:, None])[0])
            trial = own.values(point[None])[:, 0]
            now = own.evaluate(trial)
            if not now.sse < best.sse:
                break
            at, best = trial, now
        ends.append((best, at))
    best, values = min(ends, key=lambda end: end[0].sse)
    return model.guided(best.guide), values


def _valve_basins(model: Model, name: str, guesses: FloatArray, fit: Fitted, rng: np.random.Generator,
                  windows: bool) -> FloatArray:
    """Starts (k, d) whose valve goes with the effect, each with its process.

    For effects on friction from a search that grows with the record, because their basins are narrow and far from the
    base's, and beside a valve that rests from windows, too, as for effects on the stem there and under a command that
    moves between samples; for others from swarms over the valve on the one-step error, which stays local in time: one
    swarm for each guess of the effect, because the right S and J lie elsewhere for each.
    """
    rows, at = model.rows_of(name), longest_piece(model)
    effect = parse(name)[0]
    if effect.friction is not None or (effect.place is Place.STEM
                                          and (RESTING in model.spec.effects or not model.spec.held)):
        found = _grown_with(model, name, fit, rng, windows)
        return found if ridge_of(model) is None or not model.spec.held else _ridges(model, name, fit, found, rng)
    period = model.period_s / model.step_s
    ladder = np.unique(np.round(np.geomspace(1, int(np.clip(0.4 * period, 1, 60)) + 1, 6) - 1).astype(int))
    arx = Arx(model.pieces[at], 2, tuple(int(d) for d in ladder))
    valve = [0, 1, model.forces[at]]
    middle = model.values(np.full((1, model.space.size), 0.5))
    middle[model.head:, 0] = model.vector(fit.best.values)[model.head:]
    starts: list[tuple[float, FloatArray]] = []
    for guess in guesses[:_GUESSES]:
        base = middle.copy()
        base[rows, 0] = guess
        fixed = model.cube(base)[0]

        def whole(part: FloatArray, fixed: FloatArray = fixed) -> FloatArray:
            cube = fixed[None].repeat(len(part), axis=0)
            cube[:, valve] = part
            return cube

        def cost(part: FloatArray, whole: Callable[[FloatArray], FloatArray] = whole) -> FloatArray:
            return arx.costs(model.of(at, model.values(whole(part))))[0]

        best = swarm(cost, 3, rng, groups=1, particles=24, rounds=_SWARM, scouts=_SCOUTS // 2)
        starts.append((float(best.costs[0]), whole(best.points[:1])[0]))
    starts.sort(key=lambda f: f[0])
    return with_process(model, np.array([f[1] for f in starts[:3]]))


def _grown_with(model: Model, name: str, fit: Fitted, rng: np.random.Generator, windows: bool = False) -> FloatArray:
    """Starts (k, d) for an effect on friction or the stem from a search that grows with the record, each with its
    process.

    Beside a valve that rests from searches for such a valve, too. So is friction that changes with time in an
    integrator from windows: parts that grow from the beginning found it in none of 5 scanned loops, windows in 3 of 3;
    and in all where `windows` are asked for.
    """
    plain = undisturbed(model, fit.model, fit.values)
    cube = grown_valves(plain, _valve_of(plain, (name,)), rng)
    if RESTING in plain.spec.effects and name != RESTING and plain.spec.held and ridge_of(model) is None:
        cube = np.concatenate([resting_valves(plain, (name,), plain.rows_of(RESTING), rng), cube])
    elif changes(name) and plain.spec.held and (windows or plain.spec.process == INTEGRATOR):
        rows = plain.rows_of(name)
        cube = np.concatenate([windowed_valves(plain, [0, 1, *range(rows.start, rows.stop)], None, rng), cube])
    found = with_process(model, _as_in(model, plain, cube, fit))
    if model.spec.held:
        return found
    beside = grown_beside(plain, _valve_of(plain, (name,)), plain.vector(fit.best.values), rng)
    return np.concatenate([_as_in(model, plain, beside, fit), found])


def _as_in(model: Model, plain: Model, points: FloatArray, fit: Fitted) -> FloatArray:
    """Points (k, d) of a model without its linear effects as points of the model, those effects as in a fit."""
    named = [{**fit.best.values, **plain.named(column)} for column in plain.values(points).T]
    return model.cube(np.stack([model.vector(n) for n in named], axis=1))


def _ridges(model: Model, name: str, fit: Fitted, starts: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Starts (k, d) followed along their ridge, best first; grown anew where that helps, but is not yet at the noise.

    One search in two ends on the ridge. Where it leads nowhere there is nothing to go on with, unless the model so far
    has a slip jump that no friction makes: a stem jumps past its place, or its slips would not be so long.
    """
    found = followed(model, starts, rng)
    asked = fit.best.values["J"] > _BEYOND * fit.best.values["S"]
    for _ in range(_GROWTHS - 1):
        helps = asked or found.costs[0] < _PROMISES * fit.sse
        if not helps or at_noise(quick(model, model.values(found.points[:1])[:, 0])):
            break
        found = together(found, followed(model, _grown_with(model, name, fit, rng), rng))
    return found.points


def _across(model: Model, point: FloatArray, name: str, count: int) -> FloatArray:
    """The best few (count, d) valves around a point (d,) with its process as it is, distinct in S.

    Break-away, slip jump and effect trade against each other, and the cost has a step for every sample at which the
    valve might break away: a polish can't cross them.
    """
    rows = model.rows_of(name)
    values = model.values(point[None])[:, 0]
    share = np.clip(values[1] / max(values[0], 1e-12), 0.02, None)
    moves = np.zeros((1 + (rows.stop - rows.start) * _ACROSS_EFFECT.size, rows.stop - rows.start))
    for i in range(rows.stop - rows.start):
        moves[1 + i * _ACROSS_EFFECT.size:1 + (i + 1) * _ACROSS_EFFECT.size, i] = _ACROSS_EFFECT
    S, J, E = np.meshgrid(_ACROSS_S, _ACROSS_J, np.arange(len(moves)), indexing="ij")
    grid = values[:, None].repeat(S.size, axis=1)
    grid[0], grid[1] = values[0] * S.ravel(), values[0] * S.ravel() * share * J.ravel()
    trial = model.cube(grid)
    trial[:, rows] = np.clip(trial[:, rows] + moves[E.ravel()], 0.0, 1.0)
    order = np.argsort(model.costs(trial), kind="stable")
    return trial[order[distinct(S.ravel()[order, None], count, 1.5 * _ACROSS_STEP)]]


def _stickbands(model: Model, point: FloatArray) -> FloatArray:
    """The best few valves (_KEPT, d) with another S beside a point (d,), each with its start, distinct in S.

    The slips of a valve that rests between scans tell J at once, while every S has a start that goes with most of its
    slips: only the right one goes with all.
    """
    values = model.values(point[None])[:, 0]
    S, J = (g.ravel() for g in np.meshgrid(_BAND_S, _BAND_J, indexing="ij"))
    grid = values[:, None].repeat(S.size, axis=1)
    grid[0], grid[1] = values[0] * S, values[1] * J
    trial = with_start(model, model.cube(grid))
    order = np.argsort(model.costs(trial), kind="stable")
    return trial[order[distinct(S[order, None], _KEPT, 1.5 * _ACROSS_STEP)]]


def own_taps(spec: Spec) -> tuple[float, ...]:
    """Prewhitening that belongs to the fit of the process (softened differences), not to a fitted noise model."""
    return () if has_noise(spec) else tuple(spec.taps)


def has_noise(spec: Spec) -> bool:
    """Whether the model has a noise effect already, whose coefficients are estimated anew with every refit."""
    return bool(noises_in(spec.effects))


def has_walk(spec: Spec) -> bool:
    """Whether the model has a random walk: y has no level then, and a free run no error that could grow."""
    return any(parse(name)[0].noise == RANDOM_WALK for name in spec.effects)


def at_noise(refit: Refit) -> bool:
    """Whether the free run of a physical refit is at its innovations: a noise model has next to nothing to do."""
    return not has_noise(refit.model.spec) and refit.evaluated.rmse <= _WHITE * refit.innovation_sd


def quick(model: Model, values: FloatArray, *, noise: str = AUTOREGRESSIVE, order: int = LARGEST_ORDER,
          rng: np.random.Generator | None = None) -> Refit:
    """The model as it is, completed with a noise model of its residual but not refitted to it.

    An integrator that is fitted to the changes of y is completed in levels, too, and the better one is kept.
    """
    found = _as_it_is(model, values, noise, order, rng)
    if not _has_levels(model, noise):
        return found
    return better(found, _as_it_is(_in_levels(model, found.evaluated), values, noise, order, rng))


def _as_it_is(model: Model, values: FloatArray, noise: str = AUTOREGRESSIVE, order: int = LARGEST_ORDER,
              rng: np.random.Generator | None = None) -> Refit:
    evaluated = model.evaluate(values)
    increments = noise == RANDOM_WALK or model.spec.increments
    own = own_taps(model.spec)
    ar, count = _taps(model, evaluated, increments, order, own, noise, rng)
    return _refit(model, values, evaluated, ar, increments, own, count)


def _has_levels(model: Model, noise: str) -> bool:
    """Whether a model is fitted to changes of y only for the sake of the search.

    Errors of slips add up in an integrator, so changes show the valve; but white noise on y hides in them whatever is
    slow, and once nothing is missing the level shows it.
    """
    return model.spec.increments and noise in (AUTOREGRESSIVE, RESONANT) and not has_noise(model.spec)


def _in_levels(model: Model, evaluated: Evaluated) -> Model:
    return bound(model.loop, replace(model.spec, increments=False, taps=()), s_max=model.s_max,
                 period_s=model.period_s, residual=evaluated.left)


def better(found: Refit, other: Refit) -> Refit:
    """The better of two completed models by BIC on common samples."""
    return other if other.gain_over(found) > 0.0 else found


def complete(model: Model, values: FloatArray, pool: FloatArray | None, rng: np.random.Generator, *,
             noise: str = AUTOREGRESSIVE, order: int = LARGEST_ORDER) -> Refit:
    """The model with a noise model for its residual, refitted in prewhitened form where there is one.

    `noise` is an autoregression, a random walk (model and data are fitted in differences, on which the autoregression
    sits), or a resonance. Prewhitening that the model has already for its process is kept, and extended; the model of
    an integrator is completed in levels, too, and the better one is kept.
    """
    found = _completed(model, values, pool, rng, noise, order)
    if not _has_levels(model, noise):
        return found
    level = _in_levels(model, found.evaluated)
    near = descended(level, level.cube(level.vector(found.model.named(found.values))[:, None]))
    return better(found, _completed(level, level.values(near.points[:1])[:, 0], None, rng, noise, order))


def _completed(model: Model, values: FloatArray, pool: FloatArray | None, rng: np.random.Generator, noise: str,
               order: int) -> Refit:
    first = _as_it_is(model, values, noise, order, rng)
    increments, own, ar = first.increments, own_taps(model.spec), first.taps
    if ar.size == 0 and increments == model.spec.increments and not has_noise(model.spec):
        return first
    best: Refit | None = None
    evaluated, count = first.evaluated, first.noise_numbers
    for _ in range(_COMPLETIONS):
        taps = tuple(_joined(own, ar)[1:].tolist())
        white = bound(model.loop, replace(model.spec, taps=taps, increments=increments), s_max=model.s_max,
                      period_s=model.period_s, residual=evaluated.left)
        starts = [values]
        if pool is not None and best is None:
            starts += [white.vector({**model.named(values), **dict(zip(BASE, base, strict=True))}) for base in pool[1:]]
        coarse = search_model(white)
        cube = with_start(coarse, coarse.cube(np.array(starts).T))
        found = refine(coarse.costs, cube, rng, spread=spreads(coarse, 0.5), rounds=40, population=14, settle=_SETTLED)
        if white.spec.held and best is None:
            near = np.concatenate([found.points[:1], along_ridge(coarse, found.points[:1])])
            found = refine(coarse.costs, near, rng, spread=spreads(coarse, 0.4), rounds=40, population=14,
                           settle=_SETTLED)
        point, _ = polish_smooth(white, found.points[0])
        values = white.values(point[None])[:, 0]
        evaluated = white.evaluate(values)
        now = _refit(white, values, evaluated, ar, increments, own, count)
        if best is not None and now.innovation_sd > 0.998 * best.innovation_sd:
            break
        best = now
        ar, count = _taps(model, evaluated, increments, order, own, noise, rng)
    assert best is not None
    return best if noise != AUTOREGRESSIVE or has_noise(model.spec) else _plainer(model, best)


def _plainer(model: Model, found: Refit) -> Refit:
    """The better of a refit in prewhitened form and the model without, polished from there, by BIC.

    Errors of a process that was not settled look like noise: prewhitened for them, a model may settle, but keeps a
    noise that is no more, and under one with a root near 1 it loses its level.
    """
    again = descended(model, model.cube(model.vector(found.model.named(found.values))[:, None]))
    return better(found, _as_it_is(model, model.values(again.points[:1])[:, 0]))


def _joined(own: tuple[float, ...], ar: FloatArray) -> FloatArray:
    """The product of two prewhitening polynomials, the leading 1 included."""
    return np.convolve(np.concatenate([[1.0], own]), np.concatenate([[1.0], ar]))


def _whitening(own: tuple[float, ...], ar: FloatArray, increments: bool) -> FloatArray:
    """The polynomial in the lag that makes innovations of errors, the leading 1 included."""
    polynomial = _joined(own, ar)
    return np.convolve(polynomial, [1.0, -1.0]) if increments else polynomial


def _taps(model: Model, evaluated: Evaluated, increments: bool, order: int, own: tuple[float, ...], noise: str,
          rng: np.random.Generator | None) -> tuple[FloatArray, int]:
    """Taps of the noise model beside the model's own prewhitening, and how many fitted numbers they stand for.

    A resonance is looked for in the longest segment: a spectrum knows no gaps.
    """
    polynomial = np.concatenate([[1.0], own])
    if increments:
        polynomial = np.convolve(polynomial, [1.0, -1.0])
    signal, good = filtered(evaluated.residual, evaluated.counted > 0, polynomial)
    if noise == RESONANT:
        part = model.loop.longest
        found = resonance(signal[part], good[part], rng or np.random.default_rng(0))
        return (found.taps, NUMBERS - 1) if found else (np.empty(0), 0)
    ar = autoregression(signal, good, order, model.loop.starts)
    return ar, ar.size


def _refit(model: Model, values: FloatArray, evaluated: Evaluated, ar: FloatArray, increments: bool,
           own: tuple[float, ...], numbers: int) -> Refit:
    polynomial = _whitening(own, ar, increments)
    innovation, good = filtered(evaluated.residual, evaluated.counted > 0, polynomial)
    good &= ~model.starting(polynomial.size)
    count = model.space.size - len(model.spec.fixed) + len(evaluated.own) + model.shared.freedom + numbers
    return Refit(model, values, evaluated, ar, increments, innovation, good, count, numbers, own)


def restored(model: Model, values: FloatArray, taps: FloatArray, *, own: tuple[float, ...], increments: bool,
             numbers: int) -> Refit:
    """A refit from its numbers: one run of the model, no search."""
    return _refit(model, values, model.evaluate(values), taps, increments, own, numbers)


def block_gains(before: Refit, after: Refit, good: BoolArray) -> FloatArray:
    """Relative drop of the one-step error on each of BLOCKS contiguous blocks (BLOCKS,), on common samples."""
    rows = np.flatnonzero(good)
    gains = []
    for part in np.array_split(rows, BLOCKS):
        a = float(np.sqrt(np.mean(before.innovation[part] ** 2)))
        b = float(np.sqrt(np.mean(after.innovation[part] ** 2)))
        gains.append(1.0 - b / a if a else 0.0)
    return np.array(gains)


def at_thresholds(model: Model, point: FloatArray, rng: np.random.Generator) -> tuple[FloatArray, float]:
    """Point (d,) with the stickband between the right samples, everything else polished; and its cost.

    Under a held command every slip allows S an interval as wide as one step of the command, and all slips together one
    far narrower than any polish strays into: a single slip a sample early or late costs more than most missing effects.
    """
    values = model.values(point[None])[:, 0]
    best, cost = point, float(model.costs(point[None])[0])
    for reach in _THRESHOLD_REACH:
        S, J = np.meshgrid(values[0] * (1.0 + np.linspace(-reach, reach, _THRESHOLDS)), values[1] * _THRESHOLD_J,
                           indexing="ij")
        grid = values[:, None].repeat(S.size, axis=1)
        grid[0], grid[1] = S.ravel(), J.ravel()
        cube = model.cube(grid)
        order = np.argsort(model.costs(cube), kind="stable")
        for k in order[distinct(grid[0, order, None], 2, 2.5 * reach / _THRESHOLDS * values[0])]:
            trial, now = polish_smooth(model, cube[k])
            if now < cost:
                best, cost = trial, now
        values = model.values(best[None])[:, 0]
    return best, cost
