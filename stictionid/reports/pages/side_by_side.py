"""Two studies side by side in words: sentence and tables; the picture overlays or stacks their curves."""

from __future__ import annotations

from ...comparison.side_by_side import Beside, SideBySide
from .. import wording
from ..document import PageTable
from ..pictures import study_pictures
from ..pictures.curves import Case
from ..pictures.picture import Panel, Picture

_ERRORS = (("free-run error", "rmse"), ("held out", "rmse_holdout"), ("one-step error", "rmse_one_step"),
           ("irreducible noise", "noise_sd"), ("fit, %", "fit_percent"))
_AGREE = {True: "agree", False: "differ", None: wording.NOTHING}


def tables(s: SideBySide) -> tuple[PageTable, PageTable]:
    """Errors and parameters, a column for each study."""
    heads = _heads(s)
    errors = tuple((label, *(wording.number(getattr(e, field)) if e is not None else wording.NOTHING
                             for e in s.errors)) for label, field in _ERRORS)
    effects = ("effects", *(", ".join(map(wording.name, e)) or "none" for e in s.effects))
    return (PageTable("Errors", ("error", *heads), (effects, *errors), (1, 2)),
            PageTable("Parameters", ("parameter", *heads, "unit", "intervals"), tuple(map(_row, s.parameters)), (1, 2)))


def _heads(s: SideBySide) -> tuple[str, str]:
    """Names of the two studies, told apart where they are one name."""
    a, b = map(wording.name, s.names)
    return (a, b) if a != b else (f"{a}, first", f"{b}, second")


def _row(p: Beside) -> tuple[str, ...]:
    name = wording.name(p.name if p.effect is None else f"{p.effect}: {p.name}")
    shown = (wording.NOTHING if v is None else wording.estimate(v, span, "")
             for v, span in zip(p.values, p.intervals, strict=True))
    return name, *shown, wording.name(p.unit), _AGREE[p.agree]


def picture(s: SideBySide, cases: tuple[Case, Case]) -> Picture | None:
    """PV and free run of both studies over the same window; None without curves."""
    if any(c.loop is None or not c.curves for c in cases):
        return None
    panels = []
    for head, case in zip(_heads(s), cases, strict=True):
        loop, last = case.loop, case.curves[-1]
        assert loop is not None
        part = study_pictures.window(case.study, loop)
        t = loop.time_s[part]
        error = case.study.steps[-1].error.best
        panels.append(Panel("time, s", study_pictures.axis_label("PV", loop, "process_value"), (
            study_pictures.thin_line("PV", "pv", t, loop.process_value[part]),
            study_pictures.thin_line(f"{head}: error {wording.number(error)}", "model", t, last.model[part])),
            height=0.7))
    same = "the same record" if s.same_record else "two records"
    return Picture("side_by_side", "Side by side", f"{wording.sentence(s.statement)}",
                   f"Measured PV and free run of both studies, of {same}.", tuple(panels), wide=True)
