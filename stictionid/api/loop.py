"""One control loop for Python: the frozen record, and the rows of the DataFrame or the file that it came from."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import UsageError
from ..record.loop import Finding
from ..record.loop import Loop as Record
from ..system.plurals import counted
from ..typing import BoolArray, FloatArray
from .arguments import checked
from .messages import Shown, in_python, speaking_python
from .rows import InputRows, rows_behind

if TYPE_CHECKING:
    import pandas as pd

    from ..historian.bytes.options import ReadOptions
    from ..record.study import Study

# Findings shown in a short text; the loop holds all.
_SHOWN = 3


@dataclass(frozen=True, repr=False, eq=False)
class Loop(Shown):
    """Setpoint, controller output and process value of one loop, on an even time grid.

    `record` is the frozen record that the verbs work on. `rows` tells which input row became which sample.
    """

    record: Record
    rows: InputRows | None = None

    @classmethod
    @speaking_python
    @checked
    def from_dataframe(cls, frame: pd.DataFrame, *, setpoint: str | None = None, process_value: str | None = None,
                       output: str | None = None, time: str | None = None, position: str | None = None,
                       extra: Sequence[str] = (), step_s: float | None = None, name: str | None = None,
                       units: Mapping[str, str] | None = None, options: Mapping[str, Any] | None = None) -> Loop:
        """The loop in a DataFrame, with the same checks as a file; columns that are not named are guessed.

        `time` names the column of time; without it the index counts where it holds dates, else a column of time, else
        `step_s` gives the seconds between two rows. `extra` are columns of measured disturbances. `units` maps roles
        ("process_value") to units. `options` are further options of reading by their names in `ReadOptions`
        ({"dayfirst": True}). Of columns that share a name the number, from 1 on, chooses one. Raises UsageError for
        columns that are not there, DataError for content without a loop.
        """
        from ..historian.reading import read_frame

        if not (hasattr(frame, "iloc") and hasattr(frame, "columns")):
            raise UsageError(f"{type(frame).__name__} is no DataFrame",
                             "give a pandas DataFrame, or read a file with st.read_loop(path)")
        frame = frame.set_axis([str(c) for c in frame.columns], axis=1)
        dated = time is None and (frame.index.dtype.kind == "M" or "datetime" in str(frame.index.dtype))
        if dated and frame.index.name is None:
            frame = frame.rename_axis("time" if "time" not in frame.columns else "time of the index")
        if dated:
            time = str(frame.index.name)
        roles = {"setpoint": setpoint, "process_value": process_value, "output": output, "position": position}
        for role, column in {**roles, "time": None if dated else time}.items():
            if column is not None and str(column) not in frame.index.names and _place(frame, column) is None:
                raise UsageError(f"the DataFrame has no column {column!r} for {role}",
                                 "its columns: " + ", ".join(map(str, frame.columns[:20])))
        reading = read_frame(frame, options=_options(roles, time, extra, step_s, options), name=name or "loop")
        read = reading.loop
        known = {**read.units, **(units or {})}
        record = replace(read, name=name or read.name, units=known,
                         origin=replace(read.origin, file=None, units={**read.origin.units, **(units or {})}))
        place = None if dated or time is None else _place(frame, time)
        own = frame.iloc[:, place] if place is not None else frame.index if time is not None else None
        return cls(record, rows_behind(reading, len(frame), own))

    @property
    def name(self) -> str:
        """Name of the loop: its tag where it has one."""
        return self.record.name

    @property
    def samples(self) -> int:
        """Number of samples on the even grid."""
        return self.record.samples

    @property
    def step_s(self) -> float:
        """Seconds between two samples."""
        return self.record.step_s

    @property
    def setpoint(self) -> FloatArray | None:
        """Setpoint (samples,), None where there is none."""
        return self.record.setpoint

    @property
    def output(self) -> FloatArray:
        """Controller output (samples,)."""
        return self.record.output

    @property
    def process_value(self) -> FloatArray:
        """Process value (samples,)."""
        return self.record.process_value

    @property
    def used(self) -> BoolArray:
        """True (samples,) where a sample counts."""
        return self.record.used

    @property
    def units(self) -> dict[str, str]:
        """Units of the roles."""
        return self.record.units

    @property
    def findings(self) -> tuple[Finding, ...]:
        """Everything noticed while the data were read."""
        return self.record.origin.findings

    def to_dataframe(self) -> pd.DataFrame:
        """Signals of the even grid as a DataFrame with one row for each sample, indexed by seconds."""
        from .tables import signals

        return signals(self.record)

    def _lines(self) -> list[str]:
        r, at = self.record, self.record.origin
        lines = [f"Loop {r.name}: {counted(r.samples, 'sample')} of {r.step_s:g} s, {int(r.used.sum()):,} of them used",
                 f"from {self._stamp(at.start) or 'its start'} to {self._stamp(at.end) or 'its end'}, "
                 f"{counted(len(r.starts), 'segment')}"]
        for role in ("setpoint", "process_value", "output", "position"):
            values = getattr(r, role)
            if values is not None and np.isfinite(values).any():
                lines.append(f"{role.replace('_', ' ')}: {np.nanmin(values):.5g} to {np.nanmax(values):.5g} "
                             f"{r.unit(role)}".rstrip())
        told = [f for f in at.findings if f.severity != "info"]
        lines += [f"{f.severity}: {in_python(f.statement)}"[:200] for f in told[:_SHOWN]]
        return lines + ([f"{len(told) - _SHOWN} more findings"] if len(told) > _SHOWN else [])

    def _stamp(self, stamp: str | None) -> str | None:
        """A stamp in the zone of the input's own times; the record holds UTC."""
        zone = getattr(getattr(getattr(self.rows, "time", None), "dtype", None), "tz", None)
        if zone is None or stamp is None:
            return stamp
        import pandas as pd

        return f"{pd.Timestamp(stamp).tz_convert(zone).isoformat()} ({zone})"


