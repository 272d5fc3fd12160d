"""Splines of a trajectory at given times, and a matrix with a band and a border: solved and inverted."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dynident.estimators.maximum_likelihood import SplineTrajectory
from dynident.estimators.maximum_likelihood.trajectory import DEGREE, Arrow
from dynident.runtime import ModelError


class TestTrajectory:
    def test_agrees_with_scipy(self, rng: np.random.Generator) -> None:
        path = SplineTrajectory(np.array([0.0, 0.1, 0.3, 0.7, 1.0]))
        t = np.sort(rng.uniform(0, 1, 50))
        local, first = path.local(t), path.first_coefficient[path.interval(t)]
        for order in range(3):
            zeros = np.zeros((50, path.size))
            zeros[np.arange(50)[:, None], first[:, None] + np.arange(5)] = local[order]
            spline = BSpline(path.knots, np.eye(path.size), DEGREE)
            np.testing.assert_allclose(zeros, spline.derivative(order)(t) if order else spline(t), atol=1e-10)


T = np.linspace(0.0, 1.0, 41)


class TestArrow:
    def matrix(self, rng: np.random.Generator, size: int = 14, w: int = 4) -> tuple[np.ndarray, np.ndarray]:
        L = np.tril(rng.standard_normal((size, size))) * (np.abs(np.subtract.outer(range(size), range(size))) < w)
        A = (L + 3 * np.eye(size)) @ (L + 3 * np.eye(size)).T
        band = np.zeros((w, size))
        for d in range(w):
            band[d, : size - d] = np.diag(A, -d)
        return A, band

    def test_solves_and_inverts(self, rng: np.random.Generator) -> None:
        A, band = self.matrix(rng)
        B = rng.standard_normal((14, 3))
        arrow, inverse = Arrow(band, B), np.linalg.inv(A)
        np.testing.assert_allclose(arrow.solve_band(B), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.solve_transposed(arrow.half), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.lost_information, B.T @ inverse @ B, rtol=1e-10)
        for d in range(4):
            np.testing.assert_allclose(arrow.inverse[d, : 14 - d], np.diag(inverse, -d), rtol=1e-9, atol=1e-14)

    def test_refuses_what_is_not_determined(self) -> None:
        with pytest.raises(ModelError, match="not determined"):
            Arrow(np.zeros((2, 5)), np.zeros((5, 1))).solve_band(np.ones((5, 1)))
