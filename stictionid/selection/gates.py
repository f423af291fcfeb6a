"""Gates that an effect must pass: its gain, held-out blocks, the free run, its range, and physics.

Each gate is one function of an `Edge` and gives the reason for a rejection, empty where the effect passes. A gate that
compares one number gives it as a `Compared`. Source: docs/details.md, section 11.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..effects import catalogue, parse
from ..fit.cross_validation import Held
from ..fit.noise.completion import Refit, stroke_score
from ..fit.starts.beside_effect import RESTING, on_valve
from ..model.spec import INTEGRATOR
from ..record.tree import Gate
from .node import BASE_EFFECTS, plain_name, shapes_process
from .policy import Policy
from .score import Scored


def margin_of(name: str, policy: Policy, done: Refit) -> float:
    """BIC that an effect must gain to be named, and cost to stay; the completed model holds it or lacks it."""
    if plain_name(name) in BASE_EFFECTS:
        return policy.structure_margin
    return policy.margin + by_choice(name, done)


def least_cost(name: str, without: Scored, policy: Policy) -> float:
    """BIC that the model must lose without an effect for the effect to stay: the effect's margin.

    A rest stays even where the model gains by leaving it out, by up to the margin. This holds where the sliding valve
    (`without` the rest) has a slip jump larger than its stickband, because that needs a friction below zero.
    """
    if plain_name(name) == RESTING and without.jumps_past:
        return -policy.margin
    return margin_of(name, policy, without.done)


def by_choice(name: str, done: Refit) -> float:
    """2 log L that the best of so many alternatives, such as tags times lags, gains by chance; 0 without a choice.

    The largest of M values of chi-square exceeds 2 ln M + x with a chance of at most exp(-x/2) / sqrt(pi ln M).
    `benchmarks/neighbours.py --calibrate` prints it.
    """
    picked_from = parse(name)[0].picked_from
    return 0.0 if picked_from is None else 2.0 * math.log(max(picked_from(done.model.context), 1))


@dataclass(frozen=True, slots=True)
class Edge:
    """A child with one effect more than its parent, and what is known of other children and nodes."""

    name: str
    child: Scored
    parent: Scored
    policy: Policy
    # True where the output was computed between the samples, too.
    blurred: bool = False
    # The last node before that passed every gate, where it is not the parent.
    sound: Scored | None = None

    @property
    def gain(self) -> float:
        """BIC of the child over its parent, both completed with noise."""
        return self.child.done.gain_over(self.parent.done)

    @property
    def margin(self) -> float:
        """BIC that this effect must gain."""
        return margin_of(self.name, self.policy, self.child.done)

    @property
    def by_forces(self) -> bool:
        """True where the likelihood of the break-away forces alone rises by the effect's margin."""
        return gains_by_forces(self.name, self.child, self.parent, self.policy)

    @property
    def by_law(self) -> bool:
        """True where PV moved slips of the parent, and the law places those of the child."""
        return self.parent.by_pv and not self.child.by_pv


@dataclass(frozen=True, slots=True)
class Compared:
    """Answer of a gate that compares one number: the reason of a rejection, the number, and its limit."""

    reason: str
    statistic: float
    threshold: float


def _check_gain(edge: Edge) -> Compared:
    enough = edge.gain >= edge.margin
    why = "" if enough else f"it gains {edge.gain:.0f} BIC over its parent, {edge.margin:g} name an effect"
    return Compared(why, edge.gain, edge.margin)


def _is_there(edge: Edge) -> str:
    """Reject a friction or signal effect whose searched numbers all ended where the effect vanishes."""
    effect, done = parse(edge.name)[0], edge.child.done
    if effect.columns is not None:
        return ""
    values = [v for k, v in done.model.named(done.values).items() if k.startswith(edge.name + ":")]
    ranges = effect.parameters_for(done.model.context)
    vanished = bool(ranges) and all(abs(p.share(v) - p.share(p.neutral)) <= edge.policy.neutral
                                    for p, v in zip(ranges, values, strict=True))
    return "its refit ended where it vanishes" if vanished else ""


