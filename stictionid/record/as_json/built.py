"""Results out of their JSON: dataclasses filled from plain types; an error names the part that is damaged."""

from __future__ import annotations

import dataclasses
import functools
import types
import typing
from typing import Any, TypeVar

from .shape import is_shaped, unfolded

Result = TypeVar("Result")

_WHOLE = "it"
_WORDS = {int: "a whole number", bool: "true or false", str: "text"}


def built(kind: type[Result], content: Any) -> Result:
    """`content` as a dataclass; ValueError with the place and what is wrong there, in words."""
    return typing.cast(Result, _build(kind, content, ""))


def _build(kind: Any, content: Any, where: str) -> Any:
    """`content` as an instance of the annotation `kind`; unknown fields are ignored, missing ones need a default."""
    origin = typing.get_origin(kind)
    if kind is Any:
        return content
    if origin in (typing.Union, types.UnionType):
        choices = typing.get_args(kind)
        if content is None and type(None) in choices:
            return None
        return _build(next(c for c in choices if c is not type(None)), content, where)
    if origin is tuple:
        if not isinstance(content, list):
            raise ValueError(f"{where or _WHOLE} is not a list")
        inner = typing.get_args(kind)
        kinds = [inner[0]] * len(content) if inner[-1] is Ellipsis else list(inner)
        if len(kinds) != len(content):
            raise ValueError(f"{where or _WHOLE} has {len(content)} entries, not {len(kinds)}")
        return tuple(_build(k, c, f"{where}[{i}]") for i, (k, c) in enumerate(zip(kinds, content, strict=True)))
    if origin is dict:
        if not isinstance(content, dict):
            raise ValueError(f"{where or _WHOLE} is not an object of named values")
        return {k: _build(typing.get_args(kind)[1], v, f"{where}.{k}".lstrip(".")) for k, v in content.items()}
    if isinstance(kind, type) and dataclasses.is_dataclass(kind):
        if not isinstance(content, dict):
            raise ValueError(f"{where or _WHOLE} is not an object of named values")
        if is_shaped(kind):
            content = unfolded(kind, content)
        hints = _hints(kind)
        known = {f.name for f in dataclasses.fields(kind)}
        lacks = [f.name for f in dataclasses.fields(kind) if f.name not in content
                 and f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING]
        if lacks:
            raise ValueError(f"{where or _WHOLE} has no {', '.join(lacks)}")
        values = {k: _build(hints[k], v, f"{where}.{k}".lstrip(".")) for k, v in content.items() if k in known}
        return kind(**values)
    if kind is float:
        if isinstance(content, bool) or not isinstance(content, (int, float)):
            raise ValueError(f"{where} is {content!r:.60}, not a number")
        return float(content)
    if kind in (int, bool, str):
        if not isinstance(content, kind) or (kind is int and isinstance(content, bool)):
            raise ValueError(f"{where} is {content!r:.60}, not {_WORDS[kind]}")
        return content
    raise TypeError(f"{where}: no reading for {kind}")


_hints = functools.cache(typing.get_type_hints)
