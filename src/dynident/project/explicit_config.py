"""The configuration of a result with all that was chosen written out, so that nothing is left to choose."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, asdict, fields
from hashlib import sha256
from pathlib import Path
from typing import Any

import yaml

from dynident.files.opener import real_path, relative
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import UNPRINTABLE, load_yaml
from dynident.identification import Identification, Recipe, SourceFile
from dynident.models import CoupledMotor, Model, RigidBodies
from dynident.motion.smoothers import strip_time_offset
from dynident.project.config import fingerprint, robot_text
from dynident.project.settings import robot_settings
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS, PartFamily

_BOOL_TAG = "tag:yaml.org,2002:bool"


def settings_digest(folder: Path, *settings: Any) -> str:
    """Return a digest of settings, in which the content of the files that they name in ``folder`` counts.

    Raises ModelError where a robot file, or a Python file, cannot be read.
    """
    text = json.dumps([_with_file_digests(setting, folder) for setting in settings], sort_keys=True, default=str)
    return sha256(text.encode()).hexdigest()[:12]


def _with_file_digests(value: Any, folder: Path) -> Any:
    """Return settings with the digest of its content in place of the name of a robot file or a Python file."""
    if isinstance(value, Mapping):
        return {str(key): _with_file_digests(entry, folder) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_with_file_digests(entry, folder) for entry in value]
    if not isinstance(value, str):
        return value
    # the content counts instead of the name, so that an edited file gives another digest
    if value.lower().endswith(SUFFIXES):
        return sha256(robot_text(real_path(folder / value)).encode()).hexdigest()
    place, colon, name = value.rpartition(":")
    return f"{fingerprint(real_path(folder / place))}{colon}{name}" if place.endswith(".py") else value


def explicit_config(identification: Identification, path: Path, comments: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a configuration, to lie at ``path``, that repeats a result without any choice.

    ``comments`` are lines to stand above keys, those of the model as ``model.terms``; those above all by the key "".
    Raises ConfigError where the result was made without a configuration, or a part has settings without a plain form.
    """
    return settings_text(explicit_settings(identification, path.parent), comments)


