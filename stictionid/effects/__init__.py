"""Catalogue of the physical effects, one file each, and of those that users write; a new effect is a new file.

User-written effects come from `use` (files that a command line names), from the environment variable
STICTIONID_EFFECTS, from installed packages with the entry point `stictionid.effects`, and from `register`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from ..errors import DataError, UsageError
from ..system.registry import Room
from .contract import Effect

# Files and folders with effects, separated as in PATH; the group of entry points by which packages bring effects.
VARIABLE, GROUP = "STICTIONID_EFFECTS", "stictionid.effects"
_brought = False


def _bring() -> None:
    """Load the effects of the environment and of installed packages, once."""
    global _brought
    if _brought:
        return
    _brought = True
    try:
        from_environment = [place for place in os.environ.get(VARIABLE, "").split(os.pathsep) if place]
        if from_environment:
            use(from_environment)
        _from_packages()
    except BaseException:
        _brought = False
        raise


# `catalogue()` gives all effects by name, in physical order and then by name; `get(name)` gives one. `register(effect)`
# adds one, `forget(name)` takes it out again, `added()` gives those that were added.
_room = Room(__name__, "EFFECT", Effect, "effect", lambda effect: (effect.place.value, effect.name), _bring)
catalogue, get, register, forget, added = (_room.catalogue, _room.get, _room.register, _room.forget,
                                           _room.added)


def use(places: Iterable[str | Path], tell: Callable[[str], None] | None = None) -> tuple[Effect, ...]:
    """Load the effects of files and folders and add them to the catalogue; `tell` hears of every point they pass.

    UsageError for a place that is not there, DataError with file and line for a file that breaks the contract.
    """
    from .written.load import files_in, load

    built_in = {name for name, effect in catalogue().items() if not effect.file}
    found = tuple(load(path, built_in, tell) for path in files_in(tuple(places)))
    for effect in found:
        have = catalogue().get(effect.name)
        if have is not None and have.sha256 != effect.sha256 and have.file != effect.file:
            raise DataError(f"{effect.file}:1: NAME {effect.name} is that of {have.file}, too; choose another one")
        register(effect)
    return found


def _from_packages() -> None:
    """Register what installed packages bring: an `Effect`, or a module of plain numpy."""
    from importlib.metadata import entry_points

    for point in entry_points(group=GROUP):
        try:
            brought = point.load()
        except Exception as error:
            raise DataError(f"the effect {point.name} of {point.value} can't be loaded: {error}",
                            "update or uninstall that package") from None
        if isinstance(brought, Effect):
            register(brought)
        else:
            use([str(brought.__file__)])


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
    found = [(name, *parse(name)) for name in names]
    return tuple(sorted(found, key=lambda f: (f[1].place.value, f[0])))
