"""Method `auto`, the default: basins by ARX, last polish by the free-run error, then the search's small catalogue.

The base model is the given law, first order with dead time, and white output noise. The search (selection/) decides how
the command moved between samples, whether the process integrates, whether it has a further lag, and whether the valve
rests between scans. Wrong where something else is missing from the model; `diagnose` looks for it. Source:
docs/details.md, section 6; Shang et al., Eq. 7 to 21 for the ARX part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..effects import catalogue, noises_in, walks
from ..errors import CannotTell
from ..fit.adequacy import CONDITIONAL, judge_adequacy, with_one_noise
from ..fit.context import Run, parameters
from ..fit.decimated import (
    CHATTER,
    SCANS,
    SCANS_UNKNOWN,
    chatter,
    check_scans,
    held_out,
    said_chatter,
    said_scans,
    said_unseen,
    scanned,
    scans_of,
)
from ..fit.fit import include_intervals, widen_intervals
from ..fit.friction_free import follows_command
from ..fit.intervals.assemble import outline, over_break_away, region
from ..fit.noise.completion import Refit, error_beside_landings
from ..fit.noise.prewhitening import without_noise
from ..fit.points.fitted import Fitted
from ..fit.points.moves import longest_first
from ..fit.rung import fit_with_added, polish_last, with_levels
from ..fit.starts.beside_effect import LAG
from ..fit.starts.intersample import SUBSTEPS, as_moving, surely_moves
from ..fit.with_effect import scout_effect
from ..model.spec import BASE, FIRST_ORDER, SOFT, Spec
from ..process.intersample import CORNER
from ..process.scan import DECIMATED, p_law, parts_of, ran_between
from ..record.loop import Finding
from ..record.oscillation import count_reversals
from ..record.preconditions import SAMPLES_PER_PERIOD
from ..selection.decide import Decision, decide_answer
from ..selection.ladder import order_ladder
from ..selection.node import physical_effects
from ..selection.policy import Policy
from ..selection.run import ladder_of, search_of, tree_of
from ..selection.score import beyond_noise
from ..selection.search import Search
from ..system import evaluations
from ..typing import FloatArray
from .contract import Method, Outcome

# A free-run error beyond this share of the scatter of y explains nothing. An integrator is excepted if it leaves less
# than the other share of the variance of the differences: 3 to 17 % with a hidden effect.
_NOTHING, _CHANGES = 0.995, 0.5
# Share of the scatter of y by which PV must turn back to count beside fast noise. Then the frequency ranges in cycles a
# sample: below an oscillation, of one of 2.5 to 7 samples, and above.
_TURN, _SLOW, _FAST, _FASTER = 0.5, (0.0, 0.15), (0.15, 0.4), (0.4, 0.5)

# A fit of the base, findings on it, and fits that do no better yet.
Based = tuple[Fitted, tuple[Finding, ...], tuple[Fitted, ...]]


def _run(run: Run, policy: Policy) -> Outcome:
    """Base model, then the search with the small catalogue, and with the whole one where that explains nothing."""
    o = run.options
    run.tell("searching (S, J)", 0.1)
    before = evaluations.samples_spent()
    fit, notes, slow = _base(run, policy)
    spent = (evaluations.samples_spent() - before) // policy.unit
    check_scans(run, fit)
    noises = noises_in(o.effects)
    if _nothing(run, fit) and samples_a_turn(run.used_y()) < SAMPLES_PER_PERIOD:
        raise _explains_nothing(run)  # nor could a valve that rests be seen
    run.tell("asking for the process and the command", 0.5)
    small = frozenset() if o.base_only else frozenset(
        e.name for e in catalogue().values() if e.by_itself and (o.test is None or e.name == LAG))
    search, found = _searched(run, (fit, *slow), policy, small)
    spent += search.budget.counted
    follows = search.only != small  # (then the free run may be no better than a constant)
    if not (o.base_only or follows) and _explains_none(run, found.winner.scored.done, policy):
        run.tell("asking for every effect", 0.6)
        search, found = _searched(run, (fit, *slow), policy, None)
        spent += search.budget.counted
    if not follows and _explains_none(run, found.winner.scored.done, policy):
        raise _explains_nothing(run)
    if noises or o.base_only:
        found = replace(found, noise="")
    order, rungs = order_ladder(search, found.winner, physical_effects(fit.model.spec))
    steps, fits = ladder_of(run, search, found, fit, (order, rungs))
    if found.winner.spec.between == DECIMATED and not any(n.code == SCANS for n in notes):
        notes = (said_scans(run, found.winner.spec.substeps), *notes)
    if found.unseen and not notes:
        notes = (said_unseen(run, found.missing_reason),)
    steps[0] = replace(steps[0], findings=(*notes, *steps[0].findings))
    for name in noises:
        run.tell(f"fitting with {name}", 0.75)
        fits.append(fit_with_added(fits[-1], name, run.rng))
        steps.append(run.step(fits[-1], name))
    last = fits[-1]
    # Far from the noise the intervals are conditional on the model, and a further lag imitates what is missing, unless
    # the noise model explains the distance.
    near = not any(f.code == CONDITIONAL for f in with_one_noise(steps, run.loop)[-1].findings)
    wide = near and not o.base_only and not o.fixed and LAG not in last.model.spec.effects
    if last is fit:
        # The base alone ends like every other last step: where `remove` comes back to it, it is the same.
        last = replace(polish_last(fit.model, fit.values, run.rng, spans=o.intervals), runs=fit.runs, agree=fit.agree,
                       searched=fit.searched)
        fits[-1], steps[-1] = last, run.step_again(steps[-1], last)
    if last.model.spec.paths is None and o.intervals:
        fits[-1] = _whatever_the_order(run, last) if wide else widen_intervals(last, run.rng)
    if fits[-1].sse < last.sse:
        # Another step of S does better than the search did.
        steps[-1] = run.step_again(steps[-1], fits[-1])
    fits[-1] = with_levels(run, fits[-1], run.rng)
    if o.test is not None:
        fits[-1] = over_break_away(fits[-1])
    steps[-1] = replace(steps[-1], parameters=parameters(fits[-1]))
    return Outcome(tuple(steps), tuple(fits), tree=tree_of(search, found),
                   evaluations=spent, unasked=tuple(search.budget.unasked), equivalents=found.equivalents,
                   reach=found.reach, missing_reason=found.missing_reason, unexplained=found.shape)


def _base(run: Run, policy: Policy) -> Based:
    """The fit of the base with the effects asked for, findings on scans between samples, and a fit that rebuilds them.

    The last is there where it does no better yet: a valve that rests may show which of the two is right.
    """
    o = run.options
    asked = tuple(name for name in o.effects if name not in noises_in(o.effects))
    # Samples that don't count would bend every fit; a record that has none asks for no such effect.
    limits = tuple(e.name for e in catalogue().values() if e.counted and e.name not in asked
                   and e.asked_for(run.loop.process_value))
    found = _base_with(run, (*asked, *limits))
    if limits and not _bends(plain := _base_with(run, asked), found, policy):
        return plain
    return found


def _bends(plain: Based, without: Based, policy: Policy) -> bool:
    """True where samples at a limit bend a `plain` model, as one `without` them shows on the others.

    A rounded PV that rests takes one value many times, too, and bends nothing.
    """
    a, b = plain[0].best, without[0].best
    both = (a.counted > 0) & (b.counted > 0)
    gain = both.sum() * np.log(np.sum(a.residual[both] ** 2) / np.sum(b.residual[both] ** 2))
    return bool(gain >= policy.margin)


def _base_with(run: Run, asked: tuple[str, ...]) -> Based:
    """The same with these effects."""
    o = run.options
    spec = Spec(law=run.law, effects=asked, fixed=dict(o.fixed), between="hold" if o.between == "auto" else o.between,
                substeps=SUBSTEPS if o.between == CORNER else 1)
    if o.between == DECIMATED:
        slow = scanned(run, replace(spec, substeps=scans_of(run)))
        if slow.evaluated is None:
            raise CannotTell("no valve model moves under this command", "look at the trend with stictionid read",
                             code="valve-never-moves")
        return slow.finished(run), (said_scans(run, slow.spec.substeps),), ()
    moves = o.between == "auto" and surely_moves(run.loop)
    if moves:
        spec = as_moving(spec)
    fit = run.fit(spec)
    if asked and not judge_adequacy(run.step(fit, None), run.loop)[0]:
        run.tell("adding one effect after the other", 0.3)
        one = run.fit(replace(spec, effects=()))
        for name in asked:
            one = fit_with_added(one, name, run.rng)
        fit = one if one.best.rmse < fit.best.rmse else fit
    scans = parts_of(run.loop.step_s, o.scan_s)
    if o.between != "auto" or moves or scans < 2 or not (ran_between(run.loop, scans) or p_law(run.loop)):
        return fit, (), ()
    run.tell("rebuilding the scans between samples", 0.4)
    slow = scanned(run, replace(spec, between=DECIMATED, substeps=scans))
    share = chatter(run, slow.evaluated, scans)
    said = (said_chatter(run, scans, share),) if share > CHATTER and run.options.base_only else ()
    if slow.evaluated is None or (said and scans >= SCANS_UNKNOWN):
        return fit, said, ()
    errors = held_out(run, slow.fit(run)), held_out(run, fit)
    if not errors[0] < errors[1]:
        return fit, said, (slow.fit(run),) if ran_between(run.loop, scans) else ()
    return slow.finished(run), (said_scans(run, scans, errors), *said), ()


def _searched(run: Run, bases: Sequence[Fitted], policy: Policy,
              only: frozenset[str] | None) -> tuple[Search, Decision]:
    """The search from one base or several, and its decision; effects that were asked for stay."""
    search = search_of(run, policy, run.tell, seed=run.options.seed, only=only)
    for fit in bases:
        search.root(fit)
    base = bases[0].model.spec
    if not search.best().scored.white:
        # A disturbance that is slow against the valve moves differences little, and levels into another basin. White
        # noise hides slips in differences, where an integrator's levels show them.
        soft = not base.increments
        search.root(run.fit(replace(base, increments=soft, taps=SOFT if soft else ())))
    best = search.best()
    # (under a held command a base that explains the record ends the search at once)
    done = search.at_end(best) and base.held
    if only and not done and follows_command(run, bases[0]):
        # A valve that does not stick has no rest to look for; its process may have a further lag all the same.
        search.only = frozenset((LAG,))
        if not search.at_end(best):
            search.ask_for(best, (LAG,))
        best = search.best()
    else:
        best = search.run()
    return search, decide_answer(search, best, keep=physical_effects(bases[0].model.spec),
                                 spans=run.options.intervals)


def _explains_none(run: Run, done: Refit, policy: Policy) -> bool:
    """True where a completed model's free run errs by the scatter of y, and its differences by theirs."""
    if done.increments and done.model.spec.process == FIRST_ORDER:
        return False
    scatter = _NOTHING * float(np.std(run.used_y()))
    return done.error_beside_landings > scatter and without_noise(done.model, done.values) > scatter and not (
        done.increments and beyond_noise(done) >= policy.margin)


