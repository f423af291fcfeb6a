"""Two studies side by side: two models of one record, or two records of one loop.

Errors are compared on one record only; parameters by their intervals. Wrong where two records were made under other
conditions: then S and J may differ without any fault.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..record.study import ErrorSummary, ParameterValue, Study

# Share by which the held-out error of one model must be lower to count as better. Unit: 1.
_BETTER = 0.01
_Span = tuple[float, float] | None


@dataclass(frozen=True, slots=True)
class Beside:
    """One parameter of two studies; `agree` is true where the intervals overlap, null where they can't be compared."""

    effect: str | None
    name: str
    unit: str
    values: tuple[float | None, float | None]
    intervals: tuple[_Span, _Span]
    agree: bool | None


@dataclass(frozen=True, slots=True)
class SideBySide:
    """Errors and parameters of two studies; `better` is the index of the model that explains one record better."""

    same_record: bool
    names: tuple[str, str]
    effects: tuple[tuple[str, ...], tuple[str, ...]]
    errors: tuple[ErrorSummary | None, ErrorSummary | None]
    parameters: tuple[Beside, ...]
    better: int | None
    statement: str


def side_by_side(a: Study, b: Study) -> SideBySide:
    """The last models of two studies; an abstained study has neither errors nor parameters."""
    studies = (a, b)
    same = a.data.sha256 is not None and a.data.sha256 == b.data.sha256 and (a.data.rows_used == b.data.rows_used)
    last = tuple(s.steps[-1] if s.steps else None for s in studies)
    effects = tuple(step.effects if step else () for step in last)
    errors = tuple(step.error if step else None for step in last)
    rows = tuple({(p.effect, p.name): p for p in step.parameters} if step else {} for step in last)
    parameters = tuple(_beside(rows[0].get(k), rows[1].get(k)) for k in dict.fromkeys((*rows[0], *rows[1])))
    better = _better(errors[0], errors[1]) if same else None
    return SideBySide(same, (a.data.name, b.data.name), (effects[0], effects[1]), (errors[0], errors[1]), parameters,
                      better, _statement(same, better, errors[0], errors[1], parameters))


def _beside(a: ParameterValue | None, b: ParameterValue | None) -> Beside:
    known = a or b
    assert known is not None
    spans = (a.interval if a else None, b.interval if b else None)
    agree = None
    if a is not None and b is not None and spans[0] is not None and spans[1] is not None:
        agree = max(spans[0][0], spans[1][0]) <= min(spans[0][1], spans[1][1])
    return Beside(known.effect, known.name, known.unit, (a.value if a else None, b.value if b else None), spans, agree)


def _better(a: ErrorSummary | None, b: ErrorSummary | None) -> int | None:
    """The model with the lower held-out error, or the lower error where none was held out; None where they tie."""
    if a is None or b is None:
        return None
    both = ((a.rmse_holdout, b.rmse_holdout), (a.best, b.best))
    first, second = next((x, y) for x, y in both if x is not None and y is not None)
    if abs(first - second) <= _BETTER * max(first, second):
        return None
    return 0 if first < second else 1


def _statement(same: bool, better: int | None, a: ErrorSummary | None, b: ErrorSummary | None,
               parameters: tuple[Beside, ...]) -> str:
    if a is None or b is None:
        return "one of the studies has no model, because its record can't tell"
    if same:
        change = f"the free-run error is {a.best:.4g} and {b.best:.4g}"
        if a.rmse_holdout is not None and b.rmse_holdout is not None:
            change += f", held out {a.rmse_holdout:.4g} and {b.rmse_holdout:.4g}"
        word = "both models explain the record alike" if better is None else \
            f"the {('first', 'second')[better]} model explains the record better"
        return f"{word}: {change}"
    differ = [p.name for p in parameters if p.effect is None and p.agree is False]
    compared = sum(p.agree is not None for p in parameters)
    if not compared:
        return "two records: no parameter has an interval in both"
    if not differ:
        return "two records: every parameter with intervals agrees"
    return f"two records: {', '.join(differ)} differ by more than their intervals"
