"""Reads a configuration (YAML) into frozen settings, and builds the model that it names."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, combinations, product
from pathlib import Path
from typing import Any

import numpy as np

from dynident.files.folder import settle
from dynident.files.opener import XML_WEIGHT, open_input, read_text, real_path, remember_inputs
from dynident.files.xml_text import SUFFIXES, XACRO, expand
from dynident.files.yaml_text import load_yaml
from dynident.identification import SourceFile
from dynident.models import INERTIAL, CoupledMotor, Joint, Model, RigidBodies, Term
from dynident.models.friction import PerJoint
from dynident.project.fields import Channel, interval_ends, interval_words
from dynident.project.parts import build
from dynident.project.python_file import CODE, XACRO_CODE, load_from_file, resolve_file, run_user_code
from dynident.project.settings import AUTO, PLAIN_TERMS, Config, RobotSettings, robot_settings
from dynident.runtime import ConfigError, ModelError, choices, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.families import TERMS

NOMINAL_ATTRIBUTES = {"viscous": "damping", "coulomb": "friction", "rotor": "armature"}  # of a robot file, by role


def robot_text(path: Path) -> str:
    """Return the text of a robot file, with what it includes and the inertias of an MJCF's meshes.

    A xacro file is expanded by that program. Raises ModelError where it cannot be read or is not text.
    """
    from dynident.files.meshes import with_mesh_inertias
    from dynident.files.xml_text import with_includes

    settle(path.parent)  # it may be an export
    if is_xacro(path):
        return expand(path)
    return with_mesh_inertias(with_includes(read_text(path, ModelError, SUFFIXES, XML_WEIGHT), path), path)


def is_xacro(path: Path) -> bool:
    """Whether a file is expanded by a program, so that reading it runs what it says."""
    return path.suffix.lower() == XACRO


def has_changed(file: SourceFile) -> bool:
    """Whether a robot file, or one that it includes, is not as it was; ModelError where one cannot be read."""
    path = Path(file.path)
    if fingerprint(path) != file.sha256:
        return True
    # a file that it includes may have changed, although the file itself has not
    return bool(file.text) and not is_xacro(path) and robot_text(path) != file.text


def model_file(spec: str | RobotSettings, folder: Path) -> Path | None:
    """Return the file that a model is built from; None for a model of the gallery."""
    if isinstance(spec, RobotSettings):
        return next(iter(spec.file.values()))
    name = spec if Path(spec).suffix.lower() in SUFFIXES else spec.rpartition(":")[0]
    return None if name == "gallery" else real_path(folder / name, ModelError)


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files one after the other; ModelError where one cannot be read."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    try:
        for file in files:
            with open_input(file, ModelError) as content:
                while part := content.read(1 << 20):
                    digest.update(part)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}.") from error
    return digest.hexdigest()


def load_robot(settings: RobotSettings, text: str | None = None) -> Model:
    """Build the model of a robot file: rigid bodies, rotor inertias, friction, offsets, couplings as configured.

    ``text`` stands for the content of the file where that is known; that terms are to be chosen is said by the model.
    Raises ModelError where the file cannot be read or used, or a joint is unknown.
    """
    if len(settings.file) != 1:
        raise ModelError(f"model.file: names {len(settings.file)} files; a robot is one file.")
    (path,) = settings.file.values()
    xml = robot_text(path) if text is None else text
    bodies = RigidBodies(xml, settings.joints, settings.lock, settings.gravity, path.name)
    joints = bodies.joints
    terms: list[Term] = [bodies, *(term for term in configured_terms(settings, joints) if term is not None)]
    for name, coupling in settings.couplings.items():
        inertia, viscous, coulomb = (kind in coupling.terms for kind in ("rotor", "viscous", "coulomb"))
        parts: dict[str, Any] = {"inertia": inertia, "viscous": viscous, "coulomb": coulomb, "offset": False}
        terms.append(CoupledMotor(joints, coupling.joints, **parts, width=settings.coulomb_width, name=name))
    return Model(tuple(terms), path.stem, chooses_terms=settings.chooses_terms, proposed=settings.proposed)


def replace_auto_terms(spec: str | RobotSettings) -> str | RobotSettings:
    """Return the settings of a model with the plain set in place of terms that the training logs choose."""
    if not isinstance(spec, RobotSettings):
        return spec
    terms = [PLAIN_TERMS if term == AUTO else (term,) for term in spec.terms]
    return spec.model_copy(update={"terms": tuple(chain.from_iterable(terms))})


def configured_terms(settings: RobotSettings, joints: tuple[Joint, ...]) -> tuple[Term | None, ...]:
    """Return the terms that are listed, None for those that are to be chosen."""
    chosen_by_logs = {AUTO, *settings.proposed}
    parts = [TERMS.get(term) if isinstance(term, str) and term != AUTO else term for term in settings.terms]
    pairs = zip(settings.terms, parts, strict=True)
    return tuple(
        None if part in chosen_by_logs else _build_term(term, joints, settings.coulomb_width) for term, part in pairs
    )


def _build_term(term_spec: str | Callable[..., Term], joints: tuple[Joint, ...], width: float) -> Term:
    """Return a term for all joints, by its kind alone or with settings of its own."""
    if not isinstance(term_spec, str):
        return term_spec(joints=joints)
    settings = {"kind": term_spec} | ({"width": width} if term_spec == "coulomb" else {})
    term: Term = build(TERMS, settings, "model.terms", joints=joints)
    return term


def nominal_values(model: Model) -> Array:
    """Return the parameters (p) that the robot file says: its bodies, and friction and rotor inertia where it gives
    them, else zero.

    Raises ModelError where a body has no inertia.
    """
    missing = [part.body for part in model.parameters if part.role in INERTIAL and part.value is None]
    if missing:
        raise ModelError(
            f"{model.name}: the inertia of {join_names(dict.fromkeys(missing), 5)} is not in the robot file, so that "
            "the torque of a motion is not known; add it, or give the result of an identification."
        )
    bodies = [term for term in model.terms if isinstance(term, RigidBodies)]
    theta: list[float] = []
    for term in model.terms:
        joints, values_by_joint = ("",) * len(term.parameters), dict[str, float]()
        # friction and rotor inertia come from attributes of the file's joints, other terms without a value are zero
        if isinstance(term, PerJoint) and not term.memory and term.role in NOMINAL_ATTRIBUTES:
            joints = term.acts_on
            values_by_joint = {
                key: value for part in bodies for key, value in getattr(part, NOMINAL_ATTRIBUTES[term.role]).items()
            }
        pairs = zip(term.parameters, joints, strict=True)
        theta += [values_by_joint.get(joint, 0.0) if part.value is None else part.value for part, joint in pairs]
    return np.array(theta)


def read_config(path: str | Path) -> Config:
    """Read a YAML configuration; relative file names in it start at its folder.

    Raises ConfigError with the path of the wrong setting (``train[0].window``), its value and the choices.
    """
    return parse_config(config_text(path), Path(path).parent, str(path))


def config_text(path: str | Path) -> str:
    """Return the text of a configuration; ConfigError where it cannot be read or is not text."""
    return read_text(path, ConfigError, (".yaml", ".yml"))


def parse_config(
    text: str, folder: str | Path = ".", source: str = "configuration", *, allow_code: bool = True
) -> Config:
    """Return the configuration in a YAML text, as ``read_config`` does for a file.

    Unless ``allow_code``, a part of a Python file is refused, as that would run the file.
    """
    data = load_yaml(text, source)
    if isinstance(data, dict) and "recipe" in data and "model" not in data:
        raise ConfigError(f"{source}: is the file of a fleet, for `dynident fleet`; a configuration has a `model`.")
    config = Config.read(data, source, folder=folder, code=folder if allow_code else None)
    _keep_files(config, Path(folder))
    return _name_logs(config, source)


def _keep_files(config: Config, folder: Path) -> None:
    """Register the files that a configuration names as inputs, even if a command does not open them."""
    model = config.model
    models = [folder / model, folder / model.rpartition(":")[0]] if isinstance(model, str) else model.file.values()
    logs = chain.from_iterable(spec.file.values() for spec in (*config.train, *config.validation))
    for path in (*logs, *models):
        remember_inputs(path)


def config_warnings(config: Config) -> tuple[str, ...]:
    """Return warnings on probable mistakes: channels with the same column, and logs both fitted and held out.

    Raises nothing: a configuration that cannot be used is refused by ``read_config``.
    """
    twice = [*_same_channel_warnings("position", config.position), *_same_channel_warnings("torque", config.torque)]
    return (*twice, *_shared_column_warnings(config), *_overlap_warnings(config))


def _same_channel_warnings(section: str, channels: Mapping[str, Channel]) -> Iterator[str]:
    keys = ("terms", "gain", "offset", "unit")
    for (a, channel), (b, other_channel) in combinations(channels.items(), 2):
        if all(getattr(channel, key) == getattr(other_channel, key) for key in keys):
            columns = ", ".join(map(repr, channel.terms))
            yield (
                f"{section}.{a} and {section}.{b} read the same column {columns} with the same gain and offset; "
                "look whether one of them should name another column."
            )


def _shared_column_warnings(config: Config) -> Iterator[str]:
    for (a, torque), (b, position) in product(config.torque.items(), config.position.items()):
        for column in (name for name in torque.terms if name in position.terms):
            yield (
                f"torque.{a} reads the column {column!r}, which is also read by position.{b}; "
                "that is right only where the torque is measured as a deflection."
            )


def _overlap_warnings(config: Config) -> Iterator[str]:
    """Return warnings on validation logs that overlap in time with a training log; windows may touch."""
    for validation_log, training_log in product(config.validation, config.train):
        if set(map(real_path, validation_log.file.values())) & set(map(real_path, training_log.file.values())):
            windows = (map(interval_ends, log.window or ((None, None),)) for log in (validation_log, training_log))
            if any(max(a, b) < min(c, d) for (a, c), (b, d) in product(*windows)):
                yield (
                    f"validation {validation_log.label!r} overlaps in time with train {training_log.label!r} of the "
                    "same file: its errors are no test of samples that the fit has not seen; choose windows that do "
                    "not overlap."
                )


def _name_logs(config: Config, source: str) -> Config:
    """Fill in the names of the logs: the file's stem, with the window where a file serves more than once."""
    specs = (*config.train, *config.validation)
    uses = Counter(tuple(spec.file.values()) for spec in specs)
    named_specs = []
    for spec in specs:
        # one file that serves several logs: its window tells them apart
        needs_window = spec.name is None and uses[tuple(spec.file.values())] > 1
        window = f" {interval_words(spec.window[0])}" if needs_window and spec.window else ""
        named_specs.append(spec.model_copy(update={"name": spec.label + window}))
    # logs are found by name in results and reports, so names must differ
    name, count = Counter(spec.name for spec in named_specs).most_common(1)[0]
    if count > 1:
        advice = "hold out another file or `window`, or give each of them a distinct `name`."
        raise ConfigError(f"{source}: {count} logs are named {name!r}; {advice}")
    split = len(config.train)
    return config.model_copy(update={"train": tuple(named_specs[:split]), "validation": tuple(named_specs[split:])})


