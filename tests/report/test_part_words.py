"""Smoothers, estimators and filters in words."""

from dataclasses import dataclass, fields

import pytest

from dynident.estimators import (
    AugmentedKalman,
    GeneralisedLeastSquares,
    LeastSquares,
    PhysicallyConsistent,
    Ridge,
    RobustLeastSquares,
    TotalLeastSquares,
    WeightedLeastSquares,
)
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Spline,
    TimeShifted,
)
from dynident.motion.splines import GCV, REML, Constraint, Fixed, Interpolation
from dynident.regression import ParallelFilter
from dynident.runtime import part_text, setting_text
from dynident.runtime.families import ESTIMATORS, SMOOTHERS


@dataclass(frozen=True)
class Own:
    """A part of the user."""

    window_length: float = 2.0
    robust: bool = False


@pytest.mark.parametrize(
    ("part", "words"),
    [
        (Spline(), "smoothing spline, S = n"),
        (Spline(factor=1.4), "smoothing spline, S = 1.96 n (1.4 times the noise)"),
        (Spline(ends=50), "smoothing spline, S = n, 50 bandwidths left out at the ends"),
        (Spline(Constraint(S=900.0)), "smoothing spline, S = 900"),
        (Spline(GCV(), sigma=1e-3), "smoothing spline, by generalised cross-validation, noise 0.001 rad or m"),
        (Spline(REML(), factor=2.0), "smoothing spline, by restricted maximum likelihood, 2 times the noise"),
        (Spline(Interpolation()), "interpolating spline"),
        (Spline(Fixed(lam=(1, 2e-7)), {"a": 0.1}), "smoothing spline, lam (1, 2.000e-7), noise (a 0.1) rad or m"),
        (Difference("central"), "central differences"),
        (Butterworth(), "forward differences, Butterworth filters of orders 3, 3, 4 at 10, 3, 2 Hz"),
        (KalmanSmoother(), "Kalman smoother of order 3, by maximum likelihood"),
        (KalmanSmoother(2, 1e-4), "Kalman smoother of order 2, noise 0.0001 rad or m, the rest by maximum likelihood"),
        (
            KalmanSmoother(3, {"a": 0.1}, {"a": 2.0}, 3.0),
            "Kalman smoother of order 3, noise (a 0.1) rad or m, intensity (a 2), ends 3",
        ),
        (SavitzkyGolay(), "Savitzky-Golay polynomials of order 4"),
        (SavitzkyGolay(0.25, 3), "Savitzky-Golay polynomials of order 3, window 0.25 s"),
        (SavitzkyGolay({"a": 0.25}), "Savitzky-Golay polynomials of order 4, windows (a 0.25) s"),
        (SavitzkyGolay(factor=2.0), "Savitzky-Golay polynomials of order 4, 2 times the window best for ddq"),
        (FourierSeries(), "Fourier series"),
        (FourierSeries(10.0, 5), "Fourier series of period 10 s, harmonics 5"),
        (TimeShifted(Spline(), 0.0021677462751214516), "smoothing spline, S = n, shifted by 2.17 ms"),
        (LeastSquares(), "least squares"),
        (WeightedLeastSquares(), "least squares, weighted by the noise of all joints"),
        (
            GeneralisedLeastSquares(max_order=5),
            "generalised least squares, with autoregressive noise, max order 5",
        ),
        (LeastSquares(weights="per_joint", iterations=4), "least squares, weighted by joint, iterations 4"),
        (PhysicallyConsistent(viscous=False), "physically consistent least squares, viscous off"),
        (MaximumLikelihood(start="rest"), "maximum likelihood, start rest"),
        (RobustLeastSquares("tukey", tuning=6.0), "robust least squares, Tukey's weights, tuning 6"),
        (Ridge(strength=0.1), "ridge regression, strength 0.1"),
        (TotalLeastSquares({"J": 0.1}), "total least squares, errors ((J, 0.1))"),
        (AugmentedKalman(), "extended Kalman filter of motion and parameters"),
        (ParallelFilter(50), "low-pass of order 4 at 0.8 of half the decimated rate, one of 50 samples kept"),
        (ParallelFilter(cutoff=20.0), "low-pass of order 4 at 20 Hz"),
        (Own(), "Own"),
        (Own(3.5, True), "Own, window length 3.5, robust on"),
        (object(), "object"),
    ],
)  # fmt: skip
def test_parts_in_words(part, words):
    assert part_text(part) == words


def test_no_part_of_the_package_is_a_repr():
    for family in (SMOOTHERS, ESTIMATORS):
        for kind in family.table:
            cls = family.get(kind)
            part = cls(Spline(), 0.1) if cls is TimeShifted else cls()
            assert "(" not in part_text(part)
            assert not any(f"{one.name}=" in part_text(part) for one in fields(part))


def test_values():
    assert setting_text({"a": (None, 0.5)}) == "(a (none, 0.5))"
    assert setting_text(list(range(12))) == "(0, 1, 2, 3, 4, 5, 6, 7, ...)"
    assert setting_text(Own()) == "Own"
