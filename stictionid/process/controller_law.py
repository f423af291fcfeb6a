"""Controller behind a record: gain, integral and derivative time by regression, and the output without its rounding.

A PID controller that ran with the samples obeys, from sample to sample, `u = c + K e + (K h / T_i) sum(e) + (K T_d / h)
(e - e before)` with e = SP - PV and the sampling time h. The incremental form is the same regression; c is the start of
its integral. A record in steps of q obeys it to within q / 2. The law is found where its residual is no larger than
rounding: that of OP, and that of PV through the gains. Rounded PV also adds up in the integral, so that c walks by
(K h / T_i) times the rounding of PV in each sample.

Of an output that a historian thinned, the values that it kept obey the law to within their digits, and the law gives
those in between. The errors in between are not lost: their sum is in the integral.

The law holds by stretches. A stretch ends where the residual leaves its bound: at saturation, in manual, at a gap and
at a change of tuning. Wrong for a filtered derivative, and for a controller that scans faster than the samples.
Source: Astrom and Hagglund 1995 (digital PID); Harvey 1989, 2.3 (a level that walks under white noise); Fuller 1987
(errors in the regressors).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..numerics.archived import runs_of
from ..record.controller import FULL, Controller
from ..record.loop import Loop, bridged
from ..typing import BoolArray, FloatArray, IntArray
from .rounded import step_of, thinned_output

# Fewest samples of a stretch, and the most that are fitted together: longer ones are cut, and their integral begins
# anew in each. As many tell which terms the law has, and one more stretch must gain the fewest.
_FEWEST, MOST = 60, 4096
# The same of values that a historian kept. Each is known to its digits, which are far finer than its distance to the
# next one, so that a law of four numbers meets no such row by chance.
_FEWEST_KEPT = 10
# Multiple of a standard deviation that no residual exceeds: chance passes 4.5 in 1 of 1.5e5.
_NEVER = 4.5
# Relative variance of the square of a uniform error: the mean of n squares is known to the root of this over n.
_KURTOSIS = 0.8
# Rounding of an output with no step, as a share of its swing: the error of single precision.
_SINGLE = 1e-6
# t value from which a term of the law counts.
_COUNTS = 5.0
# Share of the samples that count, above which a law is the record's.
_MOSTLY = 0.5
# Two-sided 90 % point of the normal distribution.
POINT_90 = 1.645
# Share of the variance of the output that a law which need not be exact must explain.
_EXPLAINS = 0.9


@dataclass(frozen=True, slots=True)
class Form:
    """Terms of a law: integral and derivative part, the latter on PV or on the error, and samples by which PV is late.
    """

    integral: bool = True
    derivative: bool = False
    on_pv: bool = False
    late: int = 0


# Tried in this order; a later form must explain more samples.
_FORMS = (Form(), Form(late=1), Form(derivative=True), Form(derivative=True, on_pv=True),
          Form(derivative=True, late=1), Form(integral=False), Form(integral=False, late=1))


@dataclass(frozen=True, slots=True)
class Obeyed:
    """The law of a controller that a record obeys.

    `stretches` are the samples that obey it. `command` (n,) is the output without its rounding there, and as recorded
    elsewhere; `command_sd` is the standard deviation of its error.
    """

    controller: Controller
    stretches: tuple[slice, ...]
    command: FloatArray = field(repr=False)
    command_sd: float


@dataclass(frozen=True, slots=True)
class _Rounding:
    """Steps of OP and PV that the law is held against, as variances.

    `apart` is the mean distance of its rows in samples, `fewest` the number of rows in a stretch.
    """

    output: float
    error: float
    apart: float = 1.0
    fewest: int = _FEWEST

    def spread(self, form: Form, sizes: FloatArray) -> float:
        """Variance of law less record for the sizes (p,) of a form, the walk of the integral left out."""
        return self.output + self.error * float(sizes @ _shared_covariance(form) @ sizes)

    def walk(self, form: Form, sizes: FloatArray) -> float:
        """Variance by which the integral walks from one row to the next."""
        return self.apart * self.error * float(sizes[1]) ** 2 if form.integral else 0.0


@dataclass(frozen=True, slots=True)
class _Piece:
    """A regression on one stretch: sizes (p,), their covariance (p, p), fitted values (m,) and residual (m,).

    `first` and `stop` count the rows that are held against the law, and `rows` (m,) are their samples. `numbers` are
    those estimated, the walking level counted by the samples that it is smoothed over.
    """

    first: int
    stop: int
    sizes: FloatArray
    covariance: FloatArray
    fitted: FloatArray
    rest: FloatArray
    numbers: float
    rows: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))

    @property
    def counts(self) -> bool:
        """True where every term of the law is there, and all have one sign."""
        sure = np.abs(self.sizes) >= _COUNTS * np.sqrt(np.diag(self.covariance))
        return bool(sure.all() and np.ptp(np.sign(self.sizes)) == 0.0)


def controller_law(loop: Loop) -> Obeyed | None:
    """The law that u obeys to within its rounding in most samples; None without a setpoint, or where there is none."""
    if loop.setpoint is None:
        return None
    u = loop.output
    known = loop.used & np.isfinite(u) & np.isfinite(loop.setpoint) & np.isfinite(loop.process_value)
    if (thin := thinned_output(loop)) is not None:
        known &= thin.kept
    count, swing = int(known.sum()), float(np.ptp(u[known])) if known.any() else 0.0
    fewest = _FEWEST if thin is None else _FEWEST_KEPT
    if count < fewest or not swing > 0.0:
        return None
    # (few values that were kept need not show their step)
    step = step_of(u[known]) or step_of(u)
    noise = _Rounding(max(step, _SINGLE * swing) ** 2 / 12.0, step_of(loop.process_value[known]) ** 2 / 12.0,
                      1.0 if thin is None else loop.samples / count, fewest)
    head = known & (np.cumsum(known) <= MOST)
    best, form = 0, Form()
    for trial in _FORMS:
        pieces = _pieces(loop, trial, head, noise, thin is not None)
        obeys = _samples_of(pieces) - fewest * len(pieces)
        if obeys > best + fewest:
            best, form = obeys, trial
        if best > head.sum() - 2 * fewest:
            break
    pieces = _pieces(loop, form, known, noise, thin is not None) if best else []
    return _read(loop, form, pieces, noise, thin is not None) if _samples_of(pieces) > _MOSTLY * count else None


def rebuild_output(loop: Loop) -> Loop:
    """The loop with the output of its controller's law in place of the rounded one; as it is where no law is found."""
    law = None if loop.followed else controller_law(loop)
    return loop if law is None else follows_in_full(loop, law)


