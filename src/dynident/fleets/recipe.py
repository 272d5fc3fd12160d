"""The recipe of a fleet: a configuration in which all that can be chosen is chosen once, for all logs."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from dynident.errors import ConfigError, InputError, brief, choices
from dynident.fleets.folders import FILES, NOTE, RECIPE
from dynident.fleets.listing import FleetLog
from dynident.fleets.settings import FleetSettings
from dynident.identification import SourceFile, identify
from dynident.io.config import config_text, parse_config
from dynident.io.config_draft import relative
from dynident.io.digests import settings_digest
from dynident.io.explicit_config import explicit_settings, relocated, settings_text
from dynident.io.folder import ResultFolder
from dynident.io.opener import content, real, refuse_inputs
from dynident.io.places import is_address, local_file
from dynident.io.project import parse_project
from dynident.io.robot import SUFFIXES
from dynident.io.yaml_text import load_yaml
from dynident.log import Log

__all__ = ["FleetRecipe", "fleet_recipe"]

Progress = Callable[[str], None]
MOST = 5  # robots whose first logs choose, and logs of one that are tried
FORMAT = "dynident-fleet"
CHANNELS = ("position", "torque")
COMMENTS = {
    "": ("All logs of the fleet are identified with this recipe, so that they have the same parameters.",
         "Delete the file to choose it anew; what is changed here holds for all logs."),
    "train": ("the logs that chose it",),
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class FleetRecipe:
    """Settings of a configuration without a choice and without logs, with file names relative to ``folder``, and the
    ``changes`` to them by robot."""

    settings: Mapping[str, Any]
    folder: Path
    changes: Mapping[str, Mapping[str, Any]]
    reading: Mapping[str, Any]

    __repr__ = brief

    def of(self, robot: str) -> dict[str, Any]:
        """Return the settings of a robot."""
        return merged(self.settings, self.changes.get(robot, {}))

    def digest(self, robot: str) -> str:
        """Return what tells the recipe of a robot from others: its settings, and the content of the files in them.

        Raises ModelError where a file cannot be read.
        """
        settings = {key: value for key, value in self.of(robot).items() if key not in ("train", "validation")}
        return settings_digest(self.folder, settings, self.reading)

    def digests(self, robots: Iterable[str]) -> dict[str, str]:
        """Return the digests of robots by name."""
        usual = self.digest("")
        return {robot: self.digest(robot) if robot in self.changes else usual for robot in robots}

    def spec(self, name: str, file: str) -> dict[str, Any]:
        """Return a log as a configuration names it, read from a ``file``."""
        return {"file": file, "name": name, **self.reading}


def fleet_recipe(
    settings: FleetSettings, logs: Sequence[FleetLog], folder: Path, place: ResultFolder | None, progress: Progress
) -> FleetRecipe:
    """Return the recipe in the folder ``place``, where it was made from the present one; else choose it on the first
    log of up to five robots together, and write it there.

    ``folder`` is that of the fleet's configuration. Raises ConfigError and ModelError where the recipe cannot be used,
    or would replace one that was changed by hand, InputError where none of these logs can.
    """
    out = None if place is None else place.path
    path = settings.recipe
    data = load_yaml(config_text(path), str(path))
    if not isinstance(data, dict):
        raise ConfigError(f"{path}: is no configuration: a mapping of settings is expected.")
    given = {key: _named(key, value) for key, value in data.items() if key not in ("train", "validation")}
    reading = {key: value for key in ("window", "width") if (value := getattr(settings, key))}
    asked = FleetRecipe(given, path.parent, _changes(settings, folder, path.parent), reading)
    _checked(asked, settings.robots, path)
    if out is not None:
        refuse_inputs(*(out / name for name in FILES))  # before anything there is read
    start, digest = out or path.parent, settings_digest(path.parent, given, reading)
    changes = _changes(settings, folder, start)
    note = {} if out is None else _note(out)
    if out is not None and note.get("recipe") == digest and (out / RECIPE).is_file():
        known = load_yaml(config_text(out / RECIPE), str(out / RECIPE))
        recipe = FleetRecipe(known, out, changes, reading)
        _checked(recipe, (), out / RECIPE)
        return recipe
    if out is not None and os.path.lexists(out / RECIPE) and note.get("written") != _fingerprint(out / RECIPE):
        raise ConfigError(
            f"{out / RECIPE}: was written or changed by hand, and would be replaced, since it was not made from {path} "
            "as this, and the robot file, are now; move or delete it, or choose another folder."
        )
    chosen = _chosen(asked, path, logs, folder, start, progress)
    if place is not None:
        data = settings_text(chosen, COMMENTS).encode("utf-8", "backslashreplace")
        note = {"format": FORMAT, "version": 1, "recipe": digest, "written": sha256(data).hexdigest()}
        place.replace({RECIPE: data, NOTE: json.dumps(note) + "\n"})
    return FleetRecipe(chosen, start, changes, reading)


def merged(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with others in their place; mappings are joined."""
    found = dict(settings)
    for key, value in changes.items():
        before = found.get(key)
        found[key] = merged(before, value) if isinstance(before, Mapping) and isinstance(value, Mapping) else value
    return found


