"""Values and path of a model settled together: the likeliest slips, then the values along them, until neither gains.

One round seeks the likeliest path at the values so far (`likeliest_slips`). Then Gauss-Newton descends along this path
on the errors of PV and on rows for every stroke: the signed roots of what its break-away forces cost, times the noise.
Along a path the cost is smooth in all numbers. The scatter follows within bounds, by expectation and maximisation with
the forces as what is missing.

The start is the path of the law with the scatter at its lower bound. So no answer is less likely than a valve whose
break-away force never changes. Wrong where the start is no neighbour of the answer: nothing here searches.

Source: docs/details.md, section 14; Dempster, Laird and Rubin 1977.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..effects import parse
from ..model.forces import AT, BEFORE, Forces
from ..model.model import Model
from ..model.replay import Replayed
from ..model.segments import rebind_model
from ..model.slips import Paths
from ..model.spec import INTEGRATOR, SOFT, Evaluated
from ..numerics.gauss_newton import descend, slopes_at
from ..numerics.noise.normal import moments_between
from ..typing import FloatArray
from .command_error import errs_by_scan, likely_jitter
from .likelihood import deviance, forces, law_paths, likeliest_slips, log_chance, strokes

# Scatter of a break-away force: bounds as shares of f_s, and those tried for the first path of a start.
LEAST, MOST, FIRST = 0.003, 0.06, (0.06, 0.02, 0.005)
# Share of the largest scatter from which one is as large as it may be.
_AT_BOUND = 0.95
# Rounds of path and values, turns of a descent in each, and the fall of -2 log L that is worth another round.
ROUNDS, TURNS, WORTH = 8, 4, 0.5
# Share of the error that a round may leave where it leaves too much, and gets another one all the same.
_HOPEFUL = 0.8
# First difference of a number, as a share of its range.
_DIFFERENCE, _STILL = 1e-4, 1e-6
# Rounds and change that settle the scatter; break-away forces tried either way (fewer by scan, where the likelihood is
# smooth: with 24 one of 48 simulated loops was likelier by more than 1), and their reach in scatters.
_SCATTER_ROUNDS, _SAME_SCATTER, _FORCES, _FEWER, _REACH, _BOTH_WAYS = 20, 0.01, 24, 8, 1.0, 2.0
# An error of the command that is known, and the factor by which one that is sought changes, or a scatter by scan.
_KNOWN, _ERROR_STEP = (0.0, 0.0), 1.5
# Reach of f_s on a path of another valve, as a share of f_s.
_WIDE = 0.4
# Shares of a stickband whose path serves where that of the whole one never moves.
_SMALLER = (1.0, 0.85, 0.7, 0.55, 0.4)
# Numbers that the forces of the strokes tell beside their scatter, and (z^2 + 1) / 4 for the 90 % quantile z = 1.645.
_TOLD, _STUDENT = 2, 0.93
# Standard deviation of the difference of two commands, in errors of one.
_COMMANDS = float(np.sqrt(2.0))


@dataclass(frozen=True)
class Settled:
    """Values (d,) and paths of a model, -2 log L but for a constant, and what PV moved."""

    model: Model
    values: FloatArray
    paths: Paths
    deviance: float

    @property
    def prior(self) -> float:
        """-2 log of the chance of the break-away forces and turns, over the share of the path in all that PV allows."""
        found = forces(self.along, self.values[:, None])
        return -2.0 * float(log_chance(found, self.paths)[0])

    @cached_property
    def left(self) -> float:
        """Error along the paths, in the unit of y."""
        return float(np.sqrt(self.along.costs_of(self.values[:, None])[0] / self.model.shared.rows))

    @cached_property
    def along(self) -> Model:
        """The model along the paths."""
        return self.model.along(self.paths)

    def with_values(self, values: FloatArray, deviance: float) -> Settled:
        """The same path at other values (d,)."""
        found = replace(self, values=values, deviance=deviance)
        found.__dict__["along"] = self.along
        return found

    def strokes(self) -> list[Replayed]:
        """The strokes of every segment, of one candidate."""
        return strokes(self.model, self.values[:, None], self.paths, lent=False)

    @property
    def moved(self) -> float:
        """Share of the slips (0 to 1) that PV moved or added (see `Forces.moved`)."""
        strokes = self.strokes()
        return sum(one.forces.moved for one in strokes) / (self.paths.count + len(strokes))


def bounds(model: Model, values: FloatArray, error: float = 0.0) -> tuple[float, float]:
    """Least and largest scatter in %, for values (d,), which holds the `error` of the command at both ends of a stick.
    """
    fs = 0.5 * float(values[0] + (values[0] if model.law.one_parameter else values[1]))
    return LEAST * fs, MOST * fs + _COMMANDS * error


def scatters_at_most(along: Model, values: FloatArray) -> bool:
    """True where the scatter of a model along paths is the largest one allowed: it stands for what is missing."""
    paths = along.spec.paths
    return paths is not None and paths.scatter >= _AT_BOUND * bounds(along, values, paths.at_ends)[1]


def first_path(model: Model, values: FloatArray, error: float) -> Settled:
    """The likeliest path that PV shows at values (d,) with any of the scatters that `settle_path` tries first."""
    model, by_scan = model.along(None), errs_by_scan(model)
    low, high = bounds(model, values, 0.0 if by_scan else error)
    start = path_by_law(model, values, low, error, by_scan=by_scan)
    return _first_sought(start, low, high, in_differences(start))


def _first_sought(start: Settled, low: float, high: float, seen: Evaluated | None) -> Settled:
    """The likeliest of the paths sought near to one with the scatters to try first (see `_sought_path`)."""
    if seen is None and start.paths.landing is None:
        # (where a stem lands exactly, the scatter that a path is sought with changes nothing of the start)
        seen = start.along.evaluate(start.values)
    return min((_sought_path(start, share, low, high, seen) for share in FIRST), key=lambda s: s.deviance)


def settle_path(model: Model, values: FloatArray, *, error: float = 0.0, rounds: int = ROUNDS,
                begin: Paths | None = None, most: float = np.inf, first: Settled | None = None,
                within: tuple[float, float] = _KNOWN, seek: bool = True) -> Settled:
    """The model settled from values (d,); without `rounds` only the path is sought, and the values stay.

    `error` is that of the command in %; `within` are bounds of one that is sought, too, where it is not 0. A path to
    `begin` with may belong to another S, because it does not fix f_s.
    The result is never less likely than the path of the law. A path that still leaves the error `most` after a round,
    in the unit of y, and hardly less than before, lacks an effect and gets no further round. A `first` path is that of
    `first_path`, if it is known. Without `seek` the path to begin with, or that of the law, stays.
    """
    model, by_scan = model.along(None), errs_by_scan(model)
    low, high = bounds(model, values, 0.0 if by_scan else error)
    start = best = path_by_law(model, values, low, error, by_scan=by_scan)
    if begin is not None and [s.size for s in begin.slips] == [s.size for s in start.paths.slips]:
        begin = replace(begin.with_error(error), scatter=min(begin.scatter, high) if by_scan else begin.scatter,
                        by_scan=by_scan)
        known = at_force(score_path(model, values, begin), _WIDE * high / MOST)
        known = _with_scatter(at_force(_with_scatter(known, low, high)), low, high)
        start = best = min(best, known, key=lambda s: s.deviance)
    if not np.isfinite(best.deviance):
        return best  # (no path that this valve can take)
    if seek:
        best = min(best, first or _first_sought(start, low, high, in_differences(start)), key=lambda s: s.deviance)
    # (few hypotheses show in a fraction of the time that an effect is missing)
    few = model.parts > 1 and most < np.inf
    for _ in range(rounds):
        low, high = bounds(model, values, best.paths.at_ends)
        moved = at_force(_with_scatter(descend_along(best), low, high))
        before, path = best, likeliest_slips(moved.along, moved.values, few=few)
        again = _score_within(model, moved.values, path, low, high)
        if by_scan:
            best = _with_other_scatter(min(again, best, key=lambda s: s.deviance), low, high, few)
        else:
            best = _with_error(min(moved, again, best, key=lambda s: s.deviance), within)
        gains = best.deviance < before.deviance - WORTH
        if best.left > max(most, _HOPEFUL * before.left) or not (gains or few):
            return best
        few = few and gains
    return best


def in_differences(start: Settled) -> Evaluated | None:
    """The model of an integrator in differences of y, at the values of a path by its law; None for any other start.

    Slips in the wrong place add up in an integrator's level, and its gain there is that of no path. Differences forget
    them.
    """
    model = start.model
    if model.spec.process != INTEGRATOR or model.spec.increments or start.paths.landing is not None:
        return None
    spec = replace(model.spec, increments=True, taps=SOFT, paths=None)
    return rebind_model(model, spec, None).evaluate(start.values)


def _sought_path(start: Settled, share: float, low: float, high: float, seen: Evaluated | None) -> Settled:
    """The likeliest path near to one, sought with a scatter that is a share of f_s, at the same values.

    Gain and noise are those of the start, or as `seen` in differences.
    """
    width = min(max(share * high / MOST, low), high)
    # (few hypotheses: rounds go on from here with many)
    path = likeliest_slips(start.model.along(replace(start.paths, scatter=width)), start.values, seen, few=True)
    return _score_within(start.model, start.values, path, low, high)


def settle_with_error(model: Model, known: Settled, starts: Sequence[FloatArray], errors: Sequence[float], *,
                      rounds: int = ROUNDS, begin: Paths | None = None, enough: float = 0.0, most: float = np.inf,
                      within: tuple[float, float] = _KNOWN) -> Settled:
    """The best settled model: one that is `known`, with the first of several errors of the command in %, or another.

    The first error is tried from further starts (d,), the next ones from the best one, until a path leaves `enough` or
    less, in the unit of y.
    """
    likely, *others = errors
    best = min((known, *(settle_path(model, values, error=likely, rounds=rounds, begin=begin, most=most, within=within)
                         for values in starts)), key=lambda s: s.deviance)
    for error in others:
        if best.left <= enough:
            break
        now = settle_path(model, best.values, error=error, rounds=rounds, begin=best.paths, most=most, within=within)
        best = min(best, now, key=lambda s: s.deviance)
    return best


def settle_beside(best: Settled, *, most: float = np.inf, within: tuple[float, float] = _KNOWN) -> Settled:
    """A settled model, or a likelier one that no slope and no slip on its own leads to.

    First come other values of a number by which the model changes in steps. Then all slips come so many commands
    earlier or later. The dead time makes up for that, and S for the way of the command in between. PV shows the
    difference in the heights of the strokes only, and a path that is sought near to another one moves one slip at a
    time. Between two samples PV shows no difference.
    """
    best = _settle_steps(best, most, within)
    return best if best.model.parts > 1 else climb(best, (1,), lambda values, paths: settle_path(
        best.model, values, error=paths.error, begin=paths, most=most, within=within))


def _settle_steps(best: Settled, most: float, within: tuple[float, float]) -> Settled:
    """A settled model, or a likelier one with another value of a number by which the model changes in steps.

    Slopes say nothing of such a number. Every guess of its effect gets one round, and the best one goes on.
    """
    model, found = best.model, [best]
    for name, effect, rows in zip(model.names, model.effects, model.effect_rows, strict=True):
        own = model.space.parameters[rows]
        if effect.guess is None or not any(p.steps and p.high > p.low for p in own):
            continue
        for guess in effect.guess(model.context_of(parse(name)[1])):
            values = best.values.copy()
            values[rows] = [min(max(g, p.low), p.high) if p.steps else v
                            for g, v, p in zip(guess, values[rows], own, strict=True)]
            found.append(settle_path(model, values, error=best.paths.error, rounds=1, begin=best.paths, most=most,
                                     within=within))
    now = min(found, key=lambda s: s.deviance)
    if not now.deviance < best.deviance - WORTH:
        return best
    return settle_path(model, now.values, error=now.paths.error, begin=now.paths, most=most, within=within)


def climb(best: Settled, steps: Sequence[int], settle: Callable[[FloatArray, Paths], Settled]) -> Settled:
    """A settled model, or a likelier one with all its slips moved by steps in commands, each as long as it gains.

    `settle` settles moved values (d,) and paths.
    """
    for step in steps:
        for way in (-step, step):
            before = best
            while (moved := all_slips_moved(best, way)) is not None:
                if not (now := settle(*moved)).deviance < best.deviance - WORTH:
                    break
                best = now
            if best is not before:
                break
    return best


def all_slips_moved(found: Settled, commands: int) -> tuple[FloatArray, Paths] | None:
    """Values (d,) and paths with all slips so many commands later, the dead time shorter; None beyond its range.

    The stem keeps its places where f_s and f_d grow by as much as the command moved on in between, so that S grows by
    twice that and J stays. S stays, too, where that is likelier: a stem that slides on follows the command.
    """
    space, values, moved = found.model.space.parameters, found.values.copy(), []
    values[4] -= commands * found.model.step_s / found.model.parts
    if not space[4].low <= values[4] <= space[4].high:
        return None
    slips = []
    for piece, s in zip(found.model.pieces, found.paths.slips, strict=True):
        at = s.at + commands
        there = (at > 0) & (at < s.size)
        slips.append(replace(s, at=at[there], kind=s.kind[there], known=min(max(s.known + commands, 0), s.size)))
        slip = there & (np.abs(s.kind) == 1)
        command = piece.context.command
        moved.append(s.kind[slip] * (command[at[slip]] - command[s.at[slip]]))
    paths, further = replace(found.paths, slips=tuple(slips)), np.concatenate(moved)
    if not found.model.space.movable[0] or not further.size:
        return values, paths
    grown = values.copy()
    grown[0] = min(max(values[0] + 2.0 * float(np.median(further)), space[0].low), space[0].high)
    reach = _WIDE * bounds(found.model, values, paths.at_ends)[1] / MOST
    return min((values, grown), key=lambda v: at_force(score_path(found.model, v, paths), reach).deviance), paths


def path_by_law(model: Model, values: FloatArray, scatter: float, error: float, *, by_scan: bool = False) -> Settled:
    """A path by the law; of a smaller valve where this one never moves. `by_scan` is that of `Paths`."""
    jitter = likely_jitter(model)
    for share in _SMALLER:
        smaller = values.copy()
        smaller[:2] *= share
        found = score_path(model, values, Paths(law_paths(model, smaller), scatter, error, jitter=jitter,
                                               by_scan=by_scan))
        if np.isfinite(found.deviance):
            break
    return found


def score_path(model: Model, values: FloatArray, paths: Paths) -> Settled:
    """A path at values (d,) with its deviance."""
    found = Settled(model, values, paths, np.nan)
    return found.with_values(values, float(deviance(found.along, values[:, None])[0]))


def _score_within(model: Model, values: FloatArray, paths: Paths, low: float, high: float) -> Settled:
    """A path at values (d,) with its deviance under its likeliest scatter within bounds."""
    if paths.by_scan:
        return score_path(model, values, paths)
    found = [stroke.forces for stroke in strokes(model, values[:, None], paths)]
    width = _likeliest_scatter(found, paths.scatter, low, high)
    return score_path(model, values, replace(paths, scatter=width))


def _with_scatter(found: Settled, low: float, high: float) -> Settled:
    """The same path with the likeliest scatter within bounds."""
    if not np.isfinite(found.deviance) or found.paths.by_scan:
        # (a valve that does not take the path tells no scatter; one by scan moves with its path: `_with_other_scatter`)
        return found
    width = _likeliest_scatter(forces(found.along, found.values[:, None]), found.paths.scatter, low, high)
    # (at a bound it often stays, and so does the deviance)
    return found if width == found.paths.scatter else \
        score_path(found.model, found.values, replace(found.paths, scatter=width))


def _likeliest_scatter(found: Sequence[Forces], width: float, low: float, high: float) -> float:
    """The likeliest scatter within bounds for the forces of every segment, by expectation and maximisation."""
    margins = [stroke.margins[:-1, :, 0] for stroke in found]
    for _ in range(_SCATTER_ROUNDS):
        before = width
        squares = np.concatenate([moments_between(m[:, BEFORE], m[:, AT], width)[1] for m in margins])
        width = min(max(float(np.sqrt(squares.mean())) if squares.size else low, low), high)
        if abs(width - before) < _SAME_SCATTER * before:
            break
    return width


def _with_other_scatter(best: Settled, low: float, high: float, few: bool) -> Settled:
    """The same values with a likelier scatter within bounds, and the likeliest path under it."""
    model, values, paths = best.model, best.values, best.paths
    return _likelier_step(best, paths.scatter, low, high, lambda width: score_path(
        model, values, likeliest_slips(model.along(replace(paths, scatter=width)), values, few=few)))


def _with_error(found: Settled, within: tuple[float, float]) -> Settled:
    """The same path with a likelier error of the command within bounds; the same where its stem lands exactly."""
    return found if found.paths.landing is None or not within[1] else _likelier_step(
        found, found.paths.error, *within, lambda e: score_path(found.model, found.values, found.paths.with_error(e)))


def _likelier_step(best: Settled, number: float, low: float, high: float, at: Callable[[float], Settled]) -> Settled:
    """A settled model, or a likelier one `at` its number one step up or down, within bounds."""
    for factor in (_ERROR_STEP, 1.0 / _ERROR_STEP):
        if low <= (other := factor * number) <= high and (now := at(other)).deviance < best.deviance:
            return now  # (the other step leads back)
    return best


def at_force(found: Settled, reach: float = 0.0) -> Settled:
    """The same path with the likeliest break-away force: S and J move together, so that f_d stays.

    Slopes say little of it where a force is known to a whole step of the command only. The forces tried lie up to
    `reach` in % either way, or up to one scatter; an error by scan widens that.
    """
    model, values = found.model, found.values
    if model.law.one_parameter or not model.space.movable[:2].all():
        return found
    fs, width = 0.5 * (values[0] + values[1]), found.paths.scatter
    moves = np.linspace(-1.0, 1.0, 2 * (_FEWER if found.paths.by_scan else _FORCES) + 1)
    if found.paths.by_scan:
        reach = max(reach, _BOTH_WAYS * float(np.hypot(width, found.paths.error)))
    moves *= reach or _REACH * width
    trial = values[:, None].repeat(moves.size, axis=1)
    trial[:2] += moves
    trial[list(model.forces)] *= fs / (fs + moves)
    trial = trial[:, (np.abs(trial[list(model.forces)]) <= 1.0).all(axis=0) & (trial[1] >= 0.0)
                  & (trial[1] <= 2.0 * trial[0]) & (trial[0] <= model.space.parameters[0].high)]
    if not trial.shape[1]:
        return found
    costs = deviance(found.along, trial)
    best = int(np.argmin(costs))
    return found if costs[best] >= found.deviance else found.with_values(trial[:, best].copy(), float(costs[best]))


class _Rows:
    """Residuals of PV and of the break-away forces along one path, whose squares add up to the deviance."""

    def __init__(self, found: Settled) -> None:
        self.model, self.along, self.paths = found.model, found.along, found.paths
        self.noise = found.left

    def forces(self, cube: FloatArray) -> FloatArray:
        """Rows (r, P): signed roots of what each force costs more than one in the middle of its step."""
        found = forces(self.along, self.model.values(cube))
        return self.noise * np.concatenate([one.roots(self.paths.scatter) for one in found])

    def residuals(self, cube: FloatArray) -> FloatArray:
        return np.concatenate([self.along.residuals(cube), self.forces(cube)])

    def costs(self, cube: FloatArray) -> FloatArray:
        return self.along.costs(cube) + np.einsum("np,np->p", r := self.forces(cube), r)


def descend_along(found: Settled) -> Settled:
    """The values after some turns of Gauss-Newton along the path; the same where the path is impossible."""
    if not np.isfinite(found.deviance):
        return found
    rows = _Rows(found)
    best = descend(rows.residuals, rows.costs, found.model.cube(found.values[:, None]),
                   spread=np.where(found.model.space.movable, _DIFFERENCE, 0.0), turns=TURNS, settle=_STILL)
    values = found.model.values(best.points[:1])
    return found.with_values(values[:, 0], float(deviance(found.along, values)[0]))


def width_of_forces(strokes: int) -> float:
    """The factor by which the forces of few strokes tell less than those of many, because they tell their scatter, too.

    S and J leave two freedoms less, and Student's 90 % quantile takes the place of the normal one, to the first order.
    Source: Cornish and Fisher 1937.
    """
    freedom = max(strokes - _TOLD, 1)
    return float(np.sqrt(strokes / freedom)) * (1.0 + _STUDENT / freedom)


def covariance(found: Settled) -> FloatArray:
    """Covariance (d, d) of the values in the unit cube, from the curvature along the path; 0 where fixed.

    The forces of the strokes count for less by `width_of_forces`: a normal 90 % interval is then that of Student's
    distribution.
    """
    rows, point = _Rows(found), found.model.cube(found.values[:, None])
    free = np.flatnonzero(found.model.space.movable)
    slopes, left = slopes_at(rows.residuals, point, free, np.full((1, free.size), _DIFFERENCE))
    samples = found.model.loop.samples
    slopes[0, samples:] /= width_of_forces(found.paths.count)
    normal = slopes[0].T @ slopes[0]
    errors = left[0, :samples]
    size = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    inverse = np.linalg.pinv(normal / np.outer(size, size), rcond=1e-10) / np.outer(size, size)
    spread = np.zeros((point.shape[1], point.shape[1]))
    spread[np.ix_(free, free)] = inverse * float(errors @ errors) / found.model.shared.rows
    return spread
