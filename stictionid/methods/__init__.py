"""The identification methods, one file each; the catalogue finds them by looking at the folder."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache

from ..errors import UsageError
from .contract import Method

DEFAULT = "auto"


@cache
def catalogue() -> dict[str, Method]:
    """All methods by name, the default first, then by name."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        method = getattr(importlib.import_module(f"{__name__}.{module.name}"), "METHOD", None)
        if method is not None:
            found[method.name] = method
    return {name: found[name] for name in sorted(found, key=lambda n: (n != DEFAULT, n))}


def get(name: str) -> Method:
    """The method called `name`; UsageError naming the nearest one where there is none."""
    try:  # the usual case loads one file only
        method = getattr(importlib.import_module(f"{__name__}.{name.replace('-', '_')}"), "METHOD", None)
        if isinstance(method, Method) and method.name == name:
            return method
    except (ImportError, ValueError):
        pass
    methods = catalogue()
    if name in methods:
        return methods[name]
    near = difflib.get_close_matches(name, methods, 1)
    raise UsageError(f"unknown method '{name}'", (f"did you mean '{near[0]}'? " if near else "")
                     + "methods: " + ", ".join(methods))
