"""Long records: searched where the valve turns most often, polished on a longer stretch, judged on all samples.

A search runs some ten thousand valves. A few dozen reversals are enough to show the basin and the process. A long
record is therefore searched on the stretch with most reversals. The parameters are polished, with their intervals, on a
longer one. The start of the record, the levels and the errors are those of all samples. The finding
`searched-on-excerpt` says which samples were used for what. It warns where the whole record is explained worse than its
stretch.

Wrong where the loop changed on the way (another valve, another tuning): the stretch is then one of two loops, and the
warning comes. Effects that run by the clock need the whole clock: with one of them nothing is left out. Source:
docs/details.md, section 6.6.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..effects import parse
from ..fit.context import Run
from ..fit.fit import finish_fit
from ..fit.intervals.assemble import include_answer
from ..fit.points.fitted import Fitted
from ..fit.points.moves import with_start
from ..methods.contract import Outcome
from ..model.model import Model
from ..model.segments import bind_model
from ..options import Options
from ..record.loop import Finding, Loop
from ..record.oscillation import noise_of, reversals
from ..record.study import Range, Step
from ..typing import FloatArray

# Samples that are searched. Rows of the valve's path that are polished (parts of samples where the command moves
# between them). Fewest periods of a search.
SEARCHED, POLISHED, PERIODS = 10_000, 100_000, 30.0
# The output turns where it comes back by this share of its span, or this multiple of its noise.
_TURN, _TURN_NOISE = 0.1, 4.0
# Break-aways tried on all samples.
_BREAKS = 31
# Factor on the error of the stretch above which the error of the whole record is a warning.
_WORSE = 1.25


@dataclass(frozen=True, slots=True)
class Excerpt:
    """The samples of a long record that are searched, and the reversals (m,) of its output."""

    whole: Loop
    searched: slice
    turns: FloatArray

    @property
    def loop(self) -> Loop:
        """The searched samples as a loop of their own."""
        return self.whole.cut(self.searched.start, self.searched.stop)

    def polished(self, parts: int) -> slice:
        """The samples for the polish of a model with so many parts a sample; the searched ones where more is useless.
        """
        rows, searched = POLISHED // parts, self.searched.stop - self.searched.start
        return self.searched if rows < 2 * searched else _richest(self.whole, self.turns, rows, self.searched)

    def count(self, part: slice) -> int:
        """Reversals of the output within `part`."""
        return int(np.diff(np.searchsorted(self.turns, [part.start, part.stop]))[0])


def excerpt(loop: Loop, found: Range, options: Options) -> Excerpt | None:
    """The stretch of a record that is too long to be searched whole; None for one that is not."""
    period = (found.period_median_s or 0.0) / loop.step_s
    rows = max(SEARCHED, int(PERIODS * period))
    asked = [parse(name)[0] for name in options.effects]
    if loop.samples <= rows or any(effect.profile is not None or effect.kind == "L" for effect in asked):
        return None
    at = np.flatnonzero(loop.driven)
    u = loop.output[at]
    turns = at[reversals(u, max(_TURN * float(np.ptp(u)), _TURN_NOISE * noise_of(u)))].astype(np.float64)
    return Excerpt(loop, _richest(loop, turns, rows, None), turns)


def _richest(loop: Loop, turns: FloatArray, rows: int, around: slice | None) -> slice:
    """Samples of one segment, `rows` at the most and all of `around`, within which the output turns most often.

    Among equals the earliest is taken: one that begins with its segment or ends with a reversal.
    """
    best, most = slice(0, 0), (-1, 0)
    for part in loop.segments:
        low, high = part.start, max(part.start, part.stop - rows)
        if around is not None:
            if not part.start <= around.start < part.stop:
                continue
            low, high = max(low, around.stop - rows), min(high, around.start)
        starts = np.unique(np.concatenate([[low], np.clip(turns - rows + 1, low, high)])).astype(np.int64)
        ends = np.minimum(starts + rows, part.stop)
        counts = np.searchsorted(turns, ends) - np.searchsorted(turns, starts)
        i = int(np.argmax(counts))
        size = (int(counts[i]), int(ends[i] - starts[i]))
        if size > most:
            best, most = slice(int(starts[i]), int(ends[i])), size
    return best


def judged(view: Excerpt, run: Run, outcome: Outcome) -> tuple[Outcome, Finding]:
    """The outcome of the searched stretch, polished on the longer one and run over all samples; and the finding.

    `run` is that of the whole record. Intervals and held-out errors are those of the polished stretch, all other errors
    those of all samples. Entries that a method added to its step's model stay.
    """
    steps: list[Step] = []
    fits: list[Fitted] = []
    inside = 0.0
    for step, fit in zip(outcome.steps, outcome.fits, strict=True):
        run.tell("polishing on more of the record", 0.8)
        near = _polished(view, run, fit)
        inside = near.best.rmse
        fits.append(_on_all(run, near))
        now = run.step(fits[-1], step.added)
        steps.append(replace(now, findings=step.findings, model={**step.model, **now.model}))
    return replace(outcome, steps=tuple(steps), fits=tuple(fits)), _finding(view, fits[-1], inside)


def _polished(view: Excerpt, run: Run, fit: Fitted) -> Fitted:
    """A fit of the searched stretch, polished on a longer one; unchanged where the method gave no intervals."""
    rows = view.polished(fit.model.parts)
    if rows == view.searched or not fit.intervals:
        return fit
    model = bind_model(view.whole.cut(rows.start, rows.stop), fit.model.spec, s_max=run.s_max, period_s=run.period_s)
    point = with_start(model, model.cube(model.vector(fit.best.values)[:, None]))
    done = finish_fit(model, point, model.costs(point), run.rng)
    return replace(done, runs=fit.runs, agree=fit.agree, searched=fit.searched)


def _on_all(run: Run, fit: Fitted) -> Fitted:
    """The fit's valve and process run over all samples; the start of each segment is searched on its first rows."""
    loop, spec = run.loop, fit.model.spec
    model = run.model(spec)
    values = model.vector(fit.best.values)
    for segment, force in zip(loop.segments, model.forces, strict=True):
        head = loop.cut(segment.start, min(segment.stop, segment.start + SEARCHED))
        start = bind_model(head, spec, s_max=run.s_max, period_s=run.period_s)
        mine = start.cube(start.vector(fit.best.values)[:, None])
        values[force] = start.values(with_start(start, mine))[2, 0]
    if model.parts == 1:
        values = _broken_away(model, values, fit.intervals.get("S", (values[0], values[0])))
    best = model.evaluate(values)
    return replace(fit, model=model, values=values, sse=best.sse, best=best,
                   intervals=include_answer(fit.intervals, best))


