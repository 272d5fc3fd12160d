"""The splines a motion is sought among."""

import numpy as np
from scipy.interpolate import BSpline

from dynident.estimators.maximum_likelihood import SplineTrajectory
from dynident.estimators.maximum_likelihood.trajectory import DEGREE, graded_breaks


class TestTrajectory:
    def test_agrees_with_scipy(self, rng: np.random.Generator) -> None:
        path = SplineTrajectory(np.array([0.0, 0.1, 0.3, 0.7, 1.0]))
        t = np.sort(rng.uniform(0, 1, 50))
        local, first = path.local(t), path.first_coefficient[path.interval(t)]
        for order in range(3):
            whole = np.zeros((50, path.size))
            whole[np.arange(50)[:, None], first[:, None] + np.arange(5)] = local[order]
            spline = BSpline(path.knots, np.eye(path.size), DEGREE)
            np.testing.assert_allclose(whole, spline.derivative(order)(t) if order else spline(t), atol=1e-10)

    def test_acceleration_jumps_at_a_step_only(self, rng: np.random.Generator) -> None:
        path = SplineTrajectory(np.array([0.0, 0.2, 0.5, 0.8, 1.0]), steps=(0.5,))
        C = rng.standard_normal(path.size)

        def value(t: float, order: int) -> float:
            return float(
                path.local(np.array([t]))[order, 0] @ C[path.first_coefficient[path.interval(np.array([t]))[0]] :][:5]
            )

        for order, jumps in ((0, False), (1, False), (2, True)):
            gap = abs(value(0.5 + 1e-9, order) - value(0.5 - 1e-9, order))
            assert (gap > 1e-3) == jumps
        assert abs(value(0.2 + 1e-9, 2) - value(0.2 - 1e-9, 2)) < 1e-4

    def test_breaks_are_dense_after_a_step(self) -> None:
        breaks = graded_breaks((0.0, 10.0), [3.0], 0.01, 0.5, 1.3)
        assert (breaks[0], breaks[-1]) == (0.0, 10.0)
        assert 3.0 in breaks
        size = np.diff(breaks)
        assert size[breaks[:-1] < 3.0].min() > 0.4
        assert size[breaks[:-1] >= 3.0][0] <= 0.01
        assert size.max() <= 0.5 + 1e-12
