"""The ARX cost: one-step error of a linear difference equation driven by the valve position (Shang et al., Eq. 7 to
19).

For given S and J the position follows from the command. The coefficients then follow by linear least squares. A
candidate therefore costs one valve recursion and a few sums. The one-step error finds the right basin reliably but
pulls J low when y is noisy (docs/details.md, section 6.2). `identify` therefore finishes with the free-run error; only
`--method arx` stops here. Misprints of the paper are corrected: the first row of Eq. 15 starts with y(n+τ-1), Eq. 16
and 19 want the squared norm, Eq. 17 wants Φᵀy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ...errors import CannotTell
from ...model.model import Model
from ...numerics.cross_products import lagged_products
from ...numerics.varpro import Shared
from ...typing import BoolArray, FloatArray, IntArray

# Rows that an order needs at the least where PV is missing in some.
_FEWEST_ROWS = 20


@dataclass(frozen=True, slots=True)
class _Shifts:
    """Inputs of `lagged_products` for a record without gaps; `mix` makes the columns of `Shared` from y at its lags."""

    level: float
    y: FloatArray
    mix: FloatArray
    rows: tuple[int, int]
    delays: IntArray

    @classmethod
    def of(cls, arx: Arx, y: FloatArray, constant: bool) -> _Shifts:
        rows = (arx.first, y.size)
        # With a constant among the columns any level is valid; the middle of the signals keeps the sums small.
        y = y - y[arx.first:].mean() if constant else y
        raw = np.stack([y[arx.first - i:y.size - i] for i in range(3)] + [np.ones(y.size - arx.first)], axis=1)
        kept = [1, 2, 3] if constant else [1, 2]
        scale, coordinates = np.linalg.norm(raw[:, kept], axis=0), arx.shared.basis.T
        mix = np.zeros((4, arx.shared.freedom + 1))
        # The basis spans the raw columns, so each of its columns is a sum of them; so is the target freed of them.
        turned = np.linalg.lstsq(raw[:, kept] / scale, arx.shared.basis, rcond=None)[0] / scale[:, None]
        mix[kept, :-1] = turned
        mix[kept, -1] = -turned @ (coordinates @ raw[:, 0])
        mix[0, -1] = 1.0
        level = float(arx.model.context.command.mean())
        return cls(level, np.append(y, 0.0), mix, rows, np.unique(np.asarray(arx.delays, np.int64)))


def check_rows(good: BoolArray, order: int) -> None:
    """Raise CannotTell where too few of the samples (n,) that are good have `order` others right before them."""
    rows = int((np.convolve(good, np.ones(order + 1), "valid") > order + 0.5).sum())
    if not good.all() and rows < _FEWEST_ROWS * order:
        raise CannotTell(f"a difference equation of order {order} needs {order + 1} samples of PV in a row, and only "
                         f"{rows} samples of the record have {order} before them",
                         "use --method auto, which does without", code="pv-too-sparse")


class Arx:
    """ARX costs of valve candidates for one order and a set of delays (in samples), on one record.

    With `constant` an offset is fitted. Without it the signals are deviations from the mean of the samples used, which
    is Shang et al., Eq. 9.
    """

    def __init__(self, model: Model, order: int, delays: tuple[int, ...], *, constant: bool = True) -> None:
        self.model, self.order, self.delays = model, order, delays
        y = model.context.process_value
        self.first = max(model.skip, order + max(delays) + 1)
        rows = np.arange(self.first, y.size)
        good = model.good()
        weight = good.copy()
        for lag in range(1, order + 1):
            weight[lag:] &= good[:-lag]
        self.weight = weight[rows].astype(np.float64)
        self.mean = 0.0 if constant else float(y[rows].mean())
        self.command_mean = 0.0 if constant else float(model.context.command.mean())
        y = y - self.mean
        columns = [y[rows - i] for i in range(1, order + 1)]
        if constant:
            columns.append(np.ones(rows.size))
        self.columns = np.stack(columns, axis=1)
        self.target = y[rows]
        self.shared = Shared.prepare(self.target, self.columns, self.weight)
        self._shifts = _Shifts.of(self, y, constant) if order == 2 and bool(weight[rows].all()) else None

    def _driving(self, values: FloatArray) -> FloatArray:
        """Position at the samples (n, P), lent. Over a command that moves between samples it is the mean."""
        position = self.model.positions(values, lent=True)
        m = self.model.parts
        return position if m == 1 else position.reshape(-1, m, position.shape[1]).mean(axis=1)

    def costs(self, values: FloatArray) -> tuple[FloatArray, IntArray]:
        """Smallest sum of squared one-step errors (P,) over the delays, and the delay (P,) that gave it."""
        best = np.full(values.shape[1], np.inf)
        delay = np.zeros(values.shape[1], np.int64)
        for rows, part in self.model.blocks(values):
            least, chosen = best[rows], delay[rows]
            for d, c in self._costs(self._driving(part)):
                c = c[:least.size]
                better = c < least
                least[better], chosen[better] = c[better], d
        return best, delay

    def _costs(self, driving: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Every delay with the costs (P,) of positions (n, P)."""
        if self._shifts is not None:
            s = self._shifts
            squares, cross = lagged_products(driving, s.level, s.y, s.mix, s.rows, s.delays)
            for i, d in enumerate(s.delays.tolist()):
                yield d, self.shared.solved(squares[i], cross[i])[0]
            return
        if self.command_mean:
            driving -= self.command_mean
        for d in self.delays:
            yield d, self.shared.costs(driving, tuple(self.first - d - i for i in range(1, self.order + 1)))

    def coefficients(self, values: FloatArray, delay: int) -> tuple[FloatArray, FloatArray, float]:
        """Coefficients a (order,) and b (order,) of one candidate (d,) and its mean squared error (Eq. 18, 19)."""
        driving = self._driving(values.reshape(-1, 1))[:, 0] - self.command_mean
        rows = np.arange(self.first, driving.size)
        own = np.stack([driving[rows - delay - i] for i in range(1, self.order + 1)], axis=1)
        keep = self.weight > 0
        design = np.concatenate([own, self.columns], axis=1)[keep]
        theta, *_ = np.linalg.lstsq(design, self.target[keep], rcond=None)
        error = self.target[keep] - design @ theta
        return -theta[self.order:2 * self.order], theta[:self.order], float(np.mean(error**2))


def continuous_process(a: FloatArray, b: FloatArray, step_s: float) -> tuple[float, tuple[float, ...], bool]:
    """Static gain, time constants in seconds and integrating flag of A(q) y = B(q) u (coefficients after the 1).

    The gain of an integrating model is per second. A pole that is no decaying exponential gives no time constant.
    """
    poles = np.roots(np.concatenate([[1.0], a]))
    integrating = bool(np.any(np.abs(poles - 1.0) < 1e-3))
    lags = tuple(float(-step_s / np.log(p.real)) for p in poles
                 if abs(p.imag) < 1e-9 and 0.0 < p.real < 1.0 - 1e-3)
    if integrating:
        rest = np.poly(np.delete(poles, np.argmin(np.abs(poles - 1.0))))
        return float(b.sum() / np.real(rest.sum()) / step_s), lags, True
    total = 1.0 + a.sum()
    return float(b.sum() / total) if total else float("inf"), lags, False
