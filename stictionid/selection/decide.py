"""The decision after a search: the winner without needless effects, its equivalents, the ranking, and what is missing.

Source: docs/details.md, section 11.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.adequacy import LOAD_OR_OUTPUT
from ..fit.cross_validation import blocks_won
from ..fit.fit import AGREE_J, AGREE_S
from ..fit.intervals.assemble import region
from ..fit.noise.unexplained import missing_words, unexplained_shape
from ..fit.noise.whiteness import NEEDED
from ..fit.points.held_out_blocks import stated_error
from ..fit.public_values import noise_values, rows_for, rows_in
from ..fit.starts.beside_effect import LAG, RESTING
from ..process.scan import DECIMATED
from ..record.intervals import Span, united
from ..record.study import Candidate, ErrorSummary, ParameterValue, Study
from ..record.tree import Equivalent, drop_percent
from ..record.unexplained import Unexplained
from .doubts import deciding_measurement, offer_rest
from .entry import ADD, DROP, Entry
from .gates import SHORT, gains_by_forces, least_cost
from .looks import rng_of
from .node import BASE_EFFECTS, additions, depth, key, physical_effects, plain_name, shapes_process, with_effect
from .score import COLOURED, NARROW, OF_LOAD, Scored, noise_name, noise_rival
from .search import Search


@dataclass(frozen=True, slots=True)
class Decision:
    """The answer of a search: the winner, the name of its noise, its equivalents, and what is missing in words.

    `rival` is the noise that can't be told from the named one.
    `shape` is that of what is missing, where the winner's innovations depend on the valve, the signals or time.
    `unseen` is True where the course of the output between samples is unknown and the winner leaves more than noise.
    `reach` holds the pieces of S and J that the equivalents do not exclude.
    """

    winner: Entry
    noise: str
    equivalents: tuple[Equivalent, ...]
    missing_reason: str
    unseen: bool = False
    shape: Unexplained | None = None
    reach: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)
    rival: str = ""


def decide_answer(search: Search, best: Entry, keep: Sequence[str] = (), *, spans: bool = True,
                  further: bool = False) -> Decision:
    """The best node without needless effects, the noise to name, the equivalents, and what is missing.

    The best node is refitted; simpler effects or an integrator take their place where these do as well. Effects to
    `keep` are never left out. Without `spans` no intervals of equivalents are sought. With `further` a winner is
    asked along its path, if it was not: where an effect is left out, what the model lacks was sought beside the effect.
    """
    winner = _winner_of(search, best, keep)
    while further and winner.scored.done.model.spec.paths is not None and not (winner.along or search.at_end(winner)):
        search.ask_along(winner)
        winner = _winner_of(search, search.best(), keep)
    done = winner.scored.done
    unseen = (search.blurred and winner.spec.between != DECIMATED
              and not winner.scored.needs_no_noise_model(search.policy))
    ids = {name: i for i, name in enumerate(search.memo)}
    alike = equivalents(search, winner)
    tried = {parse(e.what)[0].name for e in search.memo.values() if e.op == ADD and e.parent == key(winner.spec)}
    # A command rebuilt between samples and a stem with mass err a little, so hardly any noise needs no name.
    little = winner.scored.is_explained(search.policy)
    noise = "" if little else noise_name(winner.scored, search.policy, slow=search.slow)
    in_band = noise == NARROW and winner.scored.band is not None and winner.scored.band.white
    white = done.white or in_band or search.is_explained(winner)
    shape = None if unseen or white else unexplained_shape(done, tried)
    # (slips placed early or late by unseen scans look like coloured noise, or like pulses of the load)
    if shape is not None or (unseen and noise in (COLOURED, OF_LOAD)):
        noise = ""
    return Decision(winner, noise, tuple(as_equivalent(e, ids[key(e.spec)], winner) for e in alike),
                    missing_reason(winner, white, unseen, shape, slow=search.slow and not noise,
                                   unasked=_effects_unasked(search, winner)), unseen, shape,
                    reach_of(search, alike) if spans else {}, noise_rival(winner.scored, search.policy, noise))


def _winner_of(search: Search, best: Entry, keep: Sequence[str]) -> Entry:
    """The best node, refitted, without needless effects, and with the simplest ones of those that do as well."""
    if depth(best.spec) or best.scored.leaves_little(search.policy):
        search.settle_node(best)  # (what a base misses moves its valve farther than another fit does)
    winner = _prefer_integrator(search, simplify_effects(search, prune_effects(search, best, keep), keep))
    while winner.op == ADD and winner.what not in keep and not search.memo.passed(winner) and (
            before := search.memo.get(winner.parent or "")):
        winner = before  # (the last effect passed its gates only beside an effect that was left out since)
    return search.move_slips(winner)


def _effects_unasked(search: Search, winner: Entry) -> list[str]:
    """Effects of the catalogue that no model of the search was asked for, though the record may hold them."""
    asked = {parse(e.what)[0].name for e in search.memo.values() if e.op == ADD and not e.failed}
    open_ = [name for last in (False, True) for name in additions(winner.spec, search.loop, search.only, last=last)]
    return sorted({parse(name)[0].name for name in open_} - asked)


def simplify_effects(search: Search, winner: Entry, keep: Sequence[str]) -> Entry:
    """The winner with a simpler effect in place of each one that contains it and gains less than the margin beyond it.

    An `underdamped-process` of a short natural period is two lags in series, a gain that hardly drifts is a ramp. A
    valve that rests is far more common than any other effect on the friction, and its slips may look like theirs.
    """
    for name in (n for n in physical_effects(winner.spec) if n not in keep):
        effect = parse(name)[0]
        rests = effect.friction is not None and RESTING not in winner.spec.effects
        cases = (*effect.contains, *((LAG,) if shapes_process(effect) else ()), *((RESTING,) if rests else ()))
        before = search.drop_effect(winner, name) if cases else winner
        simpler = [n for n in additions(before.spec, search.loop, search.only) if plain_name(n) in cases]
        if not simpler:
            continue
        if RESTING in simpler:
            offer_rest(search.valves, winner.scored.done, name, before.spec)
        search.ask_for(before, simpler, sure=True)
        search.ask_in_place(winner, before, simpler, sure=True)
        known = [e for n in simpler if (e := search.memo.get(key(with_effect(before.spec, n))))
                 and e.scored.full]
        best = max(known, key=lambda e: e.scored.done.gain_over(before.scored.done), default=winner)
        if best is not winner and winner.scored.done.gain_over(best.scored.done) < search.policy.margin:
            # (what the gates found in the larger effect is in the simpler one)
            best.stands_in |= search.memo.passed(winner)
            winner = best
    return winner


def _prefer_integrator(search: Search, winner: Entry) -> Entry:
    """The winner with an integrator for a lag of many periods, where that does as well."""
    other = search.fit_integrator(winner)
    if other is None or winner.scored.done.gain_over(other.scored.done) > search.policy.structure_margin:
        return winner
    other.stands_in = True
    if not depth(other.spec) and RESTING in additions(other.spec, search.loop, search.only):
        search.ask_for(other, (RESTING,))
    return other


def prune_effects(search: Search, winner: Entry, keep: Sequence[str] = ()) -> Entry:
    """The winner without the effects whose loss costs less BIC than their margin, taken out one after the other.

    An effect may be needless under another process or command, so known nodes of those without it are tried, too. They
    must explain as much: what explains little is judged beside the same process and command.
    """
    while True:
        cheap: list[tuple[float, Entry]] = []
        for name in (n for n in physical_effects(winner.spec) if n not in keep):
            without = search.drop_effect(winner, name)
            known = (without, *_known_nodes_without(search, winner, name))
            cheap += [(loss, e) for e in known
                      if (loss := _loss(winner.scored, e, name)) < least_cost(name, e.scored, search.policy)
                      or (e is without and _explains_little(search, winner.scored, e.scored, name))]
        if not cheap:
            return winner
        winner = min(cheap, key=lambda found: found[0])[1]


def _explains_little(search: Search, winner: Scored, without: Scored, name: str) -> bool:
    """True where an effect explains so little that it may only stand in for something the model lacks.

    A model that leaves more than noise lacks something, and any effect may explain a little of that. So the effect must
    lower the free-run error or the one-step error clearly. A lag or a rest need not.

    Scans that a record does not show hide when the valve slips. Extra parameters of the valve then fit slip times by
    chance, even where only noise is left. There an effect must lower either error clearly, too. So must a lag, and a
    rest even where only noise is left, because a command that moved between the samples looks like a rest. A model
    whose command moves there knows that. A lag that whitens the innovations is kept, and so is an effect for which
    break-away forces speak. An effect that is asked last has many shapes, of which one often helps a little, and so
    have load steps: with it the model must leave noise. One positioner imitated a slew limit with 8 times the noise and
    12 times the stickband.
    """
    policy, names = search.policy, plain_name(name) not in BASE_EFFECTS
    effect = parse(name)[0]
    if (effect.asked_last or effect.ahead) and not (winner.noise_alone or winner.leaves_little(policy)):
        return True
    held = winner.done.model.spec.held
    unseen = held if name == RESTING else names and (search.blurred or (search.slow and held))
    sure = winner.needs_no_noise_model(policy) and not unseen
    whitens = name == LAG and winner.white and not without.white
    if not (names or search.slow) or sure or whitens or gains_by_forces(name, winner, without, policy):
        return False
    freer = without.rmse > policy.better_base * winner.rmse
    sharper = winner.done.innovation_sd <= (1.0 - policy.beyond_scans) * without.done.innovation_sd
    return not (freer or sharper)


def _loss(winner: Scored, without: Entry, name: str) -> float:
    """BIC that the winner loses without an effect; for a disturbance at most the loss to a model with a narrow band.

    A narrow band, whose phase wanders, looks like a sine for a few cycles, and an autoregression does not explain it. A
    sine that halves the free-run error keeps its phase, so it is not compared with a band.
    """
    loss = winner.done.gain_over(without.scored.done)
    wandering = parse(name)[0].columns is not None and winner.rmse > without.scored.rmse / 2
    band = without.scored.band if wandering else None
    return loss if band is None else min(loss, winner.done.gain_over(band))


def _known_nodes_without(search: Search, winner: Entry, name: str) -> list[Entry]:
    """Nodes known in full under another process or command that have only the winner's effects, less one.

    A node with more than twice the free-run error is left out: an autoregression may hide what the effect explains.
    """
    others = set(physical_effects(winner.spec)) - {name}
    return [e for e in search.memo.values() if search.memo.passed(e) and set(physical_effects(e.spec)) <= others
            and (e.spec.process, e.spec.between) != (winner.spec.process, winner.spec.between)
            and e.scored.rmse <= 2 * winner.scored.rmse]


def equivalents(search: Search, winner: Entry) -> tuple[Entry, ...]:
    """Nodes that explain the record as well as the winner, best first.

    An equivalent passed its gates, has at most one parameter more than the winner, and does not contain the winner. Its
    BIC lies within `alike` of the winner's. The margin takes the place of `alike` for a resting valve, where the winner
    slides with a slip jump larger than its stickband: that needs a friction below zero. The other kind of valve counts
    whatever its gates say, where its S or J differs.
    """
    done, found = winner.scored.done, []
    mine = set(physical_effects(winner.spec))
    odd = winner.scored.jumps_past
    for e in search.memo.values():
        theirs = set(physical_effects(e.spec))
        other = theirs ^ mine == {RESTING} and not _same_valve(winner, e)
        if e is winner or not e.scored.full or not (other or (e.op != DROP and search.memo.passed(e))):
            continue
        near = search.policy.margin if odd and RESTING in theirs else search.policy.alike
        # (Noise of long memory may absorb a disturbance of the winner that the node lacks: that explains nothing.)
        hides = theirs < mine and e.scored.rmse >= 2 * winner.scored.rmse
        if e.scored.done.parameters <= done.parameters + 1 and (other or not mine < theirs) and not hides \
                and done.gain_over(e.scored.done) < near:
            found.append(e)
    return tuple(sorted(found, key=lambda e: done.gain_over(e.scored.done)))


def _same_valve(winner: Entry, other: Entry) -> bool:
    """True for two kinds of valve with the same S and J: a resting valve that hardly rests is a sliding one."""
    a, b = (e.scored.done.evaluated.values for e in (winner, other))
    return abs(a["S"] - b["S"]) <= AGREE_S * a["S"] and abs(a["J"] - b["J"]) <= AGREE_J * a["S"]


def reach_of(search: Search, alike: Sequence[Entry]) -> dict[str, tuple[Span, ...]]:
    """Pieces of S and J that the equivalents, the best first, do not exclude; empty without equivalents.

    An equivalent gives its intervals. It gives its point alone where it ranks behind the finalists, or where its model
    breaks down near its optimum.
    """
    spans: dict[str, list[Span]] = {"S": [], "J": []}
    for i, entry in enumerate(alike):
        done = entry.scored.done
        known: Mapping[str, Span] = {}
        parts: Mapping[str, tuple[Span, ...]] = {}
        if i < search.policy.finalists:
            model = done.white_model()
            with suppress(ModelError, np.linalg.LinAlgError):
                known, parts = region(model, model.cube(done.values[:, None])[0],
                                      rng_of(search.seed, key(entry.spec), 2))
        for name, found in spans.items():
            value = done.evaluated.values[name]
            found += [(value, value), *(parts.get(name) or [known.get(name, (value, value))])]
    return {name: united(found) for name, found in spans.items() if found}


def as_equivalent(entry: Entry, number: int, winner: Entry) -> Equivalent:
    """An equivalent node as a study holds it."""
    values = entry.scored.done.evaluated.values
    others = tuple(n for n in physical_effects(winner.spec) if n not in entry.spec.effects)
    own = next((n for n in physical_effects(entry.spec) if n not in winner.spec.effects), "")
    tell = deciding_measurement(own, others) if own else "the measured valve position"
    if {*physical_effects(entry.spec)} ^ {*physical_effects(winner.spec)} == {RESTING}:
        y = entry.scored.done.model.loop.process_value
        tell = f"a setpoint move of {np.nanmax(y) - np.nanmin(y):.2g}, or {parse(RESTING)[0].settled_by}"
    return Equivalent(number, tuple(entry.spec.effects), values["S"], values["J"],
                      entry.scored.done.bic(entry.scored.done.good), tell)


def candidates(search: Search, found: Decision, named: Sequence[str], study: Study, stated: Mapping[str, ErrorSummary],
               doubt: str = "") -> tuple[Candidate, ...]:
    """Every effect asked, a row each by the best model that holds it: those named, those of the model, the others.

    The gain is that of the best model that holds the effect over the best one without it, both completed with noise.
    `stated` holds the errors of nodes that are steps of the study, `doubt` the reason why the winner's effects are not
    named. An effect that ends with a worse BIC than its parent counts as neutral, because its search is unfinished.
    """
    of_base = {plain_name(n) for n in study.steps[0].model.get("effects", ())}
    present = {plain_name(n) for n in study.steps[-1].effects} - of_base
    best = {plain_name(name): found.winner for name in physical_effects(found.winner.spec)}
    tried: dict[str, list[Entry]] = {}
    for entry in search.memo.values():
        for name in physical_effects(entry.spec):
            tried.setdefault(plain_name(name), []).append(entry)
    rows: list[Candidate] = []
    for name, entries in tried.items():
        ran = [e for e in entries if not e.failed]
        if not ran:
            rows.append(Candidate(name, False, None, None, None, None, None, None, (), None, (),
                                  f"{name} could not be tried: {entries[0].failed}",
                                  rejected_because="could not be fitted"))
            continue
        without = best_without(search, found.winner, name)
        holds = best.get(name) or max(ran, key=lambda e: _gain_over(_entry_or_parent(search, e, name), found.winner))
        accepted = name in {*map(plain_name, named), *present}
        why = "" if accepted else doubt if name in best else _reason_not_named(search, holds, name, set(best))
        rows.append(_row(search, found, (name, holds, without), stated, accepted, why))
    rows += _noise_row(search, found, named, stated)
    first = {plain_name(name): i for i, name in enumerate(named)}
    return tuple(sorted(rows, key=lambda c: (first.get(c.effect, len(first)), not c.accepted, bool(c.rejected_because),
                                             c.rmse is None, -(c.gain_beyond_noise or 0.0))))


def best_without(search: Search, winner: Entry, name: str) -> Entry:
    """The best node that passed, lacks an effect by its plain name, and is told from other valves; or the winner."""
    rivals = [e for e in search.memo.values() if search.memo.passed(e) and not e.debit(search.memo)
              and name not in map(plain_name, e.spec.effects)]
    return max(rivals, key=lambda e: _gain_over(e, winner), default=winner)


def _gain_over(entry: Entry, other: Entry) -> float:
    return entry.scored.done.gain_over(other.scored.done)


def _entry_or_parent(search: Search, entry: Entry, name: str) -> Entry:
    """The entry, or its parent where the parent has the better BIC without the effect that the entry adds."""
    parent = search.memo.get(entry.parent or "") if entry.op == ADD and plain_name(entry.what) == name else None
    return entry if parent is None or parent.failed or _gain_over(entry, parent) >= 0.0 else parent


def _row(search: Search, found: Decision, of: tuple[str, Entry, Entry], stated: Mapping[str, ErrorSummary],
         accepted: bool, why: str) -> Candidate:
    """The candidate of an effect, of the entry that holds it, and of the best one without it."""
    name, holds, without = of
    model, scored = _entry_or_parent(search, holds, name), holds.scored
    error = _errors_of(model, stated)
    gain = _gain_over(model, without)
    whole = next(n for n in physical_effects(holds.spec) if plain_name(n) == name)
    failed = next((g.reason for g in search.memo.gates(holds) if not g.passed), "")
    said, done = f"{whole}: {failed or why or 'the model holds it'}", scored.done
    alike: tuple[str, ...] = ()
    won: tuple[int | None, int | None] = None, None
    rows = rows_in(whole, done.model, done.values, done.evaluated)
    if accepted:
        alike = tuple(dict.fromkeys(plain_name(n) for e in found.equivalents if name not in map(plain_name, e.effects)
                                    for n in e.effects if n not in found.winner.spec.effects))
        won = blocks_won(model.scored.held, without.scored.held)
        said = f"{in_brief(whole, rows)}{whole} explains it, {gain:.0f} BIC beyond noise"
        said += _other_tags(search, whole, holds)
        said += f"; what would settle it: {test}" if (test := deciding_measurement(whole, alike)) else ""
    return Candidate(
        name, accepted, error.best, error.rmse_holdout, error.rmse_one_step_holdout,
        drop_percent(_errors_of(without, stated).best, error.best),
        drop_percent(without.scored.done.innovation_sd, model.scored.done.innovation_sd), gain, alike, None,
        rows, said, parse(whole)[1], gain_beyond_noise=gain, rejected_because=why, blocks_better=won[0], blocks=won[1])


def in_brief(name: str, rows: Sequence[ParameterValue]) -> str:
    """The answer of an effect in a few words with a colon; empty where its file has none."""
    effect, option = parse(name)
    values = {row.name: row for row in rows}
    if not effect.brief:
        return ""

    def filled(place: re.Match[str]) -> str:
        names = place[1].split("+")
        return option if names == ["tag"] else f"{sum(values[n].value for n in names):.3g} {values[names[0]].unit}"

    return re.sub(r"\{(.+?)\}", filled, effect.brief) + ": "


def _other_tags(search: Search, name: str, holds: Entry) -> str:
    """The next tags in the place of a named one, by the gain that each has less; empty where none was asked."""
    others = {e.what: -_gain_over(e, holds) for e in search.memo.values()
              if e.op == ADD and not e.failed and e.parent == holds.parent and e.what != name
              and plain_name(e.what) == plain_name(name)}
    said = [f"{parse(other)[1]} ({less:.0f} BIC less)" for other, less in sorted(others.items(), key=lambda o: o[1])]
    return f"; behind it {', '.join(said)}" if said else ""


def _errors_of(entry: Entry, stated: Mapping[str, ErrorSummary]) -> ErrorSummary:
    """The errors of a node: those of the study where it is a step of it."""
    model, held = entry.scored.done.model, entry.scored.held
    level, ahead = (stated_error(model, e) for e in ((held.rmse, held.rmse_one_step) if held else (None, None)))
    return stated.get(key(entry.spec)) or ErrorSummary(entry.scored.rmse, level, rmse_one_step_holdout=ahead)


def _noise_row(search: Search, found: Decision, named: Sequence[str],
               stated: Mapping[str, ErrorSummary]) -> tuple[Candidate, ...]:
    """The noise model of the answer as a candidate of its own, where it has a name. Its gain beyond noise is 0."""
    name, done = found.noise or noise_name(found.winner.scored, search.policy), found.winner.scored.done
    if not name:
        return ()
    numbers = noise_values(name, done.model, done.evaluated, done.taps, done.increments, done.innovation_sd)
    accepted = name in map(plain_name, named)
    alike: tuple[str, ...] = ()
    said = f"{name}: every model is completed with it before effects are compared"
    if found.rival:
        alike = (found.rival,)
        said += f"; {LOAD_OR_OUTPUT}: {found.rival} explains them alike; what would settle it: " \
            + deciding_measurement(name, alike)
    return (Candidate(name, accepted, _errors_of(found.winner, stated).best, None, None, 0.0, None, None, alike, None,
                      rows_for(name, numbers), said,
                      gain_beyond_noise=0.0, rejected_because="" if accepted else "every model is given it"),)


def _reason_not_named(search: Search, entry: Entry, name: str, winner: Set[str]) -> str:
    """The reason why an effect is not named, as a short phrase; `winner` holds the effects of the answer."""
    if not entry.scored.full:
        return "only a first look"
    failed = next((g.name for g in search.memo.gates(entry) if not g.passed), "")
    needless = winner <= set(map(plain_name, entry.spec.effects)) or _entry_or_parent(search, entry, name) is not entry
    return SHORT.get(failed, "does as well without" if needless else "explains less")


def missing_reason(winner: Entry, white: bool, unseen: bool = False, shape: Unexplained | None = None, *,
                   slow: bool = False, unasked: Sequence[str] = ()) -> str:
    """The words for a winner that leaves more than noise; empty where nothing is missing.

    `white` is True where its innovations are, with an autoregression or a narrow band as its noise.
    `unseen` is True where the output moved between the samples, so that no effect can be told from its course there.
    `shape` says what the winner's innovations answer. `slow` is True where a coloured error has no name, because the
    record is slower than the scan. `unasked` are effects that the search did not come to.
    """
    done = winner.scored.done
    if unseen:
        return (f"the controller scanned between the samples of {done.model.step_s:g} s, and the course of its output "
                "there is unknown: the free-run error may be no more than that; export at the controller's scan")
    if white:
        return "" if not slow or winner.scored.free_run_at_noise else (
            "what the model leaves is coloured noise, or what the output did between the samples of "
            f"{done.model.step_s:g} s; these look alike: export at the controller's scan")
    if shape is not None:
        return missing_words(shape)
    rows = int(done.good.sum())
    if rows < NEEDED:
        return (f"{rows} samples count, and {NEEDED} are needed to tell whether something is missing: give a longer "
                "record")
    rest = f" (not asked: {', '.join(unasked)})" if unasked else ""
    return (f"something is missing that the effects asked so far do not explain{rest}: the innovations of the best "
            "model still answer past valve positions, the signals or time")
