"""Checks whether a resting valve explains the record as well as a sliding one, and whether load steps are missing.

Both kinds of valve look alike under a command that moves between samples. A slip jump larger than the stickband needs a
kinetic friction below zero. Then the valve rests after each slip, or it slides and overshoots its place. An answer
without effects whose free-run error is far above its innovations raises the same doubt. PV of a steady cycle shows
little more than the samples at which the valve slips. The other kind of valve may slip at the same samples, with
another stickband and dead time. No search near the first answer finds these values, so they are computed from the
slips.
"""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import replace

import numpy as np

from ..effects import parse
from ..errors import ModelError
from ..fit.noise.completion import Refit
from ..fit.noise.load_steps import load_steps_of
from ..fit.points.fitted import as_it_stands
from ..fit.points.moves import descend_model
from ..fit.points.plateau import settle_on_plateau
from ..fit.starts.beside_effect import LAG, RESTING, on_valve
from ..fit.starts.same_slips import FURTHER_LAG, JUMPS, SHIFTS, with_same_slips
from ..laws.contract import RESTICK
from ..model.segments import rebind_model
from ..model.spec import Spec
from ..record.loop import Loop
from .entry import ADD, DROP, ROOT, Entry
from .looks import rng_of
from .node import additions, drop_from, key, kind_of, node, physical_effects, plain_name, with_effect
from .policy import Policy
from .refits import fit_without
from .score import Scored, complete_by_law, complete_with_noise, point_in_search_form


def lacking_load_steps(memo: Mapping[str, Entry], entry: Entry, only: frozenset[str] | None) -> tuple[str, str] | None:
    """The load steps that the innovations of a node show, as one effect, and the node's own; None where none are new.
    """
    if entry.scored.free_run_at_noise or not (name := load_steps_of(entry.scored.done)):
        return None
    have = next((n for n in entry.spec.effects if plain_name(n) == plain_name(name)), "")
    asked = only is None or plain_name(name) in only
    return (name, have) if asked and key(with_effect(drop_from(entry.spec, [have]), name)) not in memo else None


def fit_dropped(memo: MutableMapping[str, Entry], entry: Entry, name: str, seed: int, policy: Policy) -> Entry:
    """The node of an entry without one effect, in the memo: as it was met, or fitted from the entry's values."""
    spec = node(drop_from(entry.spec, (name,)), soft=entry.scored.done.increments)
    known = memo.get(key(spec))
    if known is not None and known.scored.full and entry.op == ADD and entry.parent == key(spec):
        return known  # (the hand-back has polished it from this entry's values)
    done = fit_without(point_in_search_form(entry.scored, entry.spec), spec, name, rng_of(seed, key(spec), 2), policy)
    if known is not None and not known.failed and known.scored.done.gain_over(done) > 0.0:
        return known
    if known is None:
        known = memo[key(spec)] = Entry(spec, Scored(done), key(entry.spec), DROP, name)
    else:
        known.scored = Scored(done)
    return known


def offer_rest(valves: MutableMapping[str, tuple[dict[str, float], ...]], done: Refit, name: str,
               without: Spec) -> None:
    """Offer the valve of a model with effect `name` as one that rests to nodes on a specification `without` it.

    The valve that rests has the same slips and the same swings between them.
    """
    kind = kind_of(with_effect(without, RESTING))
    model, values, natural = done.model, done.values[:, None], parse(name)[0].natural
    swing, slip = values[:2] if natural is None else natural.numbers(values[0], values[1],
                                                                     values[model.rows_of(name)], model.context)
    known = {**model.named(done.values), "S": float(swing[0]), "J": float(slip[0]), **_rest_at_once()}
    valves[kind] = (known, *valves.get(kind, ()))


def add_valves(memo: MutableMapping[str, Entry], entry: Entry, loop: Loop, only: frozenset[str] | None, seed: int,
               policy: Policy, *, better: bool) -> None:
    """Put other valves that an entry suggests in the memo."""
    add_same_slips(memo, entry, loop, only, seed, policy, better=better)
    add_rest_instead(memo, entry, loop, only, seed, policy)


def add_rest_instead(memo: MutableMapping[str, Entry], entry: Entry, loop: Loop, only: frozenset[str] | None, seed: int,
                     policy: Policy) -> None:
    """Put a valve that rests by itself in the memo, in place of an effect that brings the stem of an entry to rest.

    Friction that grows does so, however slowly: it stands in for a rest. The new node starts from the entry's values
    and slips.
    """
    before = entry.scored.done
    name = next((n for n, e in zip(before.model.names, before.model.effects, strict=True)
                 if e.friction is not None and n != RESTING and _brings_to_rest(before, n)), "")
    if not name:
        return
    without = node(drop_from(entry.spec, (name,)), soft=before.increments)
    parent, spec = memo.get(key(without)), with_effect(without, RESTING)
    if parent is None or parent.failed or RESTING not in additions(without, loop, only):
        return
    fit = as_it_stands(before.model, before.values)
    done = fit_without(fit, spec, name, rng_of(seed, key(spec), 2), policy, _rest_at_once())
    if not _explains_as_much(memo.get(key(spec)), done):
        memo[key(spec)] = Entry(spec, Scored(done), key(without), ADD, RESTING)


def _explains_as_much(known: Entry | None, done: Refit) -> bool:
    """True where the memo's full fit of a node is as good as another one."""
    return known is not None and known.scored.full and known.scored.done.gain_over(done) >= 0.0


