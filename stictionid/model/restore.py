"""Stored model: rebuilt from its description in a study and run once over its record, without a search."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np

from .. import effects as effect_room
from .. import laws as law_room
from ..errors import DataError, UsageError
from ..process.controller_law import rebuild_output
from ..process.rounded import measured_rows
from ..record.controller import FULL
from ..record.loop import Loop
from ..record.segments import fitted_segments
from ..typing import FloatArray
from .model import Model
from .segments import bind_model
from .slips import paths_from
from .spec import FIRST_ORDER, INTEGRATOR, Curves, Spec

# Largest number of parts of a sampling interval, largest number of noise terms, and largest value, taken from a study.
# Searches stay below them; with them a study edited by hand can't fill memory or leave an array.
_MOST_PARTS, _MOST_TAPS, _LARGEST = 64, 1000, 1e15
_NUMBERS = (int, float, np.integer, np.floating)


def _check(loop: Loop, description: dict[str, Any]) -> None:
    """DataError for a description that no search writes: compiled code, which runs the model, checks no limits."""
    def refuse(words: str) -> NoReturn:
        raise DataError(f"the study's model can't be rebuilt: {words}", "run stictionid identify again")

    def within(name: str, value: Any, low: float, high: float) -> None:
        if isinstance(value, bool) or not isinstance(value, _NUMBERS) or not low <= value <= high:
            refuse(f"{name} is {value!r:.40}, not a number from {low:g} to {high:g}")

    effects = description["effects"]
    if description["process"] not in (FIRST_ORDER, INTEGRATOR):
        refuse(f"the process is {description['process']!r:.40}, not {FIRST_ORDER} or {INTEGRATOR}")
    if len(set(effects)) != len(effects):
        refuse("an effect is in it twice")
    within("substeps", description["substeps"], 1, _MOST_PARTS)
    within("the number of taps", len(description["taps"]), 0, _MOST_TAPS)
    positive, force = (1.0 / _LARGEST, _LARGEST), "initial_residual_force"
    limits = {"time_constant_s": positive, "dead_time_s": (0.0, loop.samples * loop.step_s), "S": (0.0, _LARGEST),
              "J": (0.0, _LARGEST), "period_s": positive, "s_max": (0.0, _LARGEST)}
    for name, value in {**description["values"], **{k: description[k] for k in ("period_s", "s_max")}}.items():
        within(name, value, *(-1.001, 1.001) if name.startswith(force) else limits.get(name, (-_LARGEST, _LARGEST)))
    for value in (*description["taps"], *dict(description["fixed"]).values()):
        within("a tap or a fixed value", value, -_LARGEST, _LARGEST)


def unknown_code(description: dict[str, Any]) -> str:
    """Words on the user-written effects and law of a model that are not loaded, or have changed since; empty where all
    are as they were."""
    known, of_law = description.get("written"), description.get("written_law")
    written: list[tuple[str, str, Mapping[str, Any], Any]] = []
    if isinstance(known, dict):
        written += [("effect", name, effect_room.catalogue(), of) for name, of in known.items()]
    if isinstance(of_law, dict):
        written.append(("law", description["law"], law_room.catalogue(), of_law))
    for word, name, room, of in written:
        have = room.get(name)
        if have is None:
            return f"the study holds the {word} {name} of {of.get('file', '')}, which is not loaded"
        if have.sha256 != of.get("sha256", ""):
            return f"{have.file or name} has changed since the study was made (the sha256 of {word} {name} differs)"
    return ""


def rebuild_model(loop: Loop, description: dict[str, Any]) -> tuple[Model, FloatArray]:
    """Model and values (d,) from the output of `describe`; DataError where an entry is missing or impossible."""
    try:
        if words := unknown_code(description):
            raise DataError(words, "give the file as it was after --effects or --laws, or run stictionid identify "
                                   "again")
        _check(loop, description)
        spec = Spec(description["law"], description["process"], tuple(description["effects"]),
                    description["between"], int(description["substeps"]), bool(description["increments"]),
                    tuple(description["taps"]), dict(description["fixed"]),
                    bool(description.get("friction_free", False)), tuple(description.get("guides", ())),
                    paths_from(description["paths"]) if "paths" in description else None)
        if spec.paths is not None and len(spec.paths.slips) != len(loop.starts):
            raise ValueError(f"its path has {len(spec.paths.slips)} segments, the record {len(loop.starts)}")
        model = bind_model(loop, spec, s_max=description["s_max"], period_s=description["period_s"])
        return model, model.vector(description["values"])
    except UsageError as error:
        # An unknown law, effect or mode between samples is a fault of the study, not of the command line.
        raise DataError(f"the study's model can't be rebuilt: {error.message}", error.hint) from None
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise DataError(f"the study's model can't be rebuilt: {error}", "run stictionid identify again") from None


def described_segments(loop: Loop, description: Mapping[str, Any]) -> tuple[Loop, tuple[slice, ...]]:
    """Segments of a record that a described model was fitted to, with the command that its valve follows, and their
    positions in the record.

    DataError where the record does not have them.
    """
    piece, rows = fitted_segments(loop, description)
    return as_followed(piece, description), rows


def as_followed(piece: Loop, description: Mapping[str, Any]) -> Loop:
    """Segments of a record with the command that a described model's valve follows, and the process values measured.
    """
    command = str(description.get("command", ""))
    return measured_rows(rebuild_output(piece) if command == FULL else replace(piece, followed=command))


def rerun(loop: Loop, description: dict[str, Any]) -> Curves:
    """Run a described model over its record once, without any search.

    NaN in segments that the model was not fitted to, and before the first sample that counts in each of the others.
    """
    piece, rows = described_segments(loop, description)
    model, values = rebuild_model(piece, description)
    e = model.evaluate(values)
    start = model.starting()

    def shown(curve: FloatArray, *, hide: bool = True) -> FloatArray:
        curve = np.where(start, np.nan, curve) if hide else curve
        if piece.samples == loop.samples:
            return curve
        whole = np.full(loop.samples, np.nan)
        whole[np.concatenate([np.arange(p.start, p.stop) for p in rows])] = curve
        return whole

    return Curves(loop.output, shown(e.model), shown(e.residual), shown(e.stem, hide=False), shown(e.innovation))
