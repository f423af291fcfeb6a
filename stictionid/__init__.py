"""Public names of the package: tell from setpoint, controller output and process value whether a control valve sticks.

The command line is a client of these functions. Names load on first use, so that importing the package is cheap.

>>> import stictionid
>>> loop = stictionid.read_loop("loop.csv")            # doctest: +SKIP
>>> study = stictionid.identify(loop)                  # doctest: +SKIP
>>> study.estimate.S, study.verdict.reason             # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._version import __version__

if TYPE_CHECKING:
    from .errors import CannotTell, DataError, ModelError, StictionidError, UsageError
    from .fit.options import Options
    from .historian import ReadOptions, read_loop
    from .model.closed_loop import Controller, Plant, Setting, Simulation, preset, simulate
    from .model.restore import rerun
    from .model.spec import Curves
    from .record.loop import Finding, Loop
    from .record.oscillation import find_range
    from .record.study import Estimate, Range, Study, Verdict, study_from_json, to_json
    from .verbs.agree import compare_records
    from .verbs.identify import identify

_HOMES = {
    "errors": ("CannotTell", "DataError", "ModelError", "StictionidError", "UsageError"),
    "fit.options": ("Options",),
    "historian": ("ReadOptions", "read_loop"),
    "model.closed_loop": ("Controller", "Plant", "Setting", "Simulation", "preset", "simulate"),
    "model.restore": ("rerun",),
    "model.spec": ("Curves",),
    "record.loop": ("Finding", "Loop"),
    "record.oscillation": ("find_range",),
    "record.study": ("Estimate", "Range", "Study", "Verdict", "study_from_json", "to_json"),
    "verbs.agree": ("compare_records",),
    "verbs.identify": ("identify",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "CannotTell", "Controller", "Curves", "DataError", "Estimate", "Finding", "Loop", "ModelError", "Options", "Plant",
    "Range", "ReadOptions", "Setting", "Simulation", "StictionidError", "Study", "UsageError", "Verdict",
    "__version__", "compare_records",
    "find_range", "identify", "preset", "read_loop", "rerun", "simulate", "study_from_json", "to_json",
]

if not TYPE_CHECKING:  # or an import of a name that is not there would pass
    def __getattr__(name: str) -> Any:
        if name in _HOME_OF:
            import importlib

            value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
            globals()[name] = value
            return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
