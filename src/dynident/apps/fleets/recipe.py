"""The recipe of a fleet: a configuration in which all that can be chosen is chosen once, for all logs."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from dynident.apps.fleets.config import FILES, NOTE, RECIPE, FleetLog, FleetSettings
from dynident.files.folder import ResultFolder, is_unchanged
from dynident.files.opener import content, is_address, local_file, real_path, refuse_inputs, relative
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import load_yaml
from dynident.identification import SourceFile, identify
from dynident.motion.log import Log
from dynident.project.config import config_text, parse_config
from dynident.project.explicit_config import explicit_settings, relocate_settings, settings_digest, settings_text
from dynident.project.project import parse_project
from dynident.runtime import ConfigError, InputError, Noun, choices, report_progress

MAX_TRIED = 5  # robots whose first logs choose, and logs of one that are tried
FORMAT = "dynident-fleet"
CHANNELS = ("position", "torque")
COMMENTS = {
    "": ("All logs of the fleet are identified with this recipe, so that they have the same parameters.",
         "Delete the file to choose it anew; what is changed here holds for all logs."),
    "train": ("the logs that chose it",),
}  # fmt: skip


class FleetRecipe(Noun):
    """Settings of a configuration without a choice and without logs, with file names relative to ``folder``, and the
    ``changes`` to them by robot."""

    settings: Mapping[str, Any]
    folder: Path
    changes: Mapping[str, Mapping[str, Any]]
    reading: Mapping[str, Any]

    def of(self, robot: str) -> dict[str, Any]:
        """Return the settings of a robot."""
        return merge_settings(self.settings, self.changes.get(robot, {}))

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
    settings: FleetSettings, logs: Sequence[FleetLog], folder: Path, place: ResultFolder | None
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
    recipe_settings = {key: _model_as_mapping(key, data[key]) for key in data if key not in ("train", "validation")}
    reading = {key: value for key in ("window", "width") if (value := getattr(settings, key))}
    requested = FleetRecipe(recipe_settings, path.parent, _changes_by_robot(settings, folder, path.parent), reading)
    _check_recipe(requested, settings.robots, path)
    if out is not None:
        refuse_inputs(*(out / name for name in FILES))  # before anything there is read
    base_folder, digest = out or path.parent, settings_digest(path.parent, recipe_settings, reading)
    changes = _changes_by_robot(settings, folder, base_folder)
    note = {} if out is None else _read_note(out)
    # a recipe that was made from the present settings is used again, also with changes by hand
    if out is not None and note.get("recipe") == digest and (out / RECIPE).is_file():
        stored_settings = load_yaml(config_text(out / RECIPE), str(out / RECIPE))
        recipe = FleetRecipe(stored_settings, out, changes, reading)
        _check_recipe(recipe, (), out / RECIPE)
        return recipe
    # what was edited by hand is never replaced
    if out is not None and os.path.lexists(out / RECIPE) and not is_unchanged(out / RECIPE, note.get("written")):
        raise ConfigError(
            f"{out / RECIPE}: was written or changed by hand, and would be replaced, since it was not made from {path} "
            "as this, and the robot file, are now; move or delete it, or choose another folder."
        )
    chosen_settings = _choose_settings(requested, path, logs, folder, base_folder)
    if place is not None:
        data = settings_text(chosen_settings, COMMENTS).encode("utf-8", "backslashreplace")
        note = {"format": FORMAT, "version": 1, "recipe": digest, "written": sha256(data).hexdigest()}
        place.replace({RECIPE: data, NOTE: json.dumps(note) + "\n"})
    return FleetRecipe(chosen_settings, base_folder, changes, reading)


def merge_settings(settings: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with others in their place; mappings are joined."""
    combined = dict(settings)
    for key, value in changes.items():
        is_joined = isinstance(combined.get(key), Mapping) and isinstance(value, Mapping)
        combined[key] = merge_settings(combined[key], value) if is_joined else value
    return combined


def _yaml_text(settings: Mapping[str, Any]) -> str:
    return str(yaml.safe_dump(dict(settings), sort_keys=False, allow_unicode=True))


