"""A result that was saved, read again: the model with the values found, and how its recordings are to be read."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, choices
from dynident.identification import Recipe, Sources, mounted
from dynident.io.logs import Reading, read_logs
from dynident.io.project import parse_project
from dynident.io.robot import fingerprint
from dynident.io.settings import Config, LogSpec
from dynident.log import Log
from dynident.models import Model
from dynident.smoothers import Smoother, TimeShifted
from dynident.validation import LogValidation, validate

__all__ = ["Saved", "check_targets", "log_spec", "read_result"]

Array = NDArray[np.float64]
TEXT, FILE, HASH, ORIGIN = "configuration", "model file", "model file SHA-256", "configuration file"
SMOOTHER, OFFSET, TILT = "smoother used", "delay used", "lean used"


@dataclass(frozen=True, eq=False)
class Saved:
    """A saved identification: its configuration, model, ``value`` (p) and ``std`` (p) of the parameters, their
    ``verdict`` where it was known, and the smoother that was used.
    """

    config: Config
    model: Model
    value: Array
    std: Array
    verdict: tuple[str, ...]
    smoother: Smoother

    def read(self, text: str) -> Reading:
        """Read the recording named on a command line as ``log_spec`` says; its torques may be missing.

        Raises the errors of ``log_spec`` and ``read_logs``.
        """
        return read_logs(log_spec(text, self.config), self.config, self.model.joints, torque=False)

    def predict(self, log: Log) -> LogValidation:
        """Return the torque of a log by the model, beside the measured one."""
        return validate(self.model, self.value, self.smoother(log))


def check_targets(folder: Path, names: Iterable[str], sources: Sources) -> None:
    """Raise ConfigError where one of the files to be written is the configuration or the model's file."""
    read = {one.path for one in (sources.configuration, sources.model) if one is not None}
    for name in names:
        if str((folder / name).resolve()) in read:
            raise ConfigError(f"{folder / name}: would be replaced, and was read; choose another folder for --out.")


def read_result(path: Path) -> Saved:
    """Read a ``result.json`` and build its model again.

    Raises InputError where the file is no such result, ModelError where the model's file is another than it was or
    its parameters have other names, and ConfigError where its configuration cannot be read any more.
    """
    data = _load(path)
    settings = data["settings"]
    _check_hash(settings, path)
    project = parse_project(settings[TEXT], Path(settings[ORIGIN]), f"{path}, its configuration")
    model = project.model
    if TILT in settings:
        model = mounted(model, *_numbers(settings, TILT, 2, path))
    value, std, verdict = _values(data["parameters"], model, path)
    smoother = _smoother(project.recipe, settings[SMOOTHER], path)
    if OFFSET in settings:
        smoother = TimeShifted(smoother, *_numbers(settings, OFFSET, 1, path))
    return Saved(project.config, model, value, std, verdict, smoother)


def _values(parameters: list[dict[str, Any]], model: Model, path: Path) -> tuple[Array, Array, tuple[str, ...]]:
    """Return values and standard deviations (p) of the model's parameters, and their verdicts where these are known."""
    rows = {row["name"]: row for row in parameters}
    if list(rows) != list(model.names):
        odd = next(iter(set(rows) ^ set(model.names)), "")
        raise ModelError(f"{path}: its parameters are not those of the model ({odd!r}); identify again.")
    value, std = (np.array([_number(row[key]) for row in rows.values()]) for key in ("value", "std"))
    if not np.isfinite(value).all():
        raise InputError(f"{path}: a parameter has no value; identify again.")
    return value, std, tuple(row["verdict"] for row in rows.values() if "verdict" in row)


