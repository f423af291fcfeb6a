"""Site profiles: reading options of one site, stored as TOML and applied to every file."""

from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import DataError, UsageError
from ..system.files import text_of, write_whole
from .bytes.options import KINDS, ReadOptions, typed
from .words.roles import take_apart

_HEAD = "# stictionid site profile: how exports of this site are read; options on the command line come first\n"
_FORMATS = (("Excel", "excel"), ("excel1904", "excel1904"), ("FILETIME", "filetime"), ("epoch", "epoch"))
_NOT_KEPT = ("profile", "no_guess", "start", "end", "loop", "limit")
_FIELDS = set(KINDS) - set(_NOT_KEPT)


def with_profile(options: ReadOptions) -> ReadOptions:
    """Options, completed from their profile where not given. UsageError where it is absent, DataError where damaged."""
    path = Path(options.profile or "")
    text = text_of(path, "profile", hint="write one with stictionid read FILE --save-profile")
    try:
        content = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise DataError(
            f"profile {path} is no TOML: {error}", "write one with stictionid read FILE --save-profile"
        ) from None
    default = ReadOptions()
    changes = {}
    for name, value in content.items():
        if name not in _FIELDS:
            raise DataError(f"profile {path} has an unknown entry {name!r}", f"known: {', '.join(sorted(_FIELDS))}")
        if getattr(options, name) == getattr(default, name):
            try:
                changes[name] = typed(name, value)
            except UsageError as error:
                raise DataError(f"profile {path}: {error.message}", error.hint) from None
    # The profile is written out in full, so that a study can be read again without it.
    return replace(options, profile=None, **changes)


def save_profile(result: Any, options: ReadOptions, path: str, *, force: bool = False) -> None:
    """Write the options given and the formats recognised in a file: separator, decimal mark, date order, modes.

    Column names are stored only where they carry no loop name, so that the profile fits the site's other loops.
    """
    kept = {k: v for k, v in options.said().items() if k not in _NOT_KEPT}
    for name in ("sp", "pv", "op", "position", "mode", "quality", "time", "extra"):
        tags = kept.get(name, ())
        if any(take_apart(tag).loop for tag in ([tags] if isinstance(tags, str) else tags)):
            del kept[name]
    guessed = " ".join(result.assumptions)
    roles = {why: role for role, why in result.why.items() if f"by its {why} (" in guessed}
    if roles:
        kept["roles"] = {**roles, **kept.get("roles", {})}
    if "(--encoding NAME)" in guessed:
        kept.setdefault("encoding", result.encoding.removesuffix(" without a mark"))
    if "(--time-format)" in guessed:
        kept.setdefault("time_format", next((w for s, w in _FORMATS if s in result.time), None))
        kept = {k: v for k, v in kept.items() if v is not None}
    if result.separator and result.separator != " ":
        kept.setdefault("separator", result.separator)
        kept.setdefault("decimal", result.decimal)
    if "day/month" in result.time or "month/day" in result.time:
        kept.setdefault("dayfirst", result.time.startswith("day"))
    known = {word: meaning for word, meaning in result.mode_map.items() if meaning != "UNKNOWN"}
    if known:
        kept["mode_map"] = {**known, **kept.get("mode_map", {})}
    lines = [_HEAD] + [f"{name} = {_toml(value)}\n" for name, value in kept.items()]
    write_whole(path, "".join(lines), force=force, kind=b"# stictionid")


def _toml(value: Any) -> str:
    if isinstance(value, (bool, int, float)):
        return repr(value).lower()
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_toml(str(k))} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(v) for v in value) + "]"
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\u{ord(c):04x}" for c in str(value)) + '"'
