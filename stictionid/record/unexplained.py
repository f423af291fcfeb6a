"""Shape of the residual that the best model leaves: where it answers the valve, the signals or time, in numbers.

Source: docs/details.md, sections 10 and 11; Ljung, System Identification, section 16.6 (residual analysis).
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Curve:
    """One curve of a residual with its 99 % bounds, equally many values in each list; `low` and `high` are pointwise.

    `at` is a lag or a time in s, or a process value.
    """

    at: tuple[float, ...]
    value: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Answer:
    """One joint test: the share of the innovations' variance that past values of `to` explain, and its normal value."""

    to: str
    share: float
    z: float


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The residual of the best model, as numbers and in one sentence.

    `named` is the answer that explains most, and `suggests` names the effects that would leave it. `impulse` is the
    response of the residual to the valve position, in the unit of y per % and sample. `step`, `opening` and `closing`
    are responses to a move of the valve of 1 %, to all moves or to those of one direction. `by_value` and `by_time` are
    levels of the residual. A row of `spectrum` is a band: period from and to in s, share of the power, share of lines.
    """

    named: str
    statement: str
    suggests: tuple[str, ...]
    answers: tuple[Answer, ...]
    impulse: Curve
    step: Curve
    opening: Curve
    closing: Curve
    by_value: Curve
    by_time: Curve
    spectrum: tuple[tuple[float, float, float, float], ...]
