"""The stiction laws, one file each; the catalogue finds them by looking at the folder."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache

from ..errors import UsageError
from .contract import Law

DEFAULT = "chen"


@cache
def catalogue() -> dict[str, Law]:
    """All laws by name, the default first, then by name."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        law = getattr(importlib.import_module(f"{__name__}.{module.name}"), "LAW", None)
        if law is not None:
            found[law.name] = law
    return {name: found[name] for name in sorted(found, key=lambda n: (n != DEFAULT, n))}


def get(name: str) -> Law:
    """The law called `name`; UsageError naming the nearest one where there is none."""
    try:  # the usual case loads one file only
        module = importlib.import_module(f"{__name__}.{name.replace('-', '_')}")
        law = getattr(module, "LAW", None)
        if isinstance(law, Law) and law.name == name:
            return law
    except (ImportError, ValueError):
        pass
    laws = catalogue()
    if name in laws:
        return laws[name]
    near = difflib.get_close_matches(name, laws, 1)
    raise UsageError(f"unknown law '{name}'", (f"did you mean '{near[0]}'? " if near else "")
                     + "laws: " + ", ".join(laws))
