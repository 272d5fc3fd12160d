"""Searches for p."""

from __future__ import annotations

import pytest

from dynident.splines.search import hermite


def test_inverse_hermite_interpolation_is_exact_for_a_cubic() -> None:
    """The search knows (x, error, slope of the error): of x = 2 + 3 e - e^2 + e^3 / 2, the zero of e is at x = 2."""

    def point(e: float) -> tuple[float, float, float]:
        return 2 + 3 * e - e**2 + e**3 / 2, e, 1 / (3 - 2 * e + 1.5 * e**2)

    for a, b in ((0.7, -0.4), (-0.4, 0.7), (0.3, 0.9)):
        assert hermite(point(a), point(b)) == pytest.approx(2.0, rel=1e-12)
