"""What is known of a robot before it moves: its parameters, the noise of its torques, what recordings have told."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import BeforeValidator, Field, StrictBool, ValidationInfo, model_validator

from dynident.apps.excitation.limits import JointLimits, MotionLimits
from dynident.apps.excitation.motion import MotionRequest
from dynident.identification import Identification
from dynident.models import Model
from dynident.project.fields import (
    Name,
    NonNegative,
    Number,
    Positive,
    PositiveOrEach,
    Section,
    bounded_reader,
    whole_number_reader,
)
from dynident.regression import rank_of_information
from dynident.runtime import ConfigError, Noun, WordedEnum, as_number, choices
from dynident.runtime.arrays import Array

NOISE_SHARE = 0.01  # of a joint's torque limit: noise where nothing is known of it
DEFAULT_NOISE = 1.0  # N m or N, where there is no limit either


def _read_seed(value: object) -> int:
    number = as_number(value)
    if not (0 <= number < 2**63 and number == int(number)):
        raise ValueError("a whole number of at least 0 is expected")
    return int(number)


def _read_folder(value: object, info: ValidationInfo) -> Path:
    """Return the absolute path of a folder; a relative one starts at the folder of the settings."""
    if not isinstance(value, str | Path) or not str(value).strip():
        raise ValueError("the name of a folder is expected")
    return Path(os.path.abspath(Path((info.context or {}).get("folder", ".")) / value))


Folder = Annotated[Path, BeforeValidator(_read_folder)]
Share = Annotated[float, BeforeValidator(bounded_reader(0.0, 0.9))]
Seconds = Annotated[float, BeforeValidator(bounded_reader(0.1, 3600.0, " s"))]
Rate = Annotated[float, BeforeValidator(bounded_reader(1.0, 20_000.0, " Hz"))]
Harmonics = Annotated[int, BeforeValidator(whole_number_reader(50))]
Starts = Annotated[int, BeforeValidator(whole_number_reader(1000))]
Seed = Annotated[int, BeforeValidator(_read_seed)]


class BoxSettings(Section):
    """A box to keep clear of: its ``centre`` and ``size`` (m) along the axes x, y and z of the root link."""

    name: Name
    centre: tuple[Number, Number, Number]
    size: tuple[Positive, Positive, Positive]


class CylinderSettings(Section):
    """An upright cylinder to keep clear of, about ``centre`` (x, y), from ``bottom`` to ``top`` (null: without end), in
    m."""

    name: Name
    centre: tuple[Number, Number]
    radius: Positive
    bottom: Number | None = None
    top: Number | None = None

    @model_validator(mode="after")
    def _check_height(self) -> Self:
        if self.bottom is not None and self.top is not None and self.bottom >= self.top:
            raise ValueError(f"`bottom` must be below `top`, but {self.bottom:g} >= {self.top:g}")
        return self


class ExcitationSettings(Section):
    """What motion to design, within which limits, and what to keep clear of.

    ``rate`` (Hz) is that of the recording, ``file_rate`` that of the files of the motion (null: the same). ``margin``
    is the share of each limit that is kept free. ``noise`` (N m, N) is that of the torques, one number or by joint;
    null: as the logs or the result show it, else by rule. ``start`` is the pose at rest where the motion begins and
    ends, by joint (rad, m); joints left out are at zero. ``floor`` (m) is a height along z of the root link.
    ``grippers`` are exercised like the arm, else held still where the robot file alone says what moves.
    ``packages`` are the folders of the packages (``package://``) that hold the robot's meshes, or those around them.
    """

    program: Literal["motion", "friction", "gravity", "all"] = "motion"
    criterion: Literal["d", "a", "condition"] = "d"
    parameters: tuple[Name, ...] = ()
    family: Literal["fourier", "bspline"] = "fourier"
    duration: Seconds = MotionRequest.duration
    period: Seconds = MotionRequest.period
    harmonics: Harmonics = MotionRequest.harmonics
    rate: Rate = MotionRequest.rate
    file_rate: Rate | None = None
    noise: PositiveOrEach = None
    start: Mapping[Name, Number] | None = None
    starts: Starts = MotionRequest.starts
    seed: Seed = 0
    margin: Share = 0.1
    limits: Mapping[Name, JointLimits] = {}
    clearance: NonNegative = MotionRequest.clearance
    floor: Number | None = None
    boxes: Annotated[tuple[BoxSettings, ...], Field(max_length=100)] = ()
    cylinders: Annotated[tuple[CylinderSettings, ...], Field(max_length=100)] = ()
    packages: Annotated[tuple[Folder, ...], Field(max_length=100)] = ()
    grippers: StrictBool = False

    @model_validator(mode="after")
    def _check_criterion(self) -> Self:
        if self.parameters and self.criterion != "a":
            raise ValueError("`parameters`, those that matter, go with `criterion: a`")
        return self

    @model_validator(mode="after")
    def _check_names(self) -> Self:
        names = [*(obstacle.name for obstacle in self.boxes), *(obstacle.name for obstacle in self.cylinders)]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two of `boxes` and `cylinders` have the name {name!r}; give each its own")
        return self


def settings_in(data: Any, source: str, *, alone: bool) -> Mapping[str, Any]:
    """Return the section ``excitation`` of a file's content; in one that is ``alone``, it may be all there is.

    Raises ConfigError where it is no mapping.
    """
    content = data if isinstance(data, Mapping) else {}
    # a file of its own may have the section, or be the section
    section = data if alone and "excitation" not in content else content.get("excitation")
    if not isinstance(section, Mapping | None):
        raise ConfigError(f"{source}: a mapping of settings is expected, such as `duration: 30`.")
    return section or {}


class NoiseOrigin(WordedEnum):
    """Where the noise of the torques is from: given, the residual of a result, that of a fit to logs, or a rule."""

    GIVEN = "given", "as far as given; of other joints as known, or 1 % of the torque limit"
    RESULT = "result", "the residual of the result, each sample counted as often as it is independent"
    LOGS = "logs", "the residual of a fit to the logs, each sample counted as often as it is independent"
    RULE = "rule", "by rule: 1 % of the torque limit, or 1 N m. Give `noise`, or a result, for errors to rely on"


class PriorKnowledge(Noun):
    """What is known of a robot before it moves: its ``model`` and the parameters ``theta`` (p), nominal or identified.

    ``identification`` is the result behind them, None for nominal ones, and ``origin`` says where it is from;
    ``information`` (p, p) is what recordings have told of the parameters; ``loss_reason`` says why information
    that could count does not.
    """

    model: Model
    theta: Array
    identification: Identification | None = None
    origin: NoiseOrigin = NoiseOrigin.RULE
    information: Array | None = None
    loss_reason: str = ""


def knowledge_of_result(identification: Identification) -> PriorKnowledge:
    """Return what a result knows, with the information in the covariance of its base parameters."""
    model, covariance = identification.model, identification.errors.base_covariance
    prior = PriorKnowledge(model, identification.estimate.value, identification, NoiseOrigin.RESULT)
    if covariance is None:
        return replace(prior, loss_reason="it has no covariance of base parameters; identify again")
    basis = identification.base.on_data
    B = np.eye(len(model.parameters)) if basis is None else basis.combination
    return replace(prior, information=B.T @ rank_of_information(covariance).inverse @ B)


def torque_noise(
    prior: PriorKnowledge, settings: ExcitationSettings, limits: MotionLimits
) -> tuple[NoiseOrigin, Array]:
    """Return the origin of the torque noise, and its standard deviation (n) as for independent samples at the ``rate``
    of the settings.

    Independent samples with this noise tell as much as the real, correlated ones: a residual is larger by the root of
    the number of samples in the time over which it decorrelates. Where nothing is known the noise is 1 % of the torque
    limit, else 1 N m or N. The settings may replace it, for all joints or by joint. Raises ConfigError for unknown
    joints.
    """
    joints = limits.joints
    # the limits are already reduced by the margin, the rule refers to the full torque
    rule = np.where(np.isfinite(limits.torque), NOISE_SHARE * limits.torque / (1.0 - settings.margin), DEFAULT_NOISE)
    origin, sigma = NoiseOrigin.RULE, rule
    if prior.identification is not None:
        residual = _residual_noise(prior.identification, joints, settings.rate)
        origin, sigma = prior.origin, np.where(residual > 0, residual, rule)
    if settings.noise is None:
        return origin, sigma
    by_joint = settings.noise if isinstance(settings.noise, Mapping) else dict.fromkeys(joints, settings.noise)
    return NoiseOrigin.GIVEN, values_of_joints(by_joint, sigma, joints, "excitation.noise")


def values_of_joints(values: Mapping[str, float], defaults: Array, joints: tuple[str, ...], place: str) -> Array:
    """Return values by joint as an array (n), with those of ``defaults`` (n) where there are none.

    Raises ConfigError for an unknown joint, with the ``place`` of the setting.
    """
    for name in values:
        if name not in joints:
            raise ConfigError(f"{place}: there is no joint {name!r}; {choices(name, joints)}")
    return np.array([values.get(name, default) for name, default in zip(joints, defaults, strict=True)])


def _residual_noise(identification: Identification, joints: tuple[str, ...], rate: float) -> Array:
    """Return the root mean square residual (n) of the training at each joint, scaled as for independent samples."""
    variance = []
    for log in (validation for validation in identification.validations if validation.role == "train"):
        row = []
        for joint in joints:
            rmse, test = log.errors.rmse.get(joint, 0.0), log.residuals.get(joint)
            # samples within the time of decorrelation tell as much as one
            time = test.decorrelation if test is not None and math.isfinite(test.decorrelation) else 0.0
            row.append(rmse**2 * max(time * rate, 1.0))
        variance.append(row)
    return np.sqrt(np.mean(variance, axis=0)) if variance else np.zeros(len(joints))
