"""Total least squares: the textbook's closed form, exact columns, the noise that a motion has left, and limits."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem, TotalLeastSquares
from dynident.estimators.notes import ErrorsInRegressor
from dynident.estimators.total_least_squares import _solve_total, motion_noise
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Difference, Spline
from dynident.regression import Regression, rank_of
from dynident.runtime import ConfigError, InputError, Use
from dynident.testing.estimator import make_problem

JOINT = (Joint("one", "prismatic"),)
CART = Model((RotorInertia(JOINT), Viscous(JOINT), Offset(JOINT)))
NAMES = CART.names


def noisy(errors: tuple[float, float], torque: float, seed: int = 0, samples: int = 4000) -> Problem:
    """A cart whose accelerations and velocities have independent errors: textbook errors in two of three columns."""
    rng = np.random.default_rng(seed)
    dq, ddq = rng.standard_normal((2, samples, 1))
    tau = 2.0 * ddq + 0.7 * dq + 0.4 + torque * rng.standard_normal((samples, 1))
    ddq, dq = ddq + errors[0] * rng.standard_normal(dq.shape), dq + errors[1] * rng.standard_normal(dq.shape)
    t, mask = np.arange(samples) * 0.01, np.ones(samples, dtype=bool)
    return make_problem(CART, Motion(t, np.zeros_like(dq), dq, ddq, tau, ("one",), mask))


def stated(errors: tuple[float, float], torque: float | None = None) -> TotalLeastSquares:
    return TotalLeastSquares(dict(zip(NAMES[:2], errors, strict=True)), torque)


def test_textbook():
    """With equal errors in all entries it is the last right singular vector of [X y]."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((200, 3)) @ np.diag([1.0, 2.0, 0.5])
    full = np.column_stack([X, X @ [1.0, -2.0, 3.0]]) + 0.1 * rng.standard_normal((200, 4))
    factor = np.linalg.qr(full, mode="r")
    v = np.linalg.svd(full)[2][-1]
    result = _solve_total(factor, 7.0 * np.eye(3), rank_of(factor), 200, 7.0)
    np.testing.assert_allclose(result.value, -v[:3] / v[3], rtol=1e-9)


def test_exact_columns_stay_exact():
    """Van Huffel's mixed LS-TLS: the exact columns eliminated first, by their QR, total least squares of the rest."""
    rng = np.random.default_rng(1)
    X = rng.standard_normal((300, 3))
    y = X @ [1.0, -2.0, 3.0] + 0.1 * rng.standard_normal(300)
    X[:, 1:] += 0.1 * rng.standard_normal((300, 2))
    factor = np.linalg.qr(np.column_stack([X, y]), mode="r")
    left = factor[1:, 1:]
    v = np.linalg.svd(left)[2][-1]
    rest = -v[:2] / v[2]
    first = (factor[0, 3] - factor[0, 1:3] @ rest) / factor[0, 0]
    result = _solve_total(factor, np.diag([0.0, 1.0, 1.0]), rank_of(factor), 300, 1.0)
    np.testing.assert_allclose(result.value, [first, *rest], rtol=1e-9)


@pytest.mark.parametrize("torque", [None, 0.05], ids=["torque error unknown", "known"])
def test_consistent_with_honest_errors(torque):
    """Least squares is biased by many standard errors; this is not, and 95 % of its intervals hold."""
    errors, inside, off = (0.3, 0.1), [], []
    for seed in range(40):
        problem = noisy(errors, 0.05, seed, 1000)
        result, plain = stated(errors, torque)(problem), LeastSquares()(problem)
        inside.append(np.abs(result.value - [2.0, 0.7, 0.4]) < 1.96 * result.std)
        off.append(np.abs(plain.value[0] - 2.0) / plain.std[0])
    assert np.min(off) > 4
    assert 0.89 < np.mean(inside) < 0.995  # of 120


def test_it_becomes_exact_with_more_data():
    far, near = (abs(stated((0.3, 0.1))(noisy((0.3, 0.1), 0.05, 3, n)).value[0] - 2.0) for n in (500, 200_000))
    assert near < 0.004
    assert near < far


