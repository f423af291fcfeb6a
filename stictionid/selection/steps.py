"""A study's last model opened for refits, and a study with new steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ..errors import DataError
from ..fit.adequacy import adequate, with_one_noise
from ..fit.context import Run, process_numbers
from ..fit.fit import Fitted, as_it_stands
from ..fit.options import Options
from ..model.restore import rebuild_model
from ..record.loop import Loop
from ..record.oscillation import find_range
from ..record.segments import described
from ..record.study import Estimate, Step, Study
from .score import Scored


def opened(loop: Loop, study: Study, seed: int) -> tuple[Run, Fitted]:
    """The study's last model on its record, ready for refits; DataError for an abstained study."""
    if not study.steps or not study.steps[-1].model:
        raise DataError("the study abstained, so there is no model to work on", study.verdict.reason)
    piece, _ = described(loop, study.steps[-1].model)
    model, values = rebuild_model(piece, study.steps[-1].model)
    options = Options(law=model.spec.law, seed=seed)
    run = Run(piece, find_range(piece), options, law=model.spec.law, rng=np.random.default_rng(seed),
              tell=lambda text, share: None)
    return run, as_it_stands(model, values)


def with_steps(study: Study, steps: tuple[Step, ...], after: Fitted) -> Study:
    """The study with new steps and one noise for all; main values and adequacy are those of the last step's fit."""
    if intervals_withheld(study.steps):
        steps = without_intervals(steps)
    steps = with_one_noise(steps)
    holds, why = adequate(steps[-1])
    # The best model that holds these effects is now the last step.
    rows = tuple(replace(c, rmse=steps[-1].error.rmse) if c.effect in steps[-1].effects else c
                 for c in study.candidates)
    return replace(study, steps=steps, estimate=estimate(study, after), adequate=holds, adequate_reason=why,
                   missing=(), candidates=rows)


def with_noise_of(study: Study, found: Scored) -> Study:
    """The study whose noise is bounded by the innovations of a search's answer, too, and judged by it."""
    steps = with_one_noise(study.steps, found.done.innovation_sd)
    if steps == study.steps:
        return study
    holds, why = adequate(steps[-1])
    return replace(study, steps=steps, adequate=holds, adequate_reason=why)


def estimate(study: Study, fit: Fitted) -> Estimate | None:
    """The study's main values after a refit."""
    if study.estimate is None:
        return None
    v = fit.best.values
    if intervals_withheld(study.steps):
        fit = replace(fit, intervals={})
    spans = fit.intervals
    found = replace(study.estimate, S=v["S"], J=v["J"], S_interval=spans.get("S"), J_interval=spans.get("J"),
                    initial_residual_force=v["initial_residual_force"], **process_numbers(fit))
    return with_ranges(found, study.steps)


def reaching_to(found: Estimate, reach: Mapping[str, tuple[float, float]]) -> Estimate:
    """The estimate with intervals of S and J that reach to those of the models that explain the record alike."""
    if not reach:
        return found
    return replace(found, S_interval=_union(found.S_interval, reach["S"]),
                   J_interval=_union(found.J_interval, reach["J"]))


def _union(span: tuple[float, float] | None, other: tuple[float, float]) -> tuple[float, float] | None:
    return None if span is None else (min(span[0], other[0]), max(span[1], other[1]))


def intervals_withheld(steps: Iterable[Step]) -> bool:
    """True where a finding of some step withholds the intervals (`no_intervals` in its evidence)."""
    return any(finding.evidence.get("no_intervals") for step in steps for finding in step.findings)


def with_ranges(found: Estimate, steps: Iterable[Step]) -> Estimate:
    """The estimate with the ranges of S and J that a finding states, and its own values, as intervals.

    The evidence holds `S_range`, `J_range`, and the share of S by which they become `wider`.
    """
    said = next((f.evidence for step in steps for f in step.findings if "S_range" in f.evidence), None)
    if said is None:
        return found
    S, J = ((max(min(said[name][0], value) - said["wider"] * found.S, 0.0),
             max(said[name][1], value) + said["wider"] * found.S)
            for name, value in (("S_range", found.S), ("J_range", found.J)))
    return replace(found, S_interval=S, J_interval=J)


def without_intervals(steps: Iterable[Step]) -> tuple[Step, ...]:
    """The steps with no interval of any number."""
    return tuple(replace(step, parameters=tuple(replace(p, interval=None) for p in step.parameters)) for step in steps)
