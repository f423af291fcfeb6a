"""Kinds of the arguments of the interface: a value of another kind is a UsageError that says what to give."""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable, Mapping
from numbers import Integral, Real
from typing import Any

from ..errors import UsageError
from ..record.study import Study
from .messages import P, R


def _is_study(value: Any) -> bool:
    return isinstance(getattr(value, "record", None), Study)


def _is_source(value: Any) -> bool:
    return isinstance(value, str | os.PathLike) or hasattr(value, "read")


def _of(kind: Any) -> Callable[[Any], bool]:
    return lambda value: isinstance(value, kind)


_WORD, _WHOLE, _MAPPING = (_of(str), "name"), (_of(Integral), "whole number"), (_of(Mapping), "dictionary")
# Test, kind in words, and an example of the arguments by their names.
_KINDS: dict[str, tuple[Callable[[Any], bool], str, str]] = {
    "law": (*_WORD, 'law="chen"'), "method": (*_WORD, 'method="auto"'), "between": (*_WORD, 'between="hold"'),
    "effect": (*_WORD, '"extra-lag"'), "figures": (*_WORD, 'figures="svg"'),
    "effects": (_of(Iterable), "list of names", 'effects=["extra-lag"]'),
    "extra": (_of(Iterable), "list of columns", 'extra=["TI101"]'),
    "seed": (*_WHOLE, "seed=0"), "budget": (*_WHOLE, "budget=100_000"), "jobs": (*_WHOLE, "jobs=2"),
    "bootstrap": (*_WHOLE, "bootstrap=99"), "scan_s": (_of(Real), "number", "scan_s=1.0"),
    "step_s": (_of(Real), "number", "step_s=1.0"),
    "plant": (*_MAPPING, 'plant={"gain": 2.0}'), "units": (*_MAPPING, 'units={"process_value": "m³/h"}'),
    "options": (*_MAPPING, 'options={"dayfirst": True}'),
    "progress": (callable, "function", "progress=lambda words, share: print(words)"),
    "study": (_is_study, "study", 'st.identify(loop), or st.Study.load("study.json")'),
    "path": (_is_source, "path", '"loop.csv"'),
}
# Longest value that is repeated in a message. Unit: characters.
_SHOWN = 60


def refuse(name: str, value: Any) -> None:
    """UsageError for an argument of the wrong kind; None is left to the function, as most arguments may be None."""
    if name not in _KINDS or (value is None and name not in ("study", "effect", "path")):
        return
    fits, kind, example = _KINDS[name]
    if not fits(value):
        raise UsageError(f"{name} is {repr(value)[:_SHOWN]}, which is no {kind}", f"give for example {example}")


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """The function that refuses arguments of a wrong kind before it does anything."""
    signature = inspect.signature(function)

    @functools.wraps(function)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        for name, value in signature.bind(*args, **kwargs).arguments.items():
            refuse(name, value)
        return function(*args, **kwargs)
    return wrapped
