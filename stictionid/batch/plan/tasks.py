"""Tasks of a batch from its paths: every loop there, once, with a unique name."""

from __future__ import annotations

import difflib
import hashlib
import os
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ...errors import DataError, UsageError
from ...historian.bytes.options import ReadOptions
from ...historian.bytes.source import PARQUET
from ...historian.dataset import groups_of, open_dataset
from ...historian.settled import settled
from ...historian.words.assign import key_of
from ...historian.words.roles import listing
from ...system.plurals import counted
from ..command import command_for
from ..task import Skipped, Task, Work
from .loop_lists import TAGS, read_list
from .peeking import Peeked, from_dataset, peek
from .sources import DATA, FOREIGN, FoundFiles, look

_NAME = "name the columns with --sp --pv --op, or give a loop list with --loops"
_EXPORT = "export it as CSV, Parquet, a workbook or a MATLAB file, or leave it out"
# Longest name of a loop in the name of its file, and names that some systems keep for devices.
_LONGEST = 80
_DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?\Z", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class Plan:
    """The tasks in the order of the sources, and the files left out with their reason."""

    tasks: tuple[Task, ...]
    skipped: tuple[Skipped, ...]


def plan(paths: Iterable[str], work: Work, *, reading: ReadOptions | None = None, loops: Path | None = None) -> Plan:
    """The tasks behind `paths`: the loops of a loop list, or else every loop with a PV and an OP.

    UsageError for absent paths and for two loops of one name; DataError where there is no loop at all.
    """
    reading = settled(reading)
    listed = read_list(loops) if loops is not None else ()
    found = look(paths, leave=[loops] if loops is not None else [])
    peeked, skipped = _peek_all(found, reading)
    tasks = [*_listed(listed, peeked, work, reading)] if listed else [*_found(peeked, work, reading)]
    if reading.loop is not None:
        wanted = [t for t in tasks if key_of(t.loop) == key_of(reading.loop)]
        if not wanted and tasks:
            raise UsageError(f"no loop {reading.loop!r}", f"loops found: {listing([t.loop for t in tasks])}")
        tasks = wanted
    used = {t.path for t in tasks} | {file for t in tasks for file in t.files}
    left = {s.file: s for s in (*skipped, *(_without_loop(p) for p in peeked if os.path.abspath(p.path) not in used))}
    if not tasks:
        first = next(iter(left.values()), None)
        raise DataError("no loop was found" + (f" of {counted(len(left), 'file')}: {first.file}: {first.reason}"
                                               if first else " (no file)"), _NAME)
    tasks = _with_endings(tasks)
    _refuse_twins(tasks)
    return Plan(tuple(tasks), tuple(left[name] for name in sorted(left)))


def _without_loop(peeked: Peeked) -> Skipped:
    """A file without a loop, with the reason and what to do."""
    if peeked.damaged:
        return Skipped(str(peeked.path), peeked.damaged, peeked.hint or "export it again")
    if peeked.foreign:
        return Skipped(str(peeked.path), peeked.foreign, peeked.hint or _NAME)
    return Skipped(str(peeked.path), "holds no loop of the list", "add its tags to the list, or leave the file out")


def _peek_all(found: FoundFiles, reading: ReadOptions) -> tuple[list[Peeked], list[Skipped]]:
    """Content of every file or dataset, and the files that cannot hold a loop."""
    peeked: list[Peeked] = []
    skipped = [Skipped(str(p), why, _EXPORT) for p, why in found.skipped]
    for folder, files in found.inside.items():
        parquet = {f for f in files if f.suffix.lower() in PARQUET}
        if parquet and (opened := _opened(folder, reading)) is not None:
            peeked.append(opened)
            files = tuple(f for f in files if f not in parquet)
        peeked += [peek(f, reading) for f in files]
    for file in found.named:
        if file.suffix.lower() in DATA:
            peeked.append(peek(file, reading))
        else:
            skipped.append(Skipped(str(file), FOREIGN, _EXPORT))
    return peeked, skipped


def _opened(folder: Path, reading: ReadOptions) -> Peeked | None:
    """A folder's Parquet files as one dataset whose rows hold many loops; None where each file stands alone."""
    try:
        opened = open_dataset(folder)
    except DataError:
        return None
    return from_dataset(opened, reading) if opened.many else None


