"""Words of an effect for a reader at the plant: its name, its size in a sentence, the action, its part of a swing.

The texts are those of the effect's own file, filled with the values of a study. An effect without texts, such as one
that a user wrote, is named by its summary.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from ..effects import parse
from ..effects.contract import Effect, Place
from ..errors import UsageError
from ..record.study import ParameterValue, Step, Study
from ..record.swing import Share
from . import wording

_PLACE, _CHOICE = re.compile(r"\{(\w+(?:\+\w+)*)\}"), re.compile(r"\[([^]]*\|[^]]*)\]")
# Stands for the tag of a measured disturbance, and what is said where its name has none.
_TAG, _NO_TAG = "tag", "another tag of the export"
_PARTS = {Share.SETPOINT: "setpoint moves", Share.NOISE: "noise", Share.START: "the start of the record"}
# Name of the valve's share of a swing, by verdict.
_VALVE = {"stiction": "the valve's friction", "undecided": "the valve, if it sticks",
          "no stiction": "what the model leaves open"}


def known(name: str) -> tuple[Effect | None, str]:
    """The effect of a name and its variant; None where the catalogue does not have it."""
    try:
        return parse(name)
    except UsageError:
        return None, ""


def named_in(step: Step) -> str:
    """The name of the effect that a step added, with its variant."""
    added = step.added or ""
    return next((n for n in step.effects if plain(n) == added), added)


def is_noise(name: str) -> bool:
    """True for an effect that is a model of the noise."""
    effect, _ = known(name)
    return effect is not None and effect.noise is not None


def moves_valve(name: str) -> bool:
    """True for an effect between command and stem that a fit of the measured position leaves out."""
    effect, _ = known(name)
    return effect is not None and (effect.place in (Place.STEM, Place.FRICTION)
                                   and (effect.friction is None or effect.profile is not None))


def noun(study: Study, name: str) -> str:
    """The effect as a noun with its main number, such as "an oscillation of 37.0 s from outside"."""
    effect, _ = known(name)
    if effect is None or not effect.noun:
        return wording.name(name)
    return _filled(study, name, effect.noun, ends=False)


def sentence(study: Study, name: str) -> str:
    """The size of an effect in a sentence, every number with its unit and interval."""
    effect, _ = known(name)
    if effect is not None and effect.sentence:
        return _filled(study, name, effect.sentence)
    rows = parameters(study, name)
    said = "; ".join(f"{wording.name(p.name)} {_value(study, p, '', True)}" for p in rows)
    return wording.sentence(f"{effect.summary if effect is not None else wording.name(name)}{': ' * bool(said)}{said}")


def plain(name: str) -> str:
    """The name of an effect without its variant."""
    return name.partition("@")[0].partition(":")[0]


def of_model(study: Study) -> list[str]:
    """Names of the effects of the last model, with their variants, in the order in which the steps added them."""
    if not study.steps:
        return []
    variants = {plain(n): n for n in study.steps[-1].model.get("effects", ())}
    added = [step.added for step in study.steps if step.added in study.steps[-1].effects]
    return [variants.get(n, n) for n in dict.fromkeys([*added, *study.steps[-1].effects]) if n]


def action(study: Study, name: str) -> str:
    """The action that an effect asks for; empty where its file has none."""
    effect, _ = known(name)
    return _filled(study, name, effect.action, ends=False) if effect is not None else ""


def part(study: Study, name: str) -> str:
    """A cause of a swing in words (see Share)."""
    if name == Share.VALVE:
        return _VALVE.get(study.verdict.stiction, _VALVE["undecided"])
    return _PARTS.get(name) or noun(study, name)


def fitted_part(study: Study, name: str, inside: Sequence[str] = ()) -> str:
    """A fitted part of PV in words, or several that cancel; `inside` names effects that act within the valve's part."""
    words: list[str] = []
    for one in name.split("+"):
        words += ["valve", "process", *inside] if one == Share.VALVE else [part(study, one)]
    return wording.listed(words)


def parameters(study: Study, name: str) -> list[ParameterValue]:
    """Values of an effect in the last step that has it, or those with which `diagnose` proposes it."""
    effect, at = known(name)
    own = name if effect is None else effect.name
    found = [*(step.parameters for step in reversed(study.steps)),
             *(c.parameters for c in study.candidates if c.variant == at or not at)]
    mine = ([p for p in rows if p.effect in (own, name)] for rows in found)
    return next((rows for rows in mine if rows), [])


def _filled(study: Study, name: str, text: str, *, ends: bool = True) -> str:
    rows = {p.name: p for p in parameters(study, name)}
    at = known(name)[1]

    def met(part: str) -> bool:
        return all(p in rows and rows[p].identifiable for one in _PLACE.findall(part) for p in one.split("+"))

    def chosen(choice: re.Match[str]) -> str:
        parts = choice[1].split("|")
        return wording.listed([part for part in parts if met(part)] or parts)

    def value(place: re.Match[str]) -> str:
        names = place[1].split("+")
        if names == [_TAG]:
            return at or _NO_TAG
        if not all(n in rows for n in names):
            return "an unknown size"
        if len(names) > 1:
            return f"{wording.number(sum(rows[n].value for n in names))} {wording.name(rows[names[0]].unit)}"
        return _value(study, rows[names[0]], at, ends)

    return _PLACE.sub(value, _CHOICE.sub(chosen, text))


def _value(study: Study, p: ParameterValue, at: str, ends: bool) -> str:
    unit = p.unit
    if "unit of y" in unit:
        # A disturbance at the load is given in the travel that would make it.
        pv = "%" if at == "load" else wording.name(study.data.units.get("process_value") or "")
        unit = re.sub(r"^/ ", "per ", unit.replace("unit of y", pv).strip())
    unit = unit if unit != "-" else ""
    if ends:
        return wording.estimate(p.value, p.interval, unit)
    # The digits are those of the value beside its interval.
    return f"{wording.apart(p.value, p.interval)[0]} {wording.name(unit)}".rstrip()
