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
    # True for a parent that fails one gate, and that may pass together with a further effect (`Entry.tentative`).
    tentative: bool = False
    # The last node before that passed every gate, where it is not the parent.
    sound: Scored | None = None
    # The best model without an effect beyond the base, where it is known.
    base: Scored | None = None
    # The parent with a step at the output, where it is known: a lost slip shifts the output of an integrator so.
    shifted: Scored | None = None

    @property
    def gain(self) -> float:
        """BIC of the child over its parent, both completed with noise."""
        return self.child.done.gain_over(self.parent.done)

    @property
    def margin(self) -> float:
        """BIC that this effect must gain."""
        return margin_of(self.name, self.policy, self.child.done)

    @property
    def before(self) -> Scored:
        """The parent, or its last ancestor that passed where the parent is tentative: both effects count together."""
        return self.sound if self.tentative and self.sound is not None else self.parent

    @property
    def by_forces(self) -> bool:
        """True where the likelihood of the break-away forces alone rises by the effect's margin."""
        return gains_by_forces(self.name, self.child, self.parent, self.policy)

    @property
    def beyond_slip(self) -> bool:
        """True where an effect of an integrator explains more than a slip of the stickband lost for half a cycle.

        Such a slip shifts y by the integrator's gain times the stickband times that time. An effect that leaves half
        of the error beside the best shift at any time explains more, too.
        """
        done, left = self.child.done, self.child.rmse
        shift = abs(done.evaluated.gain) * done.evaluated.values["S"] * done.model.period_s / 2.0
        beside_shift = 0.0 if self.shifted is None else min(self.shifted.least_rmse, self.before.rmse)
        return done.model.spec.process == INTEGRATOR and (
            self.before.rmse**2 - left**2 > shift**2 or 2 * left <= beside_shift)


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
    the choice.
    """
    after, before = edge.child.held, edge.parent.held
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
    by_law = edge.parent.by_pv and not edge.child.by_pv
    before, after = ((s.rmse_by_law if by_law else s.rmse) for s in (edge.parent, edge.child))
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


def _check_slip(edge: Edge) -> str:
    """Reject a step or ramp of an integrator that one slip in the wrong place may imitate, because slips add up.

    The effect passes where it explains more than one slip, or where the free-run error is at the noise. Under a held
    command noise of short memory will do, because then no slip is wrong. A command that moves between the samples hides
    when the valve slips. An effect added to a tentative step is tested together with the step.
    """
    child = edge.child
    names = child.done.model.spec.effects if edge.tentative else (edge.name,)
    if child.done.model.spec.process != INTEGRATOR or not any(parse(n)[0].variants for n in names) \
            or (child.noise_alone and child.done.model.spec.held) or edge.beyond_slip \
            or child.rmse <= edge.policy.at_noise * child.done.innovation_sd:
        return ""
    return "one slip in the wrong place of an integrator looks the same"


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


def _beyond_scans(edge: Edge) -> str:
    """Reject an effect that helps little where the output between samples is unknown and more than noise is left.

    The likelihood along a path knows that slips come early or late, and needs no such gate. In a model whose valve
    slips by the law an autoregression whitens single slips early or late as it does noise. Parameters of the valve
    correct many of them by chance. So most strokes must carry the gain, with the parameters paid for. Unpaid, the
    effects that only this gate refused on 38 clean building loops had at most 2.1 standard errors. True effects on
    seven others had 5.4 to 15.

    An effect off the valve also passes where it halves the free-run error. A rest or a lag must do so. Strokes do not
    tell a rest, because a valve that slides between the samples makes the same ones. Where the sliding valve needs a
    friction below zero, a rest passes by its gain.

    An effect added to a tentative parent is tested together with it. A base that is better than the parent takes the
    parent's place, because wrongly assumed scans look like an effect of a wrong base.
    """
    child, parent, names = edge.child, edge.before, plain_name(edge.name) not in BASE_EFFECTS
    if edge.base is not None and names and edge.base.done.gain_over(parent.done) > 0.0:
        parent = edge.base
    placed = child.done.model.spec.paths is not None
    beyond = child.rmse <= parent.rmse / 2 \
        or child.done.innovation_sd <= (1.0 - edge.policy.beyond_scans) * parent.done.innovation_sd
    slides_oddly = plain_name(edge.name) == RESTING and edge.parent.jumps_past
    if not edge.blurred or placed or slides_oddly or child.needs_no_noise_model(edge.policy) \
            or (beyond and not (names and on_valve(parse(edge.name)[0]))) \
            or (names and stroke_score(parent.done, child.done, paid=True) >= chance_limit(edge.policy)):
        return ""
    return "the unknown course of the output between the samples may explain as much: export faster"


def outlasts_noise(name: str, child: Scored, parent: Scored, policy: Policy) -> bool:
    """True for a disturbance that takes half of the free run or more, where the parent's noise seldom imitates one.

    A noise model of long memory absorbs any slow disturbance, so the one-step error gains nothing by the effect. The
    effect counts where no draw of that noise looks as much like the disturbance as the residual does. The policy's
    chance sets the number of draws.
    """
    if parse(name)[0].columns is None or parent.noise_alone or 2 * child.rmse > parent.rmse:
        return False
    return not parent.imitates(name, int(np.ceil(1.0 / policy.chance)))


def gains_by_forces(name: str, child: Scored, parent: Scored, policy: Policy) -> bool:
    """True where an effect raises the likelihood of the break-away forces alone by its margin.

    The forces are independent from stroke to stroke. The one-step errors of both models hardly differ then.
    """
    return parent.done.prior - child.done.prior >= margin_of(name, policy, child.done)


GAIN, HELD_OUT, LASTS, SCANS, FREE_RUN, SLIP = "gain", "held-out", "lasts", "scans", "free-run", "slip"
GATES: tuple[tuple[str, Callable[[Edge], str | Compared]], ...] = (
    (GAIN, _check_gain), ("there", _is_there), ("strokes", _check_strokes),
    (HELD_OUT, _held_out),
    (FREE_RUN, _free_run), ("range", _in_range), (SLIP, _check_slip),
    ("friction", _check_friction), (SCANS, _beyond_scans))
# Each gate's answer in a few words, for the ranking of all effects.
SHORT = {GAIN: "gains too little", "there": "ends where it vanishes",
         "strokes": "helps in few strokes", HELD_OUT: "predicts no better", FREE_RUN: "makes the free run worse",
         "range": "ends at a limit", SLIP: "may be one slip",
         "friction": "needs no friction",
         SCANS: "may be unseen scans"}


def judge_edge(edge: Edge) -> tuple[Gate, ...]:
    """All gates of an edge, with the reasons of those that it does not pass.

    A disturbance that outlasts the noise passes the gates of gain and held-out blocks; the gate `lasts` says so. An
    integrator adds up slips that unseen scans made early or late, and no draw of noise does so. There the disturbance
    must also explain more than one slip.
    """
    gates = tuple(_gate(name, gate(edge)) for name, gate in GATES)
    failed = {g.name for g in gates if not g.passed}
    slips = edge.blurred and edge.child.done.model.spec.process == INTEGRATOR and not edge.beyond_slip
    if not failed or not failed <= {GAIN, HELD_OUT} or slips \
            or not outlasts_noise(edge.name, edge.child, edge.parent, edge.policy):
        return gates
    said = Gate(LASTS, True, "it halves the free run, and no draw of the noise without it looks so much like it")
    return (*(g if g.passed else Gate(g.name, True, "") for g in gates), said)


def _gate(name: str, said: str | Compared) -> Gate:
    if isinstance(said, str):
        return Gate(name, not said, said)
    return Gate(name, not said.reason, said.reason, float(said.statistic), float(said.threshold))


def judge_change(edge: Edge) -> tuple[Gate, ...]:
    """The gate of another process or command: its gain in BIC."""
    margin = edge.policy.structure_margin
    why = "" if edge.gain >= margin else f"it gains {edge.gain:.0f} BIC over its parent"
    return (_gate(GAIN, Compared(why, edge.gain, margin)),)
