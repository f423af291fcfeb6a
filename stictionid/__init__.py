"""Tell from setpoint, controller output and process value whether a control valve sticks, and what the model misses.

>>> import stictionid as st
>>> loop = st.read_loop("loop.csv")                    # doctest: +SKIP
>>> study = st.identify(loop)                          # doctest: +SKIP
>>> study.estimate.S, study.verdict.reason             # doctest: +SKIP

Names load on first use, so that importing the package is cheap. Errors are in `stictionid.errors`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ._version import __version__ as __version__

if TYPE_CHECKING:
    from .api.loop import Loop, read_loop
    from .api.study import Study
    from .api.workflow import add, compare, diagnose, identify, remove, report

_HOMES = {
    "api.loop": ("Loop", "read_loop"),
    "api.study": ("Study",),
    "api.workflow": ("add", "compare", "diagnose", "identify", "remove", "report"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = ["Loop", "Study", "add", "compare", "diagnose", "identify", "read_loop", "remove", "report"]


def __dir__() -> list[str]:
    return list(__all__)


if not TYPE_CHECKING:  # or an import of a name that is not there would pass
    def __getattr__(name: str) -> Any:
        if name in _HOME_OF:
            import importlib

            value = getattr(importlib.import_module(f"{__name__}.{_HOME_OF[name]}"), name)
            globals()[name] = value
            return value
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
