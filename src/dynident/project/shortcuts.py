"""Short calls from Python, in which a file may stand for a model, and one log for several."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack

from dynident import checks, identification
from dynident.checks import CheckResult
from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.files.results import as_path
from dynident.files.xml_text import SUFFIXES
from dynident.identification import (
    AccuracyBound,
    Identification,
    Logs,
    NotLogged,
    Recipe,
    TorqueNoise,
    has_gravity,
    logs_by_name,
)
from dynident.models import Joint, Model
from dynident.motion.log import Log
from dynident.motion.smoothers import Smoother, Spline
from dynident.project.config import load_model, load_robot
from dynident.project.fields import unit_size
from dynident.project.logs import log_spec, read_logs
from dynident.project.parts import build
from dynident.project.project import model_source, read_project, stamp
from dynident.project.settings import Config, LogSpec, RobotSettings, robot_settings
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, Finding, InputError, ModelError, Note, choices
from dynident.runtime.families import ESTIMATORS, SMOOTHERS

Robot = Model | str | Path
Channels = Mapping[str, Any]
HERE = {"folder": ".", "code": "."}  # where relative names start


class RecipeFields(TypedDict, total=False):
    """The fields of ``Recipe``, any of which a call may set."""

    smoother: Smoother | tuple[Smoother, ...] | str
    estimator: Estimator | str
    filter: ParallelFilter | None
    min_speed: Mapping[str, float] | float | None
    time_offset: float | Literal["estimate"]
    base_tilt: tuple[float, float] | Literal["estimate"] | None
    restart: float | None
    outliers: Literal["mask", "keep"]
    rests: Literal["trim", "keep"]
    terms: Literal["auto"] | None
    proposed: tuple[type, ...]
    unfitted: tuple[str, ...]


def default_recipe(model: Model) -> Recipe:
    """Return the recipe for a real robot, with nothing to set.

    The spline is smoothed as much as predicts the torque best, the time offset between torque and position is
    estimated, and the base tilt where the model has gravity. A model with rigid bodies is fitted physically consistent,
    any other by least squares. The article's method is ``Recipe()``.
    """
    smoother = Spline.Settings(rule="torque").build()
    estimator: Estimator = (
        PhysicallyConsistent() if any(parameter.body for parameter in model.parameters) else LeastSquares()
    )
    tilt: Literal["estimate"] | None = "estimate" if has_gravity(model) else None
    recipe = Recipe(smoother, estimator, time_offset="estimate", base_tilt=tilt)
    return _choosing_terms(recipe, model)


def identify(
    robot: Robot,
    logs: Logs,
    validation: Logs = (),
    recipe: Recipe | None = None,
    *,
    joints: Sequence[str] | None = None,
    lock: Mapping[str, float] | None = None,
    executor: Executor | None = None,
    **changes: Unpack[RecipeFields],
) -> Identification:
    """Identify the parameters of a robot from logs, and judge them on all logs.

    ``robot`` is a ``Model``, or what the configuration has as ``model``: the path of a URDF or MJCF file, whose terms
    beside the bodies are chosen, ``gallery:NAME``, ``path/to/file.py:function``. ``logs``, and those held out for
    ``validation``, are one log, logs by name, or a sequence. ``recipe`` is by default ``default_recipe``, right for a
    real robot; keywords replace its fields: ``estimator=Ridge()``, or by its name ``estimator="ridge"``. Of a robot
    file, ``joints`` and ``lock`` are those of the configuration; joints that none of the logs has are locked, with a
    note. Smoothers are tried on the ``executor``, by default in this process.

    Raises ConfigError for an unknown keyword or a recipe that does not fit, ModelError for the model, InputError for
    logs.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> logs = {}
    >>> for name, rate in (("monday", 7.0), ("tuesday", 3.0)):
    ...     motion = dy.simulate(arm, arm.values, lambda s: [np.sin(rate * s)], t)
    ...     logs[name] = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=rng).log
    >>> dy.identify(arm, {"monday": logs["monday"]}, validation={"tuesday": logs["tuesday"]})
    <Identification of 'pendulum': good for control
      Torque error, training: monday 1.53 %
      Torque error, held out: tuesday 1.44 %
      J = 0.08256 +- 7.1e-5 kg m^2, h = 0.2501 +- 0.00023 kg m>
    """
    field_names = [field.name for field in fields(Recipe)]
    for name in changes:
        if name not in field_names:
            raise ConfigError(f"identify: {name!r} is no field of a recipe; {choices(name, field_names)}")
    trained, held_out = logs_by_name(logs, "logs"), logs_by_name(validation, "validation")
    model, notes = _to_model(robot, (*trained.values(), *held_out.values()), joints, lock)
    parts = {  # by their names
        name: build(family, {"kind": kind}, name)
        for name, family in (("smoother", SMOOTHERS), ("estimator", ESTIMATORS))
        if isinstance(kind := changes.get(name), str)
    }
    full_recipe = replace(_recipe_for(recipe, model), **{**changes, **parts})
    path = None if isinstance(robot, Model) else Path(robot)
    file = model_source(path) if path and path.suffix.lower() in SUFFIXES else None  # for `load` to build the model
    result = identification.identify(model, trained, held_out, full_recipe, executor=executor)
    result = checks.with_findings(result, model, {"train": trained, "validation": held_out}, full_recipe)
    provenance = replace(result.provenance, model=file, identified=stamp())
    return replace(result, provenance=provenance, warnings=(*notes, *result.warnings))


def check(robot: Robot, logs: Logs, validation: Logs = (), recipe: Recipe | None = None) -> CheckResult:
    """Examine a robot and its logs before a fit; arguments as in ``identify``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> still = dy.Log(t, np.zeros((1001, 2)), np.zeros((1001, 2)), ("joint1", "joint2"), "still")
    >>> dy.check("gallery:two_link_arm", still).has_errors
    True
    """
    roles = {"train": logs_by_name(logs, "logs"), "validation": logs_by_name(validation, "validation")}
    model, notes = _to_model(robot, [log for named_logs in roles.values() for log in named_logs.values()])
    findings = tuple(Finding(note, source=model.name) for note in notes)
    return checks.run_checks(model, roles, _recipe_for(recipe, model), initial_findings=findings)


def accuracy_bound(
    robot: Robot,
    logs: Logs,
    recipe: Recipe | None = None,
    *,
    sigma_q: Mapping[str, float] | float | None = None,
    sigma_tau: Mapping[str, float] | float | None = None,
    torque: TorqueNoise = "residual",
) -> AccuracyBound:
    """Return the accuracy that any method could reach with these logs; ``robot``, ``logs`` and ``recipe`` as in
    ``identify``, the rest as in ``dynident.identification.accuracy_bound.accuracy_bound``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=np.random.default_rng(0)).log
    >>> bound = dy.accuracy_bound(arm, log, dy.Recipe(dy.Spline(sigma=1e-4)), sigma_q=1e-4, sigma_tau=1e-2)
    >>> bound
    <AccuracyBound of 2 base parameters from 973 samples; least known: h 0.047 %, J 0.046 %>
    """
    named_logs = logs_by_name(logs, "logs")
    model, notes = _to_model(robot, tuple(named_logs.values()))
    recipe = _recipe_for(recipe, model)
    bound = identification.accuracy_bound(
        model, named_logs, recipe, sigma_q=sigma_q, sigma_tau=sigma_tau, torque=torque
    )
    warnings = (*notes, *bound.identification.warnings)
    return replace(bound, identification=replace(bound.identification, warnings=warnings))


def read_robot(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    terms: Literal["auto"] | Sequence[str | Mapping[str, Any]] = ("rotor", "viscous", "coulomb", "offset"),
    **settings: Any,
) -> Model:
    """Build the model of a URDF or MJCF file: its rigid bodies, and for each joint the ``terms``, or those that the
    logs choose where they are, or hold, "auto".

    ``joints`` chooses the moving joints and their order (None: all); ``settings`` are the others of the configuration's
    ``model``: lock, gravity, coulomb_width, couplings. Raises ConfigError for a setting that is wrong, ModelError where
    the file cannot be used.

    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> text = '''<robot name="door"><link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/>
    ... <mass value="20"/><inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
    ... <joint name="hinge" type="continuous"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/></joint>
    ... </robot>'''
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "door.urdf")
    ...     _ = file.write_text(text)
    ...     door = dy.read_robot(file, terms=["viscous"])
    >>> door.names[-2:]
    ('leaf.Izz', 'Fv_hinge')
    """
    data = {"file": str(path), "joints": joints, "terms": terms, **settings}
    return load_robot(RobotSettings.read(data, "read_robot", **HERE))


def read_log(
    path: str | Path,
    *,
    time: Any = None,
    position: Channels | None = None,
    torque: Channels | None = None,
    config: str | Path | None = None,
    window: tuple[float | None, float | None] | None = None,
    name: str | None = None,
    **settings: Any,
) -> Log:
    """Read one recording: CSV, Parquet, NumPy, MATLAB, HDF5, a ROS bag or MCAP.

    ``time`` is a column and its unit, or ``{"rate": Hz}``; ``position`` and ``torque`` give by joint a column and its
    unit, ``("pos1", "deg")``, or a mapping as in the configuration, such as ``{"column": "cur1", "gain": 0.01, "unit":
    "N m"}``. A joint whose position is a length slides. ``settings`` are transmission, zero and others of the
    configuration. Instead of all these, ``config`` names a configuration that says how to read the file. ``window`` is
    the part (start, stop) to use, in s. ``name`` is that of the log, by default the file's.

    What is odd in the file is a warning. Raises ConfigError where columns and units are not declared as they should
    be, InputError, with file, line and column, where the data cannot be used.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t = np.arange(1000.0)
    >>> with TemporaryDirectory() as folder:
    ...     file = Path(folder, "monday.csv")
    ...     table = np.column_stack([t, 40 * np.sin(t / 100), 2 * np.cos(t / 100)])
    ...     np.savetxt(file, table, delimiter=",", header="ms,angle,torque", comments="")
    ...     log = dy.read_log(file, time=("ms", "ms"), position={"hinge": ("angle", "deg")},
    ...                       torque={"hinge": ("torque", "N m")})
    >>> log
    <Log 'monday': 1000 samples of hinge; 0 to 0.999 s, 1000 Hz>
    """
    path = as_path(path)
    if config is not None:
        if not (time is None and position is None and torque is None and not settings):
            raise ConfigError("read_log: give either `config`, or time, position and torque, not both.")
        project = read_project(config)
        spec, log_config, joints = log_spec(str(path), project.config), project.config, tuple(project.model.joints)
    else:
        log_config = _declared_config(path, {"time": time, "position": position, "torque": torque}, settings)
        spec = log_config.train[0]
        # reading needs only the names and kinds of the joints, no dynamics
        joints = tuple(
            Joint(joint, "prismatic" if unit_size(channel.unit, "length") else "revolute")
            for joint, channel in log_config.position.items()
        )
    # window and name are checked as those of a configuration are; the file is that of the recording
    log_options = LogSpec.read({"file": "-", "window": window, "name": name}, "read_log", **HERE)
    reading = read_logs(
        spec.model_copy(update={"window": log_options.window, "name": log_options.name}), log_config, joints
    )
    for words in reading.warnings:
        warnings.warn(words, stacklevel=2)
    if len(reading.logs) > 1:
        spans = ", ".join(f"{log.t[0]:.6g} to {log.t[-1]:.6g} s" for log in reading.logs[:5])
        raise InputError(f"{path}: gaps divide it into {len(reading.logs)} pieces; choose one by `window`: {spans}.")
    return reading.logs[0]


def _to_model(
    robot: Any, logs: Sequence[Log], joints: Sequence[str] | None = None, lock: Mapping[str, float] | None = None
) -> tuple[Model, tuple[Note, ...]]:
    """Return the model of a robot, and a note on joints of its file that are in none of the logs, which are locked."""
    if not isinstance(robot, Model | str | Path):
        raise ModelError(f"robot: a {type(robot).__name__} is given; give a Model, or the path of a URDF or MJCF file.")
    if not isinstance(robot, Model) and Path(robot).suffix.lower() in (".yaml", ".yml"):
        raise ModelError(f"robot: {str(robot)!r} is a configuration; run it with `dynident.run({str(robot)!r})`.")
    if isinstance(robot, Model) or robot_settings(str(robot)) is None:
        if joints is not None or lock is not None:
            raise ConfigError(
                "joints, lock: are of a robot file; a model says them where it is made, as by `read_robot`."
            )
        return (robot if isinstance(robot, Model) else load_model(str(robot))), ()
    settings = {"file": str(robot), "joints": joints, "lock": lock or {}}
    model = load_model(RobotSettings.read(settings, "identify", **HERE))
    recorded = {name for log in logs for name in log.joints}
    missing = [joint.name for joint in model.joints if joint.name not in recorded]
    # joints that are asked for must be logged; where no joint at all is, the names are at fault
    if joints is not None or not missing or len(missing) == len(model.joints):
        return model, ()
    positions = {name: model.limits[name].nearest_to_zero for name in missing}
    settings["lock"] = {**(lock or {}), **positions}
    note = NotLogged(tuple(missing), tuple(positions.values()))
    return load_model(RobotSettings.read(settings, "identify", **HERE)), (note,)


def _recipe_for(recipe: Recipe | None, model: Model) -> Recipe:
    """Return the recipe for a model, by which terms are chosen where the model asks for it."""
    if not isinstance(recipe, Recipe | None):
        raise ConfigError(f"recipe: a {type(recipe).__name__} is given; give a Recipe, or its fields as keywords.")
    return default_recipe(model) if recipe is None else _choosing_terms(recipe, model)


def _choosing_terms(recipe: Recipe, model: Model) -> Recipe:
    if not model.chooses_terms:
        return recipe
    return replace(recipe, terms="auto", proposed=tuple(dict.fromkeys((*recipe.proposed, *model.proposed))))


def _declared_config(path: str | Path, channels: Mapping[str, Any], settings: Mapping[str, Any]) -> Config:
    """Return the configuration that reads one file as its columns are declared; its model is not used."""
    for key, value in channels.items():
        if value is None:
            raise ConfigError(f"read_log: {key!r} is missing; declare its columns with their units, or give `config`.")
    data = {
        "model": "-",
        "time": _read_channel(channels["time"], "time", "ms"),
        **{key: _read_channels(channels[key], key) for key in ("position", "torque")},
        "train": [{"file": str(path)}],
        **settings,
    }
    return Config.read(data, "read_log", **HERE)


def _read_channels(channels: Any, key: str) -> Any:
    if not isinstance(channels, Mapping):
        raise ConfigError(f"read_log: {key} is {channels!r}; give by joint a column and its unit.")
    example = "rad" if key == "position" else "N m"
    return {joint: _read_channel(channel, f"{key}.{joint}", example) for joint, channel in channels.items()}


def _read_channel(channel: Any, where: str, example: str) -> Any:
    """Return a channel as the configuration has it; a pair is a column and its unit."""
    if isinstance(channel, Mapping):
        return dict(channel)
    if not isinstance(channel, str) and isinstance(channel, Sequence) and len(channel) == 2:
        return {"column": channel[0], "unit": channel[1]}
    raise ConfigError(
        f"read_log: {where} is {channel!r}; give a column and its unit, such as ({channel!r}, {example!r})."
    )