def follows_in_full(loop: Loop, law: Obeyed) -> Loop:
    """The loop with the output of a law that it obeys."""
    return replace(loop, output=law.command, followed=FULL, output_sd=law.command_sd)


def usual_law(loop: Loop, *, held: bool = True) -> Controller | None:
    """The PI law behind r, y and u where it need not be exact; None without r, or where it is no PI law.

    A `held` output comes from a scanning controller, which adds the whole error of its scan to the integral.
    """
    if loop.setpoint is None:
        return None
    columns, u = _columns(loop, Form()), loop.output[loop.used]
    if u.size < 10 or not np.ptp(u) > 0:
        return None
    if not held:
        columns[1] -= 0.5 * columns[0]
    # In levels, not in differences: a continuous controller never saw the noise of the samples.
    design = np.stack([*columns, np.ones(loop.samples)], axis=1)[loop.used]
    sizes, *_ = np.linalg.lstsq(design, u, rcond=None)
    rest = u - design @ sizes
    fit = 1.0 - float(rest @ rest) / float(np.sum((u - u.mean()) ** 2))
    if fit < _EXPLAINS or sizes[0] == 0.0 or sizes[1] / sizes[0] <= 0.0:
        return None
    return Controller("PI", float(sizes[0]), float(sizes[0] / sizes[1]) * loop.step_s, None,
                      residual=float(np.sqrt(np.mean(rest**2))))


def _columns(loop: Loop, form: Form) -> FloatArray:
    """Columns of a law without its constant, shape (p, n): error, its sum, and its increment from the sample before."""
    assert loop.setpoint is not None
    y = bridged(loop.process_value)
    e = np.nan_to_num(loop.setpoint - y)
    moving = -y if form.on_pv else e
    columns = [e, *([np.cumsum(e)] if form.integral else []),
               *([np.diff(moving, prepend=moving[0])] if form.derivative else [])]
    late = [np.concatenate([c[:1].repeat(form.late), c[:c.size - form.late]]) for c in columns]
    return np.stack(late)


