"""The comparison of a model with a record: errors, findings, adequacy, and the curves behind them.

Free-run and one-step errors are reported with the error of the trivial predictor y(k) = y(k-1). A one-step fit hides
everything (docs/details.md, section 10); skill over persistence shows that. Source: docs/details.md, section 10.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import DataError
from ..fit.adequacy import ADEQUATE, NO_FLOOR, noise_floor
from ..fit.noise.completion import complete_quickly
from ..fit.noise.unexplained import judged_by, unexplained_shape
from ..model.restore import as_followed, described_segments
from ..numerics.autoregression import filter_residual
from ..numerics.noise.normal import POINT_99
from ..record.loop import Finding, Loop
from ..record.oscillation import find_range
from ..record.segments import chosen
from ..record.study import Study
from ..record.unexplained import Unexplained
from .cells import Cell
from .matches import matches
from .model_run import Ground, impulse_of, prepare
from .questions import QUESTIONS
from .residual_tests import Spectra, follows_valve, frequencies, own_innovation, whiteness
from .suspects import Suspect, suspects_of
from .validate import rebuilt, transferred

# Multiple of the noise up to which a model holds on another record. S is known to one step of the command only, so that
# single slips may come a sample early or late there.
TRANSFERS = 1.5


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors in the unit of y; skills are shares of the persistence error's square that the model removes."""

    rmse: float
    rmse_holdout: float | None
    rmse_one_step: float
    rmse_one_step_holdout: float | None
    rmse_h_step: float
    h_steps: int
    noise_sd: float | None
    fit_percent: float | None
    persistence: float
    skill: float | None
    rows: int
    effective_rows: float


@dataclass(frozen=True, slots=True)
class Comparison:
    """Result of `compare`. `tables` hold every question's cells; `ground` the arrays, for pictures and series.

    `unexplained` is the shape of what the model misses, None where that is next to nothing. `suspects` are the effects
    that all findings together point to, best first.
    """

    error: Errors
    findings: tuple[Finding, ...]
    adequate: bool
    adequate_reason: str
    tables: dict[str, tuple[Cell, ...]]
    spectra: Spectra
    notes: tuple[Finding, ...]
    validates: bool
    ground: Ground = field(repr=False)
    unexplained: Unexplained | None = None
    suspects: tuple[Suspect, ...] = ()


def compare(loop: Loop | None, study: Study, other: Loop | None = None) -> Comparison:
    """The study's last model against its record, or against `other` with S, J and process held.

    `loop` may be None only with `other`; the gain is then refitted. Raises DataError for an abstained study, or where
    the model cannot run on the other record.
    """
    if not study.steps or not study.steps[-1].model:
        raise DataError("the study abstained, so there is no model to compare", study.verdict.reason)
    description = study.steps[-1].model
    piece = described_segments(loop, description)[0] if loop is not None else None
    notes: tuple[Finding, ...] = ()
    if other is None:
        if piece is None:
            raise DataError("there is no record to compare with", "give the data file of the study")
        model, evaluated = rebuilt(piece, description)
        ground = prepare(piece, model, study.range, evaluated)
    else:
        second = as_followed(chosen(other)[0], description)
        model, evaluated, notes = transferred(second, description, piece)
        ground = prepare(second, model, find_range(second), evaluated)
    answers = [ask(ground) for ask in QUESTIONS]
    rho, coloured = whiteness(ground)
    cross, follows = follows_valve(ground)
    bands, line = frequencies(ground)
    # Correlations from one PV to the next stand at the lags in samples that they mean.
    at = np.round(ground.pace * np.arange(1, rho.size + 1)).astype(int) - 1
    lags = max(int(at[-1]) + 1, cross.size - 1)
    spaced = np.zeros(lags)
    spaced[at] = rho
    cross = np.concatenate([cross[1:], np.zeros(lags + 1 - cross.size)])
    spectra = Spectra(np.asarray(ground.step_s * np.arange(1, lags + 1), np.float64), spaced, cross,
                      POINT_99 / float(np.sqrt(max(ground.good.sum(), 1))), bands)
    clues = [c for _, _, c in answers] + [coloured, follows, line]
    order = {"serious": 0, "warning": 1, "info": 2}
    found = sorted((c for c in clues if c is not None), key=lambda c: order[c.finding.severity])
    errors = _errors(ground, study, own=other is None)
    adequate, why = _adequate(errors, study, other is None)
    shape = None if other is not None else _shape(ground, study)
    adequate, why = judged_by(shape, adequate, why)
    at_noise = errors.noise_sd is not None and errors.rmse <= ADEQUATE * errors.noise_sd
    matched = () if other is not None or at_noise else matches(ground)
    tables = {name: cells for name, cells, _ in answers}
    return Comparison(errors, tuple(c.finding for c in found), adequate, why, tables, spectra, notes,
                      other is not None, ground, shape,
                      suspects_of(found, ground.model.spec.effects, study.candidates, matched))


