"""Wrong torques are left out of the fit, true ones are not, and held-out ones are told."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.identification import Identification, Recipe, identify, judge
from dynident.identification.outliers import HeldOutOutliers
from dynident.identification.verdict_reasons import SilentTorque
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.regression import ParallelFilter
from dynident.runtime import InputError, Use
from dynident.testing.estimator import multisine_motion

ARM = pendulum()
T = np.arange(2000) * 0.005


@cache
def motion(rate: float) -> Motion:
    return simulate(ARM, ARM.values, lambda t: [0.4 * np.sin(rate * t) + np.sin(2.3 * t)], T, tolerance=1e-9)


def log(seed: int, rate: float = 9.0) -> Log:
    return record(motion(rate), sigma_q=1e-4, sigma_tau=0.02, rng=np.random.default_rng(seed)).log


TRAIN, HELD = log(1), log(2, 8.0)


def put(case: Log, rows: list[int] | slice, value: float) -> Log:
    tau = case.tau.copy()
    tau[rows] = value
    return replace(case, tau=tau)


def fitted(case: Log, held: Log | None = None, **changes) -> Identification:
    validation = {} if held is None else {"b": held}
    return identify(ARM, {"a": case}, validation, replace(Recipe(Spline(sigma=1e-4)), **changes))


@cache
def unspoilt(**changes: Any) -> Identification:
    return fitted(TRAIN, **changes)


WRONG = {
    "one of 5000 N m": put(TRAIN, [777], 5000.0),
    "spikes": put(TRAIN, list(range(100, 1900, 120)), -30.0),
    "frozen": put(TRAIN, slice(800, 1100), 0.7),
    "zeroed": put(TRAIN, slice(800, 1100), 0.0),
    "clipped": replace(TRAIN, tau=np.clip(TRAIN.tau, -0.8, 0.8)),
}


@pytest.mark.parametrize(
    ("kind", "changes"),
    [
        *((kind, {}) for kind in WRONG),
        ("spikes", {"filter": ParallelFilter(4)}),
        ("frozen", {"time_offset": "estimate"}),
    ],
)
def test_the_fit_is_that_without_them(kind: str, changes: dict) -> None:
    """Within 5 standard errors of the fit to the clean log."""
    clean, fit = unspoilt(**changes), fitted(WRONG[kind], **changes)
    assert np.all(np.abs(fit.estimate.value - clean.estimate.value) < 5 * np.maximum(clean.errors.std, fit.errors.std))


@pytest.mark.parametrize("seed", range(8))
def test_a_clean_log_loses_nothing(seed: int) -> None:
    (validation,) = fitted(log(seed)).validations
    assert validation.motion.keep is None


def test_a_held_out_log_is_judged_as_measured_and_its_outliers_told() -> None:
    fit = fitted(TRAIN, put(HELD, [500, 900], 40.0))
    (note,) = (warning for warning in fit.warnings if isinstance(warning, HeldOutOutliers))
    assert (note.log, note.joints, note.count) == ("b", ("pivot",), 2)
    assert note.error == fit.validations[1].errors.relative_error > 80
    assert note.forbidden is Use.SIMULATION
    assert replace(note, without=0.6 * note.error).forbidden is None
    assert note.without == pytest.approx(fitted(TRAIN, HELD).validations[1].errors.relative_error, rel=0.01)


@pytest.mark.parametrize("estimator", [LeastSquares(), MaximumLikelihood()], ids=["least squares", "likelihood"])
@pytest.mark.parametrize("row", [0, 777, -1])
def test_every_estimator_leaves_them_out_also_at_the_ends(estimator: Estimator, row: int) -> None:
    """The first message of a driver is often zero, or what was left in its buffer."""
    q = TRAIN.q.copy()
    q[row] += 3.0
    clean = unspoilt(estimator=estimator)
    for wrong in (replace(TRAIN, q=q), put(TRAIN, [row], 500.0)):
        fit = fitted(wrong, estimator=estimator)
        assert np.all(np.abs(fit.estimate.value - clean.estimate.value) < 2 * clean.errors.std)


def test_torques_that_are_all_zero_are_refused() -> None:
    with pytest.raises(InputError, match="all torques of the training are zero"):
        fitted(replace(TRAIN, tau=0 * TRAIN.tau))


@cache
def two_links(tau2: float | None = None) -> Log:
    """A recording of two joints, of which the second torque may be constant."""
    motion = multisine_motion(two_link_arm())
    log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    return log if tau2 is None else replace(log, tau=np.column_stack([log.tau[:, 0], np.full(len(log), tau2)]))


@pytest.mark.parametrize(
    ("estimator", "constant"),
    [(LeastSquares(), 7.5), (PhysicallyConsistent(), 0.0), (MaximumLikelihood(), 0.0)],
    ids=lambda value: type(value).__name__,
)
def test_a_torque_that_was_never_recorded_spoils_nothing(estimator: Estimator, constant: float) -> None:
    """The first joint is fitted as if the second had no equation; of the second there is no error."""
    arm, clean, recipe = two_link_arm(), two_links(), Recipe(Spline(sigma=1e-4), estimator)
    unknown = replace(clean, keep=np.column_stack([np.ones(len(T), bool), np.zeros(len(T), bool)]))
    reference, result = (identify(arm, {"a": x}, {"b": x}, recipe) for x in (unknown, two_links(constant)))
    for case, expected in zip(result.validations, reference.validations, strict=True):
        assert not case.motion.keep[:, 1].any()
        assert case.errors.per_joint["joint1"] == pytest.approx(expected.errors.per_joint["joint1"], rel=1e-3)
        assert case.errors.relative_error == case.errors.per_joint["joint1"] < 3
        assert np.isnan([case.errors.per_joint["joint2"], case.errors.rmse["joint2"]]).all()
        assert set(case.residuals) == {"joint1"}
    (reason,) = (reason for reason in judge(result).reasons if isinstance(reason, SilentTorque))
    assert reason.joints == ("joint2",)


def test_a_joint_that_turns_freely_is_fitted() -> None:
    """Zero is the torque of a passive joint, by which the other joint's determines all parameters of both."""
    arm = two_link_arm()
    passive = np.array([*arm.values[:-1], 0.0])
    motion = simulate(arm, passive, lambda t: [4 * np.sin(2 * t) + 2 * np.sin(3.1 * t), 0.0], T[:600])
    log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    free = replace(log, tau=log.tau * [1.0, 0.0])
    result = identify(arm, {"a": free}, {}, Recipe(Spline(sigma=1e-4)))
    keep = result.validations[0].motion.keep
    assert keep is None or keep[:, 1].all()
    assert np.all(np.abs(result.estimate.value - passive) < 0.03 * np.abs(passive).max())
