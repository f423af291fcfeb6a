"""Reference versions of the methods' computations, slow and written from the equations, for tests to compare with."""

from __future__ import annotations

import numpy as np


def conic_through(x, y):
    """Conic A x^2 + B xy + C y^2 + D x + E y + F = 0 through points that lie on one: the null vector of all terms."""
    terms = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=1)
    return np.linalg.svd(terms)[2][-1]


def chord_along_x(conic):
    """Length of the chord through the centre parallel to x: the two roots of the conic on that line."""
    A, B, C, D, E, F = conic
    _, y0 = np.linalg.solve([[2 * A, B], [B, 2 * C]], [-D, -E])
    roots = np.roots([A, B * y0 + D, C * y0 * y0 + E * y0 + F])
    return float(abs(roots[0] - roots[1]))


def one_step_errors(y, x, a, b, c, constant, delay, first):
    """A y = constant + B q^-delay x + C e, solved for e sample by sample; zero before `first`."""
    e = [0.0] * len(y)
    for k in range(first, len(y)):
        left = y[k] + sum(a[i] * y[k - 1 - i] for i in range(len(a)))
        driven = constant + sum(b[i] * x[k - delay - 1 - i] for i in range(len(b)))
        e[k] = left - driven - sum(c[i] * e[k - 1 - i] for i in range(len(c)))
    return np.array(e)


def simulate_armax(a, b, c, delay, x, noise):
    """y of A y = B q^-delay x + C noise, from rest."""
    y = [0.0] * len(x)
    for k in range(len(a) + delay + len(b), len(x)):
        y[k] = (-sum(a[i] * y[k - 1 - i] for i in range(len(a)))
                + sum(b[i] * x[k - delay - 1 - i] for i in range(len(b)))
                + noise[k] + sum(c[i] * noise[k - 1 - i] for i in range(len(c))))
    return np.array(y)


def signed_rank_sum(differences):
    """Wilcoxon's sum of the ranks of |d|, each with the sign of d (no ties)."""
    total = 0
    for d in differences:
        rank = sum(abs(other) <= abs(d) for other in differences)
        total += rank if d > 0 else -rank
    return total


def first_order_step(time_s, gain, time_constant_s, dead_time_s, at_s, size, level):
    """Response of a first-order process with dead time to one step of the command."""
    after = np.maximum(np.asarray(time_s) - at_s - dead_time_s, 0.0)
    return level + gain * size * (1.0 - np.exp(-after / time_constant_s))
