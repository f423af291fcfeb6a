"""Catalogue of the physical effects, one file each; a new effect is a new file in this folder."""

from __future__ import annotations

from collections.abc import Iterable

from ..errors import UsageError
from ..system.registry import room
from .contract import Effect

# `catalogue()` gives all effects by name, in physical order and then by name; `get(name)` gives one.
catalogue, get = room(__name__, "EFFECT", Effect, "effect", lambda effect: (effect.place.value, effect.name))


def parse(name: str) -> tuple[Effect, str]:
    """An effect as a study names it, with its variant ("step-disturbance@load") or tag ("measured-disturbance:TAG").

    UsageError for an unknown effect or variant.
    """
    plain, mark, variant = name.partition("@")
    effect = get(plain.partition(":")[0])
    if mark and variant not in effect.variants:
        raise UsageError(f"effect {effect.name} has no variant '{variant}'",
                         "its variants: " + (", ".join(effect.variants) or "none"))
    return effect, variant if mark else plain.partition(":")[2]


def noises_in(names: Iterable[str]) -> tuple[str, ...]:
    """Names of those effects that are noise models, out of names as in a study; UsageError for an unknown one."""
    return tuple(name for name in names if parse(name)[0].noise is not None)


def in_order(names: tuple[str, ...]) -> tuple[tuple[str, Effect, str], ...]:
    """Names, effects and variants or tags in the physical order in which they combine."""
    found = [(name, *parse(name)) for name in names]
    return tuple(sorted(found, key=lambda f: (f[1].place.value, f[0])))
