"""A signal without its white noise: second differences penalised, by as much as predicts left-out samples best.

Source: Whittaker 1923 (penalty on differences); Craven and Wahba 1979 (generalised cross-validation).
"""

from __future__ import annotations

import numpy as np

from ..typing import FloatArray

# Penalties tried, and the fewest samples that are smoothed.
_PENALTIES, _FEWEST = 10.0**np.arange(-2.0, 6.0, 0.5), 8
_SECOND = (1.0, -2.0, 1.0)


def smoothed(signal: FloatArray) -> FloatArray:
    """A signal (n,) without the part that its neighbours don't foretell; as it is where there are too few.

    The freedom that a penalty leaves is that of a signal without ends. Wrong beside jumps, which it rounds.
    """
    from scipy.linalg import solveh_banded

    n = signal.size
    if n < _FEWEST:
        return signal
    band = np.zeros((3, n))
    for i, a in enumerate(_SECOND):
        for j, b in enumerate(_SECOND[i:]):
            band[2 - j, i + j:n - 2 + i + j] += a * b
    power = np.abs(1.0 - np.exp(-2j * np.pi * np.arange(n) / n))**4
    best, least = signal, np.inf
    for penalty in _PENALTIES:
        matrix = penalty * band
        matrix[2] += 1.0
        found = solveh_banded(matrix, signal)
        left = n - float(np.sum(1.0 / (1.0 + penalty * power)))
        score = float(np.sum((signal - found)**2)) / left**2
        if score < least:
            best, least = found, score
    return best