def _brings_to_rest(done: Refit, name: str) -> bool:
    """True where a valve sticks after each slip, and would slide on without one effect."""
    model = done.model
    without = rebind_model(model, replace(drop_from(model.spec, (name,)), paths=None))
    here, other = (m.friction(m.vector(model.named(done.values))[:, None])[RESTICK] for m in (model, without))
    return bool(np.isinf(here).all() and not np.isinf(other).any())


def _rest_at_once() -> dict[str, float]:
    """Named values of a rest at any speed."""
    return {f"{RESTING}:{p.name}": p.high for p in parse(RESTING)[0].parameters}


def add_same_slips(memo: MutableMapping[str, Entry], entry: Entry, loop: Loop, only: frozenset[str] | None, seed: int,
                   policy: Policy, *, better: bool) -> None:
    """Fit nodes whose valve slips at the samples of an entry, and put those worth it in the memo.

    A node is kept where it explains about as much as the entry, and more than the memo's fit of that node. With
    `better` it must gain as much as a change of structure and leave white innovations. An entry far from the noise is
    skipped: its slips are not known well enough.
    """
    if not entry.scored.leaves_little(policy):
        return
    least = policy.structure_margin if better else -policy.alike
    for spec in specs_with_same_slips(entry, loop, only):
        own = key(spec) == key(entry.spec)
        done = fit_same_slips(entry, spec, seed, policy, policy.better_fit if own else least)
        if done is None or (better and not (own or done.white)):
            continue
        known = memo.get(key(spec))
        if _explains_as_much(known, done):
            continue
        scored = Scored(done)
        if known is not None and (own or known.op == ROOT):
            known.scored = scored
            if own:
                # (the better fit has other slips, so that its neighbours are fitted once more)
                add_same_slips(memo, entry, loop, only, seed, policy, better=better)
                break
            continue
        new = [n for n in physical_effects(spec) if n not in entry.spec.effects]
        memo[key(spec)] = Entry(spec, scored, key(entry.spec), ADD if new else DROP, LAG if new == [LAG] else RESTING)


def specs_with_same_slips(entry: Entry, loop: Loop, only: frozenset[str] | None) -> list[Spec]:
    """The entry's node and the other kind of valve, and both with a further lag unless the innovations are white.

    The list is empty where no second kind of valve is possible: the command moves between samples, S or J is given, or
    another effect acts on the valve.
    """
    spec, model, soft = entry.spec, entry.scored.done.model, entry.scored.done.increments
    others = [e for n, e in zip(model.names, model.effects, strict=True) if on_valve(e) and n != RESTING]
    fixed = model.law.one_parameter or not model.space.movable[:2].all()
    if not spec.held or spec.friction_free or others or fixed:
        return []
    found, more = [spec], additions(spec, loop, only)
    if RESTING in spec.effects:
        found.append(drop_from(spec, (RESTING,)))
    elif RESTING in more:
        found.append(with_effect(spec, RESTING))
    if LAG in more and not entry.scored.white:
        found += [with_effect(s, LAG) for s in found if RESTING in s.effects or s is spec]
    return [node(s, soft=soft) for s in found]


def fit_same_slips(entry: Entry, spec: Spec, seed: int, policy: Policy, least: float) -> Refit | None:
    """A node fitted from the valves that slip as that of an entry does; None where it gains less than the least BIC."""
    before = entry.scored.done
    model, white = (rebind_model(before.model, s, before.evaluated.left)
                    for s in (spec, replace(spec, taps=before.spec.taps, increments=before.spec.increments)))
    values = white.vector(before.model.named(before.values))
    ends = {RESTING: np.inf, LAG: FURTHER_LAG * values[3]}
    for name in (n for n in ends if n in spec.effects and n not in entry.spec.effects):
        rows = white.rows_of(name)
        values[rows] = [min(ends[name], p.high) for p in white.space.parameters[rows]]
    path = before.model.positions(before.values[:, None])[:, 0]
    try:
        trial = with_same_slips(white, values, path, rests=RESTING in spec.effects, shifts=SHIFTS,
                                jumps=values[1] * JUMPS)
        if not trial.shape[1]:
            return None
        # The best start of every dead time goes on: before the lag has converged the right one is not yet better.
        order = np.lexsort((white.costs_of(trial), trial[4]))
        best_of = order[np.unique(trial[4, order], return_index=True)[1]]
        found = descend_model(white, white.cube(trial[:, best_of]), fixed=(0, *white.forces))
        if not np.isfinite(found.costs[0]):
            return None
        best = white.values(settle_on_plateau(white, found.points[0])[None])[:, 0]
        there = model.vector(white.named(best))
        if complete_by_law(model, there).gain_over(before) < least - policy.alike:
            return None
        done = complete_with_noise(model, there, rng_of(seed, key(spec), 2), policy)
        return done if done.gain_over(before) >= least else None
    except (ModelError, np.linalg.LinAlgError):
        return None


def deciding_measurement(name: str, rivals: tuple[str, ...]) -> str:
    """The measurement that tells an effect from its rivals, in the words of their files; empty without rivals."""
    mine = parse(name)[0]
    for rival in rivals:
        other = parse(rival)[0]
        if other.name == mine.name:
            return "a tag of the suspected load, or a step of OP in manual: it shows how a load enters"
        if words := mine.told_apart.get(other.name) or other.told_apart.get(mine.name):
            return words
    return mine.settled_by if rivals else ""
