"""Choice of one table among the parts of a file: the sheets of a workbook, the structs of a MATLAB file.

`--loop` names a part, a loop inside a part, or both as PART/LOOP. Without it the only part that holds a loop is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from ...errors import DataError, UsageError
from ..bytes.options import ReadOptions
from ..words.assign import key_of
from ..words.cells import brief, shown
from ..words.roles import listing, take_all
from .table import Table

_NEEDED = {"process_value", "output"}


@dataclass(frozen=True, slots=True)
class Part:
    """One table of a file: its name, the table's first rows, the loops named in it, and a function for the whole."""

    name: str
    head: Table
    loops: tuple[str, ...]
    whole: Callable[[], Table]

    def holds_loop(self, options: ReadOptions) -> bool:
        """True where the columns, or the tags of a long table, are those of a loop."""
        if options.pv is not None and options.op is not None:
            return {options.pv, options.op} <= set(self.head.names) or options.pv.isdecimal()
        roles = {tag.role for tag in take_all(self.head.names)}
        return bool(self.loops) or roles >= _NEEDED or {"tag", "value"} <= roles


def names_of_parts(parts: list[Part], options: ReadOptions) -> tuple[str, ...]:
    """Names of the loops: of the parts, or PART/LOOP where a part holds several; () for one loop without a name."""
    held = [p for p in parts if p.holds_loop(options)]
    if len(held) == 1:
        return held[0].loops
    return tuple(name for p in held
                 for name in ([f"{p.name}/{loop}" for loop in p.loops] if len(p.loops) > 1 else [p.name]))


def choose(parts: list[Part], options: ReadOptions, file: str, kind: str) -> Table:
    """The table of the part that `--loop` names, or of the only one that holds a loop.

    Its attribute "inner" is the loop that `--loop` leaves to be found inside it. UsageError where none or several fit.
    """
    if options.loop is None:
        held = [p for p in parts if p.holds_loop(options)] or parts
        if len(held) > 1:
            names = names_of_parts(held, options) or tuple(p.name for p in held)
            raise UsageError(f"{file} holds {len(names)} loops in {len(held)} {kind}s: {listing(names)}",
                             f"choose one with --loop {brief(names[0])}")
        return _taken(held[0], None, named=len(parts) > 1)
    part, inner = _named(parts, options, file, kind)
    return _taken(part, inner, named=True)


def _named(parts: list[Part], options: ReadOptions, file: str, kind: str) -> tuple[Part, str | None]:
    """The part that `--loop` names, and the loop inside it where the name says one."""
    assert options.loop is not None
    wanted = key_of(options.loop)
    same = [p for p in parts if key_of(p.name) == wanted]
    if same:
        return same[0], None
    both = [(p, loop) for p in parts for loop in p.loops if key_of(f"{p.name}/{loop}") == wanted]
    inside = both or [(p, loop) for p in parts for loop in p.loops if key_of(loop) == wanted]
    if len(inside) == 1:
        return inside[0]
    if len(inside) > 1:
        names = [f"{p.name}/{loop}" for p, loop in inside]
        raise UsageError(f"{file} holds loop {shown(options.loop)} in {len(names)} {kind}s: {listing(names)}",
                         f"choose one with --loop {brief(names[0])}")
    ends = [p for p in parts if wanted and key_of(p.name).endswith(wanted)]
    if len(ends) == 1:
        return ends[0], None
    if len(parts) == 1 and not parts[0].name:
        return parts[0], options.loop
    names = list(names_of_parts(ends or parts, options)) or [p.name or "(no name)" for p in ends or parts]
    raise UsageError(f"{file} has {f'{len(ends)} loops' if ends else 'no loop or ' + kind} {shown(options.loop)}",
                     f"loops found: {listing(names)}")


def _taken(part: Part, inner: str | None, *, named: bool) -> Table:
    table = part.whole()
    if table.rows == 0:
        raise DataError(f"{table.file} has no rows", "export it again")
    name = {"loop": part.name} if named and part.name else {}
    return replace(table, part=True, attributes=table.attributes | name | ({"inner": inner} if inner else {}))