def log_spec(text: str, config: Config) -> LogSpec:
    """Return the recording named on a command line: a file, or ``key=file,key=file`` as the configuration has keys.

    Widths of text files are those of the training log. Raises ConfigError where keys are missing or unknown.
    """
    model = config.train[0]
    keys = list(model.file)
    if keys == [""]:
        if not text.strip():
            raise ConfigError("the name of a recording is empty; give a file.")
        return LogSpec.model_validate({"file": text, "width": model.width})
    pairs = _pairs(text, keys, _needed(config, keys))
    width = model.width
    if isinstance(width, Mapping):
        width = {key: count for key, count in width.items() if key in pairs}
    return LogSpec.model_validate({"file": pairs, "width": width})


def _pairs(text: str, keys: list[str], needed: list[str]) -> dict[str, str]:
    """Return the files by key of ``key=file,key=file``; ConfigError where one is unknown or missing."""
    pairs = dict(part.partition("=")[::2] for part in text.split(","))
    for key in pairs:
        if key not in keys:
            raise ConfigError(
                f"{text}: no file is called {key!r}; {choices(key, keys)} Write such as {_example(keys)}."
            )
    missing = [key for key in {**dict.fromkeys(needed), **pairs} if not pairs.get(key, "").strip()]
    if missing:
        raise ConfigError(f"{text}: the file {missing[0]!r} is missing; write such as {_example(keys)}.")
    return pairs


def _needed(config: Config, keys: list[str]) -> list[str]:
    """Return the keys of files that hold times or positions."""
    names = [name for channel in config.position.values() for name in channel.terms]
    names += [config.time.column] if config.time.column else []
    return [key for key in keys if any(name.startswith(f"{key}.") for name in names)]


def _example(keys: list[str]) -> str:
    return ",".join(f"{key}=FILE" for key in keys)


def _load(path: Path) -> dict[str, Any]:
    try:
        data = json.loads(path.read_bytes())
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}.") from error
    except ValueError as error:
        raise InputError(f"{path}: is not a result.json of `dynident identify` ({error}).") from error
    settings, rows = (data.get(key) if isinstance(data, dict) else None for key in ("settings", "parameters"))
    wanted = (TEXT, ORIGIN, SMOOTHER)
    sound = isinstance(settings, dict) and all(isinstance(settings.get(key), str) for key in wanted)
    if not (sound and isinstance(rows, list) and all(map(_is_row, rows))):
        raise InputError(
            f"{path}: is no result of `dynident identify` that can be used again; it needs `parameters`, and in "
            f"`settings` the {', '.join(wanted)}. Identify again."
        )
    return {"settings": settings, "parameters": rows}


def _is_row(row: object) -> bool:
    return isinstance(row, dict) and isinstance(row.get("name"), str) and {"value", "std"} <= row.keys()


def _number(value: object) -> float:
    """Return a number of the file, in which null stands for one that is not finite."""
    return float(value) if isinstance(value, int | float) else float("inf")


def _numbers(settings: Mapping[str, str], key: str, count: int, path: Path) -> list[float]:
    """Return the finite numbers that a setting holds, separated by commas; InputError for anything else."""
    try:
        found = [float(word) for word in settings[key].strip("()").split(",")]
    except (AttributeError, ValueError):
        found = []
    if len(found) != count or not np.isfinite(found).all():
        raise InputError(f"{path}: settings: {key} is {settings[key]!r}, not {count} finite numbers; identify again.")
    return found


def _check_hash(settings: Mapping[str, str], path: Path) -> None:
    if FILE in settings and HASH in settings:
        file = Path(settings[FILE])
        if fingerprint(file) != settings[HASH]:
            raise ModelError(
                f"{file}: has changed since {path} was identified with it, so that its parameters may mean something "
                "else. Put the old file back, or identify again."
            )


def _smoother(recipe: Recipe, words: str, path: Path) -> Smoother:
    """Return the smoother of that description among those of the configuration."""
    smoother = recipe.smoother
    for one in smoother if isinstance(smoother, tuple) else (smoother,):
        if repr(one) == words:
            return one
    raise ConfigError(f"{path}: its smoother {words} is none that its configuration makes now; identify again.")
