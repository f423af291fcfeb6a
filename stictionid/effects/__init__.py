"""The effect catalogue: one file for each physical effect, found by looking at the folder."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache

from ..errors import UsageError
from .contract import Effect


@cache
def catalogue() -> dict[str, Effect]:
    """All effects by name, in physical order and then by name."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        effect = getattr(importlib.import_module(f"{__name__}.{module.name}"), "EFFECT", None)
        if effect is not None:
            found[effect.name] = effect
    return {e.name: e for e in sorted(found.values(), key=lambda e: (e.place.value, e.name))}


def get(name: str) -> Effect:
    """The effect called `name`; UsageError naming the nearest one where there is none."""
    try:  # the usual case loads one file only
        effect = getattr(importlib.import_module(f"{__name__}.{name.replace('-', '_')}"), "EFFECT", None)
        if isinstance(effect, Effect) and effect.name == name:
            return effect
    except (ImportError, ValueError):
        pass
    effects = catalogue()
    if name in effects:
        return effects[name]
    near = difflib.get_close_matches(name, effects, 1)
    raise UsageError(f"unknown effect '{name}'", (f"did you mean '{near[0]}'? " if near else "")
                     + "effects: " + ", ".join(effects))


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


def in_order(names: tuple[str, ...]) -> tuple[tuple[str, Effect, str], ...]:
    """Names, effects and variants or tags in the physical order in which they combine."""
    found = [(name, *parse(name)) for name in names]
    return tuple(sorted(found, key=lambda f: (f[1].place.value, f[0])))