def _nothing(run: Run, fit: Fitted) -> bool:
    error, scatter = error_beside_landings(fit.model, fit.best), _NOTHING * float(np.std(run.used_y()))
    return error > scatter and not _explains_changes(fit) and not walks(fit.model.spec.effects)


def samples_a_turn(y: FloatArray) -> float:
    """Samples in which y (n,) turns twice, on average; turns of noise as fast as the samples do not count.

    The differences of such noise have most power at the highest frequency of a record. Those of an oscillation have it
    below. Those of a slow oscillation, or of a wandering load, have it further below.
    """
    power = np.abs(np.fft.rfft(np.diff(y)))**2
    slow, fast, faster = (power[int(a * y.size):int(b * y.size)] for a, b in (_SLOW, _FAST, _FASTER))
    oscillates = bool(fast.size and faster.size and np.mean(fast) > max(np.mean(faster), np.mean(slow)))
    return 2.0 * y.size / max(count_reversals(y, 0.0 if oscillates else _TURN * float(np.std(y))), 1)


def _explains_changes(fit: Fitted) -> bool:
    """True where the model of an integrator explains most of the differences of y, to which it is fitted.

    The errors of its slips add up: with an effect missing, the level runs away from a model that is nearly right.
    """
    model = fit.model
    return model.spec.increments and fit.sse < _CHANGES * model.shared.target_energy


