"""The configuration of a result with all that was chosen written out, so that nothing is left to choose."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any

import yaml

from dynident.errors import ConfigError
from dynident.identification import Identification
from dynident.io.config_draft import BREAKING, relative
from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS, Family
from dynident.io.opener import real
from dynident.io.settings import robot_settings
from dynident.io.yaml_text import load_yaml
from dynident.models import CoupledMotor, RigidBodies
from dynident.smoothers import unshifted

__all__ = ["explicit_config", "explicit_settings", "part_settings", "relocated", "settings_text"]

_TRUTH = "tag:yaml.org,2002:bool"


def explicit_config(found: Identification, path: Path, comments: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a configuration, to lie at ``path``, that repeats a result without any choice.

    ``comments`` are lines to stand above keys, those of the model as ``model.terms``; those above all by the key "".
    Raises ConfigError where the result was made without a configuration, or a part has settings without a plain form.
    """
    return settings_text(explicit_settings(found, path.parent), comments)


def settings_text(settings: Mapping[str, Any], comments: Mapping[str, Sequence[str]]) -> str:
    """Return the text of a configuration with these settings, and ``comments`` as in ``explicit_config``."""
    lines = [*_comments(comments, ""), ""]
    for key, value in settings.items():
        if key == "model" and isinstance(value, dict):
            lines.append("model:")
            for name, one in value.items():
                lines += [*_comments(comments, f"model.{name}", "  "), *_lines(name, one, "  ")]
        else:
            lines += [*_comments(comments, key), *_lines(key, value)]
    return "\n".join(lines) + "\n"


def explicit_settings(found: Identification, folder: Path) -> dict[str, Any]:
    """Return the same as plain values, with names of files relative to ``folder``; raises as ``explicit_config``."""
    source, recipe = found.provenance.configuration, found.recipe
    if source is None:
        raise ConfigError("the result was made from Python, without a configuration, so that none can be written.")
    was, folder = Path(source.path).parent, real(folder)
    data: dict[str, Any] = dict(load_yaml(source.text, source.path))
    smoother = unshifted(recipe.smoothers[0])
    data["model"] = _model(found, data["model"], was, folder)
    for role in ("train", "validation"):
        data[role] = [{**log, "file": _files(log["file"], was, folder)} for log in data.get(role) or ()]
    chosen = {
        "simulation": _placed(data.get("simulation"), was, folder),
        "delay": recipe.time_offset,
        "min_speed": recipe.min_speed,
        "smoother": part_settings(SMOOTHERS, smoother, folder),
        "estimator": part_settings(ESTIMATORS, recipe.estimator, folder),
        "outliers": recipe.outliers,
        "rests": recipe.rests,
    }
    return {key: value for key, value in {**data, **chosen}.items() if value is not None and value != []}


def relocated(settings: Mapping[str, Any], was: Path, folder: Path) -> dict[str, Any]:
    """Return explicit settings with the names of files in them, relative to ``was``, relative to another folder."""
    data = {key: _placed(value, was, folder) for key, value in settings.items()}
    model = data["model"]
    if isinstance(model, dict):
        data["model"] = model | {"file": _files(model["file"], was, folder)}
    else:
        data["model"] = _function(str(model), was, folder)
    for role in ("train", "validation"):
        if role in data:
            data[role] = [{**log, "file": _files(log["file"], was, folder)} for log in data[role]]
    return data


def _placed(value: Any, was: Path, folder: Path) -> Any:
    """Return a part with its Python file, and those inside it, in another folder."""
    if isinstance(value, list):
        return [_placed(one, was, folder) for one in value]
    if not isinstance(value, dict):
        return value
    moved = {key: _placed(one, was, folder) for key, one in value.items()}
    place, colon, name = str(value.get("kind", "")).rpartition(":")
    return moved | {"kind": f"{_files(place, was, folder)}{colon}{name}"} if place.endswith(".py") else moved


def _function(model: str, was: Path, folder: Path) -> str:
    """Return a model of a Python file, or of the gallery, as a configuration in another folder names it."""
    place, colon, name = model.rpartition(":")
    return f"{relative(was / place, folder)}{colon}{name}" if place != "gallery" else model


