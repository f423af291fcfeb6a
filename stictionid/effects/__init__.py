"""Catalogue of the physical effects, one file each, and of those that users write; a new effect is a new file.

User-written effects come from `use` (files that a command line names), from the environment variable
STICTIONID_EFFECTS, from installed packages with the entry point `stictionid.effects`, and from `register`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from ..errors import UsageError
from ..system.open_room import OpenRoom
from .contract import Effect

# Files and folders with effects, separated as in PATH; the group of entry points by which packages bring effects.
VARIABLE, GROUP = "STICTIONID_EFFECTS", "stictionid.effects"

# `catalogue()` gives all effects by name, in physical order and then by name; `get(name)` gives one. `register(effect)`
# adds one, `forget(name)` takes it out again, `added()` gives those that were added. `use(places, tell)` adds those of
# files and folders.
_room = OpenRoom(__name__, "EFFECT", Effect, "effect", lambda effect: (effect.place.value, effect.name),
                 variable=VARIABLE, group=GROUP)
catalogue, get, register, forget, added, use = (_room.catalogue, _room.get, _room.register, _room.forget, _room.added,
                                                _room.use)


def built_in(test: Callable[[Effect], bool]) -> str:
    """Name of the built-in effect that passes a test, for the roles that only one effect has; no user's code is run."""
    return next(effect.name for effect in _room.built_in().values() if test(effect))


def parse(name: str) -> tuple[Effect, str]:
    """An effect as a study names it, with its variant ("step-disturbance@load"), tag ("measured-disturbance:TAG") or
    known number ("backlash:1.5").

    UsageError for an unknown effect or variant.
    """
    plain, mark, variant = name.partition("@")
    effect = get(plain.partition(":")[0])
    if mark and variant not in effect.variants:
        raise UsageError(f"effect {effect.name} has no variant '{variant}'",
                         "its variants: " + (", ".join(effect.variants) or "none"))
    option = variant if mark else plain.partition(":")[2]
    return effect.known(option) if effect.known and option else effect, option


def leaving(trace: str) -> tuple[str, ...]:
    """Names of the effects that leave a trace in a residual, the likeliest first."""
    found = [effect for effect in catalogue().values() if trace in effect.leaves]
    return tuple(effect.name for effect in sorted(found, key=lambda effect: effect.leaves[trace]))


def noises_in(names: Iterable[str]) -> tuple[str, ...]:
    """Names of those effects that are noise models, out of names as in a study; UsageError for an unknown one."""
    return tuple(name for name in names if parse(name)[0].noise is not None)


def walks(names: Iterable[str]) -> bool:
    """True where an effect of these names is noise without a level; UsageError for an unknown one."""
    return any(parse(name)[0].noise == "random-walk" for name in names)


def in_order(names: tuple[str, ...]) -> tuple[tuple[str, Effect, str], ...]:
    """Names, effects and variants or tags in the physical order in which they combine."""
    return tuple(sorted(((name, *parse(name)) for name in names), key=lambda f: (f[1].place.value, f[0])))