def _changes_by_robot(settings: FleetSettings, old_folder: Path, folder: Path) -> dict[str, dict[str, Any]]:
    """Return what differs by robot, with names of files relative to a folder."""
    changes_by_robot = {}
    for robot, robot_changes in settings.robots.items():
        changed = {name: _model_as_mapping(name, _plain_dicts(value)) for name, value in robot_changes.changes.items()}
        model = changed.get("model")
        names_file = isinstance(model, str) or (isinstance(model, dict) and "file" in model)
        changes_by_robot[robot] = relocate_settings(changed, old_folder, folder) if names_file else changed
    return changes_by_robot


def _model_as_mapping(key: str, value: Any) -> Any:
    """Return a setting; a robot file that stands for the model becomes its ``file``, to be merged with other keys."""
    file = key == "model" and isinstance(value, str) and value.lower().endswith(SUFFIXES)
    return {"file": value} if file else value


def _plain_dicts(value: Any) -> Any:
    return {key: _plain_dicts(entry) for key, entry in value.items()} if isinstance(value, Mapping) else value


def _check_recipe(recipe: FleetRecipe, robots: Iterable[str], path: Path) -> None:
    """Raise ConfigError where the settings, or what differs in them for a robot, are wrong."""
    for robot in (None, *robots):
        settings = recipe.settings if robot is None else recipe.of(robot)
        source = str(path) if robot is None else f"{path} with the changes of robots.{robot}"
        for part in CHANNELS:
            channels = recipe.settings.get(part)
            for name in recipe.changes.get(robot or "", {}).get(part, {}):
                if isinstance(channels, Mapping) and name not in channels:
                    raise ConfigError(f"{source}: {part}: there is no {name!r}; {choices(name, channels)}")
        # a recipe has no logs, a configuration needs one
        logs = {"train": [{"file": "-"}]}
        parse_config(_yaml_text({**settings, **logs, "validation": []}), path.parent, source)


def _read_note(out: Path) -> dict[str, Any]:
    """Return what is noted of the recipe in a folder: digests of the one it was made from, and of its text."""
    try:
        note = json.loads(content(out / NOTE, remember=False))
    except (InputError, ValueError, RecursionError):
        return {}
    return note if isinstance(note, dict) and note.get("format") == FORMAT else {}


def _choose_settings(
    requested: FleetRecipe, path: Path, logs: Sequence[FleetLog], folder: Path, place: Path
) -> dict[str, Any]:
    """Return the settings with all that an identification of the first logs has chosen, for a configuration in the
    folder ``place``."""
    with ExitStack() as stack:
        train_logs: dict[str, Log] = {}
        specs, faults = [], list[str]()
        # the first readable log of each of a few robots chooses
        for robot in dict.fromkeys(fleet_log.robot for fleet_log in logs):
            for log in [fleet_log for fleet_log in logs if fleet_log.robot == robot][:MAX_TRIED]:
                report_progress(f"reading {log.log} for the recipe")
                try:
                    train_logs |= _read_log(requested, path, log, folder, stack)
                except (InputError, ConfigError) as error:
                    faults.append(str(error))
                    continue
                file = log.log if is_address(log.log) else relative(folder / log.log, path.parent)
                specs.append(requested.spec(f"{robot}: {log.log}", file))
                break
            if len(specs) == MAX_TRIED:
                break
        if not specs:
            raise InputError(f"no log can be read to choose the recipe: {faults[0]}")
        text = _yaml_text({**requested.settings, "train": specs})
        project = parse_project(text, path)
        identification = identify(project.model, train_logs, (), project.recipe)
    sources = replace(identification.provenance, configuration=SourceFile(str(real_path(path)), "", text))
    return explicit_settings(replace(identification, provenance=sources), place)


def _read_log(requested: FleetRecipe, path: Path, log: FleetLog, folder: Path, stack: ExitStack) -> dict[str, Log]:
    """Return a recording by name; InputError where it has a fault."""
    if log.fault:
        raise InputError(log.fault)
    file = stack.enter_context(local_file(log.log, folder))
    settings = {**requested.of(log.robot), "train": [requested.spec(log.log, str(real_path(file)))]}
    logs, _ = parse_project(_yaml_text(settings), path, f"{path} for {log.robot}").logs()
    return {f"{log.robot}: {name}": recording for name, recording in logs["train"].items()}
