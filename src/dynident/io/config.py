"""Reads a configuration (YAML) into frozen settings, and builds the model that it names."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import chain, combinations, product
from pathlib import Path
from typing import TYPE_CHECKING

from pydantic import ValidationError

from dynident.errors import ConfigError, ModelError, choices
from dynident.io.channels import Channel
from dynident.io.fields import Interval, interval_words
from dynident.io.opener import keep, real
from dynident.io.opener import text as text_of
from dynident.io.python_file import CODE, XACRO_CODE, from_file, guarded, located
from dynident.io.settings import Config, RobotSettings, robot_settings
from dynident.io.wording import worded
from dynident.io.yaml_text import load_yaml

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["config_text", "config_warnings", "load_model", "parse_config", "read_config"]


def read_config(path: str | Path) -> Config:
    """Read a YAML configuration; relative file names in it start at its folder.

    Raises ConfigError with the path of the wrong setting (``train[0].window``), its value and the choices.
    """
    return parse_config(config_text(path), Path(path).parent, str(path))


def config_text(path: str | Path) -> str:
    """Return the text of a configuration; ConfigError where it cannot be read or is not text."""
    return text_of(path, ConfigError, (".yaml", ".yml"))


def parse_config(
    text: str, folder: str | Path = ".", source: str = "configuration", *, allow_code: bool = True
) -> Config:
    """Return the configuration in a YAML text, as ``read_config`` does for a file.

    Unless ``allow_code``, a part of a Python file is refused, as that would run the file.
    """
    data = load_yaml(text, source)
    if isinstance(data, dict) and "recipe" in data and "model" not in data:
        raise ConfigError(f"{source}: is the file of a fleet, for `dynident fleet`; a configuration has a `model`.")
    try:
        config = Config.model_validate(data, context={"folder": folder, "code": folder if allow_code else None})
    except ValidationError as error:
        raise ConfigError(worded(error, data, source)) from None
    _keep(config, Path(folder))
    return _named(config, source)


def _keep(config: Config, folder: Path) -> None:
    """Count the files that a configuration names among those read, also where a command does not open them."""
    model = config.model
    if isinstance(model, RobotSettings):
        models = list(model.file.values())
    else:
        models = [folder / model, folder / model.rpartition(":")[0]]
    logs = chain.from_iterable(spec.file.values() for spec in (*config.train, *config.validation))
    for path in (*logs, *models):
        keep(path)


def config_warnings(config: Config) -> tuple[str, ...]:
    """Return warnings on probable mistakes: channels with the same column, and logs both fitted and held out.

    Raises nothing: a configuration that cannot be used is refused by ``read_config``.
    """
    twice = [*_same_channels("position", config.position), *_same_channels("torque", config.torque)]
    return (*twice, *_torques_of_positions(config), *_overlaps(config))


def _same_channels(section: str, channels: Mapping[str, Channel]) -> Iterator[str]:
    for (a, one), (b, other) in combinations(channels.items(), 2):
        if (one.terms, one.gain, one.offset, one.unit) == (other.terms, other.gain, other.offset, other.unit):
            columns = ", ".join(map(repr, one.terms))
            yield (
                f"{section}.{a} and {section}.{b} read the same column {columns} with the same gain and offset; "
                "look whether one of them should name another column."
            )


def _torques_of_positions(config: Config) -> Iterator[str]:
    for (a, torque), (b, position) in product(config.torque.items(), config.position.items()):
        for column in (name for name in torque.terms if name in position.terms):
            yield (
                f"torque.{a} reads the column {column!r}, which is also read by position.{b}; "
                "that is right only where the torque is measured as a deflection."
            )


def _overlaps(config: Config) -> Iterator[str]:
    """Return warnings on validation logs that overlap in time with a training log; windows may touch."""
    for held, fitted in product(config.validation, config.train):
        if set(map(real, held.file.values())) & set(map(real, fitted.file.values())):
            pairs = product(held.window or ((None, None),), fitted.window or ((None, None),))
            if any(_overlap(one, other) for one, other in pairs):
                yield (
                    f"validation {held.label!r} overlaps in time with train {fitted.label!r} of the same file: "
                    "its errors are no test of samples that the fit has not seen; choose windows that do not overlap."
                )


def _overlap(one: Interval, other: Interval) -> bool:
    start = max(-math.inf if window[0] is None else window[0] for window in (one, other))
    return start < min(math.inf if window[1] is None else window[1] for window in (one, other))


def _named(config: Config, source: str) -> Config:
    """Fill in the names of the logs: the file's stem, with the window where a file serves more than once."""
    specs = (*config.train, *config.validation)
    uses = Counter(tuple(spec.file.values()) for spec in specs)
    named = []
    for spec in specs:
        several = spec.name is None and uses[tuple(spec.file.values())] > 1
        window = f" {interval_words(spec.window[0])}" if several and spec.window else ""
        named.append(spec.model_copy(update={"name": spec.label + window}))
    name, count = Counter(spec.name for spec in named).most_common(1)[0]
    if count > 1:
        raise ConfigError(f"{source}: {count} logs are named {name!r}; give each of them a distinct `name`.")
    split = len(config.train)
    return config.model_copy(update={"train": tuple(named[:split]), "validation": tuple(named[split:])})


def load_model(
    spec: str | RobotSettings, folder: str | Path = ".", text: str | None = None, *, allow_code: bool = True
) -> Model:
    """Build the model of a robot file, ``gallery:NAME`` or ``path/to/file.py:function`` (relative to ``folder``).

    ``text`` stands for the content of a robot file where that is known. Raises ModelError where there is no such name,
    file or function, where it is a function and not ``allow_code``, where the function raises, or where
    it returns something else than a Model.
    """
    from dynident.io.robot import is_xacro, load_robot
    from dynident.models import Model

    if isinstance(spec, str):
        spec = robot_settings(spec, {"folder": folder}) or spec
    if isinstance(spec, RobotSettings):
        if text is None and not allow_code and any(map(is_xacro, spec.file.values())):
            raise ModelError(f"model: {' '.join(map(str, spec.file.values()))} {XACRO_CODE}")
        return load_robot(spec, text)
    place, colon, name = spec.rpartition(":")
    if not (place and colon and name):
        raise ModelError(
            f"model: {spec!r} is neither a robot file (.urdf, .xml) nor `gallery:NAME` nor `path/to/file.py:function`."
        )
    if place != "gallery" and not allow_code:
        raise ModelError(f"model: {spec!r} {CODE}")
    path = located(folder, place, "model", ModelError)
    found = _from_gallery(name) if place == "gallery" else from_file(path, name, "function", "model", ModelError)
    model = guarded(found, spec, path, "model", ModelError)
    if not isinstance(model, Model):
        raise ModelError(f"model: {spec} returned a {type(model).__name__}; it must return a dynident Model.")
    return model


def _from_gallery(name: str) -> Callable[[], object]:
    from dynident.models.gallery import MODELS

    if name not in MODELS:
        raise ModelError(f"model: the gallery has no {name!r}; {choices(name, MODELS)}")
    return MODELS[name]
