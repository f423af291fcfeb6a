"""Shape of a result in JSON where it differs from the fields of its dataclass.

An open dataclass has a field `further`, which holds all keys that have no field of their own. Its null fields are not
written. The keys of a field with metadata from `inside` are written inside the object of another field. Both forms let
code read typed fields where scripts read one flat object.
"""

from __future__ import annotations

import dataclasses
import functools
import typing
from typing import Any

FURTHER = "further"
_INSIDE, _BESIDE, _LEFT_OUT = "inside", "beside", "left out"


def inside(name: str) -> dict[str, str]:
    """Metadata of an optional field whose keys are written inside the object of the field `name`, if it is not null.

    A dataclass is written there key by key, and read where all keys are there that its fields need.
    """
    return {_INSIDE: name}


def beside(name: str) -> dict[str, str]:
    """Metadata of a field of an open dataclass that is written even as null, where the field `name` is not null."""
    return {_BESIDE: name}


def left_out() -> dict[str, bool]:
    """Metadata of a field that is not written where it holds its default."""
    return {_LEFT_OUT: True}


@functools.cache
def is_shaped(kind: type) -> bool:
    """True for a dataclass whose JSON differs from its fields."""
    return any(f.name == FURTHER or _INSIDE in f.metadata or _LEFT_OUT in f.metadata for f in dataclasses.fields(kind))


def folded(record: Any) -> dict[str, Any]:
    """Values of a shaped dataclass by the keys of its JSON."""
    fields, found = dataclasses.fields(record), dict[str, Any]()
    is_open = any(f.name == FURTHER for f in fields)
    for f in fields:
        value, home, other = getattr(record, f.name), home_of(f), f.metadata.get(_BESIDE)
        if f.name == FURTHER:
            found |= value
        elif home:
            keys = {} if value is None else _values(value) if dataclasses.is_dataclass(value) else {f.name: value}
            found[home] = {**found[home], **keys}
        elif _LEFT_OUT in f.metadata and value == f.default:
            continue
        elif not is_open or value is not None or (other and getattr(record, other) is not None):
            found[f.name] = value
    return found


def unfolded(kind: type, content: dict[str, Any]) -> dict[str, Any]:
    """Content of JSON by the fields of a shaped dataclass; the inverse of `folded`."""
    fields = {f.name: f for f in dataclasses.fields(kind)}
    if FURTHER in fields:
        known = {k: v for k, v in content.items() if k in fields and k != FURTHER}
        return {**known, FURTHER: {k: v for k, v in content.items() if k not in known}}
    found = {k: v for k, v in content.items() if k in fields and not home_of(fields[k])}
    for name, f in fields.items():
        given = found.get(home_of(f))
        if not isinstance(given, dict):
            continue
        group = group_of(kind, f)
        parts = (f,) if group is None else dataclasses.fields(group)
        keys = {g.name for g in parts if g.name in given}
        if all(g.name in keys for g in parts if group is None or g.default is dataclasses.MISSING):
            found[name] = given[name] if group is None else {k: given[k] for k in keys}
            found[home_of(f)] = {k: v for k, v in given.items() if k not in keys}
    return found


@functools.cache
def group_of(kind: type, f: dataclasses.Field[Any]) -> Any:
    """The dataclass of an optional field; None for a field of another type."""
    choices = typing.get_args(typing.get_type_hints(kind)[f.name])
    return next((c for c in choices if dataclasses.is_dataclass(c)), None)


def home_of(f: dataclasses.Field[Any]) -> str:
    """Name of the field inside whose object a field is written; empty for one with a key of its own."""
    return str(f.metadata.get(_INSIDE, ""))


def _values(record: Any) -> dict[str, Any]:
    named = {f.name: getattr(record, f.name) for f in dataclasses.fields(record)}
    return {name: value for name, value in named.items() if value is not None}