def _held_out(edge: Edge) -> str | Compared:
    """Reject an effect that predicts held-out blocks no better, over all of them and in the middle one.

    Where the parent needs a random walk, it follows any disturbance one step ahead, and a held-out free run of half the
    error will do. Nobody can predict steps at times that a name holds in the block held out; their margin has paid for
    the choice. Where PV moved the slips of the parent, that of the block did, too: a child with slips by the law is
    compared with the parent by the law.
    """
    after, before = edge.child.held, edge.parent.held_by_law if edge.by_law else edge.parent.held
    if edge.by_forces or "value" in parse(edge.name)[0].needs or after is None or before is None:
        return ""
    walks = edge.parent.done.increments and not edge.child.done.increments
    if walks and 2 * after.rmse <= before.rmse:
        return Compared("", 1.0 - after.rmse / before.rmse, edge.policy.block_gain)
    falls = fall_of_held_out_error(after, before)
    why = "it predicts held-out blocks no better"
    return Compared("" if falls >= edge.policy.block_gain else why, falls, edge.policy.block_gain)


def fall_of_held_out_error(after: Held, before: Held) -> float:
    """The fall of the held-out one-step error as a share of it, over all blocks or in the middle one, the larger.

    Each block weighs by its own likelihood. Where one lies outside the range of the others, both models extrapolate
    there, and its errors would drown what the other blocks say. A drift may leave most blocks as they are.
    """
    shares = np.maximum(after.blocks, np.finfo(float).tiny) / np.maximum(before.blocks, np.finfo(float).tiny)
    return 1.0 - min(float(np.exp(np.mean(np.log(shares)))), float(np.median(shares)))


def _check_strokes(edge: Edge) -> str | Compared:
    """Reject an effect on the valve whose gain comes from a few strokes, by chance among all effects asked.

    Rounding, an unseen scan or a stem with mass makes single slips early or late. A few more parameters of the valve
    correct some of them by chance. That lowers the free-run error by little, unless scans are unseen or an integrator
    adds up the slips. Where PV moved the slips of the parent, and the law places those of the child, the errors of both
    by law are compared. A rest is exempt, because it is told by single slips.
    """
    before, after = ((s.rmse_by_law if edge.by_law else s.rmse) for s in (edge.parent, edge.child))
    freer = (after * edge.policy.freer <= before and not edge.blurred
             and edge.child.done.model.spec.process != INTEGRATOR)
    if not on_valve(parse(edge.name)[0]) or plain_name(edge.name) in BASE_EFFECTS \
            or edge.by_forces or freer:
        return ""
    score, least = stroke_score(edge.parent.done, edge.child.done), chance_limit(edge.policy)
    why = f"few strokes carry its gain: {score:.1f} standard errors, {least:.1f} name an effect"
    return Compared("" if score >= least else why, score, least)


def chance_limit(policy: Policy) -> float:
    """Standard errors that the best of all effects exceeds by chance with the probability of the policy."""
    return NormalDist().inv_cdf(1.0 - min(policy.chance, 1.0) / len(catalogue()))


def _free_run(edge: Edge) -> str | Compared:
    """Reject an effect that makes the free run worse, unless the noise of the child alone implies that error.

    A random walk implies any error. It excuses an error only where the parent needs a random walk, too. PV may have
    placed the slips of either, so the errors of valves that slip by their laws may be compared instead.
    """
    child, sound, most = edge.child, edge.sound or edge.parent, edge.policy.free_run
    excused = edge.parent.done.increments if child.done.increments else child.white
    if excused:
        return ""
    before = min(edge.parent.rmse, sound.rmse)
    if child.rmse <= most * before:
        return Compared("", child.rmse, most * before)
    limit = most * min(edge.parent.rmse_by_law, sound.rmse_by_law)
    if child.rmse_by_law <= limit:
        return Compared("", child.rmse_by_law, limit)
    return Compared(f"its free run is worse than without it ({child.rmse:.4g} for {before:.4g})", child.rmse,
                    most * before)


