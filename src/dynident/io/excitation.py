"""A robot for which a motion is designed: what a robot file, a configuration or a result says of it."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from dynident.errors import ConfigError, InputError, brief, choices
from dynident.excitation import (
    Box,
    CapsuleSpace,
    Criterion,
    Cylinder,
    Design,
    Distances,
    Floor,
    Geometry,
    JointLimits,
    MotionLimits,
    Nothing,
    Obstacle,
    Program,
    Request,
    Space,
    design,
    exact_space,
    limits_of,
    space_of,
)
from dynident.identification import Identification, SourceFile
from dynident.io.config import config_text, load_model
from dynident.io.excitation_known import Known, NoiseOrigin, noise, nominal, of_result
from dynident.io.excitation_settings import ExcitationSettings, excitation_settings, settings_in
from dynident.io.meshes import read_geometry
from dynident.io.opener import keep
from dynident.io.opener import text as text_of
from dynident.io.project import parse_project
from dynident.io.result_read import named_terms
from dynident.io.results import as_path
from dynident.io.robot import SUFFIXES
from dynident.io.saved import load
from dynident.io.settings import RobotSettings, robot_settings
from dynident.io.wording import worded
from dynident.io.yaml_text import load_yaml
from dynident.models import RigidBodies

__all__ = ["ExcitationProject", "read_excitation"]

Array = NDArray[np.float64]
Progress = Callable[[str], None]
Robot = RobotSettings | str
CONFIGS = (".yaml", ".yml")
PERIOD = 0.6  # of the duration, at most, where nobody gives it: the ways take time, too


@dataclass(frozen=True, eq=False)
class ExcitationProject:
    """A robot, what is known of it, and what motion is to be designed within which ``limits``.

    ``path`` is the robot file, configuration or result; ``config`` its configuration, which may hold a model alone;
    ``file`` that of the model, beside which its meshes are. ``origin`` says where the noise of the request is from.
    """

    path: Path
    known: Known
    settings: ExcitationSettings
    limits: MotionLimits
    origin: NoiseOrigin
    request: Request
    config: SourceFile | None = None
    file: Path | None = None

    __repr__ = brief

    @property
    def obstacles(self) -> tuple[Obstacle, ...]:
        """What stands around the robot."""
        given = self.settings
        floor = () if given.floor is None else (Floor(given.floor),)
        boxes = (Box(one.name, one.centre, one.size) for one in given.boxes)
        ends = ((-np.inf if one.bottom is None else one.bottom, one.top) for one in given.cylinders)
        pairs = zip(given.cylinders, ends, strict=True)
        cylinders = (
            Cylinder(one.name, one.centre, one.radius, bottom, np.inf if top is None else top)
            for one, (bottom, top) in pairs
        )
        return (*floor, *boxes, *cylinders)

    @cached_property
    def geometry(self) -> Geometry | None:
        """The shapes of the links, None where the model is not made of a robot file."""
        bodies = next((one for one in self.known.model.terms if isinstance(one, RigidBodies)), None)
        return (
            None if bodies is None else read_geometry(bodies, self.file or Path(bodies.source), self.settings.packages)
        )

    @cached_property
    def space(self) -> Space:
        """What the arm must keep clear of: itself and the obstacles; ConfigError where it has no known bodies."""
        if self.geometry is not None:
            lower, upper = self.limits.lower, self.limits.upper
            return space_of(self.geometry, self.obstacles, lower, upper, self.request.clearance)
        if self.obstacles:
            raise ConfigError(
                f"excitation: {self.known.model.name} is not made of a robot file, so that nothing can keep it clear "
                "of obstacles; leave out `floor`, `boxes` and `cylinders`."
            )
        return Nothing(len(self.limits.joints))

    @cached_property
    def shapes(self) -> Distances | None:
        """The real shapes, which check the finished motion; None where Pinocchio and Coal are not installed."""
        space, limits = self.space, self.limits
        if self.geometry is None or not isinstance(space, CapsuleSpace) or not space.pairs:
            return None
        return exact_space(self.geometry, space, limits.lower, limits.upper, self.request.clearance)

    def design(self, executor: Executor | None = None, progress: Progress | None = None) -> Design:
        """Return the most informative motion; raises the errors of ``dynident.excitation.design``."""
        say = progress or (lambda _: None)
        say("reading the shapes of the links")
        known, rng = self.known, np.random.default_rng(self.settings.seed)
        return design(
            known.model,
            known.theta,
            self.limits,
            self.space,
            self.request,
            rng,
            shapes=self.shapes,
            executor=executor,
            progress=progress,
        )


def read_excitation(
    path: str | Path,
    settings: str | Path | None = None,
    changes: Mapping[str, Any] | None = None,
    *,
    ready: Callable[[], None] = lambda: None,
    allow_code: bool = False,
    progress: Progress = lambda _: None,
) -> ExcitationProject:
    """Read a robot file, a configuration or a result, and the ``settings`` of the motion: a file, else the section
    ``excitation`` of the configuration, also of that of a result; ``changes`` are put in their place.

    Terms that are to be chosen are the plain set. Where all logs of a configuration are there, they are identified: the
    torque is by the parameters found, the noise by the residual. A result also brings the information of its training.
    Raises ConfigError for wrong settings, ModelError and InputError for what cannot be read.
    """
    path = as_path(path)
    kind = path.suffix.lower()
    if kind not in (".json", *SUFFIXES, *CONFIGS):
        robots = ", ".join(SUFFIXES)
        raise InputError(f"{path}: give a robot file ({robots}), a configuration (.yaml) or a result.json.")
    found = load(path, allow_code=allow_code) if kind == ".json" else None
    config = found.provenance.configuration if found else _config(path, kind)
    given = _given(config, settings, changes)
    robot = _robot(path, found, config)
    keep(path)
    if found is not None or robot is not None:
        ready()
    if found is not None:
        known = of_result(found)
    elif robot is not None:
        progress("building the model")
        known = nominal(load_model(named_terms(robot), path.parent if config else "."))
    else:
        known = _recorded(path, config_text(path), ready, progress)
    limits = limits_of(known.model, _limits(given), given.margin)
    origin, sigma = noise(known, given.noise, limits, given.margin, given.rate)
    request = Request(
        sigma,
        Program(given.program),
        Criterion(given.criterion),
        given.family,
        given.duration,
        given.period,
        given.harmonics,
        given.rate,
        _start(given, limits.joints),
        given.parameters,
        known.information,
        given.starts,
        given.clearance,
    )
    return ExcitationProject(path, known, given, limits, origin, request, config, _file(path, kind, found, config))


def _file(path: Path, kind: str, found: Identification | None, config: SourceFile | None) -> Path | None:
    """Return the file of the model, None where there is none."""
    if found is not None:
        return None if found.provenance.model is None else Path(found.provenance.model.path)
    if config is None:
        return path if kind in SUFFIXES else None
    model = load_yaml(config.text, config.path)["model"]
    named = model.get("file") if isinstance(model, Mapping) else model
    return path.parent / named if isinstance(named, str) and ":" not in named else None


def _config(path: Path, kind: str) -> SourceFile | None:
    return SourceFile(str(path), text=config_text(path)) if kind in CONFIGS else None


def _robot(path: Path, found: Identification | None, config: SourceFile | None) -> Robot | None:
    """Return what the model is made of, where no configuration reads its recordings; else None."""
    if config is not None:
        return _alone(load_yaml(config.text, config.path), Path(config.path))
    if found is None:
        return robot_settings(str(path)) or str(path)
    file = found.provenance.model
    return None if file is None else robot_settings(file.path)


def _recorded(path: Path, text: str, ready: Callable[[], None], progress: Progress) -> Known:
    """Return what a configuration knows: by its logs where they are all there, else nominal."""
    project = parse_project(text, path)
    ready()
    logs = [file for log in (*project.config.train, *project.config.validation) for file in log.file.values()]
    if gone := next((file for file in logs if not file.exists()), None):
        model = load_model(named_terms(project.config.model), path.parent)
        return nominal(model, f"the configuration names {gone.name}, which is not there")
    progress("identifying from the logs of the configuration")
    found = project.identify(progress)
    return Known(found.model, found.estimate.value, found, NoiseOrigin.LOGS)


def _alone(data: Any, path: Path) -> Robot | None:
    """Return the settings of the model in a file that holds nothing else of a configuration; None for another one."""
    if not isinstance(data, dict) or "model" not in data or set(data) - {"model", "excitation"}:
        return None
    context = {"folder": path.parent, "code": path.parent}
    given = data["model"]
    if not isinstance(given, Mapping):
        return robot_settings(str(given), context) or str(given)
    try:
        return RobotSettings.model_validate(given, context=context)
    except ValidationError as error:
        raise ConfigError(worded(error, given, f"{path}: model")) from None


def _given(
    config: SourceFile | None, settings: str | Path | None, changes: Mapping[str, Any] | None
) -> ExcitationSettings:
    """Return the settings of the file ``settings``, else those in a configuration, with changes."""
    data: Mapping[str, Any] = {}
    place, folder = "excitation", Path()
    if settings is not None:
        place, folder = str(settings), Path(settings).parent
        data = settings_in(load_yaml(text_of(settings, ConfigError, CONFIGS), place), place, alone=True)
    elif config is not None:
        place, folder = f"{config.path}: excitation", Path(config.path).parent
        data = settings_in(load_yaml(config.text, config.path), place, alone=False)
    changes = dict(changes or {})
    if isinstance(given := changes.get("packages"), list | tuple):  # these are relative to where we are
        changes["packages"] = [Path.cwd() / one if isinstance(one, str | Path) else one for one in given]
    found = excitation_settings({**data, **changes}, place, folder)
    for one in found.packages:
        if not os.path.isdir(one):
            raise ConfigError(f"{place}: packages: there is no folder {str(one)!r}.")
    if "period" not in found.model_fields_set and found.period > PERIOD * found.duration:
        return found.model_copy(update={"period": PERIOD * found.duration})
    return found


def _limits(given: ExcitationSettings) -> dict[str, JointLimits]:
    return {name: JointLimits(**one.model_dump()) for name, one in given.limits.items()}


def _start(given: ExcitationSettings, joints: tuple[str, ...]) -> Array | None:
    if given.start is None:
        return None
    for name in given.start:
        if name not in joints:
            raise ConfigError(f"excitation.start: there is no joint {name!r}; {choices(name, joints)}")
    return np.array([given.start.get(name, 0.0) for name in joints])
