"""Direct least-squares fit of an ellipse to points, and the width of the ellipse along the x axis.

The fit minimises the algebraic distance |a x^2 + b x y + c y^2 + d x + e y + f| under 4 a c - b^2 = 1. The constraint
admits ellipses only and makes the fit one eigenvalue problem. The points are centred and scaled first and the linear
part is eliminated, so that the problem stays well conditioned.

Wrong for points on a line: no ellipse exists, and the fit returns None. Wrong, too, for a small arc, where the
algebraic distance makes the ellipse too flat.

Source: Fitzgibbon, Pilu and Fisher 1999, "Direct least square fitting of ellipses"; the reduction to 3 x 3 of Halir
and Flusser 1998.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import FloatArray

# Points lie on a line if their spread across the main direction is below this share of that along it. Unit: 1.
_FLAT = 1e-6


@dataclass(frozen=True, slots=True)
class Ellipse:
    """a x^2 + b x y + c y^2 = 1 about a centre (x, y), in the units of the points."""

    a: float
    b: float
    c: float
    centre: tuple[float, float]

    @property
    def width(self) -> float:
        """Chord through the centre along x, 2 m n / sqrt(m^2 sin^2 + n^2 cos^2) for half axes m, n at an angle."""
        return 2.0 / float(np.sqrt(self.a))

    @property
    def extent(self) -> float:
        """Whole size along x, from the leftmost to the rightmost point."""
        return 2.0 * float(np.sqrt(self.c / (self.a * self.c - 0.25 * self.b**2)))


def fit_ellipse(x: FloatArray, y: FloatArray) -> Ellipse | None:
    """The ellipse that fits points (n,), (n,) best; None where they lie on a line or are fewer than six."""
    if x.size < 6:
        return None
    middle = (float(x.mean()), float(y.mean()))
    scale = (float(x.std()), float(y.std()))
    if min(scale) <= 0.0:
        return None
    px, py = (x - middle[0]) / scale[0], (y - middle[1]) / scale[1]
    if np.linalg.svd(np.stack([px, py]), compute_uv=False)[1] < _FLAT * np.sqrt(px.size):
        return None
    squares = np.stack([px**2, px * py, py**2], axis=1)
    lines = np.stack([px, py, np.ones_like(px)], axis=1)
    # The linear part follows from the quadratic one, which leaves a 3 x 3 problem with 4ac - b^2 = 1.
    follow = -np.linalg.solve(lines.T @ lines, lines.T @ squares)
    reduced = squares.T @ squares + squares.T @ lines @ follow
    bound = np.array([reduced[2] / 2.0, -reduced[1], reduced[0] / 2.0])
    values, vectors = np.linalg.eig(bound)
    vectors = np.real(vectors[:, np.abs(np.imag(values)) < 1e-9])
    good = 4.0 * vectors[0] * vectors[2] - vectors[1] ** 2 > 0.0
    if not good.any():
        return None
    quadratic = vectors[:, np.flatnonzero(good)[0]]
    a, b, c = quadratic
    d, e, f = follow @ quadratic
    cx, cy = np.linalg.solve(np.array([[2.0 * a, b], [b, 2.0 * c]]), [-d, -e])
    size = -(f + 0.5 * (d * cx + e * cy))
    if size == 0.0 or a / size <= 0.0:
        return None
    return Ellipse(float(a / size / scale[0] ** 2), float(b / size / (scale[0] * scale[1])),
                   float(c / size / scale[1] ** 2), (middle[0] + cx * scale[0], middle[1] + cy * scale[1]))
