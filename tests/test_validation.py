"""Errors of a model on a log, by hand."""

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dynident.errors import InputError, ModelError
from dynident.log import Motion
from dynident.model import Model
from dynident.regression import Parallel
from dynident.terms import Joint, Viscous
from dynident.validation import relative_error, validate

MODEL = Model((Viscous((Joint("a"), Joint("b", "prismatic"))),))
THETA = (2.0, 10.0)


def motion(dq: ArrayLike, tau: ArrayLike, mask: ArrayLike | None = None) -> Motion:
    velocity = np.asarray(dq, dtype=float)
    t, zero = np.linspace(0, 1, len(velocity)), np.zeros_like(velocity)
    used = np.ones(len(t), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    return Motion(t, zero, velocity, zero, np.asarray(tau, dtype=float), ("a", "b"), used, "morning")


@pytest.mark.parametrize(
    ("measured", "predicted", "percent"),
    [
        ((3, 4), (3, 4), 0.0),
        ((3, 4), (0, 0), 100.0),
        ((3, 4), (3, 0), 80.0),
        ((3, 4), (6, 8), 100.0),
        ((0, 0), (0, 0), float("nan")),
        ((0, 0), (1, 0), float("nan")),
        ((), (), float("nan")),
    ],
)
def test_relative_error(measured: tuple[float, ...], predicted: tuple[float, ...], percent: float) -> None:
    found = relative_error(np.array(measured, dtype=float), np.array(predicted, dtype=float))
    assert found == pytest.approx(percent, nan_ok=True)


def test_errors_by_hand() -> None:
    """Predicted (2, 10) at the two samples that count; the residuals are (1, 0) and (1, -2)."""
    found = validate(MODEL, THETA, motion([[1, 1], [1, 1], [9, 9]], [[3, 10], [3, 8], [0, 0]], [1, 1, 0]))
    np.testing.assert_array_equal(found.predicted, [[2, 10], [2, 10], [18, 90]])
    assert found.relative_error == pytest.approx(100 * np.sqrt(6 / 182))
    assert found.relative_error_filtered is None
    assert found.rmse == pytest.approx({"a": 1.0, "b": np.sqrt(2)})
    assert found.per_joint == pytest.approx({"a": 100 / 3, "b": 100 * np.sqrt(4 / 164)})
    assert (found.name, found.role) == ("morning", "validation")
    assert found.motion.source == "morning"


def test_name_and_role_can_be_given() -> None:
    found = validate(MODEL, THETA, motion([[1, 1]] * 2, [[1, 1]] * 2), name="noon", role="train")
    assert (found.name, found.role) == ("noon", "train")


def test_a_joint_without_torque_has_no_relative_error() -> None:
    found = validate(MODEL, THETA, motion([[1, 1]] * 3, [[0, 5]] * 3))
    assert np.isnan(found.per_joint["a"])
    assert found.per_joint["b"] == pytest.approx(100.0)
    assert found.rmse == pytest.approx({"a": 2.0, "b": 5.0})
    assert found.relative_error == pytest.approx(100 * np.sqrt(29 / 25))


def test_without_any_torque_there_is_no_relative_error() -> None:
    found = validate(MODEL, THETA, motion([[1, 1]] * 50, [[0, 0]] * 50), parallel=Parallel(2))
    assert found.relative_error_filtered is not None
    assert np.isnan([found.relative_error, found.relative_error_filtered, *found.per_joint.values()]).all()
    assert found.rmse == pytest.approx({"a": 2.0, "b": 10.0})


def test_filtered_error_forgives_noise_above_the_cutoff_and_the_unfiltered_does_not() -> None:
    """A tone at half the rate, on a velocity of a few rad/s; what is left of it comes from the two ends."""
    t = np.linspace(0, 10, 1000)
    velocity = np.column_stack((2 + np.sin(t), 2 + np.cos(t)))
    noise = np.outer((-1.0) ** np.arange(1000), [1.0, 1.0])
    made = motion(velocity, velocity * THETA + noise)
    found = validate(MODEL, THETA, made, parallel=Parallel(decimate=4))
    assert found.relative_error == pytest.approx(100 * np.sqrt(2000) / np.linalg.norm(made.tau))
    assert found.relative_error_filtered is not None
    assert found.relative_error_filtered < 0.1 * found.relative_error


def test_filtered_error_keeps_what_is_below_the_cutoff() -> None:
    """An error of one tenth of the torque at all frequencies stays so."""
    velocity = np.random.default_rng(0).normal(size=(300, 2))
    mask = np.arange(300) % 100 > 3
    found = validate(MODEL, THETA, motion(velocity, velocity * THETA / 0.9, mask), parallel=Parallel(3))
    assert found.relative_error == pytest.approx(10.0)
    assert found.relative_error_filtered == pytest.approx(10.0)


def test_single_samples_cannot_be_filtered() -> None:
    made = motion([[1, 1]] * 10, [[2, 10]] * 10, np.arange(10) % 2)
    found = validate(MODEL, THETA, made, parallel=Parallel(2))
    assert found.relative_error == 0.0
    assert np.isnan(found.relative_error_filtered or 0.0)


def test_no_usable_sample() -> None:
    with pytest.raises(InputError, match="morning: no sample is left to judge the model on"):
        validate(MODEL, THETA, motion([[1, 1]] * 3, [[1, 1]] * 3, [0, 0, 0]))


def test_parameters_of_another_model() -> None:
    with pytest.raises(ModelError, match="theta"):
        validate(MODEL, (1.0, 2.0, 3.0), motion([[1, 1]] * 3, [[1, 1]] * 3))
