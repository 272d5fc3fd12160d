"""What errors of the smoothed motion do to an estimate: predicted, corrected, counted, and said."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem, RobustLeastSquares
from dynident.estimators.notes import MotionCorrected, MotionTooNoisy
from dynident.identification import Identification, Recipe, align_motion, find_time_offset, identify
from dynident.identification.motion_errors import (
    MotionErrors,
    RepetitionFactors,
    motion_errors,
    repeat_piece,
    sampled_bias,
)
from dynident.identification.repetition import pieces_of
from dynident.identification.uncertainty import identifiability_of
from dynident.models import Model
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, Spline, TimeShifted
from dynident.motion.splines import NORMAL_95
from dynident.regression import ParallelFilter, Regression, Selection
from dynident.validation import clustered_std
from tests.identification.motions import sines

ARM = pendulum()
MODEL = Model((*ARM.terms, Viscous(ARM.joints, values=(0.05,)), Coulomb(ARM.joints, values=(0.1,), width=0.1)))
TRUTH = np.asarray(MODEL.values)
SIGMA = 3e-3  # rad
WIDE = Spline(factor=1.4)


@cache
def truth() -> Motion:
    """A smooth motion; where friction bends a free one sharply, only part of what smoothing takes can be predicted."""
    t = np.arange(2000) * 0.005
    return moving(t, *sines(t, [[1.5], [0.8], [0.3]], [[2.0], [5.0], [9.0]], [[0.0], [1.0], [2.0]]))


def moving(t: np.ndarray, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> Motion:
    """The motion with the torque of the model."""
    names = tuple(joint.name for joint in MODEL.joints)
    return Motion(t, q, dq, ddq, MODEL.torque(q, dq, ddq, TRUTH), names, np.ones(len(t), dtype=bool))


def log(seed: int, sigma: float = SIGMA) -> Log:
    return record(truth(), sigma, 0.02, np.random.default_rng(seed)).log


def predicted(case: Log, smoother: Smoother, parallel_filter: ParallelFilter | None = None) -> MotionErrors:
    motions = (smoother(case),)
    regression = Regression(MODEL, motions, Selection(parallel_filter))
    return motion_errors([case], regression, smoother, LeastSquares()(Problem(MODEL, motions, regression)))


def plain(case: Log, smoother: Smoother, parallel_filter: ParallelFilter | None = None) -> np.ndarray:
    motions = (smoother(case),)
    return LeastSquares()(Problem(MODEL, motions, Regression(MODEL, motions, Selection(parallel_filter)))).value


@pytest.mark.parametrize(
    ("smoother", "parallel_filter"),
    [
        (WIDE, None),
        (WIDE, ParallelFilter(decimate=4)),
        (TimeShifted(WIDE, 0.0), None),
    ],
    ids=["spline", "filter", "shifted"],
)
def test_the_bias_is_that_of_many_runs(smoother: Smoother, parallel_filter: ParallelFilter | None) -> None:
    """Over 16 runs the mean error, less what is predicted, is a third of the mean error or chance (5 deviations)."""
    errors = np.array([plain(log(seed), smoother, parallel_filter) - TRUTH for seed in range(16)])
    bias = np.array([predicted(log(seed), smoother, parallel_filter).bias for seed in range(6)]).mean(axis=0)
    chance = 5 * errors.std(axis=0) / np.sqrt(16)
    assert (np.abs(errors.mean(axis=0)) > chance).any(), "there is a bias to predict"
    assert (np.abs(errors.mean(axis=0) - bias) < 0.33 * np.abs(errors.mean(axis=0)) + chance).all()


@pytest.mark.parametrize("estimator", [LeastSquares(), PhysicallyConsistent()], ids=["least squares", "consistent"])
def test_intervals_of_an_identification_hold(estimator: LeastSquares | PhysicallyConsistent) -> None:
    """Of 12 x 4 intervals at least 82 % hold (four deviations below 95 %), and far fewer of the plain ones."""
    held, before, recipe = [], [], Recipe(WIDE, estimator, outliers="keep")  # there are none to search for
    for seed in range(12):
        test_log = log(seed)
        result = identify(MODEL, [test_log], recipe=recipe)
        held.append(np.abs(result.estimate.value - TRUTH) < NORMAL_95 * result.errors.std)
        before.append(np.abs(plain(test_log, WIDE) - TRUTH) < NORMAL_95 * result.estimate.std)
    assert np.mean(held) > 0.82
    assert np.mean(held, axis=0).min() > 0.75
    assert np.mean(before) < 0.75


def test_intervals_of_a_robust_fit_hold() -> None:
    """The same where positions are noisy and every tenth torque is wrong."""
    held, before, robust = [], [], RobustLeastSquares("tukey")
    for seed in range(12):
        rng, test_log = np.random.default_rng(seed), log(seed)
        motion = WIDE(test_log)
        wrong = np.where(rng.random(test_log.tau.shape) < 0.1, rng.normal(0, 5.0, test_log.tau.shape), 0.0)
        regression = Regression(MODEL, (replace(motion, tau=motion.tau + wrong),))
        estimate = robust(Problem(MODEL, regression.motions, regression))
        rows = estimate.residual.weight_rows(regression)
        result = motion_errors([test_log], rows, WIDE, estimate)
        errors, _ = identifiability_of(rows, estimate, result.covariance)
        held.append(np.abs(estimate.value - result.bias - TRUTH) < NORMAL_95 * errors.std)
        before.append(np.abs(estimate.value - TRUTH) < NORMAL_95 * estimate.std)
    assert np.mean(held) > 0.82
    assert np.mean(before) < 0.75


def notes(identification: Identification) -> list[type]:
    return [
        type(warning) for warning in identification.warnings if isinstance(warning, MotionCorrected | MotionTooNoisy)
    ]


def test_the_correction_is_said_and_only_made_where_it_matters() -> None:
    noisy = identify(MODEL, [log(1)], recipe=Recipe(WIDE))
    assert notes(noisy) == [MotionCorrected]
    assert not np.array_equal(noisy.estimate.value, plain(log(1), WIDE))
    quiet = identify(MODEL, [log(1, 1e-6)], recipe=Recipe(WIDE))
    assert notes(quiet) == []
    np.testing.assert_array_equal(quiet.estimate.value, plain(log(1, 1e-6), WIDE))


def test_noise_that_is_less_between_samples_is_no_time_offset() -> None:
    """At 100 Hz and with known noise, a search alone finds an offset of 1 ms, six standard errors from zero."""
    t, rng = np.arange(1001) * 0.01, np.random.default_rng(0)
    motion = simulate(ARM, np.asarray(ARM.values), lambda s: [np.sin(5 * s)], t)
    test_log, reference = record(motion, 1e-4, 0.01, rng).log, Spline(sigma=1e-4)
    assert abs(find_time_offset(ARM, [reference(test_log)]).seconds) > 5e-4
    time_offset = align_motion(ARM, [test_log], [reference], "estimate").time_offset
    assert time_offset.seconds == 0.0


def test_a_bias_of_nearly_all_samples_is_as_sure_as_that_of_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """However much it differs between the recordings: one of them has hardly any noise."""
    logs = [log(0), log(1, SIGMA / 10)]
    regression = Regression(MODEL, tuple(WIDE(recording) for recording in logs))
    estimate = LeastSquares()(Problem(MODEL, regression.motions, regression))
    of_all = motion_errors(logs, regression, WIDE, estimate)
    monkeypatch.setattr("dynident.identification.motion_errors.MAX_BIAS_SAMPLES", 3999)  # of 4000
    of_most = motion_errors(logs, regression, WIDE, estimate)
    np.testing.assert_allclose(of_most.bias, of_all.bias, rtol=0.01)
    np.testing.assert_allclose(np.sqrt(np.diag(of_most.covariance)), np.sqrt(np.diag(of_all.covariance)), rtol=0.3)


PIECES, SAMPLES = 16, 1000


def piece_motion(rng: np.random.Generator) -> Motion:
    """A piece of a recording, unlike the others."""
    t = np.arange(SAMPLES) * 0.005
    rate = rng.uniform((1, 3, 7), (3, 7, 11))[:, None]
    return moving(t, *sines(t, rng.uniform(0.5, 2.0, (3, 1)) / rate, rate, rng.uniform(0, 6, (3, 1))))


def corrected_errors(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the errors of a corrected estimate, its standard errors as if the correction were exact, and with its
    error: of a quarter of the samples of each piece."""
    rng = np.random.default_rng(seed)
    logs = [record(piece_motion(rng), 3e-3, 0.002, rng).log for _ in range(PIECES)]
    motions = tuple(WIDE(x) for x in logs)
    regression = Regression(MODEL, motions)
    value = LeastSquares()(Problem(MODEL, motions, regression)).value
    part = np.arange(SAMPLES // 4)
    repeated = [
        repeat_piece(MODEL, piece, value, regression, rng)
        for log, motion in zip(logs, motions, strict=True)
        for piece in pieces_of(MODEL, log.rows(part, ""), motion.shift(0.0, part), WIDE, value, 1.0)
    ]
    result = sampled_bias(repeated, MODEL, np.ones(1))
    parts = [Regression(MODEL, (motion,)).triangular_factors for motion in motions]
    plain = clustered_std(lambda: parts, regression, value)
    wide = np.sqrt(plain**2 + np.diag(result.covariance) + result.remainder**2)
    return value - result.bias - TRUTH, plain, wide


def test_intervals_that_count_the_error_of_the_correction_hold() -> None:
    """Of 10 x 4 intervals at least 81 % hold (four deviations below 95 %)."""
    errors, plain, wide = (np.array(x) for x in zip(*map(corrected_errors, range(10)), strict=True))
    assert np.mean(np.abs(errors) < NORMAL_95 * wide) > 0.81
    assert (
        np.mean(np.abs(errors) < NORMAL_95 * plain) < np.mean(np.abs(errors) < NORMAL_95 * wide) - 0.1
    )  # not by the rest alone


def test_pieces_without_rows_do_not_count_and_one_is_too_few() -> None:
    rng = np.random.default_rng(0)
    case = piece_motion(rng)
    log = record(case, 3e-3, 0.01, rng).log
    like = Regression(MODEL, (WIDE(log),))
    (piece,) = pieces_of(MODEL, log, like.motions[0], WIDE, TRUTH, 1.0)
    result = repeat_piece(MODEL, piece, TRUTH, like, rng)
    empty = like.triangular_factors.__class__(np.zeros_like(result.once.factors), np.zeros_like(result.once.rows))
    none = RepetitionFactors(empty, empty)
    assert sampled_bias([result, none], MODEL, np.ones(1)) is None
    both, more = (
        sampled_bias([result, result], MODEL, np.ones(1)),
        sampled_bias([result, none, result], MODEL, np.ones(1)),
    )
    np.testing.assert_allclose(more.bias, both.bias, rtol=1e-9)
    np.testing.assert_allclose(both.covariance, 0.0, atol=1e-12 * np.square(both.bias).max())
    assert both.remainder == pytest.approx(more.remainder)
