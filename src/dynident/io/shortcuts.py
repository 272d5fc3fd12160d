"""Short calls from Python, in which a file may stand for a model, and one log for several."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, TypedDict, TypeVar, Unpack

from pydantic import ValidationError

from dynident import bounds, checks, identification
from dynident.bounds import AccuracyBound, TorqueNoise
from dynident.checks import CheckResult
from dynident.errors import ConfigError, InputError, ModelError, choices
from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Identification, Recipe, has_gravity
from dynident.io.config import load_model
from dynident.io.fields import UNITS, Section
from dynident.io.logs import read_logs
from dynident.io.named_log import log_spec
from dynident.io.project import model_source, read_project, stamp
from dynident.io.robot import SUFFIXES, load_robot
from dynident.io.settings import Config, LogSpec, RobotSettings, robot_settings
from dynident.io.wording import worded
from dynident.log import Log
from dynident.models import Joint, Model
from dynident.regression import ParallelFilter
from dynident.smoothers import Smoother, Spline

__all__ = [
    "RecipeFields",
    "accuracy_bound",
    "check",
    "default_recipe",
    "identify",
    "read_log",
    "read_robot",
]

Robot = Model | str | Path
Logs = Log | Mapping[str, Log] | Sequence[Log]
Channels = Mapping[str, Any]
Progress = Callable[[str], None]
S = TypeVar("S", bound=Section)


class RecipeFields(TypedDict, total=False):
    """The fields of ``Recipe``, any of which a call may set."""

    smoother: Smoother | tuple[Smoother, ...]
    estimator: Estimator
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
    estimator: Estimator = PhysicallyConsistent() if any(one.body for one in model.parameters) else LeastSquares()
    tilt: Literal["estimate"] | None = "estimate" if has_gravity(model) else None
    return Recipe(smoother, estimator, time_offset="estimate", base_tilt=tilt)


def identify(
    robot: Robot,
    logs: Logs,
    validation: Logs = (),
    recipe: Recipe | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress | None = None,
    **changes: Unpack[RecipeFields],
) -> Identification:
    """Identify the parameters of a robot from logs, and judge them on all logs.

    ``robot`` is a ``Model``, or what the configuration has as ``model``: the path of a URDF or MJCF file, whose terms
    beside the bodies are chosen, ``gallery:NAME``, ``path/to/file.py:function``. ``logs``, and those held out for
    ``validation``, are one log, logs by name, or a sequence. ``recipe`` is by default ``default_recipe``, right for a
    real robot; keywords replace its fields, such as ``estimator=LeastSquares()``. Smoothers are tried on the
    ``executor``, by default in this process. ``progress`` is called with a few words before each step.

    Raises ConfigError for an unknown keyword or a recipe that does not fit, ModelError for the model, InputError for
    logs.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> logs = {}
    >>> for name, rate in (("monday", 7.0), ("tuesday", 3.0)):
    ...     motion = dy.simulate(arm, arm.values, lambda s: [np.sin(rate * s)], t)
    ...     logs[name] = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=rng).log
    >>> dy.identify(arm, {"monday": logs["monday"]}, validation={"tuesday": logs["tuesday"]})
    <Identification of 'pendulum': good for control
      torque error, training: monday 1.53 %
      torque error, held out: tuesday 1.44 %
      J = 0.08256 +- 7.1e-5 kg m^2, h = 0.2501 +- 0.00023 kg m>
    """
    model = _model(robot)
    known = [field.name for field in fields(Recipe)]
    for name in changes:
        if name not in known:
            raise ConfigError(f"identify: {name!r} is no field of a recipe; {choices(name, known)}")
    used = replace(_recipe(recipe, model, robot), **changes)
    trained, held_out = _named(logs, "logs"), _named(validation, "validation")
    path = None if isinstance(robot, Model) else Path(robot)
    file = model_source(path) if path and path.suffix.lower() in SUFFIXES else None  # for `load` to build the model
    found = identification.identify(model, trained, held_out, used, executor=executor, progress=progress)
    found = checks.with_findings(found, model, {"train": trained, "validation": held_out}, used, progress=progress)
    return replace(found, provenance=replace(found.provenance, model=file, identified=stamp()))


def check(
    robot: Robot, logs: Logs, validation: Logs = (), recipe: Recipe | None = None, *, progress: Progress | None = None
) -> CheckResult:
    """Examine a robot and its logs before a fit; arguments as in ``identify``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> still = dy.Log(t, np.zeros((1001, 2)), np.zeros((1001, 2)), ("joint1", "joint2"), "still")
    >>> dy.check("gallery:two_link_arm", still).failed
    True
    """
    model = _model(robot)
    roles = {"train": _named(logs, "logs"), "validation": _named(validation, "validation")}
    return checks.run_checks(model, roles, _recipe(recipe, model, robot), progress=progress)


def accuracy_bound(
    robot: Robot,
    logs: Logs,
    recipe: Recipe | None = None,
    *,
    sigma_q: Mapping[str, float] | float | None = None,
    sigma_tau: Mapping[str, float] | float | None = None,
    torque: TorqueNoise = "residual",
    progress: Progress | None = None,
) -> AccuracyBound:
    """Return the accuracy that any method could reach with these logs; ``robot``, ``logs`` and ``recipe`` as in
    ``identify``, the rest as in ``dynident.bounds.accuracy_bound``.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=np.random.default_rng(0)).log
    >>> bound = dy.accuracy_bound(arm, log, dy.Recipe(dy.Spline(sigma=1e-4)), sigma_q=1e-4, sigma_tau=1e-2)
    >>> bound
    <AccuracyBound of 2 base parameters from 973 samples; least known: h 0.047 %, J 0.046 %>
    """
    model = _model(robot)
    return bounds.accuracy_bound(
        model,
        _named(logs, "logs"),
        _recipe(recipe, model, robot),
        sigma_q=sigma_q,
        sigma_tau=sigma_tau,
        torque=torque,
        progress=progress,
    )


def read_robot(
    path: str | Path,
    *,
    joints: Sequence[str] | None = None,
    terms: Sequence[str | Mapping[str, Any]] = ("rotor", "viscous", "coulomb", "offset"),
    **settings: Any,
) -> Model:
    """Build the model of a URDF or MJCF file: its rigid bodies, and for each joint the ``terms``.

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
    return load_robot(_read(RobotSettings, data, "read_robot"))


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
    if config is not None:
        if not (time is None and position is None and torque is None and not settings):
            raise ConfigError("read_log: give either `config`, or time, position and torque, not both.")
        project = read_project(config)
        spec, read, joints = log_spec(str(path), project.config), project.config, tuple(project.model.joints)
    else:
        read = _declared(path, {"time": time, "position": position, "torque": torque}, settings)
        spec = read.train[0]
        joints = tuple(Joint(joint, _kind(channel.unit)) for joint, channel in read.position.items())
    given = _read(LogSpec, {"file": "-", "window": window, "name": name}, "read_log")
    reading = read_logs(spec.model_copy(update={"window": given.window, "name": given.name}), read, joints)
    for words in reading.warnings:
        warnings.warn(words, stacklevel=2)
    if len(reading.logs) > 1:
        spans = ", ".join(f"{one.t[0]:.6g} to {one.t[-1]:.6g} s" for one in reading.logs[:5])
        raise InputError(f"{path}: gaps divide it into {len(reading.logs)} pieces; choose one by `window`: {spans}.")
    return reading.logs[0]