def _check_joints(part: str, known: Any, given: Mapping[str, Any], source: str) -> None:
    """Raise ConfigError where a joint has changes but no channel."""
    for name in given:
        if isinstance(known, Mapping) and name not in known:
            raise ConfigError(f"{source}: {part}: there is no {name!r}; {choices(name, known)}")


def _yaml(settings: Mapping[str, Any]) -> str:
    return str(yaml.safe_dump(dict(settings), sort_keys=False, allow_unicode=True))


def _changes(settings: FleetSettings, was: Path, folder: Path) -> dict[str, dict[str, Any]]:
    """Return what differs by robot, with names of files relative to a folder."""
    found = {}
    for robot, one in settings.robots.items():
        own = {name: _named(name, _plain(value)) for name, value in one.changes.items()}
        model = own.get("model")
        named = isinstance(model, str) or (isinstance(model, dict) and "file" in model)
        found[robot] = relocated(own, was, folder) if named else own
    return found


def _named(key: str, value: Any) -> Any:
    """Return a setting, a robot file that stands for the model as the ``file`` of it, to be merged with other keys."""
    file = key == "model" and isinstance(value, str) and value.lower().endswith(SUFFIXES)
    return {"file": value} if file else value


def _plain(value: Any) -> Any:
    return {key: _plain(one) for key, one in value.items()} if isinstance(value, Mapping) else value


def _checked(recipe: FleetRecipe, robots: Iterable[str], path: Path) -> None:
    """Raise ConfigError where the settings, or what differs in them for a robot, are wrong."""
    for robot in (None, *robots):
        settings = recipe.settings if robot is None else recipe.of(robot)
        source = str(path) if robot is None else f"{path} with the changes of robots.{robot}"
        for part in CHANNELS:
            _check_joints(part, recipe.settings.get(part), recipe.changes.get(robot or "", {}).get(part, {}), source)
        logs = {"train": [{"file": "-"}]}
        parse_config(_yaml({**settings, **logs, "validation": []}), path.parent, source)


def _note(out: Path) -> dict[str, Any]:
    """Return what is noted of the recipe in a folder: digests of the one it was made from, and of its text."""
    try:
        note = json.loads(content(out / NOTE, remember=False))
    except (InputError, ValueError, RecursionError):
        return {}
    return note if isinstance(note, dict) and note.get("format") == FORMAT else {}


def _fingerprint(file: Path) -> str | None:
    """Return the digest of a file, None where it cannot be read."""
    try:
        return sha256(content(file, remember=False)).hexdigest()
    except InputError:
        return None


def _chosen(
    asked: FleetRecipe, path: Path, logs: Sequence[FleetLog], folder: Path, place: Path, progress: Progress
) -> dict[str, Any]:
    """Return the settings with all that an identification of the first logs has chosen, for a configuration in the
    folder ``place``."""
    with ExitStack() as stack:
        used: dict[str, Log] = {}
        specs, faults = [], list[str]()
        for robot in dict.fromkeys(one.robot for one in logs):
            for log in [one for one in logs if one.robot == robot][:MOST]:
                progress(f"reading {log.log} for the recipe")
                try:
                    used |= _read(asked, path, log, folder, stack)
                except (InputError, ConfigError) as error:
                    faults.append(str(error))
                    continue
                file = log.log if is_address(log.log) else relative(folder / log.log, path.parent)
                specs.append(asked.spec(f"{robot}: {log.log}", file))
                break
            if len(specs) == MOST:
                break
        if not specs:
            raise InputError(f"no log can be read to choose the recipe: {faults[0]}")
        text = _yaml({**asked.settings, "train": specs})
        project = parse_project(text, path)
        found = identify(project.model, used, (), project.recipe, progress=progress)
    sources = replace(found.provenance, configuration=SourceFile(str(real(path)), "", text))
    return explicit_settings(replace(found, provenance=sources), place)


def _read(asked: FleetRecipe, path: Path, log: FleetLog, folder: Path, stack: ExitStack) -> dict[str, Log]:
    """Return a recording by name; InputError where it has a fault."""
    if log.fault:
        raise InputError(log.fault)
    file = stack.enter_context(local_file(log.log, folder))
    settings = {**asked.of(log.robot), "train": [asked.spec(log.log, str(real(file)))]}
    found, _ = parse_project(_yaml(settings), path, f"{path} for {log.robot}").logs()
    return {f"{log.robot}: {name}": one for name, one in found["train"].items()}