def _found(peeked: list[Peeked], work: Work, reading: ReadOptions) -> Iterator[Task]:
    """Tasks of every loop that the sources hold by themselves."""
    single: dict[Path, dict[str, str]] = {}
    for p in peeked:
        path = os.path.abspath(p.path)
        if p.damaged:
            yield _task(p.path.name.split(".")[0], "file", path, work, reading, problem=p.damaged)
            continue
        if p.tag:
            single.setdefault(p.path.parent, {})[p.tag] = path
        for name, select in p.loops.items():
            # Tags given by hand name their loop already.
            many = (len(p.loops) > 1 or p.kind == "dataset") and (p.kind == "part" or not (reading.pv and reading.op))
            yield _task(name or p.path.name.split(".")[0], p.kind, path, work,
                        replace(reading, loop=name) if many else replace(reading, loop=None), select=select)
    for folder, tags in single.items():
        for name, mine in groups_of(tags).items():
            yield _task(name, "tags", os.path.abspath(folder), work, replace(reading, loop=name), select=mine,
                        files=tuple(sorted(tags[t] for t in mine)))


def _listed(listed: tuple[ReadOptions, ...], peeked: list[Peeked], work: Work, reading: ReadOptions) -> Iterator[Task]:
    """Tasks of the loops of a list; one whose tags are absent is a task that fails with the reason."""
    places: dict[str, list[Peeked]] = {}
    for p in peeked:
        for tag in (*p.names, *([p.tag] if p.tag else [])):
            places.setdefault(tag, []).append(p)
    some = False
    for entry in listed:
        named = {role: getattr(entry, role) for role in TAGS}
        own = replace(reading, **named, span_pv=entry.span_pv or reading.span_pv,
                      span_op=entry.span_op or reading.span_op, loop=None)
        name, tags = str(entry.loop), tuple(filter(None, named.values()))
        absent = [t for t in tags if t not in places]
        if absent:
            near = difflib.get_close_matches(absent[0], places, 1)
            problem = (f"the loop list names the tag {absent[0]!r}, which is in none of the {len(peeked)} sources"
                       + (f"; nearest: {near[0]!r}" if near else ""))
            yield _task(name, "file", "", work, own, problem=problem)
            continue
        some = True
        homes = [p for p in places[str(entry.pv)] if set(tags) <= set(p.names)]
        if homes:
            kind = homes[0].kind if homes[0].kind == "dataset" else "wide"
            yield _task(name, kind, os.path.abspath(homes[0].path), work, own, select=tags)
        else:
            files = tuple(sorted({os.path.abspath(places[t][0].path) for t in tags}))
            yield _task(name, "tags", os.path.commonpath([os.path.dirname(f) for f in files]), work, own,
                        select=tags, files=files)
    if not some:
        raise UsageError(f"none of the {len(listed)} loops of the list is in the data, the first: {listed[0].pv!r}",
                         "check the tags of the list against stictionid read")


def _task(loop: str, kind: str, path: str, work: Work, reading: ReadOptions, *, select: tuple[str, ...] = (),
          files: tuple[str, ...] = (), problem: str = "") -> Task:
    return Task(loop, kind, path, reading, key_for(loop), command_for(path, work, reading), select, files, problem)


def key_for(loop: str) -> str:
    """A file name without ending for a loop: its own name where that is harmless, else a harmless form with a mark.

    The mark is a fingerprint of the whole name: two names never share a file, and the same name always gets the same
    one. Lower-case letters are marked too, since some file systems take them for capitals.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]+", "_", loop)[:_LONGEST].strip("._- ") or "loop"
    if plain == loop and loop.upper() == loop and not _DEVICES.match(loop):
        return plain
    return f"{plain}-{hashlib.sha256(loop.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


def _with_endings(tasks: list[Task]) -> list[Task]:
    """The tasks, damaged files with the ending in their name where another loop is called so, too."""
    called = Counter(task.loop for task in tasks)
    return [task if not task.problem or called[task.loop] == 1 or not task.path else
            replace(task, loop=Path(task.path).name, key=key_for(Path(task.path).name)) for task in tasks]


def _refuse_twins(tasks: list[Task]) -> None:
    seen: dict[str, Task] = {}
    for task in tasks:
        other = seen.setdefault(task.loop, task)
        if other is not task:
            raise UsageError(f"two loops are called {task.loop!r}: one in {other.path}, one in {task.path}",
                             "give one of the two, or run them with an -o folder each")
