"""The decision after a search: the winner pruned, its equivalents, the ranking, and what the catalogue does not hold.

Source: SELECTION.md section 1; CRITICISM.md section 7.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.intervals.assemble import region
from ..fit.noise.unexplained import said_missing, unexplained
from ..fit.public_values import noise_values, rows_for, values_of
from ..fit.starts.beside_effect import RESTING
from ..model.rounding import moved_by_rounding
from ..process.rounded import unknown_step
from ..process.scan import DECIMATED
from ..record.loop import Loop
from ..record.study import Candidate, Study
from ..record.tree import Equivalent, drop_percent
from ..record.unexplained import Unexplained
from .doubts import jumps_past, least_cost
from .entry import ADD, DROP, Entry
from .gates import LASTS, lasts
from .looks import rng_of
from .node import BASE_EFFECTS, LAG, additions, key, physical, plain, shapes, with_effect
from .policy import Policy
from .score import COLOURED, NARROW, Scored, by_rounding, least_free_run, noise_name
from .search import Search
from .tells import settling


@dataclass(frozen=True, slots=True)
class Decision:
    """The answer of a search: the winner, the name of its noise, its equivalents, and what is missing in words.

    `shape` is that of what is missing, where the winner's innovations answer valve, signals or time.
    `unseen` is True where the course of the output between samples is unknown and the winner leaves more than noise.
    `reach` holds the values of S and J that the equivalents do not exclude.
    """

    winner: Entry
    noise: str
    equivalents: tuple[Equivalent, ...]
    missing_reason: str
    unseen: bool = False
    shape: Unexplained | None = None
    reach: Mapping[str, tuple[float, float]] = field(default_factory=dict)


def decided(search: Search, best: Entry, keep: Sequence[str] = ()) -> Decision:
    """The best node pruned, with the noise to name, its equivalents, and what the catalogue does not hold.

    Effects to `keep` are never pruned.
    """
    search.settle(best)
    winner = _integrating(search, with_lag(search, pruned(search, best, keep), keep))
    done = winner.scored.done
    unseen = (search.blurred and winner.spec.between != DECIMATED
              and not winner.scored.bare(search.policy))
    ids = {name: i for i, name in enumerate(search.memo)}
    alike = equivalents(search, winner)
    tried = {parse(e.what)[0].name for e in search.memo.values() if e.op == ADD and e.parent == key(winner.spec)}
    # The command between samples and a stem with mass err a little: noise that carries hardly any of it may be that.
    little = winner.scored.explained(search.policy)
    rounds = by_rounding(winner.scored.rmse, done.innovation_sd, winner.scored.moved)
    noise = "" if little or rounds else noise_name(winner.scored, search.policy, slow=search.slow)
    band = winner.scored.band if noise == NARROW else None
    white = done.white or (band is not None and band.white) or search.explained(winner)
    shape = None if unseen or white else unexplained(done, tried)
    noise = "" if shape is not None else noise
    if unseen and noise == COLOURED:
        noise = ""  # (slips that unseen scans made early or late look the same)
    return Decision(winner, noise, tuple(as_equivalent(e, ids[key(e.spec)], winner) for e in alike),
                    missing_reason(winner, white, unseen, shape, slow=search.slow and not noise), unseen, shape,
                    reach_of(search, alike))


def with_lag(search: Search, winner: Entry, keep: Sequence[str]) -> Entry:
    """The winner with a further lag in place of each effect on the process that gains less than the margin beyond one.

    An `underdamped-process` of a short natural period is two lags in series, which need no name.
    """
    for name in (n for n in physical(winner.spec) if n not in keep and shapes(parse(n)[0])):
        before = search.dropped(winner, name)
        if LAG not in additions(before.spec, search.loop, search.only):
            continue
        search.ask(before, (LAG,))
        lagging = search.memo[key(with_effect(before.spec, LAG))]
        fitted = lagging.scored.full and not lagging.failed
        if fitted and winner.scored.done.gain_over(lagging.scored.done) < search.policy.margin:
            winner = lagging
    return winner


def _integrating(search: Search, winner: Entry) -> Entry:
    """The winner with an integrator for a lag of many periods, where that does as well."""
    other = search.integrated(winner)
    if other is None or winner.scored.done.gain_over(other.scored.done) > search.policy.structure_margin:
        return winner
    other.gates = ()
    return other


def rounded(loop: Loop, study: Study, before: Scored, found: Decision, policy: Policy, seed: int) -> str:
    """Words where the rounding of the output explains what the study's model leaves; empty elsewhere.

    A right model of a rounded output leaves whole strokes that no effect explains to the noise. `before` is the study's
    model in the search.
    """
    scored, last = found.winner.scored, study.steps[-1]
    floor, error = last.error.noise_sd, last.error.rmse
    sharper = scored.done.innovation_sd <= (1.0 - policy.beyond_scans) * before.done.innovation_sd
    if floor is None or scored.bare(policy) or scored.rmse <= error / 2 or sharper:
        return ""
    moved = moved_by_rounding(loop, last.model, seed)
    if not moved > 0.0 or error > float(np.hypot(floor, policy.rounding * moved)):
        return ""
    return (f"the free-run error {error:.4g} may be no more than rounding: the output is recorded in steps of "
            f"{unknown_step(loop):.3g} {loop.unit('output', '%')}, which moves the model's process value by "
            f"{moved:.3g} beside the noise, and no effect brings the error to the noise, or lowers it by much; export "
            "the output with more digits")


def pruned(search: Search, winner: Entry, keep: Sequence[str] = ()) -> Entry:
    """The winner without each effect whose loss costs less than its margin, one after the other.

    Under another process or command an effect may not be needed, so nodes known without it count, too.
    """
    while True:
        cheap: list[tuple[float, Entry]] = []
        for name in (n for n in physical(winner.spec) if n not in keep):
            known = (search.dropped(winner, name), *_known_without(search, winner, name))
            cheap += [(loss, e) for e in known
                      if ((loss := _loss(winner.scored, e, name)) < least_cost(name, e, search.policy)
                          or _idle(search, winner.scored, e.scored, name))
                      and not lasts(name, winner.scored, e.scored, search.policy)]
        if not cheap:
            return winner
        winner = min(cheap, key=lambda found: found[0])[1]


def _idle(search: Search, winner: Scored, without: Scored, name: str) -> bool:
    """True where a model leaves more than noise and does hardly better than one `without` an effect.

    What the model lacks may be the reason for so little. In a record slower than the scan that holds beside noise
    alone, too: slips come early or late there, and a few numbers more put some of them right. So an effect must lower
    the least free-run error clearly; a sharper one-step error may be chance. A lag must show either, and so must a
    rest, even beside noise alone: what moved between the samples looks like one.

    An effect is asked last because nothing else helps, and its many courses help a little beside what is missing. So it
    must leave noise: a positioner stood for a slew limit at 8 times the noise and 12 times the stickband.
    """
    policy, names = search.policy, plain(name) not in BASE_EFFECTS
    if parse(name)[0].asked_last and not (winner.noise_alone or winner.nearly(policy)):
        return True
    if names and search.slow:
        return least_free_run(without, winner) <= policy.nearly * winner.rmse
    if not (names or search.slow) or (winner.bare(policy) and name != RESTING):
        return False
    freer = without.rmse > policy.better_base * winner.rmse
    sharper = winner.done.innovation_sd <= (1.0 - policy.beyond_scans) * without.done.innovation_sd
    return not (freer or sharper)


def _loss(winner: Scored, without: Entry, name: str) -> float:
    """BIC that a model costs by losing an effect; of a disturbance at most what it costs beside a narrow band.

    A band of wandering phase looks like a sine for a few cycles, and an autoregression does not hold it. A sine that
    halves the free run keeps its phase.
    """
    loss = winner.done.gain_over(without.scored.done)
    wandering = parse(name)[0].columns is not None and winner.rmse > without.scored.rmse / 2
    band = without.scored.band if wandering else None
    return loss if band is None else min(loss, winner.done.gain_over(band))


def _known_without(search: Search, winner: Entry, name: str) -> list[Entry]:
    """Nodes known in full under another process or command that have only the winner's effects, less one.

    A node with more than twice the free-run error is left out: an autoregression may hide what the effect explains.
    """
    rest = set(physical(winner.spec)) - {name}
    return [e for e in search.memo.values() if e.passed and not e.failed and set(physical(e.spec)) <= rest
            and (e.spec.process, e.spec.between) != (winner.spec.process, winner.spec.between)
            and e.scored.rmse <= 2 * winner.scored.rmse]


def equivalents(search: Search, winner: Entry) -> tuple[Entry, ...]:
    """Nodes that do as well as the winner, are no wider, don't contain it, and pass the same gates; best first.

    A sliding valve whose slip jump exceeds its stickband needs a friction below zero. One that rests then counts as
    equivalent up to the full margin.
    """
    done, found = winner.scored.done, []
    mine = set(physical(winner.spec))
    odd = jumps_past(winner)
    for e in search.memo.values():
        if e is winner or e.failed or not e.scored.full or e.op == DROP or not e.passed:
            continue
        theirs = set(physical(e.spec))
        near = search.policy.margin if odd and RESTING in theirs else search.policy.alike
        # (Where the winner's disturbance is left out, noise of long memory may hide it: that explains nothing.)
        hides = theirs < mine and e.scored.rmse >= 2 * winner.scored.rmse
        if e.scored.done.parameters <= done.parameters + 1 and not mine < theirs and not hides \
                and done.gain_over(e.scored.done) < near:
            found.append(e)
    return tuple(sorted(found, key=lambda e: done.gain_over(e.scored.done)))


def reach_of(search: Search, alike: Sequence[Entry]) -> dict[str, tuple[float, float]]:
    """Least and largest S and J that equivalents, the best first, do not exclude; empty without equivalents.

    Those beyond the number of finalists, and those whose model breaks down beside its optimum, give their points.
    """
    spans: dict[str, list[float]] = {"S": [], "J": []}
    for i, entry in enumerate(alike):
        done = entry.scored.done
        known: Mapping[str, tuple[float, float]] = {}
        if i < search.policy.finalists:
            model = done.white_model()
            with suppress(ModelError, np.linalg.LinAlgError):
                known = region(model, model.cube(done.values[:, None])[0], rng_of(search.seed, key(entry.spec), 2))
        for name, found in spans.items():
            found += [done.evaluated.values[name], *known.get(name, ())]
    return {name: (min(found), max(found)) for name, found in spans.items() if found}


def as_equivalent(entry: Entry, number: int, winner: Entry) -> Equivalent:
    """An equivalent node as a study holds it."""
    values = entry.scored.done.evaluated.values
    others = tuple(n for n in physical(winner.spec) if n not in entry.spec.effects)
    own = next((n for n in physical(entry.spec) if n not in winner.spec.effects), "")
    tell = settling(own, others) if own else "the measured valve position"
    return Equivalent(number, tuple(entry.spec.effects), values["S"], values["J"],
                      entry.scored.done.bic(entry.scored.done.good), tell)


def candidates(search: Search, parent: Entry, winner: str, alike: tuple[str, ...]) -> tuple[Candidate, ...]:
    """The ranking of all effects beside one node, the named one first, then by what they gain beyond noise."""
    base, out = parent.scored, []
    children = [e for e in search.memo.values() if e.parent == key(parent.spec) and e.op == ADD]
    noise = _noise_gain(search, parent)
    for e in sorted(children, key=lambda e: (e.what != winner, -_gain(e, parent))):
        effect, variant = parse(e.what)
        if e.failed:
            out.append(Candidate(effect.name, False, None, None, None, None, None, None, (), None, (),
                                 f"{e.what} could not be tried: {e.failed}", variant, rejected_because=e.failed))
            continue
        done, gain = e.scored.done, _gain(e, parent)
        why = "" if e.what == winner else _why(e, winner)
        change = (f"one-step error {base.done.innovation_sd:.4g} to {done.innovation_sd:.4g}, free run "
                  f"{base.rmse:.4g} to {e.scored.rmse:.4g}, BIC {gain:+.0f} beyond noise")
        said = f"{e.what} explains it: {change}" if e.what == winner else f"{e.what}: {why}: {change}"
        if e.what == winner:
            said += "".join(f"; but {g.reason}" for g in e.gates if g.name == LASTS)
        if e.what == winner and (test := settling(winner, alike)):
            said += f"; what would settle it: {test}"
        held = e.scored.held
        out.append(Candidate(
            effect.name, e.what == winner, e.scored.rmse, held.rmse if held else None,
            held.rmse_one_step if held else None, drop_percent(base.rmse, e.scored.rmse),
            drop_percent(base.done.innovation_sd, done.innovation_sd), gain, alike if e.what == winner else (), None,
            rows_for(e.what, values_of(e.what, done.model, done.values, done.evaluated)), said, variant,
            gain_beyond_noise=gain, rejected_because=why))
    return tuple(out) if not noise else (*out[:1 if winner else 0], *noise, *out[1 if winner else 0:])


def _noise_gain(search: Search, parent: Entry) -> tuple[Candidate, ...]:
    """The noise model of a node as a candidate of its own, where it has one."""
    done = parent.scored.done
    name = noise_name(parent.scored, search.policy)
    if not name:
        return ()
    numbers = noise_values(name, done.taps, done.increments, done.innovation_sd, done.model.step_s, done.model.pace)
    return (Candidate(name, False, parent.scored.rmse, None, None, 0.0, None, None, (), None, rows_for(name, numbers),
                      f"{name}: every model is completed with it before effects are compared",
                      gain_beyond_noise=0.0, rejected_because="it is the noise that others are compared with"),)


def _gain(entry: Entry, parent: Entry) -> float:
    return -np.inf if entry.failed else entry.scored.done.gain_over(parent.scored.done)


def _why(entry: Entry, winner: str) -> str:
    """The reason why an effect is not named."""
    for gate in entry.gates:
        if not gate.passed:
            return gate.reason
    if not entry.scored.full:
        return f"a quick fit gained {f'less than {winner}' if winner else 'too little'}, so no full fit was made"
    return f"it helps less than {winner}" if winner else "it was not needed"


def missing_reason(winner: Entry, white: bool, unseen: bool = False, shape: Unexplained | None = None, *,
                   slow: bool = False) -> str:
    """The words for a winner that leaves more than noise; empty where nothing is missing.

    `white` is True where its innovations are, with an autoregression or a narrow band as its noise.
    `unseen` is True where the output moved between the samples, so that no effect can be told from its course there.
    `shape` says what the winner's innovations answer. `slow` is True where a coloured error has no name, because the
    record is slower than the scan.
    """
    done = winner.scored.done
    if unseen:
        return (f"the controller scanned between the samples of {done.model.step_s:g} s, and the course of its output "
                f"there is unknown: the free-run error {winner.scored.rmse:.4g} may be no more than that; export at "
                "the controller's scan")
    if white:
        return "" if not slow or winner.scored.free_run_at_noise else (
            f"what the model leaves ({winner.scored.rmse:.4g}) is coloured noise, or what the output did between the "
            f"samples of {done.model.step_s:g} s; these look alike: export at the controller's scan")
    if shape is not None:
        return said_missing(shape, done)
    return (f"something is missing that the catalogue does not hold: the innovations {done.innovation_sd:.4g} of the "
            f"best model still answer past valve positions, the signals or time (free run {winner.scored.rmse:.4g})")
