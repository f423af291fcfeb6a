"""Find out from setpoint, controller output and process value whether a control valve sticks, and how much.

The command line is a client of these functions; names load on first use, so that importing the package is cheap.

>>> import stictionid
>>> loop = stictionid.read_loop("loop.csv")            # doctest: +SKIP
>>> study = stictionid.identify(loop)                  # doctest: +SKIP
>>> study.estimate.S, study.verdict.reason             # doctest: +SKIP
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .agreement import compare_records
    from .errors import CannotTell, DataError, ModelError, StictionidError, UsageError
    from .historian import ReadOptions, read_loop
    from .identify import Options, identify
    from .loop import Finding, Loop
    from .oscillation import find_range
    from .rerun import rerun
    from .results import Estimate, Range, Study, Verdict, study_from_json, to_json
    from .simulate import Controller, Plant, Setting, Simulation, preset, simulate
    from .spec import Curves

_HOMES = {
    "agreement": ("compare_records",),
    "errors": ("CannotTell", "DataError", "ModelError", "StictionidError", "UsageError"),
    "historian": ("ReadOptions", "read_loop"),
    "identify": ("Options", "identify"),
    "loop": ("Finding", "Loop"),
    "rerun": ("rerun",),
    "spec": ("Curves",),
    "oscillation": ("find_range",),
    "results": ("Estimate", "Range", "Study", "Verdict", "study_from_json", "to_json"),
    "simulate": ("Controller", "Plant", "Setting", "Simulation", "preset", "simulate"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "CannotTell", "Controller", "Curves", "DataError", "Estimate", "Finding", "Loop", "ModelError", "Options", "Plant",
    "Range", "ReadOptions", "Setting", "Simulation", "StictionidError", "Study", "UsageError", "Verdict",
    "__version__", "compare_records",
    "find_range", "identify", "preset", "read_loop", "rerun", "simulate", "study_from_json", "to_json",
]


def __getattr__(name: str) -> Any:
    if name in _HOME_OF:
        import importlib

        value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
        globals()[name] = value
        return value
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


class _Package(ModuleType):
    """Some functions have the name of their module: `stictionid.identify` is the function, whatever was imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if name in _HOME_OF and isinstance(value, ModuleType):
            value = getattr(value, name)  # the import system binds a module once it is complete
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