def _broken_away(model: Model, values: FloatArray, within: tuple[float, float]) -> FloatArray:
    """Values (d,) with the break-away that fits all samples best, f_d unchanged, S within its interval.

    Under a held command more slips determine the break-away better. One that is exact on some slips is a sample early
    or late on others. Each of those would look like an error of the model.
    """
    shift = np.concatenate([[0.0], np.linspace(within[0], within[1], _BREAKS) - values[0]])
    trial = values[:, None].repeat(shift.size, axis=1)
    trial[0] += shift
    trial[1] = trial[0] if model.law.one_parameter else np.clip(trial[1] + shift, 0.0, 2.0 * trial[0])
    return trial[:, int(np.argmin(model.costs_of(trial)))]


def _finding(view: Excerpt, fit: Fitted, inside: float) -> Finding:
    whole, first, more = view.whole, view.searched, view.polished(fit.model.parts)
    worse = fit.best.rmse > _WORSE * inside
    said = (f"the record has {whole.samples:,} samples: S, J and the process were searched on samples {first.start:,} "
            f"to {first.stop:,} ({view.count(first):,} of {view.turns.size:,} reversals of the output) and polished, "
            f"with their intervals, on {more.start:,} to {more.stop:,}; the free-run error is {inside:.4g} there and "
            f"{fit.best.rmse:.4g} over all samples")
    if worse:
        said += ": the loop is not the same throughout; compare windows of it (stictionid agree, or --start and --end)"
    return Finding("searched-on-excerpt", "warning" if worse else "info", said,
                   {"samples": whole.samples, "searched": [first.start, first.stop],
                    "polished": [more.start, more.stop], "reversals": int(view.turns.size),
                    "reversals_searched": view.count(first), "rmse_polished": inside, "rmse": fit.best.rmse})


def looked_at(view: Excerpt) -> Finding:
    """The finding of a quick look, which polishes and judges nothing."""
    first = view.searched
    return Finding("searched-on-excerpt", "info",
                   f"of {view.whole.samples:,} samples, {first.start:,} to {first.stop:,} were looked at "
                   f"({view.count(first):,} of {len(view.turns):,} reversals of the output)",
                   {"samples": view.whole.samples, "searched": [first.start, first.stop],
                    "reversals": int(view.turns.size), "reversals_searched": view.count(first)})