def test_noise_of_the_positions():
    """Of what smoothing leaves of it, nine tenths of the bias go, and the intervals allow for the rest."""
    arm = ARM
    plain, total, std = [], [], []
    for seed in range(8):
        log = recorded(2e-3, seed)
        smooth = Spline(sigma=1.8e-3)(log)
        problem = Problem(arm, (smooth,), Regression(arm, (smooth,)), (log,))
        result = TotalLeastSquares()(problem)
        assert result.information is not None
        plain.append(LeastSquares()(problem).value / arm.values - 1)
        total.append(result.value / arm.values - 1)
        std.append(result.std / arm.values)
    assert (np.mean(plain, axis=0) < -0.04).all()
    assert (np.abs(np.mean(total, axis=0)) < 0.2 * np.abs(np.mean(plain, axis=0))).all()
    assert (np.sqrt(np.square(total).mean(axis=0)) < 2 * np.mean(std, axis=0)).all()


def test_more_error_than_motion_forbids_any_use_also_of_a_consistent_fit():
    size, problem = (1.1, 0.0), noisy((1.1, 0.0), 0.05)
    for estimator in (stated(size), PhysicallyConsistent(fit=stated(size), prior="none")):
        (note,) = (note for note in estimator(problem).notes if isinstance(note, ErrorsInRegressor))
        assert note.forbidden is Use.CONTROL


def test_no_solution():
    """The nongeneric case: the direction of least singular value has no share of the torque."""
    factor = np.linalg.qr(np.diag([1.0, 5.0, 1.0]) + np.eye(3, k=1) * [0.0, 0.0, 2.0], mode="r")
    with pytest.raises(InputError, match="no solution"):
        _solve_total(factor, np.diag([1e6, 0.0]), rank_of(factor), 100, 1.0)


def test_wrong_settings_are_named():
    with pytest.raises(ConfigError, match="J = -1"):
        TotalLeastSquares({"J": -1.0})
    with pytest.raises(ConfigError, match="has no parameter 'x'"):
        TotalLeastSquares({"x": 1.0})(noisy((0.0, 0.0), 0.1))
    assert TotalLeastSquares({"x": 1.0, "y": 2.0}).among(["y"]).named == ("y",)


T = np.arange(2001) * 0.01
ARM = pendulum()


@cache
def exact() -> Motion:
    return simulate(ARM, ARM.values, lambda s: [0.4 * np.sin(5 * s)], T)


def recorded(sigma: float, seed: int = 0) -> Log:
    return record(exact(), sigma_q=sigma, sigma_tau=0.01, rng=np.random.default_rng(seed)).log


@pytest.mark.parametrize("sigma", [5e-4, 2e-3])
@pytest.mark.parametrize("smoother", [Spline, Butterworth, Difference], ids=lambda x: x.__name__)
def test_errors_that_are_drawn_are_as_large_as_the_true_ones(smoother, sigma):
    log = recorded(sigma)
    part = {Spline: Spline(sigma=0.9 * sigma), Butterworth: Butterworth(cutoffs=(8.0, 8.0, 8.0)),
            Difference: Difference("central")}[smoother]  # fmt: skip
    motion = part(log)
    noise = motion_noise(log, motion)
    np.testing.assert_allclose(np.sqrt(noise.density / 0.02), sigma, rtol=0.05)
    again = noise.draw(motion, np.random.default_rng(1))
    clean = exact() if smoother is Spline else part(replace(log, q=exact().q))
    for name in ("dq", "ddq"):
        made, true = (getattr(again, name) - getattr(motion, name)), (getattr(motion, name) - getattr(clean, name))
        near = 1.4 if smoother is Spline else 2.5  # another smoother has another shape than a spline's
        ratio = made[motion.mask].std() / true[motion.mask].std()
        assert 1 / near < ratio < near, (name, ratio)


def test_few_samples_show_nothing():
    log = recorded(2e-3).window(0, 0.1)
    motion = Difference("central")(log)
    assert (motion_noise(log, motion).density == 0).all()
