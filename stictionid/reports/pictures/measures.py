"""Numbers behind the pictures: thinning, autocorrelation, spectrum, and the stretches where a model fails."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...numerics.archived import runs_of
from ...numerics.autoregression import link_samples
from ...record.loop import Loop, bridged
from ...record.study import Study
from ...typing import BoolArray, FloatArray

# A stretch fails where the running RMS of the residual exceeds this multiple of its RMS over the record. Chosen so that
# a Gaussian residual of one period (30 samples or more) is shaded less than once in 1,000 stretches.
FAILING_RATIO = 1.6
# Length of the running RMS where the record has no period, as a share of the record.
_RUNNING_SHARE = 0.02
# Most lags of an autocorrelation and most points of a spectrum segment. Unit: samples.
_MOST_LAGS = 400
_LONGEST_SEGMENT = 4096

Stretches = tuple[tuple[float, float], ...]
"""Parts of a record, each by its start and end in seconds since the first sample."""


def thin(x: FloatArray, y: FloatArray, bins: int) -> tuple[FloatArray, FloatArray]:
    """At most 2·bins points of a curve (n,) that look the same: lowest and highest value of each bin, in order."""
    n = y.size
    if n <= 2 * bins:
        return x, y
    edges = np.linspace(0, n, bins + 1).astype(np.intp)[:-1]
    low = np.fmin.reduceat(y, edges)
    high = np.fmax.reduceat(y, edges)
    which = np.repeat(np.arange(bins), np.diff(np.append(edges, n)))
    keep: list[NDArray[Any]] = []
    for extreme in (low, high):
        hits = np.flatnonzero((y == extreme[which]) | np.isnan(extreme[which]))
        _, first = np.unique(which[hits], return_index=True)
        keep.append(hits[first])
    index = np.unique(np.concatenate([*keep, [0, n - 1]]))
    return x[index], y[index]


def stretches(mask: BoolArray, step_s: float) -> Stretches:
    """Runs of True in `mask` (n,) as stretches."""
    return tuple((float(start * step_s), float(end * step_s)) for start, end in zip(*runs_of(mask), strict=True))


def unused(loop: Loop) -> Stretches:
    """Stretches whose samples entered no cost; not those from one PV to the next of a slower tag."""
    return stretches(~np.asarray(loop.used) & ~passed(loop), loop.step_s)


def passed(loop: Loop) -> BoolArray:
    """Samples (n,) without a PV that lie between two of a slower tag."""
    missing = np.isnan(loop.process_value)
    links = link_samples(loop.used, loop.starts) if missing.any() else None
    return np.zeros(loop.samples, bool) if links is None else missing & links.gap_samples()


def joined(loop: Loop, values: FloatArray) -> FloatArray:
    """A curve (n,) at the samples of PV with straight lines from one PV to the next of a slower tag."""
    gaps = passed(loop)
    return np.where(gaps, bridged(values), values) if gaps.any() else values


def failing(study: Study, loop: Loop, residual: FloatArray) -> Stretches:
    """Stretches where the last model fails: those that findings name, else those where the running RMS stands out.

    A finding names each stretch by its start and end in s.
    """
    named = tuple((float(a), float(b)) for step in study.steps[-1:] for f in step.findings
                  for a, b in f.stretches or () if np.isfinite([a, b]).all())
    if named:
        return named
    good = np.isfinite(residual) & loop.used
    if not good.any():
        return ()
    square = np.where(good, residual, 0.0) ** 2
    period = study.range.period_median_s
    width = round(period / loop.step_s) if period else round(_RUNNING_SHARE * residual.size)
    width = int(min(max(width, 8), max(residual.size // 4, 1)))
    counted = _running_sum(good.astype(float), width)
    mean_square = _running_sum(square, width) / np.maximum(counted, 1.0)
    level = FAILING_RATIO ** 2 * float(square[good].mean())
    if level <= 0:
        return ()
    return stretches((mean_square > level) & (counted >= width / 2), loop.step_s)


def _running_sum(values: FloatArray, width: int) -> FloatArray:
    """Sum over `width` samples centred on each sample (n,)."""
    total = np.concatenate(([0.0], np.cumsum(values)))
    n = values.size
    at = np.arange(n)
    return total[np.minimum(at + width - width // 2, n)] - total[np.maximum(at - width // 2, 0)]


def longest_run(good: BoolArray) -> slice:
    """The longest stretch of True in `good` (n,); empty where there is none."""
    start, end = max(stretches(good, 1.0), key=lambda run: run[1] - run[0], default=(0, 0))
    return slice(int(start), int(end))


def autocorrelation(signal: FloatArray, most: int) -> FloatArray:
    """Autocorrelation of `signal` (n,) at lags 0..most, biased (divided by n), by FFT."""
    centred = signal - signal.mean()
    n = centred.size
    size = 1 << (2 * n - 1).bit_length()
    spectrum = np.fft.rfft(centred, size)
    full = np.fft.irfft(spectrum.real ** 2 + spectrum.imag ** 2, size)[: most + 1]
    return full / full[0] if full[0] > 0 else np.zeros(most + 1)


def lags_for(samples: int, period_samples: float | None) -> int:
    """Number of lags to show: three periods, at most a quarter of the samples."""
    wanted = 3 * period_samples if period_samples else 100
    return int(max(1, min(wanted, samples // 4, _MOST_LAGS)))


def spectrum(signal: FloatArray, step_s: float) -> tuple[FloatArray, FloatArray]:
    """Welch's power spectrum: periods in s (descending) and share of the power in each line, both (k,)."""
    n = signal.size
    size = min(_LONGEST_SEGMENT, n)
    window = np.hanning(size + 1)[:-1]
    hop = max(size // 2, 1)
    power = np.zeros(size // 2 + 1)
    centred = signal - signal.mean()
    for start in range(0, n - size + 1, hop):
        power += np.abs(np.fft.rfft(centred[start:start + size] * window)) ** 2
    power, frequency = power[1:], np.fft.rfftfreq(size, step_s)[1:]
    total = power.sum()
    return np.asarray(1.0 / frequency, float), np.asarray(power / total if total > 0 else power, float)
