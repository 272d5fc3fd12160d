"""Errors of a model on a log, by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from dynident.models import Joint, Lagrangian, Model, Unknown
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.models.robot_files import RobotJointLimits
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter, Selection
from dynident.runtime import InputError, ModelError
from dynident.validation import check_mass, validate

MODEL = Model((Viscous((Joint("a"), Joint("b", "prismatic"))),))
THETA = (2.0, 10.0)


def motion(dq: ArrayLike, tau: ArrayLike, mask: ArrayLike | None = None) -> Motion:
    velocity = np.asarray(dq, dtype=float)
    t, zero = np.linspace(0, 1, len(velocity)), np.zeros_like(velocity)
    used = np.ones(len(t), dtype=bool) if mask is None else np.asarray(mask, dtype=bool)
    return Motion(t, zero, velocity, zero, np.asarray(tau, dtype=float), ("a", "b"), used, "morning")


def test_errors_by_hand() -> None:
    """Predicted (2, 10) at the two samples that count; the residuals are (1, 0) and (1, -2)."""
    validation = validate(MODEL, THETA, motion([[1, 1], [1, 1], [9, 9]], [[3, 10], [3, 8], [0, 0]], [1, 1, 0]))
    np.testing.assert_array_equal(validation.predicted_torque, [[2, 10], [2, 10], [18, 90]])
    assert validation.errors.relative_error == pytest.approx(100 * np.sqrt(6 / 182))
    assert validation.errors.relative_error_filtered is None
    assert validation.errors.rmse == pytest.approx({"a": 1.0, "b": np.sqrt(2)})
    assert validation.errors.per_joint == pytest.approx({"a": 100 / 3, "b": 100 * np.sqrt(4 / 164)})
    assert (validation.name, validation.role) == ("morning", "validation")
    assert validation.motion.source == "morning"


def test_filtered_error_forgives_noise_above_the_cutoff_and_the_unfiltered_does_not() -> None:
    """A tone at half the rate, on a velocity of a few rad/s; what is left of it comes from the two ends."""
    t = np.linspace(0, 10, 1000)
    velocity = np.column_stack((2 + np.sin(t), 2 + np.cos(t)))
    noise = np.outer((-1.0) ** np.arange(1000), [1.0, 1.0])
    made = motion(velocity, velocity * THETA + noise)
    validation = validate(MODEL, THETA, made, selection=Selection(filter=ParallelFilter(decimate=4)))
    assert validation.errors.relative_error == pytest.approx(100 * np.sqrt(2000) / np.linalg.norm(made.tau))
    assert validation.errors.relative_error_filtered < 0.1 * validation.errors.relative_error


def test_what_cannot_be_judged_is_named() -> None:
    with pytest.raises(InputError, match="morning: no usable sample is left for validation"):
        validate(MODEL, THETA, motion([[1, 1]] * 3, [[1, 1]] * 3, [0, 0, 0]))
    with pytest.raises(ModelError, match="theta"):
        validate(MODEL, (1.0, 2.0, 3.0), motion([[1, 1]] * 3, [[1, 1]] * 3))


class Limited(Viscous):
    """A term that knows the limits of its joints."""

    @property
    def limits(self) -> dict[str, RobotJointLimits]:
        return {"a": RobotJointLimits(effort=20.0, lower=-0.5, upper=0.5)}


def test_mass_is_looked_at_over_the_logs_and_within_the_limits() -> None:
    """A mass 1 + 3 cos(3 q) of joint a is negative only beyond q = 0.5, where neither limits nor logs reach, and that
    of joint b, 1 + 3 cos(1.5 q), beyond 1 m, which stands for its limits."""
    import sympy as sp

    a, b, da, db, m, c = sp.symbols("a b da db m c")
    kinetic = ((m + c * sp.cos(3 * a)) * da**2 + (m + c * sp.cos(1.5 * b)) * db**2) / 2
    unknowns = (Unknown(m, "kg"), Unknown(c, "kg"))
    mass = Lagrangian(MODEL.joints, (a, b), (da, db), kinetic, 0, unknowns)
    still = motion([[1, 1]] * 5, [[1, 1]] * 5)
    theta = [3.0 if "c" in parameter.expression else 1.0 for parameter in mass.parameters]
    limited = Model((mass, Limited(MODEL.joints)))
    assert check_mass(limited, [*theta, 1, 1], [still]).positive
    assert not check_mass(Model((mass, Viscous(MODEL.joints))), [*theta, 1, 1], [still]).positive
    gone = Motion(still.t, still.q + 0.9, still.dq, still.ddq, still.tau, still.joints, still.mask, "gone")
    result = check_mass(limited, [*theta, 1, 1], [still, gone])
    assert not result.positive
    assert result.q[0] == pytest.approx(0.9)
    # a joint without limits is drawn over a turn or two metres
    drawn: list[tuple[ArrayLike, ArrayLike]] = []
    rng: Any = SimpleNamespace(uniform=lambda lower, upper, size: drawn.append((lower, upper)) or np.zeros(size))
    for model in (limited, Model((mass, Viscous(MODEL.joints)))):
        check_mass(model, [*theta, 1, 1], [still], rng)
    np.testing.assert_array_equal(drawn, [[[-0.5, -1], [0.5, 1]], [[-np.pi, -1], [np.pi, 1]]])


def test_the_mass_matrix_says_where_it_is_weakest() -> None:
    arm, q = two_link_arm(), np.stack([np.zeros(5), np.linspace(0.0, np.pi, 5)], axis=1)
    good = str(arm.check_mass_matrix(q, arm.values))
    assert good.startswith("The mass matrix is positive definite: smallest eigenvalue 0.00")
    wrong = arm.values.copy()
    wrong[2] = 0.02
    bad = str(arm.check_mass_matrix(q, wrong))
    assert "not positive definite: eigenvalue -0.0" in bad
    assert "at q = (0, 3.142)" in bad