def settings_text(settings: Mapping[str, Any], comments: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a configuration with these settings, and ``comments`` as in ``explicit_config``."""
    lines = [*_comment_lines(comments, ""), ""]
    for key, value in settings.items():
        if key == "model" and isinstance(value, dict):
            lines.append("model:")
            for name, setting in value.items():
                lines += [*_comment_lines(comments, f"model.{name}", "  "), *_yaml_lines(name, setting, "  ")]
        else:
            lines += [*_comment_lines(comments, key), *_yaml_lines(key, value)]
    return "\n".join(lines) + "\n"


def explicit_settings(identification: Identification, folder: Path) -> dict[str, Any]:
    """Return the explicit configuration of a result as plain values, with file names relative to ``folder``.

    Raises as ``explicit_config``.
    """
    source = identification.provenance.configuration
    if source is None:
        raise ConfigError("the result was made from Python, without a configuration, so that none can be written.")
    return fixed_settings(source, identification.recipe, identification.model, folder)


def fixed_settings(source: SourceFile, recipe: Recipe, model: Model, folder: Path) -> dict[str, Any]:
    """Return the configuration ``source`` as plain values, with a recipe and the terms of a model that leave no choice.

    File names become relative to ``folder``. Raises ConfigError where a part has settings without a plain form.
    """
    old_folder, folder = Path(source.path).parent, real_path(folder)
    data = relocate_settings(load_yaml(source.text, source.path), old_folder, folder)
    # the time offset is written as a setting of its own, not as part of the smoother
    smoother = strip_time_offset(recipe.smoothers[0])
    resolved_settings = {
        "model": _fix_terms(recipe, model, data["model"], folder),
        "time_offset": recipe.time_offset,
        "min_speed": recipe.min_speed,
        "smoother": part_settings(SMOOTHERS, smoother, folder),
        "estimator": part_settings(ESTIMATORS, recipe.estimator, folder),
        "filter": recipe.filter and _without_defaults(asdict(recipe.filter), recipe.filter),
        "unfitted": list(recipe.unfitted),
        "outliers": recipe.outliers,
        "rests": recipe.rests,
    }
    # what was resolved replaces what the configuration left open
    return {key: value for key, value in {**data, **resolved_settings}.items() if value is not None and value != []}


def relocate_settings(settings: Mapping[str, Any], old_folder: Path, folder: Path) -> dict[str, Any]:
    """Return settings whose file names, relative to ``old_folder``, are made relative to ``folder``."""

    def relocate_files(files: Any) -> Any:
        """Return the name of a file, or a mapping of short names to them, relative to the other folder."""
        if isinstance(files, Mapping):
            return {key: relocate_files(file) for key, file in files.items()}
        return str(files) if Path(str(files)).is_absolute() else relative(old_folder / str(files), folder)

    data = {key: _map_kinds(value, relocate_files) for key, value in settings.items()}
    model = data["model"]
    if isinstance(model, dict):
        data["model"] = model | {"file": relocate_files(model["file"])}
    elif robot_settings(model) is not None:
        data["model"] = relocate_files(model)
    else:  # a function of a Python file, or a model of the gallery
        place, colon, name = str(model).rpartition(":")
        data["model"] = f"{relative(old_folder / place, folder)}{colon}{name}" if place != "gallery" else model
    for role in ("train", "validation"):
        if data.get(role):
            data[role] = [{**log, "file": relocate_files(log["file"])} for log in data[role]]
    return data


def _map_kinds(value: Any, file_name: Callable[[str], str]) -> Any:
    """Return a part, and those inside it, with the names of the Python files in their kinds as ``file_name`` says."""
    if isinstance(value, list):
        return [_map_kinds(entry, file_name) for entry in value]
    if not isinstance(value, dict):
        return value
    entries = {key: _map_kinds(entry, file_name) for key, entry in value.items()}
    # the kind of a part of the user names a file and a class in it
    place, colon, name = str(value.get("kind", "")).rpartition(":")
    return entries | {"kind": f"{file_name(place)}{colon}{name}"} if place.endswith(".py") else entries


def _fix_terms(recipe: Recipe, model: Model, settings: Any, folder: Path) -> Any:
    """Return the settings of a model, with its terms and the tilt of its base where it is built of a robot file."""
    if isinstance(settings, str) and robot_settings(settings) is None:
        return settings
    data = dict(settings) if isinstance(settings, Mapping) else {"file": settings}
    data["base_tilt"] = list(recipe.base_tilt) if isinstance(recipe.base_tilt, tuple) else "none"
    # bodies and couplings follow from the robot file and the other keys, the remaining terms are listed
    joint_terms = [term for term in model.terms if not isinstance(term, RigidBodies | CoupledMotor)]
    return data | {"terms": [part_settings(TERMS, term, folder) for term in joint_terms]}


def part_settings(family: PartFamily, part: Any, folder: Path) -> Any:
    """Return the settings of a part that are not as they are by default, its Python file relative to a folder.

    Raises ConfigError where a setting has no plain form.
    """
    return _map_kinds(_without_defaults(family.describe(part), part), lambda place: relative(Path(place), folder))


def _without_defaults(described: dict[str, Any], part: Any) -> dict[str, Any]:
    """Return the settings of a part, and of parts inside it, without those that are as they are by default."""
    # a part may keep its settings in another class than itself
    holder = getattr(type(part), "Settings", type(part))
    defaults = {field.name: field.default for field in (*fields(part), *fields(holder)) if field.init}
    return {
        key: _without_defaults(value, getattr(part, key)) if isinstance(value, dict) and "kind" in value else value
        for key, value in described.items()
        if key == "kind" or not (value is None or _is_default(value, defaults.get(key, MISSING)))
    }


def _is_default(value: Any, default: Any) -> bool:
    """Whether a setting, or that of each joint, is as it is by default."""
    if isinstance(value, dict | list) and not value:
        return not default
    return all(entry == default for entry in value.values()) if isinstance(value, dict) else value == default


def _comment_lines(comments: Mapping[str, Sequence[str]], key: str, indent: str = "") -> list[str]:
    """Return the lines above a key; names in them may hold anything."""
    return [f"{indent}# {UNPRINTABLE.sub('?', line)}" for line in comments.get(key, ())]


def _yaml_lines(key: str, value: Any, indent: str = "") -> list[str]:
    """Return a setting as YAML, in which mappings and lists of plain values alone are on one line."""
    how: dict[str, Any] = {"default_flow_style": None, "width": math.inf, "sort_keys": False, "allow_unicode": True}
    text = yaml.dump({key: value}, Dumper=_Dumper, **how).rstrip("\n")
    text = text[1:-1] if text.startswith("{") else text  # of one plain value
    return [indent + line for line in text.split("\n")]


class _Dumper(yaml.SafeDumper):
    """Writes the key ``on`` without quotes, as it is read, lists below their key, and nothing as an alias."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        # YAML 1.1 reads ``on`` as a truth value: tagged as one, the key is written without quotes
        for key, _ in node.value:
            key.tag = _BOOL_TAG if key.value == "on" else key.tag
        return node

    def increase_indent(self, flow: bool = False, indentless: bool = False) -> None:  # noqa: ARG002
        return super().increase_indent(flow)

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        return True
