"""A robot for which a motion is designed: what a robot file, a configuration or a result says of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.excitation.clearance import CapsuleSpace
from dynident.apps.excitation.config import (
    ExcitationSettings,
    NoiseOrigin,
    PriorKnowledge,
    knowledge_of_result,
    settings_in,
    torque_noise,
    values_of_joints,
)
from dynident.apps.excitation.criterion import Criterion
from dynident.apps.excitation.design import Design, design
from dynident.apps.excitation.exact_space import build_space, exact_space, sample_poses
from dynident.apps.excitation.gripper import GripperLeftOut, find_gripper
from dynident.apps.excitation.limits import JointLimits, MotionLimits, motion_limits
from dynident.apps.excitation.motion import MotionRequest, Program
from dynident.files.meshes import read_geometry
from dynident.files.opener import read_text, remember_inputs
from dynident.files.results import as_path
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import load_yaml
from dynident.identification import Identification, SourceFile
from dynident.models import Box, Cylinder, Distances, EmptySpace, Floor, Geometry, Model, Obstacle, RigidBodies, Space
from dynident.project.config import config_text, load_model, nominal_values, replace_auto_terms
from dynident.project.project import parse_project
from dynident.project.saved import load
from dynident.project.settings import RobotSettings, robot_settings
from dynident.runtime import ConfigError, InputError, ModelError, Noun, report_progress

Robot = RobotSettings | str
CONFIGS = (".yaml", ".yml")
# s, of the programs where nobody gives it: one joint after the other takes longer than all at once
DURATIONS = {"motion": 30.0, "friction": 60.0, "gravity": 30.0, "all": 150.0}
MAX_PERIOD_SHARE = 0.6  # of the duration, at most, where nobody gives it: the ways take time, too


class ExcitationProject(Noun):
    """A robot, what is known of it, and what motion is to be designed within which ``limits``.

    ``path`` is the robot file, configuration or result; ``config`` its configuration, which may hold a model alone;
    ``file`` that of the model, beside which its meshes are. ``origin`` says where the noise of the request is from.
    ``gripper`` is what is left out.
    """

    path: Path
    prior: PriorKnowledge
    settings: ExcitationSettings
    limits: MotionLimits
    origin: NoiseOrigin
    request: MotionRequest
    config: SourceFile | None = None
    file: Path | None = None
    gripper: GripperLeftOut | None = None

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """What stands around the robot."""
        settings = self.settings
        floor = () if settings.floor is None else (Floor(settings.floor),)
        boxes = (Box(**box.model_dump()) for box in settings.boxes)
        cylinders = (Cylinder(**cylinder.model_dump(exclude_none=True)) for cylinder in settings.cylinders)
        return (*floor, *boxes, *cylinders)

    @cached_property
    def geometry(self) -> Geometry | None:
        """The shapes of the links, None where the model is not made of a robot file."""
        bodies = next((term for term in self.prior.model.terms if isinstance(term, RigidBodies)), None)
        if bodies is None:
            return None
        return read_geometry(bodies, self.file or Path(bodies.source), self.settings.packages)

    @cached_property
    def space(self) -> Space:
        """What the arm must keep clear of: itself and the obstacles; ConfigError where it has no known bodies."""
        if self.geometry is not None:
            poses = sample_poses(self.limits.lower, self.limits.upper)
            return build_space(self.geometry, self.obstacles, poses, self.request.clearance)
        if self.obstacles:
            raise ConfigError(
                f"excitation: {self.prior.model.name} is not made of a robot file, so that nothing can keep it clear "
                "of obstacles; leave out `floor`, `boxes` and `cylinders`."
            )
        return EmptySpace()

    @cached_property
    def shapes(self) -> Distances | None:
        """The real shapes, which check the finished motion; None where Pinocchio and Coal are not installed."""
        space, limits = self.space, self.limits
        if self.geometry is None or not isinstance(space, CapsuleSpace) or not space.pairs:
            return None
        return exact_space(self.geometry, space, sample_poses(limits.lower, limits.upper), self.request.clearance)

    def design(self, executor: Executor | None = None) -> Design:
        """Return the most informative motion; raises the errors of ``dynident.apps.excitation.design``."""
        report_progress("reading the shapes of the links")
        prior, rng = self.prior, np.random.default_rng(self.settings.seed)
        return design(
            prior.model, prior.theta, self.limits, self.space, self.request, rng, shapes=self.shapes, executor=executor
        )


def read_excitation(
    path: str | Path,
    settings: str | Path | None = None,
    changes: Mapping[str, Any] | None = None,
    *,
    ready: Callable[[], None] = lambda: None,
    allow_code: bool = False,
    defaults: Mapping[str, Any] | None = None,
    speed: float | None = None,
) -> ExcitationProject:
    """Read a robot file, a configuration or a result, and the ``settings`` of the motion: a file, else the section
    ``excitation`` of the configuration, also of that of a result; ``changes`` are put in their place, and ``defaults``
    where they say nothing.

    Terms that are to be chosen are the plain set. Where all logs of a configuration are there, they are identified: the
    torque is by the parameters found, the noise by the residual. A result also brings the information of its training.
    ``speed`` (rad/s, m/s) is the limit of joints for which neither the file nor the settings give one.
    Raises ConfigError for wrong settings, ModelError and InputError for what cannot be read.
    """
    path = as_path(path)
    kind = path.suffix.lower()
    if kind not in (".json", *SUFFIXES, *CONFIGS):
        robots = ", ".join(SUFFIXES)
        raise InputError(f"{path}: give a robot file ({robots}), a configuration (.yaml) or a result.json.")
    identification = load(path, allow_code=allow_code) if kind == ".json" else None
    config = SourceFile(str(path), text=config_text(path)) if kind in CONFIGS else None
    config = identification.provenance.configuration if identification else config
    source = identification.provenance.model if identification else None
    if source is not None and not os.path.exists(source.path):
        raise ModelError(f"{source.path}: the robot file of the result is gone; move it back, or give a robot file.")
    motion_settings = _motion_settings(config, settings, changes, defaults or {})
    robot = _robot_settings_of(path, identification, config)
    remember_inputs(path)
    # let the caller refuse its targets before the slow work, now that the inputs are known
    if identification is not None or robot is not None:
        ready()
    gripper = None
    # the best source at hand: a result, else the robot file alone, else the logs of a configuration
    if identification is not None:
        prior = knowledge_of_result(identification)
    elif robot is not None:
        report_progress("building the model")
        folder = path.parent if config else Path()
        model = load_model(replace_auto_terms(robot), folder)
        # whoever chooses joints is asked nothing; else a gripper is held still
        if isinstance(robot, RobotSettings) and not (motion_settings.grippers or robot.joints or robot.lock):
            gripper = find_gripper(model)
            held_robot = robot.model_copy(update={"lock": gripper.positions if gripper else {}})
            model = load_model(replace_auto_terms(held_robot), folder) if gripper else model
        prior = PriorKnowledge(model, nominal_values(model))
    else:
        prior = _prior_from_logs(path, config_text(path), ready)
    limits = motion_limits(prior.model, _user_limits(motion_settings, prior.model, speed), motion_settings.margin)
    origin, sigma = torque_noise(prior, motion_settings, limits)
    start = None
    if motion_settings.start is not None:
        start = values_of_joints(motion_settings.start, np.zeros(len(sigma)), limits.joints, "excitation.start")
    alike = ("family", "duration", "period", "harmonics", "rate", "starts", "clearance")
    request = MotionRequest(
        sigma,
        Program(motion_settings.program),
        Criterion(motion_settings.criterion),
        file_rate=motion_settings.file_rate or motion_settings.rate,
        start=start,
        named=motion_settings.parameters,
        prior=prior.information,
        **{name: getattr(motion_settings, name) for name in alike},
    )
    file = _model_file(path, kind, identification, config)
    return ExcitationProject(path, prior, motion_settings, limits, origin, request, config, file, gripper)


def _user_limits(settings: ExcitationSettings, model: Model, speed: float | None) -> dict[str, JointLimits]:
    """Return the limits of the settings, and the ``speed`` of joints for which nothing gives one."""
    limits = dict(settings.limits)
    for joint in model.joints if speed is not None else ():
        limit, in_file = limits.get(joint.name, JointLimits()), model.limits.get(joint.name)
        if limit.velocity is None and (in_file is None or in_file.velocity is None):
            limits[joint.name] = limit.model_copy(update={"velocity": speed})
    return limits


def _model_file(path: Path, kind: str, identification: Identification | None, config: SourceFile | None) -> Path | None:
    """Return the file of the model, None where there is none."""
    if identification is not None:
        return None if identification.provenance.model is None else Path(identification.provenance.model.path)
    if config is None:
        return path if kind in SUFFIXES else None
    model = load_yaml(config.text, config.path)["model"]
    file_name = model.get("file") if isinstance(model, Mapping) else model
    return path.parent / file_name if isinstance(file_name, str) and ":" not in file_name else None


def _robot_settings_of(path: Path, identification: Identification | None, config: SourceFile | None) -> Robot | None:
    """Return what the model is made of, where no configuration reads its recordings; else None."""
    if config is not None:
        return _lone_model(load_yaml(config.text, config.path), Path(config.path))
    if identification is None:
        return robot_settings(str(path)) or str(path)
    file = identification.provenance.model
    return None if file is None else robot_settings(file.path)


def _prior_from_logs(path: Path, text: str, ready: Callable[[], None]) -> PriorKnowledge:
    """Return what a configuration knows: by its logs where they are all there, else nominal."""
    project = parse_project(text, path)
    ready()
    logs = [file for log in (*project.config.train, *project.config.validation) for file in log.file.values()]
    # a fit to part of the logs would be another one than the configuration describes
    if missing_file := next((file for file in logs if not file.exists()), None):
        model = load_model(replace_auto_terms(project.config.model), path.parent)
        reason = f"the configuration names {missing_file.name}, which is not there"
        return PriorKnowledge(model, nominal_values(model), loss_reason=reason)
    report_progress("identifying from the logs of the configuration")
    identification = project.identify()
    return PriorKnowledge(identification.model, identification.estimate.value, identification, NoiseOrigin.LOGS)


def _lone_model(data: Any, path: Path) -> Robot | None:
    """Return the settings of the model in a file that holds nothing else of a configuration; None for another one."""
    if not isinstance(data, dict) or "model" not in data or set(data) - {"model", "excitation"}:
        return None
    context = {"folder": path.parent, "code": path.parent}
    model = data["model"]
    if not isinstance(model, Mapping):
        return robot_settings(str(model), context) or str(model)
    return RobotSettings.read(model, f"{path}: model", **context)


def _motion_settings(
    config: SourceFile | None, settings: str | Path | None, changes: Mapping[str, Any] | None,
    defaults: Mapping[str, Any],
) -> ExcitationSettings:  # fmt: skip
    """Return the settings of the file ``settings``, else those in a configuration, with changes, over defaults."""
    data: Mapping[str, Any] = {}
    place, folder = "excitation", Path()
    if settings is not None:
        place, folder = str(settings), Path(settings).parent
        data = settings_in(load_yaml(read_text(settings, ConfigError, CONFIGS), place), place, alone=True)
    elif config is not None:
        place, folder = f"{config.path}: excitation", Path(config.path).parent
        data = settings_in(load_yaml(config.text, config.path), place, alone=False)
    changes = dict(changes or {})
    if isinstance(packages := changes.get("packages"), list | tuple):  # these are relative to where we are
        changes["packages"] = [
            Path.cwd() / package if isinstance(package, str | Path) else package for package in packages
        ]
    motion_settings = ExcitationSettings.read({**defaults, **data, **changes}, place, folder=folder)
    for package in motion_settings.packages:
        if not os.path.isdir(package):
            raise ConfigError(f"{place}: packages: there is no folder {str(package)!r}.")
    named_fields = motion_settings.model_fields_set
    duration = motion_settings.duration if "duration" in named_fields else DURATIONS[motion_settings.program]
    # a default period leaves room for the ways to and from the periodic motion
    capped_period = min(motion_settings.period, MAX_PERIOD_SHARE * duration)
    period = motion_settings.period if "period" in named_fields else capped_period
    # what nobody gives stays a default in the files that are written
    values = {**dict(motion_settings), "duration": duration, "period": period}
    return ExcitationSettings.model_construct(named_fields, **values)