def _in_range(edge: Edge) -> str:
    """Reject a signal effect or disturbance that ended at a limit of its range that is not its neutral value.

    A friction effect may end there: its far limit is a law of its own, such as a valve that rests at every sample.
    """
    effect, done = parse(edge.name)[0], edge.child.done
    if effect.friction is not None:
        return ""
    values = [v for k, v in done.model.named(done.values).items() if k.startswith(edge.name + ":")]
    for p, value in zip(effect.parameters_for(done.model.context), values, strict=True):
        near_neutral = abs(p.share(value) - p.share(p.neutral)) <= edge.policy.edge
        if p.at_bound(value) and not near_neutral and p.name not in ("lag_s", "dead_time_s"):
            return f"its {p.name} ended at the limit of its range, {value:.4g} {p.unit}"
    return ""


def _check_friction(edge: Edge) -> str | Compared:
    """Reject an effect of friction or process beside a valve that might as well follow its command.

    Without friction the command excites the process at the period of the loop alone. Any process with the right gain
    and phase there explains y, and an inverse response may be the controller seen in reverse. Free-run errors tell
    that. Under a random walk they tell nothing, and the likelihood does. A sinusoid passes by its gain, unless the
    command between the samples is unknown.
    """
    effect, child, policy = parse(edge.name)[0], edge.child, edge.policy
    swings = edge.blurred and any(p.name == "period_s" for p in effect.parameters)
    if effect.friction is None and not swings and not shapes_process(effect):
        return ""
    with_it, least = (child.gain_by_friction, policy.alike) if child.done.increments else \
        (child.without_friction, policy.carried * child.rmse)
    return Compared("" if with_it > least else "beside it the valve might as well follow its command", with_it, least)


def gains_by_forces(name: str, child: Scored, parent: Scored, policy: Policy) -> bool:
    """True where an effect raises the likelihood of the break-away forces alone by its margin.

    The forces are independent from stroke to stroke. The one-step errors of both models hardly differ then.
    """
    return parent.done.prior - child.done.prior >= margin_of(name, policy, child.done)


GAIN, HELD_OUT, FREE_RUN = "gain", "held-out", "free-run"
GATES: tuple[tuple[str, Callable[[Edge], str | Compared]], ...] = (
    (GAIN, _check_gain), ("there", _is_there), ("strokes", _check_strokes), (HELD_OUT, _held_out),
    (FREE_RUN, _free_run), ("range", _in_range), ("friction", _check_friction))
# Each gate's answer in a few words, for the ranking of all effects.
SHORT = {GAIN: "gains too little", "there": "ends where it vanishes", "strokes": "helps in few strokes",
         HELD_OUT: "predicts no better", FREE_RUN: "makes the free run worse", "range": "ends at a limit",
         "friction": "needs no friction"}


def judge_edge(edge: Edge) -> tuple[Gate, ...]:
    """All gates of an edge, with the reasons of those that it does not pass."""
    return tuple(_gate(name, gate(edge)) for name, gate in GATES)


def _gate(name: str, said: str | Compared) -> Gate:
    if isinstance(said, str):
        return Gate(name, not said, said)
    return Gate(name, not said.reason, said.reason, float(said.statistic), float(said.threshold))


def judge_drop(edge: Edge) -> tuple[Gate, ...]:
    """The gate of a sliding valve whose slip jump exceeds its stickband; empty for any other.

    It fails where the resting valve that it came from explains the record about as well.
    """
    least = least_cost(edge.name, edge.child, edge.policy)
    return (Gate("rest", False, "its slip jump exceeds its stickband: a valve that rests does as well"),) \
        if least < 0.0 and -edge.gain >= least else ()


def judge_change(edge: Edge) -> tuple[Gate, ...]:
    """The gate of another process or command: its gain in BIC."""
    margin = edge.policy.structure_margin
    why = "" if edge.gain >= margin else f"it gains {edge.gain:.0f} BIC over its parent"
    return (_gate(GAIN, Compared(why, edge.gain, margin)),)