def load_model(
    spec: str | RobotSettings, folder: str | Path = ".", text: str | None = None, *, allow_code: bool = True
) -> Model:
    """Build the model of a robot file, ``gallery:NAME`` or ``path/to/file.py:function`` (relative to ``folder``).

    ``text`` stands for the content of a robot file where that is known. Raises ModelError where there is no such name,
    file or function, where it is a function and not ``allow_code``, where the function raises, or where
    it returns something else than a Model.
    """
    if isinstance(spec, str):
        spec = robot_settings(spec, {"folder": folder}) or spec
    if isinstance(spec, RobotSettings):
        # xacro runs commands, so that reading such a file counts as running code
        if text is None and not allow_code and any(map(is_xacro, spec.file.values())):
            raise ModelError(f"model: {' '.join(map(str, spec.file.values()))} {XACRO_CODE}")
        return load_robot(spec, text)
    # all else is a function, of the gallery or of a Python file, that makes the model
    place, colon, name = spec.rpartition(":")
    if not (place and colon and name):
        raise ModelError(
            f"model: {spec!r} is neither a robot file (.urdf, .xml) nor `gallery:NAME` nor `path/to/file.py:function`."
        )
    if place != "gallery" and not allow_code:
        raise ModelError(f"model: {spec!r} {CODE}")
    path = resolve_file(folder, place, "model", ModelError)
    factory = _from_gallery(name) if place == "gallery" else load_from_file(path, name, "function", "model", ModelError)
    model = run_user_code(factory, spec, path, "model", ModelError)
    if not isinstance(model, Model):
        raise ModelError(f"model: {spec} returned a {type(model).__name__}; it must return a dynident Model.")
    return model


def _from_gallery(name: str) -> Callable[[], object]:
    from dynident.models.lagrangian import MODELS

    if name not in MODELS:
        raise ModelError(f"model: the gallery has no {name!r}; {choices(name, MODELS)}")
    return MODELS[name]