def _explains_nothing(run: Run) -> CannotTell:
    """The reason why the best model is no better than a constant: PV turns too fast for the samples, or ignores OP."""
    per, step = samples_a_turn(run.used_y()), run.loop.step_s
    if per < SAMPLES_PER_PERIOD:
        return CannotTell(f"sampled too slowly: the process value turns every {0.5 * per:.1f} samples of {step:g} s, "
                          f"{per:.1f} samples a period where {SAMPLES_PER_PERIOD} are needed, and no model explains it",
                          f"export at {per * step / SAMPLES_PER_PERIOD:.3g} s or faster", code="too-slow-sampling")
    return CannotTell("the best model explains nothing: its free-run error is no smaller than the scatter of y "
                      "about its mean", "check that OP drives this PV; look at the trend with stictionid read",
                      code="model-explains-nothing")


def _whatever_the_order(run: Run, fit: Fitted) -> Fitted:
    """The fit with intervals that hold even if the process has a second lag, too small to be named."""
    fit = widen_intervals(fit, run.rng, steps_only=True)
    look = scout_effect(fit, LAG, fit.values[None, :len(BASE)], run.rng)
    model = look.model
    top = longest_first(model, look.points[:1])
    known = None
    if fit.around is not None:
        possible = fit.model.values(outline(fit.model, *fit.around))
        values = model.values(top).repeat(possible.shape[1], axis=1)
        values[:len(possible)] = possible
        known = model.cube(values)
    return include_intervals(fit, *region(model, top[0], run.rng, known))


METHOD = Method(
    name="auto",
    summary="ARX finds the basin, the free-run error finishes; structure chosen, restarts must agree",
    equation="min over (S, J, e0, T, L) of ||y - K g(T, L) * u_v(S, J, e0) - b||^2 from the basins of Eq. 19",
    source="docs/details.md, section 6; Shang et al., Eq. 7 to 21",
    checked="this project's own",
    cannot="anything missing from the model (see diagnose); J where the slide is short",
    run=_run, options=frozenset({"law", "effects", "base_only", "between", "scan", "fixed", "policy", "test"}),
    restarts=True,
)
