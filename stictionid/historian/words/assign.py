"""Assignment of columns to roles (SP, PV, OP, …) for one loop: first by the options, then by the names."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from ...errors import DataError, UsageError
from ..bytes.options import ALL_TAGS, FLAGS, ROLES, ReadOptions
from .cells import brief, shown
from .roles import Tag, listing, pick, take_all, take_apart, tidy

_FLAG = {role: FLAGS[option] for role, option in ROLES.items()}
_PLAIN = ("", "ascii", "utf-8")
"""Encodings that spoil no name: none (Parquet, workbook), ASCII, and UTF-8, whose bytes prove it."""
_SURE_WORDS = """
    co, controller output, date time, datetime, meas, mode, mode actual, op, out cv, position, process value,
    process variable, pv, pv cv, set point, setpoint, sp, sp cv, spt, stem position, sv, t s, time, time s,
    time stamp, time utc, timestamp, valve position, zi, zt
"""
SURE = frozenset(w.strip() for w in _SURE_WORDS.split(","))
"""Names with one meaning only; every other match is a guess and is reported as one (MV and OUT among them)."""


@dataclass
class Assignment:
    """Columns by role, for one loop. `index` maps roles to column numbers (or, in long tables, to tags)."""

    index: dict[str, int]
    why: dict[str, str]
    loop: str = ""
    extras: dict[str, int] = field(default_factory=dict)
    guesses: list[str] = field(default_factory=list)
    unused: list[str] = field(default_factory=list)

    @property
    def columns(self) -> list[tuple[str, int]]:
        """Every role with its column, further columns as "extra:NAME"."""
        return [*self.index.items(), *((f"extra:{name}", i) for name, i in self.extras.items())]


def assign(names: tuple[str, ...], options: ReadOptions, file: str, *, skip: set[int], numeric: set[int],
           encoding: str = "") -> Assignment:
    """Roles of the signal columns. `skip` are columns already used (time); `numeric` those that hold numbers.

    `encoding` is that of the file, which an error names where it may have spoilt the names.

    DataError where PV or OP is in no column or in several; UsageError where the loop is unknown or several are found.
    """
    found = Assignment({}, {})
    for role, option in ROLES.items():
        wanted = getattr(options, option)
        if wanted is not None:
            found.index[role] = pick(names, wanted, _FLAG[role], file)
            found.why[role] = f"said with {_FLAG[role]}"
    places = [pick(names, wanted, "--extra", file) for wanted in options.extra if wanted != ALL_TAGS]
    found.extras |= {names[place]: place for place in places}
    _refuse_shared(found.index | {f"extra {n}": i for n, i in found.extras.items()}, skip, names, file)
    taken = set(found.index.values()) | set(found.extras.values()) | skip
    tags = {i: tag for i, tag in enumerate(take_all(names)) if i not in taken}
    tags = {i: t for i, t in tags.items() if t.role in ROLES and (i in numeric or t.role == "mode")}
    # Of several mode columns without a loop the surest alone counts.
    for _, i in sorted((t.rank, i) for i, t in tags.items() if t.role == "mode" and not t.loop)[1:]:
        del tags[i]
    group = _choose_loop(tags, found, names, options, file)
    _complete(found, tags, group, options.roles, file)
    missing = [role for role in ("process_value", "output") if role not in found.index]
    if missing:
        raise _not_found(missing, found, tags, names, file, encoding)
    _refuse_shared(found.index, skip, names, file)
    if ALL_TAGS in options.extra:
        found.extras |= _others(names, found, group, skip, numeric)
    used = set(found.index.values()) | set(found.extras.values()) | skip
    found.unused = [n for i, n in enumerate(names) if i not in used and n]
    if not found.loop:
        loops = [take_apart(names[found.index[r]]).loop for r in ("output", "process_value")]
        found.loop = next((loop for loop in loops if loop), "")
    return found


def _others(names: tuple[str, ...], found: Assignment, group: str, skip: set[int],
            numeric: set[int]) -> dict[str, int]:
    """Every other column of numbers with a name of its own, without modes, qualities, masks and this loop's tags."""
    used = set(found.index.values()) | set(found.extras.values()) | skip
    own = {key_of(take_apart(names[i]).loop) for i in found.index.values()} | {group}
    counts = Counter(names)
    tags = {i: take_apart(names[i]) for i in sorted(numeric - used)}
    return {names[i]: i for i, tag in tags.items()
            if counts[names[i]] == 1 and names[i] and tag.role not in ("mode", "quality")
            and names[i].strip().lower() != "used" and not (tag.role and tag.loop and key_of(tag.loop) in own)}


