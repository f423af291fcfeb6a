"""JSON Schema of a study, made from the dataclasses that write it, so that the two cannot differ.

Source: JSON Schema 2020-12; the contract of study.json.
"""

from __future__ import annotations

import dataclasses
import types
import typing
from typing import Any

from .as_json.shape import FURTHER, group_of, home_of
from .study import SCHEMA, Study

DIALECT = "https://json-schema.org/draft/2020-12/schema"
_PLAIN = {float: "number", int: "integer", bool: "boolean", str: "string"}


def study_schema() -> dict[str, Any]:
    """The schema as plain JSON types; a study may hold further fields, and lack those that have a default.

    Every number may be null: one that does not exist or is not finite is written so.
    """
    parts: dict[str, Any] = {}
    top = _of(Study, parts)
    parts["Study"]["properties"]["schema"] = {"const": SCHEMA}
    return {"$schema": DIALECT, "title": "stictionid study", **top, "$defs": parts}


def _of(kind: Any, parts: dict[str, Any]) -> dict[str, Any]:
    """The schema of one annotation; dataclasses are collected in `parts` by name."""
    origin, inner = typing.get_origin(kind), typing.get_args(kind)
    if kind is Any:
        return {}
    if kind is float:
        return {"type": ["number", "null"]}
    if kind in _PLAIN:
        return {"type": _PLAIN[kind]}
    if origin in (typing.Union, types.UnionType):
        return {"anyOf": [{"type": "null"} if k is type(None) else _of(k, parts) for k in inner]}
    if origin is tuple and inner[-1] is Ellipsis:
        return {"type": "array", "items": _of(inner[0], parts)}
    if origin is tuple:
        return {"type": "array", "prefixItems": [_of(k, parts) for k in inner], "minItems": len(inner),
                "maxItems": len(inner)}
    if origin is dict:
        return {"type": "object", "additionalProperties": _of(inner[1], parts)}
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        if kind.__name__ not in parts:
            parts[kind.__name__] = {}
            parts[kind.__name__].update(_fields(kind, parts))
        return {"$ref": f"#/$defs/{kind.__name__}"}
    raise TypeError(f"no schema for {kind}")


def _fields(kind: type, parts: dict[str, Any]) -> dict[str, Any]:
    """Properties of a dataclass, its required ones, and its docstring as the description."""
    hints, fields = typing.get_type_hints(kind), dataclasses.fields(kind)
    needed = [f.name for f in fields if f.default is dataclasses.MISSING and f.default_factory is dataclasses.MISSING]
    properties = {f.name: _of(hints[f.name], parts) for f in fields if f.name != FURTHER and not home_of(f)}
    for f in fields:
        if home := home_of(f):
            # Keys inside an object that may hold others.
            group = group_of(kind, f)
            keys = {f.name: _of(hints[f.name], parts)} if group is None else _fields(group, parts)["properties"]
            properties[home] = {**properties[home], "properties": {**properties[home].get("properties", {}), **keys}}
    return {"type": "object", "description": " ".join((kind.__doc__ or "").split()),
            "properties": properties, "required": needed}
