"""A recording named on a command line, read with the channels of a configuration."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dynident.errors import ConfigError, choices
from dynident.io.settings import Config, LogSpec

__all__ = ["log_spec", "named", "recording_of"]


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


def named(spec: LogSpec) -> str:
    """Return the text by which a command line names a recording, with files below the current folder relative to it."""
    here = Path.cwd()
    files = {key: file.relative_to(here) if file.is_relative_to(here) else file for key, file in spec.file.items()}
    return ",".join(f"{key}={file}" if key else str(file) for key, file in files.items())


def recording_of(log: str, specs: Sequence[LogSpec]) -> LogSpec | None:
    """Return the recording that a log is, or a window or a piece of, by its name; None where there is none."""
    found = [spec for spec in specs if log == spec.label or log.startswith(f"{spec.label} ")]
    return max(found, key=lambda spec: len(spec.label), default=None)


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
