"""The residual split into cells (stretches, phases, deciles), each tested against all the others.

A cell stands out when its mean, or its mean square, differs from that of the other samples. The difference must exceed
chance at 1 % over all cells of all questions, and be of a size that matters. Source: docs/details.md, section 10.2.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..typing import BoolArray, FloatArray
from .model_run import Ground

# Joint level of all cells of all questions, and the number of cells in a full comparison (Bonferroni).
LEVEL, CELLS = 0.01, 80
# Fewest samples of a cell. Unit: samples.
FEWEST = 12
# Sizes that matter: the factor of the cell's error over the error elsewhere, and its mean as a share of its error.
_LARGER, _SHIFTED = 1.2, 0.35
BEYOND = NormalDist().inv_cdf(1.0 - LEVEL / (2.0 * CELLS))


@dataclass(frozen=True, slots=True)
class Cell:
    """One cell: shares of samples and of squared error (0..1), rms and mean in the unit of y, both as z values.

    `rms_one_step` is that of the one-step errors, with the noise model that the residual asks for.
    """

    label: str
    samples: int
    share: float
    energy_share: float
    rms: float
    mean: float
    z_energy: float
    z_mean: float
    rms_one_step: float
    one_step_elsewhere: float
    z_one_step: float

    @property
    def fails(self) -> bool:
        """True where the error stands out in this cell, by more than chance and by a size that matters."""
        rest = max(1.0 - self.share, 1e-12)
        outside = np.sqrt(max((1.0 - self.energy_share) / rest, 1e-12))
        inside = np.sqrt(self.energy_share / max(self.share, 1e-12))
        larger = self.z_energy > BEYOND and inside > _LARGER * outside
        shifted = abs(self.z_mean) > BEYOND and abs(self.mean) > _SHIFTED * self.rms
        return larger or shifted or self.fails_ahead

    @property
    def fails_ahead(self) -> bool:
        """True where the one-step error stands out in this cell, which a slow error of the free run cannot hide."""
        return self.z_one_step > BEYOND and self.rms_one_step > _LARGER * self.one_step_elsewhere

    @property
    def weight(self) -> float:
        """The strongest of the three z values, for the choice of the worst cell."""
        return max(self.z_energy, abs(self.z_mean), self.z_one_step)


def split(ground: Ground, cells: dict[str, BoolArray]) -> tuple[Cell, ...]:
    """The residual over labelled masks (n,), cells with too few samples left out."""
    out = []
    total = float(np.sum(ground.residual[ground.good] ** 2))
    rows = int(ground.good.sum())
    ahead = ground.innovation**2
    sure = ground.innovation != 0.0
    tails = _tails(ground.innovation[sure])
    for label, mask in cells.items():
        inside = mask & ground.good
        count = int(inside.sum())
        if count < FEWEST or rows - count < FEWEST or total <= 0.0:
            continue
        energy = float(np.sum(ground.residual[inside] ** 2))
        mean = float(ground.residual[inside].mean())
        here, there = inside & sure, ground.good & ~inside & sure
        a, b = (float(ahead[m].mean()) if m.any() else 0.0 for m in (here, there))
        z = _paulson(a / b, 2.0 * tails / max(here.sum(), 1), 2.0 * tails / max(there.sum(), 1)) if b > 0.0 else 0.0
        out.append(Cell(label, count, count / rows, energy / total, float(np.sqrt(energy / count)), mean,
                        _z_energy(ground, inside), mean / ground.spread_of_mean(inside / count), float(np.sqrt(a)),
                        float(np.sqrt(b)), z))
    return tuple(out)


def _z_energy(ground: Ground, inside: BoolArray) -> float:
    """Wilson and Hilferty's normal value of the cell's mean square over that of all other samples."""
    outside = ground.good & ~inside
    base = float(np.mean(ground.residual[outside] ** 2))
    if base <= 0.0:
        return 0.0
    ratio = float(np.mean(ground.residual[inside] ** 2)) / base
    scale = ground.covariance[0]
    relative = [ground.spread_of_mean(m / m.sum(), squared=True) ** 2 / max(scale**2, 1e-300)
                for m in (inside, outside)]
    return _paulson(ratio, relative[0], relative[1])


def _paulson(ratio: float, above: float, below: float) -> float:
    """Paulson's normal value of a ratio of mean squares with these relative variances (2 over the freedom)."""
    a, b = min(above, 2.0) / 9.0, min(below, 2.0) / 9.0
    cube = ratio ** (1.0 / 3.0)
    return float(((1.0 - b) * cube - (1.0 - a)) / np.sqrt(b * cube**2 + a))


def _tails(e: FloatArray) -> float:
    """Variance of squared errors over that of Gaussian ones, at least 1: spikes must not pass for a failing cell."""
    square = e**2
    mean = float(square.mean()) if e.size else 0.0
    return max(1.0, float(square.var()) / (2.0 * mean**2)) if mean > 0.0 else 1.0


def worst(cells: tuple[Cell, ...]) -> Cell | None:
    """The failing cell that stands out most, None where none fails."""
    failing = [c for c in cells if c.fails]
    return max(failing, key=lambda c: c.weight) if failing else None


def quantile_masks(signal: FloatArray, good: BoolArray, count: int, label: str) -> dict[str, BoolArray]:
    """Masks (n,) of equally many samples by the size of a signal, labelled with its limits."""
    values = signal[good & np.isfinite(signal)]
    if values.size < count * FEWEST or float(np.ptp(values)) == 0.0:
        return {}
    edges = np.unique(np.quantile(values, np.linspace(0.0, 1.0, count + 1)))
    which = np.clip(np.searchsorted(edges, np.nan_to_num(signal), side="right") - 1, 0, edges.size - 2)
    return {f"{label} {a:.4g} to {b:.4g}": which == i
            for i, (a, b) in enumerate(itertools.pairwise(edges))}