def _model(robot: Any) -> Model:
    if isinstance(robot, Model):
        return robot
    if not isinstance(robot, str | Path):
        raise ModelError(f"robot: a {type(robot).__name__} is given; give a Model, or the path of a URDF or MJCF file.")
    if Path(robot).suffix.lower() in (".yaml", ".yml"):
        raise ModelError(f"robot: {str(robot)!r} is a configuration; run it with `dynident.run({str(robot)!r})`.")
    return load_model(str(robot))


def _recipe(recipe: Recipe | None, model: Model, robot: Robot) -> Recipe:
    """Return the recipe for a robot as it is given: a robot file names no terms."""
    if not isinstance(recipe, Recipe | None):
        raise ConfigError(f"recipe: a {type(recipe).__name__} is given; give a Recipe, or its fields as keywords.")
    used = default_recipe(model) if recipe is None else recipe
    return used if isinstance(robot, Model) or robot_settings(str(robot)) is None else replace(used, terms="auto")


def _named(logs: Any, what: str) -> dict[str, Log]:
    """Return the logs by name; InputError where one is not a Log, ConfigError where two have one name."""
    if isinstance(logs, str | Path):
        raise InputError(f"{what}: {str(logs)!r} is a file; read it with `read_log`, which asks for its columns.")
    several = (logs,) if isinstance(logs, Log) else logs
    if not isinstance(several, Iterable):
        raise InputError(f"{what}: a {type(logs).__name__} is given; give a Log, logs by name, or a sequence of them.")
    pairs = (
        list(several.items())
        if isinstance(several, Mapping)
        else [(getattr(one, "source", ""), one) for one in several]
    )
    for name, log in pairs:
        if not isinstance(log, Log):
            more = "; give its `log`" if isinstance(getattr(log, "log", None), Log) else ""
            more = "; read the file with `read_log`" if isinstance(log, str | Path) else more
            raise InputError(f"{what}: {name!r} is a {type(log).__name__}, not a Log{more}.")
    if len(dict(pairs)) < len(pairs):
        raise ConfigError(
            f"{what}: two logs have the same source among {[name for name, _ in pairs]}; give them by name."
        )
    return dict(pairs)


def _declared(path: str | Path, channels: Mapping[str, Any], settings: Mapping[str, Any]) -> Config:
    """Return the configuration that reads one file as its columns are declared; its model is not used."""
    for key, value in channels.items():
        if value is None:
            raise ConfigError(f"read_log: {key!r} is missing; declare its columns with their units, or give `config`.")
    data = {
        "model": "-",
        "time": _channel(channels["time"], "time", "ms"),
        **{key: _channels(channels[key], key) for key in ("position", "torque")},
        "train": [{"file": str(path)}],
        **settings,
    }
    return _read(Config, data, "read_log")


def _channels(given: Any, key: str) -> Any:
    if not isinstance(given, Mapping):
        raise ConfigError(f"read_log: {key} is {given!r}; give by joint a column and its unit.")
    example = "rad" if key == "position" else "N m"
    return {joint: _channel(channel, f"{key}.{joint}", example) for joint, channel in given.items()}


def _channel(given: Any, where: str, example: str) -> Any:
    """Return a channel as the configuration has it; a pair is a column and its unit."""
    if isinstance(given, Mapping):
        return dict(given)
    if not isinstance(given, str) and isinstance(given, Sequence) and len(given) == 2:
        return {"column": given[0], "unit": given[1]}
    raise ConfigError(f"read_log: {where} is {given!r}; give a column and its unit, such as ({given!r}, {example!r}).")


def _kind(unit: str) -> Literal["revolute", "prismatic"]:
    return "prismatic" if unit.replace(" ", "") in UNITS["length"] else "revolute"


def _read(section: type[S], data: Mapping[str, Any], source: str) -> S:
    """Return settings, checked; ConfigError, led by ``source``, where one is wrong."""
    try:
        return section.model_validate(dict(data), context={"folder": ".", "code": "."})
    except ValidationError as error:
        raise ConfigError(worded(error, data, source)) from None