def _model(found: Identification, given: Any, was: Path, folder: Path) -> Any:
    """Return the settings of the model, with its terms and the tilt of its base where it is built of a robot file."""
    if isinstance(given, str) and robot_settings(given) is None:
        return _function(given, was, folder)
    data = dict(given) if isinstance(given, Mapping) else {"file": given}
    tilt = found.recipe.base_tilt
    data["file"] = _files(data["file"], was, folder)
    data["base_tilt"] = list(tilt) if isinstance(tilt, tuple) else "none"
    own = [one for one in found.model.terms if not isinstance(one, RigidBodies | CoupledMotor)]
    return data | {"terms": [part_settings(TERMS, one, folder) for one in own]}


def part_settings(family: Family, part: Any, folder: Path) -> Any:
    """Return the settings of a part that are not as they are by default, its Python file relative to a folder.

    Raises ConfigError where a setting has no plain form.
    """
    return _moved(_short(family.describe(part), part), folder)


def _short(described: dict[str, Any], part: Any) -> dict[str, Any]:
    """Return the settings of a part, and of parts inside it, without those that are as they are by default."""
    own = getattr(type(part), "Settings", type(part))
    plain = {one.name: one.default for one in (*fields(part), *fields(own)) if one.init}
    return {
        key: _short(value, getattr(part, key)) if isinstance(value, dict) and "kind" in value else value
        for key, value in described.items()
        if key == "kind" or not (value is None or _is_plain(value, plain.get(key, MISSING)))
    }


def _is_plain(value: Any, default: Any) -> bool:
    """Whether a setting, or that of each joint, is as it is by default."""
    if isinstance(value, dict | list) and not value:
        return not default
    return all(one == default for one in value.values()) if isinstance(value, dict) else value == default


def _files(given: Any, was: Path, folder: Path) -> Any:
    """Return the name of a file, or a mapping of short names to them, relative to another folder."""
    if isinstance(given, Mapping):
        return {key: _files(one, was, folder) for key, one in given.items()}
    return str(given) if Path(str(given)).is_absolute() else relative(was / str(given), folder)


def _moved(described: Any, folder: Path) -> Any:
    """Return settings with the Python files that kinds in them name relative to a folder."""
    if not isinstance(described, dict):
        return described
    place, colon, name = str(described.get("kind", "")).rpartition(":")
    moved = {key: _moved(value, folder) for key, value in described.items()}
    return moved | {"kind": f"{relative(Path(place), folder)}{colon}{name}"} if place.endswith(".py") else moved


def _comments(comments: Mapping[str, Sequence[str]], key: str, indent: str = "") -> list[str]:
    """Return the lines above a key; names in them may hold anything."""
    return [f"{indent}# {BREAKING.sub('?', line)}" for line in comments.get(key, ())]


def _lines(key: str, value: Any, indent: str = "") -> Iterator[str]:
    """Yield a setting as YAML: each entry of a list of mappings, or mapping of them, on a line of its own."""
    if isinstance(value, list) and any(isinstance(one, dict) for one in value):
        yield f"{indent}{_flow({key: None})}"
        yield from (f"{indent}  - {_dump(one)}" for one in value)
    elif isinstance(value, dict) and any(isinstance(one, dict) for one in value.values()) and _simple(value):
        yield f"{indent}{_flow({key: None})}"
        yield from (f"{indent}  {_flow({name: one})}" for name, one in value.items())
    else:
        yield f"{indent}{_flow({key: value})}"


def _simple(value: Mapping[Any, Any]) -> bool:
    """Whether each key can stand on a line before a colon; very long ones cannot."""
    return not any(_flow({name: 0}).startswith("?") for name in value)


def _flow(value: dict[Any, Any]) -> str:
    """Return a mapping of one key on one line."""
    text = _dump(value)[1:-1]
    return text.removesuffix(" null") if list(value.values()) == [None] else text


def _dump(value: Any) -> str:
    text = yaml.dump(
        value, Dumper=_Dumper, default_flow_style=True, width=math.inf, sort_keys=False, allow_unicode=True
    )
    return str(text).strip(os.linesep + "\n")


class _Dumper(yaml.SafeDumper):
    """Writes the key ``on`` without quotes, as it is read, and nothing as an alias."""

    def represent_mapping(self, tag: str, mapping: Any, flow_style: bool | None = None) -> yaml.MappingNode:
        node = super().represent_mapping(tag, mapping, flow_style)
        for key, _ in node.value:
            key.tag = _TRUTH if key.value == "on" else key.tag
        return node

    def ignore_aliases(self, data: Any) -> bool:  # noqa: ARG002
        return True
