"""Smoothers, estimators and filters in words."""

from dataclasses import dataclass, fields

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
from dynident.runtime import part_text
from dynident.runtime.families import ESTIMATORS, SMOOTHERS
from tests.kept import check_kept


@dataclass(frozen=True)
class Own:
    """A part of the user."""

    window_length: float = 2.0
    robust: bool = False


PARTS = (
    Spline(), Spline(factor=1.4), Spline(ends=50), Spline(Constraint(S=900.0)), Spline(GCV(), sigma=1e-3),
    Spline(REML(), factor=2.0), Spline(Interpolation()), Spline(Fixed(lam=(1, 2e-7)), {"a": 0.1}),
    Difference("central"), Butterworth(), KalmanSmoother(), KalmanSmoother(2, 1e-4),
    KalmanSmoother(3, {"a": 0.1}, {"a": 2.0}, 3.0), SavitzkyGolay(), SavitzkyGolay(0.25, 3),
    SavitzkyGolay({"a": 0.25}), SavitzkyGolay(factor=2.0), FourierSeries(), FourierSeries(10.0, 5),
    TimeShifted(Spline(), 0.0021677462751214516), LeastSquares(), WeightedLeastSquares(),
    GeneralisedLeastSquares(max_order=5), LeastSquares(weights="per_joint", iterations=4),
    PhysicallyConsistent(viscous=False), MaximumLikelihood(start="rest"), RobustLeastSquares("tukey", tuning=6.0),
    Ridge(strength=0.1), TotalLeastSquares({"J": 0.1}), AugmentedKalman(), ParallelFilter(50),
    ParallelFilter(cutoff=20.0), Own(), Own(3.5, True), object(),
)  # fmt: skip


def test_parts_in_words():
    check_kept("part_words", "\n".join(map(part_text, PARTS)))


def test_no_part_of_the_package_is_a_repr():
    for family in (SMOOTHERS, ESTIMATORS):
        for kind in family.table:
            cls = family.get(kind)
            part = cls(Spline(), 0.1) if cls is TimeShifted else cls()
            assert "(" not in part_text(part)
            assert not any(f"{field.name}=" in part_text(part) for field in fields(part))
