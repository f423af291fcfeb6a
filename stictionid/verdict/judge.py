"""Verdict on stiction: the best model without friction against the best one with it, noise models included.

Both models are fitted by free run, completed with an autoregression of their residual and refitted in prewhitened form.
The reason: a friction-free model with coloured noise explains every smooth oscillation (a sine from elsewhere, tight
tuning) as well as a valve does. Only the slips of a sticking valve stay unpredicted. The friction-free model has a
structure of its own and one more lag, so that friction is not confused with a process of higher order.

Each model gets the noise of either, so that no noise model speaks for friction. Four quantities are compared. First the
log likelihood ratio of the one-step errors on common samples, whose tails may be heavy; second the number of five
blocks on which the error falls. Third are the one-step errors on blocks held out of both models: without a gain there
the verdict is not stiction. A record too short to hold blocks out is judged by the other three and trusted less. Fourth
is the part of the free-run error that friction explains. "No stiction" is a claim of its own: no friction may predict y
much better than none, and the S that is not excluded must be small beside the swing of the output.

The confidence is the posterior probability of the answer (odds.py), 0.98 at most. A model far from its noise caps it,
and the reason begins with that. Few reversals cap it, too, as does a record of which no block could be held out. Wrong
where a disturbance slips as a valve does. Source: docs/details.md, sections 7, 8, 9, 10 and 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from ..fit.context import Run
from ..fit.friction_free import with_and_without
from ..fit.noise.prewhitening import Whitened, whiten_model, without_noise
from ..fit.points.fitted import Fitted
from ..model.spec import INTEGRATOR
from ..numerics.varpro import SAME, axes
from ..record.evidence import Check, Evidence
from ..record.loop import Finding, Loop
from ..record.oscillation import BY_TURNS
from ..record.study import PositionEstimate, Step, Verdict
from .causes import looks_like
from .excluded import largest_possible
from .measured import MOST_TIMES, Gain, Measured, held_out_gain, measure
from .odds import BLOCKS, FrictionGain

# Likelihood ratio from which friction is in the record, and ratio below which nothing speaks for it. Unit: 2 log L.
_STICKS, _CLEAN = 40.0, 15.0
# Blocks of five in which friction must lower the error.
_WON = 4
# Share of the variance of y that friction must explain. Unit: 1.
_EXPLAINED = 0.03
# Likelihood ratio that is clear: a fall of the one-step error may then take the place of that share. Unit: 2 log L.
_CLEAR = 200.0
# Share by which the one-step error must then fall. Unit: 1.
_CLEAR_DROP = 0.08
# Share by which a fall of the free-run error takes its place at any ratio: a small S beside a large disturbance
# explains little of the variance, but most of the error. Unit: 1.
_MOST_OF_THE_ERROR = 0.5
# Below these shares of the variance and of the free-run error friction explains nothing that matters.
_NOTHING, _NOTHING_DROP = 0.02, 0.05
# Fewer reversals of the output than this cap the confidence (docs/details.md, section 12).
_FEWEST_FOR_TRUST, _CAPPED, _SUREST = 10, 0.6, 0.98
# Confidence of an undecided verdict at most: below a half it speaks for neither answer.
_NEITHER = 0.4
# Words that the reason of "stiction" has where the cap makes its confidence.
_AT_MOST = f", so the confidence is at most {_CAPPED:g}"
# "No stiction" needs an S excluded from this share of the output's swing on. From the second number on the reason
# begins with the free-run error in times the noise, and the confidence is capped.
_SMALL, _MANY = 0.2, 2.0
# Share of the variance of y that a model without friction may leave and still deny a friction that predicts better.
_POOR = 0.5
# Code of a verdict on a record that cannot tell, and the advice for it.
UNANSWERED = "valve-hardly-moves"
ASK = "give a record in which the output moves further, or one with setpoint moves; check that OP drives this PV"
# The confidence where only a measured position shows stiction: its transmitter may stick, too.
_SEEN = 0.9


def judge(run: Run, fit: Fitted, loop: Loop, seen: PositionEstimate | None, steps: Sequence[Step] = ()) -> Verdict:
    """The verdict on one fit of a loop, with its measured position if there is one.

    A finding of its `steps` that withholds intervals leaves no S excluded, so it forbids to deny friction.
    """
    verdict = _from_process_value(run, fit)
    unseen = next((f for step in steps for f in step.findings if f.no_intervals), None)
    if unseen is not None and verdict.stiction == "no stiction":
        verdict = _capped_by(verdict, unseen)
    return cap_verdict(with_position(verdict, seen), loop)


def _from_process_value(run: Run, fit: Fitted) -> Verdict:
    """The verdict on one fit by y alone."""
    run.tell("comparing with a valve that does not stick", 0.85)
    sticking = whiten_model(fit.model, fit.values)
    if fit.model.spec.taps:
        # A model with a noise model is not fitted to the free run; without the noise model it may do better there.
        sticking = replace(sticking, rmse=min(sticking.rmse, without_noise(fit.model, fit.values)))
    verdict, checks = _compared(run, sticking, float(fit.values[0]), fit.intervals.get("S", (0.0, 0.0))[1],
                                fit.best.rmse)
    clear = checks.clear.passed and checks.explained.passed
    if verdict.stiction == "stiction" and fit.agree < 2 <= fit.runs and not clear and _restarts_scatter(fit) \
            and run.options.test is None:
        return _undecided(verdict, "the restarts disagree; ")
    return verdict


def _restarts_scatter(fit: Fitted) -> bool:
    """True where some restart ended at an S outside the interval of S.

    Restarts inside it differ by no more than the stated uncertainty: a flat valley, not another basin.
    """
    low, high = fit.intervals.get("S", (np.inf, -np.inf))
    return bool(((fit.searched[:, 0] < low) | (fit.searched[:, 0] > high)).any())


def compare_with_free(run: Run, sticking: Whitened) -> Verdict:
    """The verdict on one model with friction, completed with its noise model, against the best one without friction."""
    return _compared(run, sticking)[0]


def _compared(run: Run, sticking: Whitened, searched: float = 0.0, reach: float = 0.0,
              error: float | None = None) -> tuple[Verdict, Checks]:
    """The verdict on one model with friction against the best one without, and the checks that decided it.

    `searched` is the S that a study states, `reach` the upper end of its interval, where there is one. `error` is its
    free-run error, which a fit without its noise model may lower.
    """
    sticking, free = with_and_without(run, sticking)
    found, gain = measure(run, sticking, free), held_out_gain(sticking, free)
    checks, ratio = checks_of(found, gain), found.gain.ratio
    evidence = Evidence(
        rmse_without_friction=free.rmse, rmse_with_friction=sticking.rmse, share_of_pv_variance=found.explained,
        error_drop=found.drop, one_step_without=free.innovation_sd, one_step_with=sticking.innovation_sd,
        one_step_drop=found.one_step, likelihood_ratio=ratio, blocks_won=found.won, blocks=BLOCKS,
        effects=tuple(effect.name for effect in sticking.model.effects),
        held_out_gain=None if gain is None else gain.share, held_out_won=None if gain is None else gain.won)
    # A free-run error larger than the scatter of y comes from a disturbance, which then makes the difference.
    leaves = free.rmse > float(np.std(run.used_y()))
    said = (f"friction lowers the quick-fit error from {free.rmse:.4g} to {sticking.rmse:.4g}" if found.drop > 0 else
            f"friction does not lower the quick-fit error ({sticking.rmse:.4g} with it, {free.rmse:.4g} without)")
    if error is not None and f"{error:.4g}" != f"{sticking.rmse:.4g}":
        said = (f"the free-run error is {error:.4g}; quick fits without a noise model leave {sticking.rmse:.4g} with "
                f"friction and {free.rmse:.4g} without")
    said += f"; {_prediction_words(found, gain)}; likelihood ratio {ratio:.0f}"
    walks = sticking.model.spec.increments and sticking.model.spec.process != INTEGRATOR
    answer, confidence = answer_of(found, checks, walks=walks, by_hand=run.options.test is not None)
    far = answer == "stiction" and _times_noise(sticking, sticking.rmse if error is None else error) > _MANY
    if answer == "stiction" and (not checks.held_out.passed or (leaves and not checks.clear.passed)):
        answer, confidence = "undecided", _NEITHER
    if far:
        said = f"the model is far from the noise{_AT_MOST if confidence >= _CAPPED else ''}; {said}"
        confidence = min(confidence, _CAPPED)
    most = checks.most.passed and not walks and not leaves
    told = [getattr(checks, f.name) for f in fields(checks)]
    instead, claim, in_free_run = "", None, most or (checks.something.passed and checks.matters.passed)
    if answer != "stiction":
        claim = _claim(run, sticking, free, found.gain, reach, in_free_run)
        # One that predicts a little better, and errs less in the free run by what matters, is not denied.
        both = checks.speaks.passed and checks.matters.passed and not walks and not leaves
        if (most or both) and not claim.open:
            words = ("friction explains most of the free-run error, though it predicts no better" if most else
                     f"friction predicts y a bit better (likelihood ratio {ratio:.0f}) and lowers the free-run error")
            claim = replace(claim, open=words, confidence=_NEITHER)
        answer, confidence = "undecided" if claim.open else "no stiction", claim.confidence
        instead = looks_like(run.loop, free, denied=not claim.open)
        first = [f"the model without friction errs by {claim.errs:.2g} times its noise"] if claim.errs > _MANY else []
        quiet = not (checks.speaks.passed and checks.blocks.passed) and not in_free_run
        answered = _answering_gain(free) if quiet or not claim.open else np.inf
        told += [*claim.checks, *([] if np.isinf(answered) else [_reaches("answer to the output", answered, _CLEAN)])]
        if answered < _CLEAN:
            swing = float(np.ptp(run.loop.output[run.loop.used]))
            answer, confidence, instead, claim = "undecided", _NEITHER, "", None
            # A model far from its noise may lack an effect that would make y depend on the output.
            evidence = replace(evidence, answered=answered, code=None if first else UNANSWERED)
            said = (f"y does not answer the output, which moves over {swing:.3g} {run.loop.unit('output', '%')} "
                    f"(likelihood ratio {answered:.0f}, {_CLEAN:.0f} are needed): a valve whose stickband is about as "
                    "wide rests, and can't be told from one without friction that moves too little")
        else:
            first += [claim.open] if claim.open else []
        said = "; ".join([*first, said])
    if claim is not None and claim.bound is not None:
        # The reason states one limit of S: the interval's, where the one-step errors exclude less than the interval.
        evidence = replace(evidence, S_excluded_above=max(claim.bound, searched, reach))
        said += f"; S above {evidence.S_stated_above:.2g} {run.loop.unit('output', '%')} is excluded"
    if instead:
        said += f"; {instead}"
        evidence = replace(evidence, looks_like=instead)
    # Steps made by hand need no cycles to be trusted.
    few = run.found.reversals < _FEWEST_FOR_TRUST and run.options.test is None
    by_turns = run.found.reference == BY_TURNS
    if by_turns and answer != "undecided":
        said += "; cycles are told by the turning points of the output alone, so this is not sure"
    elif few and answer != "undecided":
        times = "once" if run.found.reversals == 1 else f"{run.found.reversals} times"
        said += f"; the output reverses only {times}, so this is not sure"
    sure = _CAPPED if few or by_turns or gain is None else _SUREST
    return Verdict(answer, said, min(confidence, sure), evidence, checks=tuple(told)), checks


@dataclass(frozen=True, slots=True)
class _Claim:
    """Support of "no stiction": S from which on it is excluded, free-run error over the noise, and the lack in words.

    `errs` is 1 where the innovations pass all tests: a disturbance is then no fault of the model. `checks` are those of
    the likelihood ratio of the friction that predicts y best, and of the S excluded. `confidence` is that of "no
    stiction".
    """

    bound: float | None
    errs: float
    checks: tuple[Check, Check]
    open: str
    confidence: float


def _claim(run: Run, sticking: Whitened, free: Whitened, gain: FrictionGain, reach: float, in_free_run: bool,
           ) -> _Claim:
    """The support that the friction-free model and the largest possible S give to "no stiction".

    `gain` is that of the sticking model. The upper end `reach` of its S says nothing where it predicts worse, unless
    it lowers the free-run error by what matters (`in_free_run`): two models that disagree decide nothing.
    """
    swing = float(np.ptp(run.loop.output[run.loop.driven]))
    possible = largest_possible(sticking, free, swing)
    bound = None if possible is None else possible.above
    if bound is not None and (gain.ratio > 0.0 or in_free_run):
        bound = max(bound, reach)
    if possible is not None and possible.gain.ratio > gain.ratio:
        gain = possible.gain
    ratio = gain.ratio
    errs = _times_noise(free, free.rmse)
    lack = ""
    # A friction-free model that leaves most of y unexplained can't deny a friction that predicts better.
    poor = free.rmse**2 > _POOR * float(np.var(run.used_y()))
    limit = _CLEAN if poor else _STICKS
    checks = (Check("no friction predicts better", ratio, limit, bool(ratio < limit)),
              Check("S excluded", bound, _SMALL * swing, bound is not None and bool(bound <= _SMALL * swing)))
    if not checks[0].passed:
        lack = f"some friction predicts y better than none (likelihood ratio {ratio:.0f})"
    elif not checks[1].passed:
        left = "no S is excluded" if bound is None else f"S up to {100 * bound / swing:.0f} % of it is not excluded"
        lack = f"the output swings by {swing:.3g} {run.loop.unit('output', '%')} and {left}"
    if lack or bound is None:
        return _Claim(bound, errs, checks, lack, _NEITHER)
    sure = 1.0 - gain.probability(bound / swing)
    return _Claim(bound, errs, checks, "", min(sure, _CAPPED) if in_free_run or errs > _MANY else sure)


def _times_noise(model: Whitened, error: float) -> float:
    """The free-run error of a model in times its noise; 1 where the innovations pass every test for whiteness.

    It is 1, too, where no transmitter resolves the error: a model can't be far from a noise that nobody sees.
    """
    return 1.0 if model.white or error <= model.model.loop.resolution else error / max(model.innovation_sd, 1e-300)


def _answering_gain(free: Whitened) -> float:
    """Twice the log-likelihood by which y supports a process that answers the output; infinite with a given gain."""
    model = free.model
    if "gain" in model.spec.fixed:
        return np.inf
    used = model.weight > 0
    own = model.own_columns(*model.responses(free.values[:, None]))[:, used, 0]
    others = np.concatenate([own[1:].T, model.shared.basis[used]], axis=1)
    known = axes(others, SAME)
    y, response = (x - known @ (known.T @ x) for x in (model.target[used], own[0]))
    energy = float(response @ response) * float(y @ y)
    return -y.size * float(np.log1p(-min(float(response @ y)**2 / energy, 1.0 - 1e-15))) if energy else 0.0


def _prediction_words(found: Measured, gain: Gain | None) -> str:
    """The effect of friction on the prediction of the next sample, in words."""
    if gain is None:
        share, where, won, blocks = found.one_step, "the samples it was fitted to", found.won, BLOCKS
        tail = "; no blocks could be held out of this record, so this is weaker"
    else:
        share, where, won, blocks, tail = gain.share, "blocks it was not fitted to", gain.won, gain.blocks, ""
    word = "better" if share > 0.0 else "worse"
    size = f"{100 * abs(share):.{0 if abs(share) >= 0.01 else 1}f} %" if share > -1.0 else \
        f"more than {MOST_TIMES:,.0f} times" if 1.0 - share >= MOST_TIMES else f"{1.0 - share:.2g} times"
    return f"noise model included, it predicts the next sample {size} {word} on {where} ({won} of {blocks}){tail}"


def with_position(verdict: Verdict, seen: PositionEstimate | None) -> Verdict:
    """The verdict with a measured position: one that rests and jumps shows a sticking valve, whatever y shows."""
    if verdict.stiction == "stiction" or seen is None or not seen.shows_stiction:
        return verdict
    said = (f"the measured position rests and jumps: by it alone S is {seen.S:.4g}, J {seen.J:.4g}, and the law leaves "
            f"{seen.rmse:.3g} where a position in proportion to the output leaves {seen.rmse_proportional:.3g}; from "
            f"the process value alone: {verdict.stiction}, {verdict.reason}")
    # A measured position that shows sticking is the cause: no other one is named.
    return replace(verdict, stiction="stiction", confidence=_SEEN, reason=said,
                   evidence=replace(verdict.evidence, looks_like=None, without_position=verdict.stiction))


def cap_verdict(verdict: Verdict, loop: Loop) -> Verdict:
    """The verdict, undecided where reading found a fault that forbids one: compressed, averaged, re-ranged, irregular.
    """
    why = next((f for f in loop.origin.findings if f.severity == "serious" or f.caps_verdict), None)
    if why is None or verdict.stiction == "undecided":
        return verdict
    return _capped_by(verdict, why)


def _capped_by(verdict: Verdict, why: Finding) -> Verdict:
    """The verdict held back for a finding."""
    held = _undecided(verdict, f"{why.statement}; otherwise: ")
    return replace(held, evidence=replace(verdict.evidence, capped_by=why.code))


def _undecided(verdict: Verdict, why: str) -> Verdict:
    """The verdict held back, its reason preceded by `why`; a cap on the confidence of "stiction" is not said."""
    return replace(verdict, stiction="undecided", reason=why + verdict.reason.replace(_AT_MOST, ""),
                   confidence=min(verdict.confidence, _NEITHER))


@dataclass(frozen=True, slots=True)
class Checks:
    """Checks on the numbers that friction changes. The likelihood ratio, the variance and the error have several."""

    sticks: Check
    speaks: Check
    clear: Check
    blocks: Check
    explained: Check
    something: Check
    most: Check
    matters: Check
    one_step: Check
    held_out: Check


def _reaches(name: str, statistic: float, threshold: float) -> Check:
    return Check(name, float(statistic), float(threshold), bool(statistic >= threshold))


def checks_of(found: Measured, gain: Gain | None) -> Checks:
    """The checks that a verdict is decided by; a record of which nothing could be held out passes that check."""
    return Checks(
        _reaches("likelihood ratio", found.gain.ratio, _STICKS),
        _reaches("some likelihood ratio", found.gain.ratio, _CLEAN),
        _reaches("clear likelihood ratio", found.gain.ratio, _CLEAR), _reaches("blocks won", found.won, _WON),
        _reaches("explained variance", found.explained, _EXPLAINED),
        _reaches("some explained variance", found.explained, _NOTHING),
        _reaches("most of the free-run error", found.drop, _MOST_OF_THE_ERROR),
        _reaches("some free-run error", found.drop, _NOTHING_DROP),
        _reaches("one-step error", found.one_step, _CLEAR_DROP),
        Check("held-out gain", None if gain is None else gain.share, 0.0, gain is None or gain.share > 0.0))


def answer_of(found: Measured, checks: Checks, *, walks: bool = False, by_hand: bool = False) -> tuple[str, float]:
    """The answer "stiction" or "undecided", and its confidence, from the checks.

    Where y `walks` the free-run error is that of the random walk, and only the prediction counts. In a test `by_hand`
    the steps of the test make the variance of y, so that friction needs no share of it.
    """
    explained = checks.explained.passed and not walks
    # A model may predict single samples well although its free run drifts away, as slips of an integrator add up. So
    # may a model that takes the edge of a disturbance for a slip. Neither proves friction.
    enough = (explained or checks.most.passed
              or ((walks or checks.clear.passed) and checks.one_step.passed and checks.matters.passed)
              or (by_hand and checks.matters.passed))
    if not (checks.sticks.passed and checks.blocks.passed and enough):
        return "undecided", _NEITHER
    sure = found.gain.probability()
    # A model may take a sine or a neighbour's cycle for slips, where only the prediction speaks for friction.
    return "stiction", sure if explained or checks.most.passed else min(sure, _CAPPED)
