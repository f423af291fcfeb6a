"""A study for Python: the frozen record with files, tables, curves, pictures and short texts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import DataError
from ..record.study import Estimate, Range, Step, Verdict, study_from_json, to_json
from ..record.study import Study as Record
from ..record.swing import Severity
from ..record.tree import TreeNode
from ..record.unexplained import Unexplained
from .loop import Loop
from .messages import Shown, in_python, speaking_python
from .plots import Plots, last_step, loop_for
from .threads import one_thread

if TYPE_CHECKING:
    import pandas as pd

# Longest line of a short text. Unit: characters.
_LINE = 160


class Tree(tuple[TreeNode, ...]):
    """Every model that the search tried, as nodes; its text draws the nodes worth seeing, best first."""

    lines: tuple[str, ...]

    def __new__(cls, nodes: Sequence[TreeNode], lines: Sequence[str] = ()) -> Tree:
        made = super().__new__(cls, nodes)
        made.lines = tuple(lines)
        return made

    def __repr__(self) -> str:
        return "\n".join(self.lines) or "no tree: the study has one model, or is an older one"

    def _repr_html_(self) -> str:
        return f"<pre>{escape(repr(self))}</pre>"


@dataclass(frozen=True, repr=False)
class Study(Shown):
    """Result of `identify`, `diagnose` or `add`. Nothing changes a study; every function returns a new one.

    `record` is the frozen record, whose JSON is study.json. `loop` is the loop it was made from, None after `load`.
    """

    record: Record
    loop: Loop | None = field(default=None, compare=False)

    @classmethod
    @speaking_python
    def load(cls, path: str | os.PathLike[str]) -> Study:
        """The study in a file. UsageError where it is not there, DataError where it is no study or a newer one."""
        from ..system.files import text_of

        try:
            return cls(study_from_json(text_of(Path(path), "the study", hint="give a file written by Study.save")))
        except DataError as error:
            raise DataError(f"{path}: {error.message}", error.hint) from None

    @speaking_python
    def save(self, path: str | os.PathLike[str], *, force: bool = False) -> Path:
        """Write study.json, whole or not at all, and return its place; `force` replaces a file of another kind."""
        from ..system.files import write_whole

        write_whole(Path(path), to_json(self.record), force=force, kind=b"{")
        return Path(path)

    @property
    def name(self) -> str:
        """Name of the loop."""
        return self.record.data.name

    @property
    def verdict(self) -> Verdict:
        """Verdict on stiction, with reason and confidence; what the reason says to do is in the words of Python."""
        return replace(self.record.verdict, reason=in_python(self.record.verdict.reason))

    @property
    def estimate(self) -> Estimate | None:
        """S, J and the process with intervals; None where the study abstained."""
        return self.record.estimate

    @property
    def range(self) -> Range:
        """Period and S_max of the oscillation."""
        return self.record.range

    @property
    def severity(self) -> Severity | None:
        """Effect of the friction on the loop; None where it was not judged."""
        return self.record.severity

    @property
    def steps(self) -> tuple[Step, ...]:
        """Models of the ladder, the base first."""
        return self.record.steps

    @property
    def missing(self) -> tuple[str, ...]:
        """Effects that the search named."""
        return self.record.missing

    @property
    def adequate(self) -> bool | None:
        """True where nothing above the noise is left to explain."""
        return self.record.adequate

    @property
    def unexplained(self) -> Unexplained | None:
        """Shape of what the best model leaves: responses, levels, spectrum, and a sentence; None where nothing is."""
        return self.record.unexplained

    @property
    def parameters(self) -> pd.DataFrame:
        """Parameters of the last model, one row each."""
        from .tables import parameters

        return parameters(self.record.steps[-1] if self.record.steps else None)

    @property
    def candidates(self) -> pd.DataFrame:
        """Effects that `diagnose` asked for, best first; empty before."""
        from .tables import candidates

        return candidates(self.record.candidates)

    @property
    def tree(self) -> Tree:
        """Every model that the search tried."""
        from ..reports.tree_text import tree_lines

        return Tree(self.record.tree, tree_lines(self.record))

    @property
    def plot(self) -> Plots:
        """Pictures of the study: `plot.fit(loop)` and others return matplotlib Axes."""
        return Plots(self.record, self.loop)

    def summary(self) -> pd.DataFrame:
        """Main numbers, one row each: value, ends of its interval, and unit; it prints within 80 columns."""
        from .tables import summary

        return summary(self.record)

    @speaking_python
    @one_thread
    def curves(self, loop: Any = None) -> pd.DataFrame:
        """Signals and curves of the last model, one row for each input row of the loop, NaN where it is not used.

        Indexed by the input's own times. `loop` may be left out where the study still has it. Raises DataError for
        another record than the study's, and for an abstained study.
        """
        from .tables import curves

        used = loop_for(self.record, loop, self.loop)
        return curves(last_step(self.record), used.record, used.rows)

    def _repr_html_(self) -> str:
        from ..reports.facts import facts

        found = facts(self.record)
        rows = "".join(f"<tr><td>{escape(n.label)}</td><td><b>{escape(n.value)}</b></td><td>{escape(n.note)}</td></tr>"
                       for n in found.numbers)
        rest = "".join(f"<li>{escape(line)}</li>" for line in self._lines()[-3:]) if self.record.steps else ""
        return (f"<div><p><b>{escape(found.title)}</b></p><p>{escape(in_python(found.headline))}</p>"
                f"<table>{rows}</table><ul>{rest}</ul></div>")

    def _lines(self) -> list[str]:
        """At most ten lines: data, verdict, numbers, error, effects, and the next thing to do."""
        from ..reports import wording

        r, e, unit = self.record, self.record.estimate, self.record.data.units.get("process_value", "")
        lines = [f"Study of {wording.name(r.data.name)}: {r.data.rows_used:,} of {r.data.rows:,} rows used, "
                 f"{r.data.step_s:g} s apart",
                 f"verdict: {wording.name(r.verdict.stiction)} (confidence {r.verdict.confidence:.2f})"]
        if e is None or not r.steps:
            return [*lines, wording.clean(f"because: {in_python(r.verdict.reason)}", _LINE)]
        error = r.steps[-1].error
        lags = ", ".join(wording.number(t) for t in e.time_constants_s)
        lines += [f"S {wording.estimate(e.S, e.S_interval, e.unit, e.S_pieces)}, "
                  f"J {wording.jump(e.J, e.J_interval, e.unit, e.J_pieces, known=e.J_known)}; "
                  f"{100 * e.interval_level:g} % intervals",
                  f"process: gain {wording.number(e.gain)}, lag {lags} s, dead time {wording.number(e.dead_time_s)} s"
                  + (", integrating" if e.integrating else ""),
                  f"error: {wording.with_unit(error.best, unit)}, held out {wording.number(error.rmse_holdout)}, noise "
                  f"{wording.number(error.noise_sd)}; the model is {'' if r.adequate else 'not '}adequate",
                  "model: " + " + ".join([f"valve ({wording.name(e.law)})", *map(wording.name, r.steps[-1].effects)])]
        if r.missing:
            lines.append(f"named: {wording.clean(', '.join(r.missing), _LINE)}")
        elif not r.adequate and not r.candidates:
            lines.append("next: st.diagnose(study, loop) asks which effect is missing")
        return [wording.clean(line, 2 * _LINE) for line in lines]