def _shared_covariance(form: Form) -> FloatArray:
    """Covariance of a law's columns (p, p) from an error of PV with the variance 1, white; its sum left out."""
    out = np.zeros((1 + form.integral + form.derivative,) * 2)
    out[0, 0] = 1.0
    if form.derivative:
        out[-1, -1], out[0, -1], out[-1, 0] = 2.0, 1.0, 1.0
    return out


def _pieces(loop: Loop, form: Form, known: BoolArray, noise: _Rounding, thin: bool) -> list[_Piece]:
    """Longest stretches that obey a form, from the start on. Of a `thin` output the known rows follow on one another.
    """
    rows = np.flatnonzero(known) if thin else np.arange(loop.samples)
    columns, u = _columns(loop, form)[:, rows], loop.output[rows]
    lead = form.late + form.derivative
    found: list[_Piece] = []
    for first, stop in _kept_runs(loop, rows, lead) if thin else _runs(loop, known, lead):
        at = first
        while at + noise.fewest <= stop:
            piece = _longest_stretch(columns, u, form, noise, at, min(stop, at + MOST))
            if piece is None:
                at += noise.fewest
                continue
            if piece.counts:
                found.append(replace(piece, rows=rows[piece.first:piece.stop]))
            at = piece.stop
    return found


def _samples_of(pieces: list[_Piece]) -> int:
    return sum(piece.stop - piece.first for piece in pieces)


def _kept_runs(loop: Loop, rows: IntArray, lead: int) -> list[tuple[int, int]]:
    """The same for rows (m,) that a historian kept: one run in each segment."""
    ends = (*loop.starts[1:], loop.samples)
    return [(int(a), int(b)) for a, b in np.searchsorted(rows, np.stack([np.array(loop.starts) + 1 + lead, ends], 1))]


def _runs(loop: Loop, known: BoolArray, lead: int) -> list[tuple[int, int]]:
    """Runs of known samples within segments, without the first `lead` samples of each, whose e before is unknown."""
    cut = known.copy()
    cut[list(loop.starts)] = False
    return [(int(a) + lead, int(b)) for a, b in zip(*runs_of(cut), strict=True)]


def _longest_stretch(columns: FloatArray, u: FloatArray, form: Form, noise: _Rounding, first: int,
                     end: int) -> _Piece | None:
    """The longest stretch from `first` on that obeys a form, by doubling and bisection; None where none does."""
    good: _Piece | None = None
    size, bad = noise.fewest, end + 1
    while True:
        stop = min(first + size, end)
        piece = _regress_law(columns, u, form, noise, first, stop)
        if piece is None:
            bad = stop
            break
        good = piece
        if stop == end:
            return good
        size *= 2
    while good is not None and bad - good.stop > 1:
        middle = (good.stop + bad) // 2
        piece = _regress_law(columns, u, form, noise, first, middle)
        good, bad = (good, middle) if piece is None else (piece, bad)
    return good


def _regress_law(columns: FloatArray, u: FloatArray, form: Form, noise: _Rounding, first: int,
                 stop: int) -> _Piece | None:
    """The regression on samples first..stop-1; None where its residual is more than rounding.

    The second round knows from the first how the integral walks.
    """
    X, y = columns[:, first:stop], u[first:stop]
    X = X - X.mean(axis=1, keepdims=True)
    y = y - y.mean()
    walk, spread = 0.0, noise.output
    for _ in range(2):
        own = _take_out_level(np.vstack([X, y]), walk / spread)
        gram, answer = X @ own[:-1].T, X @ own[-1]
        # Rounding of PV bends the sizes, and its known covariance is taken out again.
        true = gram - noise.error * y.size * _shared_covariance(form)
        if not np.all(np.isfinite(gram)) or np.linalg.cond(true) > 1e14 or np.linalg.eigvalsh(true)[0] <= 0.0:
            return None
        sizes = np.linalg.solve(true, answer)
        walk, spread = noise.walk(form, sizes), noise.spread(form, sizes)
    best = np.linalg.solve(gram, answer)
    rest = own[-1] - best @ own[:-1]
    n, other = y.size, spread - noise.output
    if float(np.mean(rest**2)) > spread * (1.0 + _NEVER * np.sqrt(_KURTOSIS / n)) \
            or float(np.abs(rest).max()) > np.sqrt(3.0 * noise.output) + _NEVER * np.sqrt(other + spread / n):
        return None
    return _Piece(first, stop, sizes, np.linalg.inv(true) * spread, u[first:stop] - rest, rest,
                  sizes.size + max(1.0, n * (1.0 - (decay := _decay(walk / spread))) / (1.0 + decay)))


