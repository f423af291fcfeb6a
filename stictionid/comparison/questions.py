"""Questions about the parts of a record where the model fails: each gives a table of cells and at most one finding.

A finding names the numbers it rests on and the effects of the catalogue that leave such a trace (docs/details.md,
section 10). Only a refit can tell which of these effects it is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from ..effects import leaving
from ..record.loop import Finding
from ..typing import BoolArray, FloatArray
from .cells import FEWEST, Cell, quantile_masks, split, worst
from .model_run import Ground
from .suspects import Clue

BLOCKS, DECILES, CYCLE_PARTS = 10, 10, 12
# Factor on the error elsewhere above which an error is serious, and share of an error below which a mean is not stated.
_SERIOUS, _MEAN = 2.0, 0.02
# A slip shows in y for one time constant after the dead time, at most this share of a period.
_LONGEST_SLIP = 0.1
# The position has moved when it changed by more than this share of S.
_REST = 1e-6
_SOURCE = "cell against the rest, 1 % over all cells, autocorrelation allowed for; docs/details.md, section 10.2"

Answer = tuple[str, tuple[Cell, ...], Clue | None]


def _answer(ground: Ground, name: str, masks: dict[str, BoolArray], where: Callable[[Cell], str],
            trace: Callable[[Cell], str] | None = None, spans: dict[str, tuple[float, float]] | None = None) -> Answer:
    """The residual over labelled masks (n,), and a finding about the worst of them, in words and numbers.

    `trace` names what the effects that the finding suggests leave in a residual, in place of the question's name.
    `spans` hold the start and end in s of masks that are stretches.
    """
    cells = split(ground, masks)
    cell = worst(cells)
    if cell is None:
        return name, cells, None
    unit = ground.loop.unit("process_value", "")
    size = f"{cell.rms:.3g} {unit}".rstrip()
    rest = max(1.0 - cell.share, 1e-12)
    outside = float(np.sqrt(max((1.0 - cell.energy_share) / rest, 0.0)) * ground.rmse)
    statement = (f"{100 * cell.energy_share:.0f} % of the squared error lies in {100 * cell.share:.0f} % of the "
                 f"samples: {where(cell)} the error is {size}, elsewhere {outside:.3g}, its mean there "
                 + (f"{cell.mean:+.3g}" if abs(cell.mean) > _MEAN * cell.rms else "next to nothing"))
    severity = "serious" if cell.rms > _SERIOUS * outside else "warning"
    if cell.fails_ahead and cell.z_one_step >= max(cell.z_energy, abs(cell.z_mean)):
        statement = (f"{where(cell)} the error one step ahead is {cell.rms_one_step:.3g} {unit}".rstrip()
                     + f", elsewhere {cell.one_step_elsewhere:.3g} ({100 * cell.share:.0f} % of the samples; free run "
                     f"{cell.rms:.3g} against {outside:.3g})")
    evidence = {"cell": cell.label, "share_of_samples": cell.share, "share_of_error": cell.energy_share,
                "rms": cell.rms, "rms_elsewhere": outside, "mean": cell.mean, "z_energy": cell.z_energy,
                "z_mean": cell.z_mean, "rms_one_step": cell.rms_one_step,
                "rms_one_step_elsewhere": cell.one_step_elsewhere, "z_one_step": cell.z_one_step,
                "samples": cell.samples, "effective_rows": ground.effective_rows}
    failing = None if spans is None else tuple(spans[c.label] for c in cells if c.fails)
    found = Finding(f"error-by-{name}", severity, statement, evidence, leaving(trace(cell) if trace else name), _SOURCE,
                    stretches=failing)
    return name, cells, Clue(found, max(abs(cell.z_energy), abs(cell.z_mean), abs(cell.z_one_step)),
                             _said(cell, outside))


def _said(cell: Cell, outside: float) -> str:
    """The number of a cell that speaks for its suspects; the error elsewhere is `outside`."""
    if abs(cell.z_mean) > max(cell.z_energy, cell.z_one_step):
        return f"{cell.label}: mean error {cell.mean:+.3g}"
    free, ahead = cell.rms / max(outside, 1e-300), cell.rms_one_step / max(cell.one_step_elsewhere, 1e-300)
    which = "one-step error" if ahead > free else "error"
    return f"{cell.label}: {which} {max(free, ahead):.2g} times as large as elsewhere"


def by_time(ground: Ground) -> Answer:
    """Ten blocks of the record."""
    n = ground.residual.size
    edges = np.linspace(0, n, BLOCKS + 1).astype(int)
    at = np.arange(n)
    blocks = {f"{a * ground.step_s:.4g} to {b * ground.step_s:.4g} s": (a, b) for a, b in itertools.pairwise(edges)}
    return _answer(ground, "time", {label: (at >= a) & (at < b) for label, (a, b) in blocks.items()},
                   lambda c: f"from {c.label}", lambda c: "level" if abs(c.z_mean) > c.z_energy else "stretch",
                   {label: (float(a * ground.step_s), float(b * ground.step_s)) for label, (a, b) in blocks.items()})


def by_phase(ground: Ground) -> Answer:
    """Stick, slip (just after break-away) and slide, delayed to where y shows them."""
    words = {"stick": "while the valve sticks", "slip": "just after the valve slipped", "slide": "while it slides"}
    return _answer(ground, "phase", {name: _delayed(ground, mask) for name, mask in _phases(ground).items()},
                   lambda c: words[c.label], lambda c: c.label)


def by_direction(ground: Ground) -> Answer:
    """Samples after opening moves against those after closing ones."""
    return _answer(ground, "direction", {name: _delayed(ground, mask) for name, mask in _directions(ground).items()},
                   lambda c: f"after the {c.label} strokes")


def by_output(ground: Ground) -> Answer:
    """Deciles of the controller output."""
    return _answer(ground, "output", quantile_masks(ground.loop.output, ground.good, DECILES, "OP"),
                   lambda c: f"at {c.label} %")


def by_value(ground: Ground) -> Answer:
    """Deciles of the model's process value: measured values would let the noise sort itself into the outer deciles."""
    return _answer(ground, "value", quantile_masks(ground.evaluated.model, ground.good, DECILES, "PV"),
                   lambda c: f"at {c.label}")


