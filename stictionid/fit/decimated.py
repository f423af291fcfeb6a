"""Command rebuilt at the scans of a controller that ran faster than the export: search, findings and refusal.

Source: docs/details.md, section 6.4.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..errors import CannotTell, UsageError
from ..model.spec import Evaluated, Spec
from ..process.rounded import step_of
from ..process.scan import DECIMATED, parts_of, pi_law
from ..record.loop import Finding
from ..record.preconditions import SAMPLES_PER_PERIOD
from ..typing import FloatArray
from .context import Run, level_holdout
from .fit import held_out_error, one_run
from .points.fitted import Fitted, as_it_stands
from .points.moves import descend_model, with_start
from .starts.intersample import QUICK_SETTLE, QUICK_TURNS

# Noise of the scans in between, as a share of the pace of the output, beyond which S and J by the law come out wrong.
# Measured with every third to tenth of the 1 s scans exported: up to 0.3 S within 3 %, from 0.4 on off by 10 to 20 %.
# Unit: 1.
CHATTER, SCANS_UNKNOWN = 0.35, 3
# Code of the finding on a command that was rebuilt.
SCANS = "scans-between-samples"
# Searches with the course of y between samples taken from the one before. Measured on loops with a 1 s scan exported
# every 5 s: S off by up to 5, 3 and 0.5 % with none, one and two; every 10 s, J by up to 40, 8 and 3 %.
_GUIDED = 2
# Stickbands tried with a dead time that is a scan longer or shorter, as shares of the one found. Unit: 1.
_NEAR_S = np.linspace(0.95, 1.05, 81)


@dataclass(frozen=True, slots=True)
class Rebuilt:
    """One search with a rebuilt command: its point of the unit cube (d,), its cost and its curves."""

    spec: Spec
    point: FloatArray
    cost: float
    evaluated: Evaluated | None

    def fit(self, run: Run) -> Fitted:
        """The search's point, ready for refits."""
        assert self.evaluated is not None
        model = run.model(self.spec)
        return as_it_stands(model, model.vector(self.evaluated.values))

    def finished(self, run: Run) -> Fitted:
        """The fit with restarts that agree, beginning with this search."""
        return run.fit(self.spec, before=(self.point[None], np.array([self.cost])))


def scans_of(run: Run) -> int:
    """The number of scans that `--between decimated` rebuilds in a sample; UsageError where there are none between."""
    scans = parts_of(run.loop.step_s, run.options.scan_s)
    if scans < 2:
        raise UsageError(f"--between decimated: the record's step of {run.loop.step_s:g} s is no slower than the "
                         f"controller's scan of {run.options.scan_s:g} s",
                         "leave --between out, or give the scan with --scan SECONDS")
    return scans


def scanned(run: Run, spec: Spec) -> Rebuilt:
    """The search with the command rebuilt at the scans, twice more with the course of y that it found in between."""
    tried = _first(run, spec)
    if len(run.loop.starts) > 1:
        return tried  # a guide belongs to one stretch
    for _ in range(_GUIDED):
        if tried.evaluated is None:
            break
        model = run.model(tried.spec)
        guide = model.guide(model.vector(tried.evaluated.values))
        tried = _first(run, replace(tried.spec, guides=(*tried.spec.guides, guide)), tried.point)
    return tried if tried.evaluated is None else _beside(run, tried)


def _first(run: Run, spec: Spec, known: FloatArray | None = None) -> Rebuilt:
    """One search from the basins; a `known` point (d,) of a similar model is polished beside it."""
    model = run.model(spec)
    point, cost = one_run(model, run.rng, None, run.basins(spec))
    if known is not None:
        again = descend_model(model, with_start(model, known[None]))
        if again.costs[0] < cost:
            point, cost = again.points[0], float(again.costs[0])
    e = model.evaluate(model.values(point[None])[:, 0]) if np.isfinite(cost) else None
    return Rebuilt(spec, point, cost, e)


def _beside(run: Run, tried: Rebuilt) -> Rebuilt:
    """A search with a guide, or a better one a scan of dead time away with the course of y that belongs there.

    With the guide of a wrong dead time the wrong one stays the best.
    """
    best, model = tried, run.model(tried.spec)
    values = model.values(tried.point[None]).repeat(_NEAR_S.size, axis=1)
    values[0] *= _NEAR_S
    values[1] *= _NEAR_S
    for scans in (-1, 1):
        near = values.copy()
        near[4] = np.maximum(near[4] + scans * model.step_s / model.spec.substeps, 0.0)
        cube = model.cube(near)
        point, there, spec = cube[model.costs(cube).argmin()], model, tried.spec
        for _ in range(_GUIDED):
            guide = there.guide(there.values(point[None])[:, 0])
            spec = replace(spec, guides=(*spec.guides[:-1], guide))
            there = run.model(spec)
            found = descend_model(there, with_start(there, point[None]), turns=QUICK_TURNS, settle=QUICK_SETTLE)
            point, cost = found.points[0], float(found.costs[0])
        if cost < best.cost:
            best = Rebuilt(spec, point, cost, there.evaluate(there.values(point[None])[:, 0]))
    return best


