"""What is known of a robot before it moves: its parameters, the noise of its torques, what recordings have told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, ModelError, brief, choices, listed
from dynident.excitation import MotionLimits
from dynident.identification import Identification
from dynident.models import INERTIAL, Model, RigidBodies
from dynident.models.friction import PerJoint

__all__ = ["Known", "NoiseOrigin", "noise", "nominal", "of_result"]

Array = NDArray[np.float64]
SHARE = 0.01  # of a joint's torque limit: noise where nothing is known of it
USUAL = 1.0  # N m or N, where there is no limit either
RANK = 1e-12  # of a covariance with ones on its diagonal
NOMINAL = {"viscous": "damping", "coulomb": "friction", "rotor": "armature"}  # of a robot file, by role


class NoiseOrigin(StrEnum):
    """Where the noise of the torques is from: given, the residual of a result, that of a fit to logs, or a rule."""

    GIVEN = "given"
    RESULT = "result"
    LOGS = "logs"
    RULE = "rule"


@dataclass(frozen=True, eq=False)
class Known:
    """What is known of a robot before it moves: its ``model`` and the parameters ``theta`` (p), nominal or identified.

    ``found`` is the identification behind them, None for nominal ones, ``origin`` where it is from; ``information``
    (p, p) is what recordings have told of the parameters; ``lost`` says why some do not count that could.
    """

    model: Model
    theta: Array
    found: Identification | None = None
    origin: NoiseOrigin = NoiseOrigin.RULE
    information: Array | None = None
    lost: str = ""

    __repr__ = brief


def nominal(model: Model, lost: str = "") -> Known:
    """Return what the robot file says: its bodies, and friction and rotor inertia where it gives them, else none.

    Raises ModelError where a body has no inertia.
    """
    missing = [one.body for one in model.parameters if one.role in INERTIAL and one.value is None]
    if missing:
        raise ModelError(
            f"{model.name}: the inertia of {listed(dict.fromkeys(missing), 5)} is not in the robot file, so that the "
            "torque of a motion is not known; add it, or give the result of an identification."
        )
    bodies = [term for term in model.terms if isinstance(term, RigidBodies)]
    theta: list[float] = []
    for term in model.terms:
        joints, named = ("",) * len(term.parameters), dict[str, float]()
        if isinstance(term, PerJoint) and term.role in NOMINAL:
            joints = term.acts_on
            named = {key: value for one in bodies for key, value in getattr(one, NOMINAL[term.role]).items()}
        pairs = zip(term.parameters, joints, strict=True)
        theta += [named.get(joint, 0.0) if one.value is None else one.value for one, joint in pairs]
    return Known(model, np.array(theta), lost=lost)


def of_result(found: Identification) -> Known:
    """Return what a result knows, with the information in the covariance of its base parameters."""
    basis, covariance = found.base.on_data, found.errors.base_covariance
    p = len(found.model.parameters)
    B = np.eye(p) if basis is None else basis.combination
    if covariance is None:
        lost = "it has no covariance of base parameters; identify again"
        return Known(found.model, found.estimate.value, found, NoiseOrigin.RESULT, lost=lost)
    known = np.diag(covariance) > 0
    size = np.sqrt(np.diag(covariance)[known])
    inverse = np.linalg.pinv(covariance[np.ix_(known, known)] / np.outer(size, size), rcond=RANK, hermitian=True)
    rows = B[known] / size[:, None]
    return Known(found.model, found.estimate.value, found, NoiseOrigin.RESULT, rows.T @ inverse @ rows)


def noise(
    known: Known, given: Mapping[str, float] | float | None, limits: MotionLimits, margin: float, rate: float
) -> tuple[NoiseOrigin, Array]:
    """Return the standard deviation (n) of the torques at ``rate`` (Hz) that independent samples would have to have to
    tell as much as the real ones, and where it is from.

    A residual is larger by the root of the number of samples in the time over which it decorrelates. Where nothing is
    known it is 1 % of the torque limit, else 1 N m or N. ``given`` stands in its place. Raises ConfigError for unknown
    joints.
    """
    joints = limits.joints
    rule = np.where(np.isfinite(limits.torque), SHARE * limits.torque / (1.0 - margin), USUAL)
    origin, sigma = NoiseOrigin.RULE, rule
    if known.found is not None:
        found = _residual(known.found, joints, rate)
        origin, sigma = known.origin, np.where(found > 0, found, rule)
    return origin if given is None else NoiseOrigin.GIVEN, _replaced(sigma, given, joints)


def _replaced(sigma: Array, given: Mapping[str, float] | float | None, joints: tuple[str, ...]) -> Array:
    """Return noise (n) with what is given, for all or by joint, in its place."""
    by_joint = given if isinstance(given, Mapping) else {} if given is None else dict.fromkeys(joints, given)
    for name in by_joint:
        if name not in joints:
            raise ConfigError(f"excitation.noise: there is no joint {name!r}; {choices(name, joints)}")
    return np.array([by_joint.get(name, one) for name, one in zip(joints, sigma.tolist(), strict=True)])


def _residual(found: Identification, joints: tuple[str, ...], rate: float) -> Array:
    """Return the root mean square (n) of what the training left at each joint, as independent samples would have it."""
    variance = []
    for log in (one for one in found.validations if one.role == "train"):
        row = []
        for joint in joints:
            size, test = log.errors.rmse.get(joint, 0.0), log.residuals.get(joint)
            time = test.decorrelation if test is not None and math.isfinite(test.decorrelation) else 0.0
            row.append(size**2 * max(time * rate, 1.0))
        variance.append(row)
    return np.sqrt(np.mean(variance, axis=0)) if variance else np.zeros(len(joints))