def by_cycle(ground: Ground) -> Answer:
    """Parts of the limit cycle, from one up-crossing to the next."""
    phase = ground.cycle_phase
    masks = {f"{100 * i // CYCLE_PARTS} to {100 * (i + 1) // CYCLE_PARTS} % of the cycle":
             (phase >= i / CYCLE_PARTS) & (phase < (i + 1) / CYCLE_PARTS) for i in range(CYCLE_PARTS)}
    return _answer(ground, "cycle", masks if len(ground.found.cycles) >= 3 else {}, lambda c: f"at {c.label}")


def around_setpoint(ground: Ground) -> Answer:
    """Samples within one period after a setpoint move against the rest of the record."""
    r = ground.loop.setpoint
    if r is None:
        return "setpoint", (), None
    moves = np.flatnonzero(np.abs(np.diff(r)) > 1e-9 * max(float(np.ptp(r)), 1e-300)) + 1
    inside = np.zeros(r.size, bool)
    width = max(round(ground.period_s / ground.step_s), FEWEST)
    if 0 < moves.size * width < r.size:  # a setpoint that always moves has no "after"
        for k in moves:
            inside[k:k + width] = True
    return _answer(ground, "setpoint", {"after a setpoint move": inside, "between setpoint moves": ~inside}
                   if inside.any() else {}, lambda c: c.label)


QUESTIONS: tuple[Callable[[Ground], Answer], ...] = (by_time, by_phase, by_direction, by_output, by_value, by_cycle,
                                                     around_setpoint)


def _delayed(ground: Ground, mask: BoolArray) -> BoolArray:
    """A mask of the valve (n,) as y shows it, one dead time later."""
    samples = round(ground.evaluated.values["dead_time_s"] / ground.step_s) + 1
    out = np.zeros_like(mask)
    for part in ground.loop.segments:
        if samples < part.stop - part.start:
            out[part.start + samples:part.stop] = mask[part.start:part.stop - samples]
    return out


def _phases(ground: Ground) -> dict[str, BoolArray]:
    """Masks (n,) "stick", "slip" and "slide", at the valve."""
    change = _changes(ground)
    moves = change != 0.0
    before = np.concatenate([[False], moves[:-1]])
    start = moves & ~before
    lag = ground.evaluated.values["time_constant_s"]
    length = max(1, round(min(lag, _LONGEST_SLIP * ground.period_s) / ground.step_s))
    slip = np.convolve(start.astype(float), np.ones(length))[:moves.size] > 0.5
    return {"stick": ~moves & ~slip, "slip": slip, "slide": moves & ~slip}


def _directions(ground: Ground) -> dict[str, BoolArray]:
    """Masks (n,) "opening" and "closing": the direction of the valve's last move."""
    sign = np.sign(_changes(ground))
    at = np.where(sign != 0, np.arange(sign.size), 0)
    np.maximum.accumulate(at, out=at)
    last = sign[at]
    return {"opening": last > 0, "closing": last < 0}


def _changes(ground: Ground) -> FloatArray:
    position = ground.evaluated.stem
    change = np.diff(position, prepend=position[0])
    change[list(ground.loop.starts)] = 0.0
    rest = _REST * max(ground.evaluated.values["S"], 1e-12)
    return np.where(np.abs(change) > rest, change, 0.0)
