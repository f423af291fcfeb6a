"""Pictures of a study on matplotlib Axes: the same numbers and the same look as in a report, no global state."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import DataError
from ..record.study import Step
from ..record.study import Study as Record
from .loop import Loop, loop_in_file, loop_of
from .messages import speaking_python

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..model.spec import Curves
    from ..reports.pictures.picture import Picture


@dataclass(frozen=True)
class Plots:
    """Pictures of one study. Each method draws on `ax`, or on the axes of a new figure, and returns the axes.

    `loop` may be left out where the study still has it. A new figure is not registered with pyplot: `axes.figure` shows
    or saves it.
    """

    study: Record
    known: Loop | None = None

    @speaking_python
    def fit(self, loop: Loop | None = None, ax: Axes | None = None) -> Axes:
        """Measured process value and the free run of the last model; the residual in axes of its own below."""
        return _drawn(self._fit(loop), ax, "the model says nothing about this record")

    @speaking_python
    def residual(self, loop: Loop | None = None, ax: Axes | None = None) -> Axes:
        """Residual of the last model over time, with twice the noise either way."""
        whole = self._fit(loop)
        below = None if whole is None else replace(whole, key="residual", panels=whole.panels[1:])
        return _drawn(below, ax, "the model says nothing about this record")

    @speaking_python
    def ladder(self, ax: Axes | None = None) -> Axes:
        """Error after each added effect, beside the noise."""
        from ..reports.pictures.study_pictures import ladder

        return _drawn(ladder(self.study), ax, "the study has one model and no added effect",
                      "add effects with st.diagnose(study, loop, apply=True)")

    @speaking_python
    def valve(self, loop: Loop | None = None, ax: Axes | None = None) -> Axes:
        """Controller output against valve position, inferred and measured."""
        from ..reports.pictures.study_pictures import characteristic

        used = self._loop(loop)
        return _drawn(characteristic(self.study, used.record, self._curves(used)), ax,
                      "the model has no valve position on this record")

    @speaking_python
    def candidates(self, ax: Axes | None = None) -> Axes:
        """Drop of the one-step error by each effect that was asked for."""
        from ..reports.pictures.study_pictures import candidates

        return _drawn(candidates(self.study), ax, "the study has no candidates", "run st.diagnose(study, loop) first")

    @speaking_python
    def contributions(self, loop: Loop | None = None, ax: Axes | None = None) -> Axes:
        """Parts of the process value by valve, effects and noise, each with its share of the variance."""
        from ..reports.pictures.contribution_picture import contributions

        used = self._loop(loop)
        return _drawn(contributions(self.study, last_step(self.study), used.record), ax, "")

    @speaking_python
    def cost_map(self, ax: Axes | None = None) -> Axes:
        """Free-run error over S and J, with the optimum and its intervals."""
        from ..reports.pictures.study_pictures import cost_map

        return _drawn(cost_map(self.study), ax, "the study has no map of its cost", "run st.identify again")

    def _fit(self, loop: Loop | None) -> Picture | None:
        from ..reports.pictures.study_pictures import fit

        used = self._loop(loop)
        return fit(self.study, used.record, self._curves(used))

    def _loop(self, loop: Loop | None) -> Loop:
        return loop_for(self.study, loop, self.known)

    def _curves(self, loop: Loop) -> Curves:
        from ..model.restore import rerun

        return rerun(loop.record, last_step(self.study).model)


def last_step(study: Record) -> Step:
    """The last step of a study; DataError where it abstained and has no model."""
    if not study.steps or not study.steps[-1].model:
        raise DataError("the study abstained, so it has no model", study.verdict.reason)
    return study.steps[-1]


def loop_for(study: Record, loop: Any, known: Loop | None) -> Loop:
    """The loop given, else the one that the study still has, else the one in the study's file.

    Raises DataError where the loop is not the record of the study, UsageError where there is none.
    """
    if loop is None:
        return known if known is not None else loop_in_file(study)
    found = loop_of(loop)
    if not is_own(study, found, known):
        raise DataError(f"this loop ({found.name}, {found.samples} samples from {found.record.origin.start}) is not "
                        f"the record of the study ({study.data.name}, {study.data.rows} rows from {study.data.start})",
                        "give the loop that was identified; st.compare(study, loop) validates on another one")
    return found


def is_own(study: Record, loop: Loop, known: Loop | None) -> bool:
    """True where a loop is the record that a study was made from, by its samples, its file, or its extent."""
    if known is not None:
        return loop.record is known.record or (
            np.array_equal(loop.record.process_value, known.record.process_value, equal_nan=True)
            and np.array_equal(loop.record.output, known.record.output, equal_nan=True))
    origin, data = loop.record.origin, study.data
    if data.sha256 and origin.sha256:
        return data.sha256 == origin.sha256
    extent = (origin.rows or loop.samples, loop.step_s, origin.start, origin.end)
    return extent == (data.rows, data.step_s, data.start, data.end)


def _drawn(picture: Picture | None, ax: Axes | None, why: str, hint: str = "") -> Axes:
    """The picture on `ax`, or in a new figure of the size that the report gives it; DataError without a picture."""
    from ..reports.pictures.figures import draw, new_axes

    if picture is None:
        raise DataError(f"there is nothing to draw: {why}", hint)
    return draw(picture, new_axes(picture) if ax is None else ax)