def _take_out_level(rows: FloatArray, ratio: float) -> FloatArray:
    """Rows (k, n) without the smoothed level that walks by `ratio` of the variance of white noise in each sample."""
    n = rows.shape[1]
    if ratio * n**2 < 1e-3:
        return np.asarray(rows - rows.mean(axis=1, keepdims=True))
    decay = _decay(ratio)
    size = 1 << (2 * n - 1).bit_length()
    kernel = np.zeros(size)
    powers = decay ** np.arange(n)
    kernel[:n], kernel[size - n + 1:] = powers, powers[:0:-1]
    heard = np.fft.rfft(kernel)
    padded = np.fft.irfft(np.fft.rfft(np.vstack([rows, np.ones(n)]), size) * heard, size)[:, :n]
    return np.asarray(rows - padded[:-1] / padded[-1])


def _decay(ratio: float) -> float:
    """Factor from sample to sample of the weights that smooth such a level."""
    return float(1.0 + 0.5 * ratio - np.sqrt(ratio + 0.25 * ratio * ratio))


def _read(loop: Loop, form: Form, pieces: list[_Piece], noise: _Rounding, thin: bool) -> Obeyed:
    """The law of the longest stretch, and the command of all."""
    u, columns = loop.output, _columns(loop, form)
    command = np.array(u)
    half = 0.5 * step_of(u[loop.used])
    squares = error = 0.0
    for piece in pieces:
        size = float(np.mean(piece.rest**2))
        squares += size * piece.rest.size
        # As far as the residual is larger than the rounding of OP, the record knows better than the law.
        share = max(1.0 - noise.output / size, 0.0) if size > 0.0 else 0.0
        # The law's own error, and that of its numbers.
        error += noise.output * min(share * piece.rest.size + piece.numbers, float(piece.rest.size))
        command[piece.rows] = np.clip(piece.fitted + share * piece.rest, u[piece.rows] - half, u[piece.rows] + half)
        if thin:
            # Between the rows the law goes on, from a level that walks.
            stretch = _reach(loop, form, piece, pieces)
            by_law = piece.sizes @ columns[:, stretch]
            at = piece.rows - stretch.start
            command[stretch] = by_law + np.interp(np.arange(by_law.size), at, command[piece.rows] - by_law[at])
    longest = max(pieces, key=lambda piece: piece.stop - piece.first)
    rows_used = _samples_of(pieces)
    return Obeyed(_controller(form, longest, loop.step_s, float(np.sqrt(squares / rows_used))),
                  tuple(slice(int(piece.rows[0]), int(piece.rows[-1]) + 1) for piece in pieces), command,
                  float(np.sqrt(error / rows_used)))


def _reach(loop: Loop, form: Form, piece: _Piece, pieces: list[_Piece]) -> slice:
    """Samples from the first to the last row of a piece; to the ends of the segment where no other piece lies there."""
    segment = next(part for part in loop.segments if part.start <= piece.rows[0] < part.stop)
    first, last = int(piece.rows[0]), int(piece.rows[-1])
    others = [int(row) for other in pieces if other is not piece for row in (other.rows[0], other.rows[-1])]
    if not any(segment.start <= row < first for row in others):
        first = min(segment.start + 1 + form.late + form.derivative, first)
    return slice(first, segment.stop if not any(last < row < segment.stop for row in others) else last + 1)


def _controller(form: Form, piece: _Piece, step_s: float, residual: float) -> Controller:
    """The controller of a stretch; the intervals of its numbers by the delta method."""
    sizes, names = piece.sizes, ["gain", *["integral_time_s"] * form.integral, *["derivative_time_s"] * form.derivative]
    known, intervals = {}, {}
    for i, name in enumerate(names):
        value, slope = float(sizes[0]), np.eye(sizes.size)[0]
        if i:
            over, under = (0, i) if name == "integral_time_s" else (i, 0)
            value = float(sizes[over] / sizes[under]) * step_s
            slope[0], slope[over], slope[under] = 0.0, value / sizes[over], -value / sizes[under]
        wide = POINT_90 * float(np.sqrt(slope @ piece.covariance @ slope))
        known[name], intervals[name] = value, (float(value - wide), float(value + wide))
    kind = "P" + "I" * form.integral + "D" * form.derivative
    return Controller(kind, known["gain"], known.get("integral_time_s"), known.get("derivative_time_s"), intervals,
                      residual)
