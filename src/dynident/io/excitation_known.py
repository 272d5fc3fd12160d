"""What is known of a robot before it moves: its parameters, the noise of its torques, what recordings have told."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, DynidentError, ModelError, brief, choices, listed
from dynident.excitation import MotionLimits
from dynident.identification import Identification
from dynident.io.config import parse_config
from dynident.io.logs import read_roles
from dynident.io.long_log import is_long
from dynident.log import Motion
from dynident.models import INERTIAL, Model, RigidBodies
from dynident.models.friction import PerJoint
from dynident.regression import Regression

__all__ = ["Known", "NoiseOrigin", "information", "noise", "nominal", "with_motions"]

Array = NDArray[np.float64]
SHARE = 0.01  # of a joint's torque limit: noise where nothing is known of it
USUAL = 1.0  # N m or N, where there is no limit either
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

    ``found`` is the identification behind them, None for nominal ones, ``origin`` where it is from; ``motions`` are
    those that it was fitted to, whose information counts; ``lost`` says why recordings do not count that could.
    """

    model: Model
    theta: Array
    found: Identification | None = None
    origin: NoiseOrigin = NoiseOrigin.RULE
    motions: tuple[Motion, ...] = ()
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


def with_motions(found: Identification, *, allow_code: bool = False) -> Known:
    """Return what a result knows, with the motions of its training, where its logs can be read again."""
    given, motions, lost = found.provenance.configuration, list[Motion](), ""
    if given is None:
        lost = "the result was made from Python, without a configuration"
    else:
        try:
            config = parse_config(given.text, Path(given.path).parent, given.path, allow_code=allow_code)
            if is_long(config):
                lost = "its training is too long to be read again"
            else:
                logs = read_roles(config, found.model.joints)[0]["train"].values()
                joints = tuple(joint.name for joint in found.model.joints)
                smoothed = (found.recipe.motion(log.select(joints)) for log in logs)
                motions = [found.model.remembering(one) for one in smoothed]
        except DynidentError as error:
            lost = str(error)
    return Known(found.model, found.estimate.value, found, NoiseOrigin.RESULT, tuple(motions), lost)


def noise(
    known: Known, given: Mapping[str, float] | float | None, limits: MotionLimits, margin: float, rate: float
) -> tuple[NoiseOrigin, Array]:
    """Return the standard deviation (n) of the torques at ``rate`` (Hz) that independent samples would have to have to
    tell as much as the real ones, and where it is from.

    A residual is larger by the root of the number of samples in the time over which it decorrelates. Where nothing is
    known it is 1 % of the torque limit, else 1 N m or N. Raises ConfigError for unknown joints, and where one has none.
    """
    joints = limits.joints
    if given is not None:
        return NoiseOrigin.GIVEN, _given(given, joints)
    rule = np.where(np.isfinite(limits.torque), SHARE * limits.torque / (1.0 - margin), USUAL)
    if known.found is None:
        return NoiseOrigin.RULE, rule
    found = _residual(known.found, joints, rate)
    return known.origin, np.where(found > 0, found, rule)


def _given(given: Mapping[str, float] | float, joints: tuple[str, ...]) -> Array:
    by_joint = given if isinstance(given, Mapping) else dict.fromkeys(joints, given)
    for name in by_joint:
        if name not in joints:
            raise ConfigError(f"excitation.noise: there is no joint {name!r}; {choices(name, joints)}")
    for name in joints:
        if name not in by_joint:
            raise ConfigError(f"excitation.noise: joint {name!r} is missing; add it, or give one number for all.")
    return np.array([by_joint[name] for name in joints])


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


def information(known: Known, given: Mapping[str, float] | float | None, limits: MotionLimits, margin: float) -> Array:
    """Return what the motions known already tell of the parameters: sum of Y' W Y (p, p), at their own rates."""
    p = len(known.theta)
    total = np.zeros((p, p))
    for motion in known.motions:
        rate = 1.0 / float(np.median(np.diff(motion.t)))
        _, sigma = noise(known, given, limits, margin, rate)
        factor = Regression(known.model, (motion,)).triangular_factors.stacked(1.0 / sigma)[:, :p]
        total += factor.T @ factor
    return total
