"""Options of the reader: columns, formats, spans and window; options not given are guessed, and guesses are listed.

Each option is declared once, here. The command line, the list of loops, profiles and the command that a study stores
read the declaration.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from ...errors import UsageError

# Stands among the further tags for all columns of numbers that have no other use.
ALL_TAGS = "*"


def _option(text: str, metavar: str = "", *, flag: str = "", default: Any = None) -> Any:
    """A field with the help text of its option on the command line; `flag` where it is not the field's name."""
    metadata = {"help": text, "metavar": metavar or None, "flag": flag}
    if isinstance(default, dict):
        return field(default_factory=dict, metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True, slots=True)
class ReadOptions:
    """Options for reading a file: names of columns, formats, spans, window; None or empty means "find out".

    `sp pv op position time mode quality extra` are column names or 1-based column numbers; an `extra` of * stands for
    every other tag. `step_s` seconds.
    `span_pv`, `span_op`, `split` are (low, high) in the unit of the column. `start`, `end` are time stamps, or
    seconds since the first row. `dayfirst` True, False, or None to decide over the whole file. `mode_map` maps
    a mode as written to AUTO, CAS, MAN or OFF. `roles` maps the reason of a guess, as `Reading.why` words it
    ("suffix 'mv'"), to the role it has on this site; profiles store it. `sentinels` are numbers that mean
    "no value". `limit` raises limits, for example "rows=1e8". Fields without a help text are no options of a command.
    """

    sp: str | None = _option("Column of the setpoint.", "TAG")
    pv: str | None = _option("Column of the process value.", "TAG")
    op: str | None = _option("Column of the controller output.", "TAG")
    position: str | None = _option("Column of a measured valve position.", "TAG")
    time: str | None = _option("Column of the time (DATE+CLOCK for two).", "TAG")
    mode: str | None = _option("Column of the controller mode.", "TAG")
    quality: str | None = _option("Column of the quality of all values.", "TAG")
    extra: tuple[str, ...] = _option("Further column kept as a measured disturbance; repeatable; '*' for every other "
                                     "tag.", "TAG", default=())
    loop: str | None = _option("Which loop, sheet or struct of a file that holds several.", "NAME")
    step_s: float | None = _option("Sampling time where there is no time column.", "SECONDS", flag="--step")
    span_pv: tuple[float, float] | None = _option("Range of PV and SP, to scale them to % of span.", "LO,HI")
    span_op: tuple[float, float] | None = _option("Range of OP (4,20 or 0,1), to scale it to %.", "LO,HI")
    split: tuple[float, float] | None = _option("Part of OP that drives this valve (split range).", "LO,HI")
    reverse_op: bool = _option("OP of 100 closes the valve: use 100 - OP.", default=False)
    start: str | None = _option("First time used: a stamp, a clock time, or seconds since the first row.", "TIME")
    end: str | None = _option("Last time used.", "TIME")
    decimal: str | None = _option("Decimal mark, . or ,", "MARK")
    dayfirst: bool | None = _option("Dates like 03/04/2024 are day first, or month first.",
                                    flag="--dayfirst/--monthfirst")
    zone: str | None = _option("Time zone of local stamps, for example Europe/Berlin.", "NAME")
    time_format: str | None = _option("iso, dmy, mdy, ymd, epoch, excel, excel1904, filetime or seconds.", "WORD")
    encoding: str | None = _option("Character encoding, for example cp1252 or gbk.", "NAME")
    separator: str | None = _option("Cell separator: , ; | tab or space.", "MARK")
    header: int | None = _option("Lines before the data.", "LINES")
    shape: str | None = _option("wide, long or paired.", "WORD")
    mode_map: dict[str, str] = _option("Meaning of a mode: AUTO, CAS, MAN or OFF; repeatable.", "MODE=MEANING",
                                       default={})
    quality_kind: str | None = None
    sentinels: tuple[float, ...] = _option("Number that means no value; repeatable.", "VALUE", flag="--sentinel",
                                           default=())
    keep_manual: bool = _option("Use samples in manual as well.", default=False)
    keep_startup: bool = _option("Use samples of a start-up or shut-down as well.", default=False)
    no_guess: bool = _option("Every assumption is an error.", default=False)
    profile: str | None = _option("Site profile written by read --save-profile.", "SITE.toml")
    limit: tuple[str, ...] = _option("Raise a limit: rows, columns, line, file or unpacked; repeatable.", "WHAT=SIZE",
                                     default=())
    roles: dict[str, str] = field(default_factory=dict)

    def said(self) -> dict[str, Any]:
        """The options that differ from the defaults, as plain JSON types, for `Origin.options`."""
        default = ReadOptions()
        changed = {name: getattr(self, name) for name in KINDS if getattr(self, name) != getattr(default, name)}
        return {
            k: list(v) if isinstance(v, tuple) else dict(v) if isinstance(v, dict) else v for k, v in changed.items()
        }


KINDS = {f.name: str(f.type) for f in fields(ReadOptions)}
"""Type of each option, as written."""
FLAGS = {f.name: f.metadata.get("flag") or "--" + f.name.replace("_", "-") for f in fields(ReadOptions)}
"""Name of each option on the command line."""
ROLES = {"setpoint": "sp", "process_value": "pv", "output": "op", "position": "position", "mode": "mode"}
"""Option that names the column of each role."""


def span_of(text: str) -> tuple[float, float]:
    """Two numbers with a comma or a semicolon between them; ValueError for other text."""
    low, high = (float(part) for part in text.replace(";", ",").split(","))
    return low, high


def options_from(said: dict[str, Any]) -> ReadOptions:
    """The ReadOptions that `said` describes (the reverse of `ReadOptions.said`); UsageError for unknown names."""
    unknown = sorted(set(said) - set(KINDS))
    if unknown:
        raise UsageError(f"{unknown[0]!r} is not an option of reading", f"known: {', '.join(sorted(KINDS))}")
    return ReadOptions(**{name: typed(name, value) for name, value in said.items()})


def typed(name: str, value: Any) -> Any:
    """A value of TOML or JSON in the type of its option; UsageError where its type is another."""
    kind = KINDS[name]
    if value is None and kind.endswith("None"):
        return None
    if kind.startswith("tuple") and isinstance(value, (list, tuple)):
        if kind.startswith("tuple[str") and all(isinstance(v, str) for v in value):
            return tuple(value)
        pair = kind.startswith("tuple[float, float]")
        if kind.startswith("tuple[float") and all(map(_is_number, value)) and (len(value) == 2 or not pair):
            return tuple(map(float, value))
    if kind.startswith("dict") and isinstance(value, dict):
        return {str(k): str(v) for k, v in value.items()}
    if kind.startswith("float") and _is_number(value):
        return float(value)
    plain = {"bool": bool, "int": int, "str": str}.get(kind.split(" |")[0])
    if plain is not None and isinstance(value, plain) and (plain is bool or not isinstance(value, bool)):
        return value
    raise UsageError(f"{name} = {str(value)[:60]!r} is not a {kind.split(' |')[0]}", "correct it, or save it again")


def _is_number(value: Any) -> bool:
    """A finite JSON number that a float holds."""
    return isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) < 1e300
