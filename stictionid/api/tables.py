"""DataFrames of a study and of a loop; pandas loads with this file."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ..model.restore import rerun
from ..record.loop import Finding
from ..record.loop import Loop as Record
from ..record.study import Candidate, ParameterValue, Step, Study
from ..reports.effect_words import plain
from ..typing import FloatArray
from .messages import in_python
from .rows import InputRows

_PARAMETERS = ("effect", "name", "value", "low", "high", "unit", "at_bound", "identifiable", "meaning")
_CANDIDATES = ("effect", "variant", "accepted", "gain_beyond_noise", "delta_bic", "rmse", "rmse_holdout",
               "rmse_one_step_holdout", "error_drop_percent", "one_step_drop_percent", "equivalent_to",
               "detectable_from", "rejected_because", "statement")
_FINDINGS = ("severity", "code", "statement", "suggests")


def summary(study: Study) -> pd.DataFrame:
    """Main numbers of a study, one row each: value, ends of its interval, and unit.

    A column of sentences would make pandas hide the others. An effect that the model has stands as "effect", one that
    it lacks as "missing".
    """
    rows: list[tuple[str, Any, Any, Any, str]] = [("verdict", study.verdict.stiction, None, None, ""),
                                                  ("confidence", study.verdict.confidence, None, None, "")]
    e, unit = study.estimate, study.data.units.get("process_value") or "unit of y"
    if e is not None:
        per = " per s" if e.integrating else ""
        rows += [("S", e.S, *_ends(e.S_interval), e.unit), ("J", e.J, *_ends(e.J_interval), e.unit),
                 ("gain", e.gain, *_ends(e.gain_interval), f"{unit}/{e.unit}{per}")]
        spans = (*e.time_constants_intervals, *[None] * len(e.time_constants_s))
        rows += [("time constant", value, *_ends(spans[i]), "s") for i, value in enumerate(e.time_constants_s)]
        rows.append(("dead time", e.dead_time_s, *_ends(e.dead_time_interval), "s"))
    if study.range.period_median_s is not None:
        rows.append(("period", study.range.period_median_s, None, None, "s"))
    if study.steps:
        error = study.steps[-1].error
        rows += [("error", error.best, None, None, unit), ("error held out", error.rmse_holdout, None, None, unit),
                 ("noise", error.noise_sd, None, None, unit), ("adequate", study.adequate, None, None, "")]
    have = study.steps[-1].effects if study.steps else ()
    lacks = [name for name in study.missing if name not in set(map(plain, have))]
    rows += [("effect", name, None, None, "") for name in have]
    rows += [("missing", name, None, None, "") for name in lacks or ["none of these"] * (study.unexplained is not None)]
    table = _frame(rows, ["quantity", "value", "low", "high", "unit"])
    return table.astype({"low": float, "high": float}).set_index("quantity")


def parameters(step: Step | None) -> pd.DataFrame:
    """Parameters of one step, one row each; `effect` is None for valve and process."""
    found: Sequence[ParameterValue] = step.parameters if step is not None else ()
    return _frame([(p.effect, p.name, p.value, *_ends(p.interval), p.unit, p.at_bound, p.identifiable, p.meaning)
                   for p in found], _PARAMETERS)


def candidates(found: Sequence[Candidate]) -> pd.DataFrame:
    """Effects that were asked for, best first; `equivalent_to` is a text."""
    rows = [[", ".join(c.equivalent_to) if name == "equivalent_to" else getattr(c, name) for name in _CANDIDATES]
            for c in found]
    return _frame(rows, _CANDIDATES)


def findings(found: Sequence[Finding]) -> pd.DataFrame:
    """Findings, one row each; `suggests` is a text."""
    return _frame([(f.severity, f.code, f.statement, ", ".join(f.suggests)) for f in found], _FINDINGS)


def signals(record: Record) -> pd.DataFrame:
    """Signals of a record with one row for each sample, indexed by seconds since the first one, gaps included."""
    columns: dict[str, Any] = {role: getattr(record, role) for role in ("setpoint", "process_value", "output",
                                                                        "position")
                               if getattr(record, role) is not None}
    return pd.DataFrame({**columns, **record.extras, "used": record.used}, index=pd.Index(record.clock_s,
                                                                                          name="time_s"))


def curves(step: Step, record: Record, rows: InputRows | None) -> pd.DataFrame:
    """Signals and curves of one step's model, one row for each input row, NaN where it is not used.

    Without input rows there is one row for each sample.
    """
    found = rerun(record, step.model)
    columns: dict[str, FloatArray] = {}
    if record.setpoint is not None:
        columns["setpoint"] = record.setpoint
    columns |= {"output": record.output, "process_value": record.process_value, "model": found.model,
                "residual": found.residual, "innovation": found.innovation, "valve_position": found.position}
    if record.position is not None:
        columns["measured_position"] = record.position
    sample = np.arange(record.samples) if rows is None else rows.sample
    used = (sample >= 0) & record.used[sample]
    table = pd.DataFrame({name: np.where(used, values[sample], np.nan) for name, values in columns.items()})
    table.index = pd.Index(record.clock_s, name="time_s") if rows is None else pd.Index(rows.time, name=rows.name)
    return table


def _frame(rows: Iterable[Sequence[Any]], columns: Sequence[str]) -> pd.DataFrame:
    """A DataFrame of rows, texts in the words of Python; halves of surrogate pairs, which Arrow refuses, are escaped.
    """
    return pd.DataFrame([[in_python(v).encode("utf-8", "backslashreplace").decode() if isinstance(v, str) else v
                          for v in row] for row in rows], columns=list(columns))


def _ends(span: tuple[float, float] | None) -> tuple[float | None, float | None]:
    return (None, None) if span is None else span
