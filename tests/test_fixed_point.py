"""Anderson's acceleration: the fixed point of a contraction, in fewer evaluations than damped steps need."""

import numpy as np
import pytest

from stictionid.numerics.fixed_point import fixed_point


def _solved(matrix: np.ndarray, offset: np.ndarray, curve: float) -> tuple[np.ndarray, int]:
    count = 0

    def evaluate(point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nonlocal count
        count += 1
        return point, matrix @ point + curve * np.sin(point) + offset

    found = fixed_point(evaluate, np.zeros(offset.size), lambda _, r: bool(np.abs(r).max() < 1e-9), 200)
    return found, count


@pytest.mark.parametrize("share", [0.3, 0.9, -0.9])
def test_a_linear_map_is_solved(share: float) -> None:
    rng = np.random.default_rng(1)
    axes, _ = np.linalg.qr(rng.standard_normal((40, 40)))
    matrix = axes @ np.diag(share * rng.random(40)) @ axes.T
    offset = rng.standard_normal(40)
    found, count = _solved(matrix, offset, 0.0)
    np.testing.assert_allclose(found, np.linalg.solve(np.eye(40) - matrix, offset), atol=1e-7)
    damped, point = 0, np.zeros(40)
    while np.abs(matrix @ point + offset - point).max() >= 1e-9:
        point, damped = point + 0.5 * (matrix @ point + offset - point), damped + 1
    assert count < damped


def test_a_nonlinear_map_is_solved() -> None:
    rng = np.random.default_rng(2)
    matrix, offset = 0.1 * rng.standard_normal((10, 10)), rng.standard_normal(10)
    found, _ = _solved(matrix, offset, 0.4)
    np.testing.assert_allclose(found, matrix @ found + 0.4 * np.sin(found) + offset, atol=1e-8)


def test_a_map_without_a_fixed_point_in_reach_ends() -> None:
    _, count = _solved(3.0 * np.eye(5), np.ones(5), 0.0)
    assert count <= 201
