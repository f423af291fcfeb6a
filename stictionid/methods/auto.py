"""Method `auto`, the default: basins by ARX, last polish by the free-run error, restarts, choice of the structure.

The base model is the given law, first order with dead time or integrator with lag and dead time, and white output
noise. The method decides how the command moved between samples and whether the process integrates. Where the data ask
for a further lag it becomes a step of its own. Wrong where something is missing from the model; `diagnose` looks for
it. Source: METHODS.md section 4, traps 1 to 5; the paper's Eq. 7 to 21 for the ARX part.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from ..effects import noises_in
from ..errors import CannotTell
from ..fit.add_effect import added
from ..fit.context import WALK, Run, parameters
from ..fit.fit import Fitted, reaching
from ..fit.intervals.assemble import outline, region
from ..fit.noise.prewhitening import whitened
from ..fit.starts.beside_effect import RESTING
from ..fit.starts.intersample import SUBSTEPS, moved_after_all
from ..model.spec import FIRST_ORDER, Spec
from ..record.loop import Finding
from ..record.oscillation import count_reversals
from ..record.preconditions import SAMPLES_PER_PERIOD
from ..selection.added_steps import leave_out, try_load, try_resting, try_step, try_stop
from ..selection.noise_steps import ask_noise, try_noise, try_walk_alone
from ..selection.policy import Policy
from ..selection.structure import LAG, check_scans, choose, first_look
from ..typing import FloatArray
from .contract import Method, Outcome

# A free-run error beyond this share of the scatter of y explains nothing. An integrator is excepted if it leaves less
# than the other share of the variance of the differences: 3 to 17 % with a hidden effect.
_NOTHING, _CHANGES = 0.995, 0.5
# Share of the scatter of y by which PV must turn back to count beside fast noise. Then the frequency ranges in cycles a
# sample: below an oscillation, of one of 2.5 to 7 samples, and above.
_TURN, _SLOW, _FAST, _FASTER = 0.5, (0.0, 0.15), (0.15, 0.4), (0.4, 0.5)


def _run(run: Run, policy: Policy) -> Outcome:
    """The search with the command that the record indicates; where that is a held one, again with a moving one.

    The steps that it may add by itself have numbers of their own; none of them is a field of `policy` yet.
    """
    outcome = _searched(run)
    if run.options.between != "auto" or moved_after_all(outcome.fits[-1], run.options.scan_s) is None:
        return outcome
    run.tell("rebuilding the command between samples", 0.5)
    again = copy(run)
    again.options = replace(run.options, between="corner")
    try:
        moving = _searched(again)
    except CannotTell:
        return outcome
    return min(outcome, moving, key=lambda o: whitened(o.fits[-1].model, o.fits[-1].values).innovation_sd)


def _searched(run: Run) -> Outcome:
    """Base model with its process and its command between samples, then whatever else the data ask for."""
    o = run.options
    noises = noises_in(o.effects)
    spec = Spec(law=run.law, effects=tuple(name for name in o.effects if name not in noises), fixed=dict(o.fixed),
                between="hold" if o.between == "auto" else o.between,
                substeps=SUBSTEPS if o.between == "corner" else 1)
    run.tell("searching (S, J)", 0.1)
    spec, runs, notes = choose(run, spec)
    run.tell("restarting until two searches agree", 0.5)
    fit = run.fit(spec, before=runs)
    first = run.step(fit, None)
    if spec.effects and not run.adequate(first)[0]:
        run.tell("adding one effect after the other", 0.55)
        one, said = _one_by_one(run, spec)
        if one.best.rmse < fit.best.rmse:
            fit, first, notes = one, run.step(one, None), said
    check_scans(run, fit)
    steps, fits = [replace(first, findings=(*notes, *first.findings))], [fit]
    if _nothing(run, fit) and samples_a_turn(run.used_y()) < SAMPLES_PER_PERIOD:
        raise _explains_nothing(run)  # nor could a valve that rests be seen
    if not o.base_only and RESTING not in spec.effects:
        run.tell("trying a valve that rests between scans", 0.6)
        try_resting(run, steps, fits)
    if not o.base_only and _nothing(run, fits[-1]):
        run.tell("trying a load that changes", 0.65)
        try_load(run, steps, fits)
    if not o.base_only:
        try_stop(run, steps, fits)
    if not o.base_only and _nothing(run, fits[-1]):
        run.tell("trying a random walk", 0.68)
        try_walk_alone(run, steps, fits)
    if _nothing(run, fits[-1]):
        raise _explains_nothing(run)
    # With a random walk the lag was tried already.
    if not o.base_only and not o.fixed and not {LAG, WALK} & set(fits[-1].model.spec.effects):
        run.tell("trying a further lag", 0.7)
        try_step(run, steps, fits, LAG)
    for name in noises:
        run.tell(f"fitting with {name}", 0.75)
        ask_noise(run, steps, fits, name)
    if not noises and not o.base_only and not o.fixed and not run.adequate(steps[-1])[0]:
        run.tell("trying coloured noise and a random walk", 0.75)
        try_noise(run, steps, fits)
    if not noises:
        leave_out(run, steps, fits)
    found = fits[-1]
    if not o.base_only and not o.fixed and LAG not in found.model.spec.effects:
        fits[-1] = _whatever_the_order(run, fits[-1])
    else:
        fits[-1] = reaching(fits[-1], run.rng)
    if fits[-1].sse < found.sse:
        # Another step of S does better than the search did.
        steps[-1] = run.step_again(steps[-1], fits[-1])
    steps[-1] = replace(steps[-1], parameters=parameters(fits[-1]))
    adequate, why = run.adequate(steps[-1])
    return Outcome(tuple(steps), tuple(fits), adequate, why)


def _one_by_one(run: Run, spec: Spec) -> tuple[Fitted, tuple[Finding, ...]]:
    """The fit of the requested effects, each added to the best model so far, and the findings on its structure.

    A narrow basin (a period, a drift) is found beside a valve that is nearly right, not by a search for everything.
    """
    bare, runs, notes = choose(run, replace(spec, effects=(), process=FIRST_ORDER, increments=False, taps=()))
    fit = run.fit(bare, before=runs)
    for name in spec.effects:
        fit = added(fit, name, run.rng)
    return fit, notes


def _nothing(run: Run, fit: Fitted) -> bool:
    return fit.best.rmse > _NOTHING * float(np.std(run.used_y())) and not _explains_changes(fit) \
        and WALK not in fit.model.spec.effects


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
    fit = reaching(fit, run.rng, steps_only=True)
    model, quick = first_look(run, fit.model, fit.best.values, LAG)
    known = None
    if fit.around is not None:
        possible = fit.model.values(outline(fit.model, *fit.around))
        values = model.values(quick.points[:1]).repeat(possible.shape[1], axis=1)
        values[:len(possible)] = possible
        known = model.cube(values)
    wide = region(model, quick.points[0], run.rng, known)
    names = {name: (min(low, wide[name][0]), max(high, wide[name][1]))
             for name, (low, high) in fit.intervals.items() if name in wide}
    return replace(fit, intervals={**fit.intervals, **names})


METHOD = Method(
    name="auto",
    summary="ARX finds the basin, the free-run error finishes; structure chosen, restarts must agree",
    equation="min over (S, J, e0, T, L) of ||y - K g(T, L) * u_v(S, J, e0) - b||^2 from the basins of Eq. 19",
    source="METHODS.md section 4; paper Eq. 7 to 21",
    checked="this project's own",
    cannot="anything missing from the model (see diagnose); J where the slide is short",
    run=_run, options=frozenset({"law", "effects", "base_only", "between", "scan", "fixed", "policy"}), restarts=True,
)
