"""What every smoother promises (``dynident.testing``), for the whole family. A new smoother is added to SMOOTHERS."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import (
    Butterworth,
    Difference,
    FourierSeries,
    KalmanSmoother,
    SavitzkyGolay,
    Smoother,
    Spline,
    TimeShifted,
)
from dynident.motion.splines import GCV, REML, Fixed, Interpolation, smooth
from dynident.runtime import MissingInputError
from dynident.runtime.families import SMOOTHERS as FAMILY
from dynident.testing import SMOOTHER_CHECKS, check_smoother
from dynident.testing.smoother import make_log, motion_for, two_sines

SMOOTHERS = [
    Difference(),
    Difference("central"),
    Butterworth(),
    Butterworth(orders=(2, 2, 2), cutoffs=(40.0, 40.0, 40.0)),
    Spline(),
    Spline(sigma=1e-4),
    Spline(sigma={"b": 1e-4}),
    Spline(GCV()),
    Spline(REML()),
    Spline(Fixed(lam=1e-7)),
    Spline(Interpolation()),
    KalmanSmoother(),
    KalmanSmoother(2),
    KalmanSmoother(sigma={"b": 1e-4}),
    KalmanSmoother(2, 1e-4, 3.0),
    SavitzkyGolay(),
    SavitzkyGolay({"b": 0.3}, order=3),
    FourierSeries(),
    FourierSeries(3.7),
    FourierSeries(3.7, {"b": 2}, (0.5, 0.0)),
    TimeShifted(Spline(), 0.0),
]
RESTING = [Spline(), KalmanSmoother(), KalmanSmoother(2), SavitzkyGolay(), FourierSeries()]
NOISY = [s for s in SMOOTHERS if isinstance(s, Spline | KalmanSmoother)]


@pytest.mark.parametrize("check", SMOOTHER_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("smoother", SMOOTHERS, ids=repr)
def test_every_smoother(smoother: Smoother, check: Callable[[Smoother], None]) -> None:
    check(smoother)


def test_every_kind_is_checked() -> None:
    assert {FAMILY.kind_of(smoother) for smoother in SMOOTHERS} == set(FAMILY.table)


@pytest.mark.parametrize("smoother", NOISY, ids=repr)
def test_splines_take_irregular_times_as_they_are(smoother: Smoother) -> None:
    made = smoother(make_log(0.0, jitter=0.9))
    true = two_sines(made.t)[2]
    assert np.abs(made.ddq - true)[made.mask].max() < 3e-2 * np.abs(true).max()


@pytest.mark.parametrize("time_offset", [0.003, -0.0071, 0.25])
def test_a_shifted_spline_is_the_spline_at_later_times(time_offset: float) -> None:
    """Between samples a cubic spline's second derivative is straight: the shift is exact."""
    log = make_log(1e-4, jitter=0.3)
    fit = smooth(log.t, log.q)
    made = TimeShifted(Spline(), time_offset)(log)
    seen = (log.t + time_offset >= log.t[0]) & (log.t + time_offset <= log.t[-1])
    for order, result in enumerate((made.q, made.dq, made.ddq)):
        expected = fit(log.t[seen] + time_offset, order)
        assert np.abs(result[seen] - expected).max() < 1e-9 * np.abs(expected).max()
    assert not made.mask[~seen].any()
    np.testing.assert_array_equal(made.tau, log.tau)


@pytest.mark.parametrize("smoother", [SavitzkyGolay(), FourierSeries()], ids=repr)
def test_what_is_least_squares_takes_irregular_times_as_they_are(smoother: Smoother) -> None:
    motion = motion_for(smoother)
    made = smoother(make_log(0.0, jitter=0.9, motion=motion))
    true = motion(made.t)[2]
    assert np.abs(made.ddq - true)[made.mask].max() < 1e-5 * np.abs(true).max()


@cache
def moved_alone(smoother: Smoother, size: float) -> tuple[Log, Motion]:
    """Return a log of one joint that moves, and what a smoother makes of it."""
    log = make_log(1e-5, n=2000, h=5e-3, motion=motion_for(smoother))
    log = replace(log, q=size * log.q).select(("b",))
    return log, smoother(log)


@pytest.mark.parametrize("smoother", RESTING, ids=repr)
@pytest.mark.parametrize("kind", ["noise", "flicker", "constant"])
@pytest.mark.parametrize("size", [1.0, 1e-4])
def test_a_joint_at_rest_has_no_velocity_and_takes_nothing_from_one_that_moves(
    smoother: Smoother, kind: str, size: float
) -> None:
    (log, alone), rng = moved_alone(smoother, size), np.random.default_rng(5)
    rests = {"noise": 1e-5 * rng.standard_normal(len(log)), "flicker": 1e-4 * (rng.uniform(size=len(log)) > 0.7)}
    rest = 0.4 + rests.get(kind, np.zeros(len(log)))
    made = smoother(Log(log.t, np.column_stack([rest, log.q]), np.column_stack([log.tau, log.tau]), ("a", "b"), "made"))
    assert made.q[:, 0] == pytest.approx(rest.mean(), rel=1e-12)
    assert not made.dq[:, 0].any()
    assert not made.ddq[:, 0].any()
    if not isinstance(smoother, Spline):  # whose ends count all widths
        np.testing.assert_array_equal(made.mask, alone.mask)
    np.testing.assert_allclose(made.ddq[:, 1], alone.ddq[:, 0], atol=1e-6 * np.abs(alone.ddq).max())
    assert np.ptp(made.ddq[:, 1]) > size


@dataclass(frozen=True)
class Picky(Smoother):
    """A smoother that misses what no motion has."""

    def __call__(self, log: Log) -> Motion:
        raise MissingInputError(f"{log.source}: the moon is missing")


@dataclass(frozen=True)
class Lopsided(Smoother):
    """A smoother that is not linear in the positions."""

    def __call__(self, log: Log) -> Motion:
        made = Spline()(log)
        return replace(made, ddq=made.ddq + 1e-3 * np.abs(log.q - made.q) / 1e-4)


@dataclass(frozen=True)
class Careless(Smoother):
    """A smoother that says too much of the ends."""

    def __call__(self, log: Log) -> Motion:
        return replace(Spline()(log), mask=np.ones(len(log), dtype=bool))


@pytest.mark.parametrize("smoother", [TimeShifted(Spline(), 0.2), Careless(), Lopsided()], ids=repr)
def test_a_smoother_that_breaks_a_promise_is_found(smoother: Smoother) -> None:
    with pytest.raises(AssertionError):
        check_smoother(smoother)


def test_a_smoother_that_misses_something_in_every_motion_is_found() -> None:
    with pytest.raises(MissingInputError, match="the moon"):
        check_smoother(Picky())