def _not_found(
    missing: list[str], found: Assignment, tags: dict[int, Tag], names: tuple[str, ...], file: str, encoding: str
) -> DataError:
    """The error for PV or OP in no column; it names the role that no column has, even of another loop."""
    role = next((r for r in missing if all(tag.role != r for tag in tags.values())), missing[0])
    columns = f"columns: {listing(names)}"
    for other, i in found.index.items():
        if take_apart(names[i]).role == role:
            return DataError(
                f"{file}: column {shown(names[i])} would be both {role.replace('_', ' ')} (by its name) and "
                f"{other.replace('_', ' ')} (said with {_FLAG[other]})",
                f"name another column with {_FLAG[role]}; {columns}",
            )
    if any(tag.role == role for tag in tags.values()):
        return DataError(f"{file} has no loop with both a process value (PV) and a controller output (OP)",
                         f"name the columns of one with --pv and --op; {columns}")
    read_as, more = "", ""
    if encoding not in _PLAIN:
        read_as, more = f", read as {encoding},", ", or the file's encoding with --encoding (cp1252, cp1251, gbk)"
    words = {"process_value": "process value (PV)", "output": "controller output (OP)"}[role]
    return DataError(f"{file}{read_as} has no column for the {words}", f"name it with {_FLAG[role]}{more}; {columns}")


def _refuse_shared(index: dict[str, int], skip: set[int], names: tuple[str, ...], file: str) -> None:
    seen: dict[int, str] = dict.fromkeys(skip, "time")
    for role, column in index.items():
        if column in seen:
            raise DataError(
                f"{file}: column {shown(names[column])} would be both {seen[column].replace('_', ' ')} and "
                f"{role.replace('_', ' ')}",
                "give each role a column of its own (--sp --pv --op --position --time)",
            )
        seen[column] = role


def key_of(loop: str) -> str:
    """A loop's name for comparison: case and separators ignored."""
    return tidy(loop).replace(" ", "")


def _choose_loop(
    tags: dict[int, Tag], found: Assignment, names: tuple[str, ...], options: ReadOptions, file: str
) -> str:
    """Key of the loop whose columns are taken; "" where names carry none."""
    groups: dict[str, list[Tag]] = {}
    for tag in tags.values():
        groups.setdefault(key_of(tag.loop), []).append(tag)
    said = {key_of(take_apart(names[i]).loop) for r, i in found.index.items() if r in ("process_value", "output")}
    needed = {"process_value", "output"} - set(found.index)
    full = {k: g[0].loop for k, g in groups.items() if needed <= {tag.role for tag in g}} if needed else {}
    if options.loop is not None:
        wanted = key_of(options.loop)
        match = [k for k in groups if k == wanted] or [
            k for k in full if k.endswith(wanted) or (wanted.endswith(k) and k)
        ]
        if len(match) != 1:
            raise UsageError(
                f"{file} has no loop {shown(options.loop)}",
                f"loops found: {listing([loop or '(no name)' for loop in full.values()])}"
                if full
                else f"no loop was found; columns: {listing(names)}",
            )
        found.loop = groups[match[0]][0].loop
        return match[0]
    if said - {""} and len(said) == 1 and (said & set(groups) or not needed):
        return next(iter(said))
    if len(full) > 1:
        loops = [loop or "(no name)" for loop in full.values()]
        raise UsageError(
            f"{file} holds {len(full)} loops: {listing(loops)}", f"choose one with --loop {brief(loops[0] or loops[1])}"
        )
    found.loop = next(iter(full.values()), "")
    return next(iter(full), "")


def _complete(found: Assignment, tags: dict[int, Tag], group: str, known: dict[str, str], file: str) -> None:
    """Assign the roles not given by options: from the chosen loop, else from columns of no loop or the only one."""
    digits = "".join(c for c in group if c.isdigit())
    for role in ROLES:
        if role in found.index:
            continue
        columns = [(i, t) for i, t in tags.items() if t.role == role]
        inside = [(i, t) for i, t in columns if key_of(t.loop) == group]
        near = [(i, t) for i, t in columns if digits and t.loop and "".join(c for c in t.loop if c.isdigit()) == digits]
        choice = inside or near or [(i, t) for i, t in columns if not t.loop]
        if not choice and role in ("process_value", "output", "setpoint") and len(columns) == 1 and not group:
            choice = columns
        if not choice:
            continue
        choice = sorted(choice, key=lambda c: (c[1].rank, c[0]))
        if len(choice) > 1 and choice[0][1].rank == choice[1][1].rank and role in ("process_value", "output"):
            (i, one), (j, other) = choice[:2]
            raise DataError(
                f"{file}: {role.replace('_', ' ')} may be column {i + 1}, {shown(one.name)}, or column {j + 1}, "
                f"{shown(other.name)}",
                f"choose with {_FLAG[role]} {i + 1} or {_FLAG[role]} {j + 1}",
            )
        column, tag = choice[0]
        found.index[role], found.why[role] = column, tag.why
        word = tag.why.partition("'")[2].rstrip("'")
        if word not in SURE and known.get(tag.why) != role:
            found.guesses.append(f"{role.replace('_', ' ')} is {shown(tag.name)}, by its {tag.why} ({_FLAG[role]})")