@speaking_python
@checked
def read_loop(path: Any, *, setpoint: str | None = None, process_value: str | None = None, output: str | None = None,
              time: str | None = None, position: str | None = None, extra: Sequence[str] = (),
              step_s: float | None = None, loop: str | None = None, start: str | None = None, end: str | None = None,
              options: Mapping[str, Any] | None = None) -> Loop:
    """The loop in a file or a folder: CSV, TSV, text or Parquet; columns that are not named are guessed.

    `loop` chooses one of several, `start` and `end` a stretch (stamps, or seconds since the first row). `options` are
    further options of reading by their names in `ReadOptions`. Raises UsageError for absent files and unknown names,
    DataError for content that can't be used.
    """
    from ..historian.reading import read

    roles = {"setpoint": setpoint, "process_value": process_value, "output": output, "position": position}
    more = {"loop": loop, "start": start, "end": end}
    said = {**(options or {}), **{k: v for k, v in more.items() if v is not None}}
    reading = read(path, options=_options(roles, time, extra, step_s, said))
    rows = None
    if reading.behind:
        highest = max(int(rows.max(initial=-1)) for rows in reading.behind) + 1
        rows = rows_behind(reading, max(highest, 0 if reading.stamps is None else reading.stamps.ns.size), None)
    return Loop(reading.loop, rows)


def _options(roles: Mapping[str, Any], time: Any, extra: Sequence[str], step_s: float | None,
             more: Mapping[str, Any] | None) -> ReadOptions:
    """Options of the reader from the keywords, which come before those of the mapping `more`."""
    from ..historian.bytes.options import ROLES, options_from

    if isinstance(extra, str):
        extra = (extra,)
    said = {**(more or {}), **{ROLES[role]: str(column) for role, column in roles.items() if column is not None}}
    for key, value in (("time", None if time is None else str(time)), ("extra", tuple(map(str, extra)) or None),
                       ("step_s", step_s)):
        if value is not None:
            said[key] = value
    return options_from(said)


def _place(frame: pd.DataFrame, column: Any) -> int | None:
    """Place of a column by its name, or by its number from 1 on where no column is called so; None where it is none."""
    same = [i for i, name in enumerate(frame.columns) if name == str(column)]
    if same:
        return same[0]
    number = int(column) if str(column).isdecimal() and len(str(column)) < 10 else 0
    return number - 1 if 1 <= number <= len(frame.columns) else None


def loop_of(source: Any) -> Loop:
    """The loop in a Loop, a record, a DataFrame, a path or an open file; UsageError for anything else."""
    if isinstance(source, Loop):
        return source
    if isinstance(source, Record):
        return Loop(source)
    if isinstance(source, str | os.PathLike) or hasattr(source, "read"):
        return read_loop(source)
    if hasattr(source, "columns") and hasattr(source, "index"):
        return Loop.from_dataframe(source)
    raise UsageError(f"{type(source).__name__} is no loop", "give a Loop, a DataFrame or the path of a file")


def loop_in_file(study: Study) -> Loop:
    """The loop in the file that a study names; UsageError where it is not there, DataError where it has changed."""
    from ..reports.pictures.curves import find_data, refuse_changed

    place = find_data(study)
    if place is None:
        raise UsageError(f"the data of the study ({study.data.file or 'no file'}) are not there",
                         "give the loop that was identified")
    found = read_loop(place, options=study.data.options)
    refuse_changed(study, place, found.record.origin.sha256)
    return found