def _shape(ground: Ground, study: Study) -> Unexplained | None:
    """The shape of what the study's model misses, as the study holds it; worked out for a study of an older version."""
    if study.unexplained is not None or study.missing_reason:
        return study.unexplained
    return unexplained_shape(complete_quickly(ground.model, ground.model.vector(ground.evaluated.values)))


def _errors(ground: Ground, study: Study, *, own: bool) -> Errors:
    e, good = own_innovation(ground)
    y = np.where(np.isfinite(ground.loop.process_value), ground.loop.process_value, 0.0)
    steps, pairs = filter_residual(y, ground.good, np.array([1.0, -1.0]), ground.loop.starts)
    steps = steps[pairs]
    persistence = float(np.sqrt(np.mean(steps**2))) if steps.size else 0.0
    used = y[ground.good]
    spread = float(used.std())
    last = study.steps[-1].error
    ahead = float(np.sqrt(np.mean(e[good] ** 2))) if good.any() else 0.0
    free, one_step = (last.best, last.rmse_one_step or ahead) if own else (ground.rmse, ahead)
    h = max(1, round(ground.evaluated.values["time_constant_s"] / (ground.step_s * ground.pace)))
    floor = last.noise_sd if own else noise_floor(ground.loop, ground.evaluated.position_means, ground.good,
                                                  ground.evaluated.values["dead_time_s"])
    return Errors(
        free, last.rmse_holdout if own else None, one_step, last.rmse_one_step_holdout if own else None,
        _h_step(ground, h), h, floor, 100.0 * (1.0 - ground.rmse / spread) if spread else None, persistence,
        1.0 - (one_step / persistence) ** 2 if persistence else None, int(ground.good.sum()), ground.effective_rows)


def _h_step(ground: Ground, h: int) -> float:
    """Error h samples ahead: the free run plus the part of the residual that the noise model still predicts."""
    taps = ground.model.taps
    if taps.size == 0:
        return ground.rmse
    response = impulse_of(taps, h)
    innovation = ground.innovation if ground.pace == 1.0 else ground.innovation[ground.good]
    ahead = np.convolve(innovation, response)[:innovation.size]
    sure = innovation != 0.0
    sure[:h] = False
    return float(np.sqrt(np.mean(ahead[sure] ** 2))) if sure.any() else ground.rmse


def _adequate(errors: Errors, study: Study, own: bool) -> tuple[bool, str]:
    if own and study.adequate is not None:
        return study.adequate, study.adequate_reason
    if errors.noise_sd is None:
        return False, NO_FLOOR
    ratio = errors.rmse / errors.noise_sd
    if ratio <= (ADEQUATE if own else TRANSFERS):
        return True, (f"the free-run error {errors.rmse:.4g} on this record is {ratio:.3g} times its irreducible "
                      f"noise {errors.noise_sd:.4g} (at most {ADEQUATE if own else TRANSFERS:g}): the model holds")
    return False, (f"the free-run error {errors.rmse:.4g} on this record is {ratio:.3g} times its irreducible noise "
                   f"{errors.noise_sd:.4g}: the model does not hold here")
