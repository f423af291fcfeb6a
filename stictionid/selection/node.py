"""A node of the search: the specification of a model without its noise, and the ways from one to the next."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from ..effects import catalogue, in_order, parse
from ..effects.contract import Effect, Place
from ..fit.starts.beside_effect import LAG, RESTING, on_valve
from ..model.spec import FIRST_ORDER, INTEGRATOR, SOFT, Spec, suited_effects
from ..options import check_tag
from ..record.loop import Loop

# Effects that belong to the base: they neither deepen the tree nor need a rival.
BASE_EFFECTS = frozenset({LAG, RESTING})


def plain_name(name: str) -> str:
    """The effect's name without variant and tag."""
    return parse(name)[0].name


def is_local(effect: Effect) -> bool:
    """True for an effect that acts at a place of the record: a disturbance, or friction that changes with time."""
    return effect.kind == "L" or effect.profile is not None


def shapes_process(effect: Effect) -> bool:
    """True for an effect that gives the process another shape than a further lag does."""
    return effect.place is Place.PROCESS and not effect.by_itself


def hidden_by_lag(effect: Effect) -> bool:
    """True for an effect that a further lag may stand in for: another shape of the process, or friction that drifts."""
    return shapes_process(effect) or effect.drifts


def physical_effects(spec: Spec) -> tuple[str, ...]:
    """The names of a spec's effects that are no noise models."""
    return tuple(name for name in spec.effects if parse(name)[0].noise is None)


def node(spec: Spec, *, soft: bool = False) -> Spec:
    """The spec in the form in which it is searched: without noise model, its effects in physical order.

    An integrator is fitted to softened differences of y, and so is a first order under a random walk (`soft`).
    """
    differences = soft or spec.process == INTEGRATOR
    return replace(spec, effects=tuple(name for name, _, _ in in_order(physical_effects(spec))), increments=differences,
                   taps=SOFT if differences else (), paths=None)


def key(spec: Spec) -> str:
    """A text that is equal for equal nodes, whatever their noise."""
    return f"{structure(spec)}: {' + '.join(sorted(physical_effects(spec)))}"


def structure(spec: Spec) -> str:
    """Law, process and command between samples in words, as a study's tree holds them."""
    between = spec.between + (f"/{spec.substeps}" if spec.substeps > 1 else "")
    return f"{spec.law}, {spec.process}, {between}"


def spec_of(words: str, effects: Iterable[str], like: Spec) -> Spec:
    """The node that `structure` described in words, with some effects; what words leave out is as in another spec."""
    law, process, command = words.split(", ")
    between, _, parts = command.partition("/")
    return node(replace(like, law=law, process=process, between=between, substeps=int(parts or 1),
                        effects=tuple(effects)))


def valve_effects(spec: Spec) -> list[str]:
    """The effects of a node that act on the valve, in alphabetical order."""
    return sorted(n for n in spec.effects if on_valve(parse(n)[0]))


def kind_of(spec: Spec) -> str:
    """The effects on the valve of a node, and its command between samples: nodes of one kind have the same valves.

    A resting valve without other valve effects is searched with its process, on the record less its disturbances. So
    process and disturbances belong to its kind.
    """
    valve = valve_effects(spec)
    beside = [n for n in spec.effects if plain_name(n) in BASE_EFFECTS or parse(n)[0].columns]
    words = [spec.process, *beside] if valve == [RESTING] else []
    return f"{' + '.join(valve)} {spec.between} {' + '.join(words)}".rstrip()


def depth(spec: Spec) -> int:
    """Number of effects, a lag and a rest not counted."""
    return sum(plain_name(name) not in BASE_EFFECTS for name in physical_effects(spec))


def with_effect(spec: Spec, name: str) -> Spec:
    """The node with one effect more."""
    return replace(spec, effects=tuple(n for n, _, _ in in_order((*physical_effects(spec), name))))


def drop_from(spec: Spec, names: Iterable[str]) -> Spec:
    """The node without some of its effects."""
    gone = set(names)
    return replace(spec, effects=tuple(n for n in physical_effects(spec) if n not in gone))


def slips_like_rests(spec: Spec) -> str:
    """The effect of a node whose slips a resting valve may imitate; empty where it has none."""
    return next((name for name in physical_effects(spec) if parse(name)[0].natural is not None), "")


def other_process(spec: Spec) -> Spec:
    """The node with an integrator in place of a first-order lag, or the reverse; effects that don't suit it go."""
    process = FIRST_ORDER if spec.process == INTEGRATOR else INTEGRATOR
    return node(replace(spec, process=process, effects=suited_effects(spec.effects, process), guides=()))


def other_commands(spec: Spec, commands: Iterable[Spec]) -> list[Spec]:
    """A base with the other courses of the command between samples; none for a node with effects beyond the base."""
    others = [] if depth(spec) else commands
    return [replace(spec, between=c.between, substeps=c.substeps) for c in others if c.between != spec.between]


def variants(effect: str, loop: Loop) -> tuple[str, ...]:
    """The names under which an effect is tried: one for each variant, or for each further tag of the record."""
    check_tag(effect, loop)
    found, option = parse(effect)
    if option:
        return (effect,)
    if "extra" in found.needs:
        return tuple(f"{found.name}:{tag}" for tag in loop.moving_extras)
    return tuple(f"{found.name}@{v}" for v in found.variants) or (found.name,)


def additions(spec: Spec, loop: Loop, only: Iterable[str] | None = None, *, last: bool = False) -> tuple[str, ...]:
    """Names under which effects of the catalogue (or of `only` these) may be added to a node, noise models left out.

    A resting valve gets no effect that only a sliding valve can show, and a valve with such an effect gets no rest.
    With `last` the result holds only the effects that are asked last, otherwise only the others.
    """
    have = {plain_name(name) for name in physical_effects(spec)}
    slides = any(parse(name)[0].slides for name in have)
    asked = None if only is None else set(only)
    return tuple(name for effect in catalogue().values()
                 if effect.name not in have and effect.noise is None and (asked is None or effect.name in asked)
                 and effect.asked_for(loop.process_value) and effect.asked_last == last
                 and not (effect.slides and RESTING in have) and not (slides and effect.name == RESTING)
                 and suited_effects((effect.name,), spec.process)
                 and not ("extra" in effect.needs and not loop.moving_extras)
                 for name in variants(effect.name, loop))


def by_tag(spec: Spec, loop: Loop, only: Iterable[str] | None) -> tuple[str, ...]:
    """Names of effects that a further tag of the record drives and that a node may take."""
    return tuple(name for name in additions(spec, loop, only) if "extra" in parse(name)[0].needs)


def leaking_process(spec: Spec) -> Spec | None:
    """A first-order process with a further lag for a leaking integrator, one lag being long; None elsewhere."""
    if spec.process != INTEGRATOR or LAG in spec.effects or spec.fixed:
        return None
    return node(with_effect(other_process(spec), LAG), soft=spec.increments)


def what_of(spec: Spec, before: Spec) -> str:
    """A change of structure in words: the new process, or the new command between samples."""
    return spec.process if spec.process != before.process else f"{spec.between} command"