def held_out(run: Run, fit: Fitted) -> float:
    """Held-out error of a fit in the unit of y; the free-run error where no block could be held out."""
    error = held_out_error(fit.model, fit.model.cube(fit.values[:, None])[0], run.rng)
    level = level_holdout(replace(fit, rmse_holdout=error))
    return fit.best.rmse if level is None else level


def said_scans(run: Run, scans: int, errors: tuple[float, float] | None = None) -> Finding:
    """The finding on a command rebuilt at `scans` scans a sample; `errors` are held out, with it and before."""
    law, step = pi_law(run.loop, scans), run.loop.step_s
    how = ("its corners, because r and y do not give its PI law" if law is None else
           f"the PI law read from r, y and u (gain {law.gain:.3g}, integral time "
           f"{law.gain / law.per_scan * step / scans:.3g} s)")
    why = "" if errors is None else f"; that lowers the held-out error from {errors[1]:.4g} to {errors[0]:.4g}"
    return Finding(SCANS, "info",
                   f"the controller is taken to scan every {step / scans:.3g} s and the export to keep one scan in "
                   f"{scans}: the output in between is rebuilt from {how}{why}",
                   {"scans": scans, "scan_s": step / scans, "gain": law.gain if law else None,
                    "integral_time_s": law.gain / law.per_scan * step / scans if law else None}, (),
                   "docs/details.md, section 6.4")


def chatter(run: Run, e: Evaluated | None, scans: int) -> float:
    """The noise of u from scan to scan as a share of the pace of u; 0 where that can be rebuilt.

    Every second scan exported tells the one in between, noise and all, as far as u and y are not rounded.
    """
    law = pi_law(run.loop, scans)
    floor = run.floor(e.position_means, e.values["dead_time_s"]) if e is not None else None
    pace = float(np.median(np.abs(np.diff(run.loop.output[run.loop.driven])))) / scans
    if law is None or floor is None or not pace > 0.0:
        return 0.0
    told = 0.0
    if scans < SCANS_UNKNOWN:
        rounding = np.hypot(step_of(run.loop.output), law.gain * step_of(run.loop.process_value)) / np.sqrt(6.0)
        told = 1.0 / (1.0 + (float(rounding) / (abs(law.per_scan) * floor))**2) if law.per_scan else 0.0
    return abs(law.gain) * floor / pace * float(np.sqrt(1.0 - told))


def said_chatter(run: Run, scans: int, share: float) -> Finding:
    """The finding on scans between the samples that nothing can rebuild, for a model by its law alone."""
    return Finding("scans-too-noisy", "warning",
                   f"if the controller scans every {run.loop.step_s / scans:.3g} s, one scan in {scans} was exported; "
                   f"in between, noise moves the output {share:.2g} times as far as it goes anyway: the valve stops "
                   "and starts unseen: J is hardly known; intervals would only say how well the samples fit, so none "
                   "are given", {"scans": scans, "noise_to_pace": share, "limit": CHATTER}, (),
                   "benchmarks/slow_exports.py", no_intervals=True)


def said_unseen(run: Run, words: str) -> Finding:
    """The finding on an output that moved between the samples, in `words`; intervals would not hold."""
    return Finding("scans-unseen", "warning", f"{words}; intervals would only say how well the samples fit, so none "
                   "are given", {"step_s": run.loop.step_s, "scan_s": run.options.scan_s}, (), "benchmarks/plants",
                   no_intervals=True)


def check_scans(run: Run, fit: Fitted) -> None:
    """CannotTell where the valve of a rebuilt command moves so often between samples that they can't show how.

    Along a path the noise of unseen scans is part of the likelihood, so that it is no obstacle but to a base alone.
    """
    model = fit.model
    if model.spec.between != DECIMATED:
        return
    scans, values = model.spec.substeps, fit.values
    share = chatter(run, fit.best, scans)
    if share > CHATTER and scans >= SCANS_UNKNOWN and run.options.base_only:
        raise CannotTell(
            f"the valve moves several times between samples: noise moves the output {share:.2g} times as far from "
            f"scan to scan as it goes anyway ({CHATTER:g} is the most), and one scan in {scans} was exported",
            f"export at {2.0 * run.loop.step_s / scans:.3g} s or faster", code="moves-between-samples")
    moves = np.sign(np.diff(model.positions(values[:, None])[:, 0]))
    moves = moves[moves != 0]
    turns = int((moves[1:] != moves[:-1]).sum())
    per = 2.0 * run.loop.samples / max(turns, 1)
    if per < SAMPLES_PER_PERIOD:
        raise CannotTell(
            f"the valve moves between samples: it turns every {0.5 * per:.1f} samples of {run.loop.step_s:g} s, "
            f"{per:.1f} samples a period where {SAMPLES_PER_PERIOD} are needed",
            f"export at {per * run.loop.step_s / SAMPLES_PER_PERIOD:.3g} s or faster", code="moves-between-samples")
