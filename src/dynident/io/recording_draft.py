"""The draft of a configuration that reads the recordings of a designed motion."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import count
from pathlib import Path
from typing import Any

from dynident.excitation import slowest
from dynident.identification import SourceFile
from dynident.io.config_draft import relative
from dynident.io.excitation import ExcitationProject
from dynident.io.explicit_config import relocated, settings_text
from dynident.io.opener import real
from dynident.io.settings import robot_settings
from dynident.io.yaml_text import load_yaml
from dynident.models import Joint

__all__ = ["RECORDED", "recording_config"]

RECORDED = {"train": "motion_recorded", "validation": "validation_recorded"}  # names of the recordings by role
OWN = ("t", "q", "tau")  # columns, before the names of the joints
_HEAD = (
    "For `dynident check` and `dynident identify`, once the motions of this folder are recorded: save the recordings",
    "under the names below, or correct these.",
)
_FLOOR = "for the next design; without `floor` (m, along z of the root link) the arm may reach below its base: floor: 0"
_SLOW = "slower samples are left out of a joint's equation, where friction may hold it with any torque"
_COLUMNS = "? columns and units as your recorder has them; or draft this anew from the recordings, by `dynident init`"


def recording_config(project: ExcitationProject, folder: Path) -> str:
    """Return the configuration, to lie in ``folder``, that reads the recordings of both motions.

    Columns, gains and all else are those of the configuration that the project came from, whose own training stays in
    the fit where the announced errors count it; without one they are to be confirmed. The settings of the motion are in
    it, too. "" where a model was made from Python, so that no configuration can name it.
    """
    data, was = _data(project)
    if not data:
        return ""
    counts = project.known.information is not None
    data = relocated({**data, "model": data["model"]}, was, real(folder))
    comments: dict[str, tuple[str, ...]] = {"": _HEAD}
    if "time" not in data:
        data = {"model": data["model"], **_channels(project.known.model.joints)}
        comments |= {"time": (_COLUMNS,)}
    old = list(data.get("train") or ()) if counts else []
    like = old[0] if old else next(iter(data.get("train") or ()), {})
    taken = {_label(one) for one in (*old, *(data.get("validation") or ()))}
    logs = {role: _free(like, name, taken) for role, name in RECORDED.items()}
    data |= {"train": [*old, logs["train"]], "validation": [logs["validation"]]}
    speeds = slowest(project.known.model, project.limits)
    slow = {name: round(float(x), 4) for name, x in zip(project.limits.joints, speeds, strict=True) if x}
    if slow and "min_speed" not in data:
        data, comments = {**data, "min_speed": slow}, comments | {"min_speed": (_SLOW,)}
    given = project.settings.model_dump(mode="json", exclude_unset=True)
    if "packages" in given:
        given["packages"] = [relative(Path(one), real(folder)) for one in given["packages"]]
    comments |= {"excitation": () if "floor" in given else (_FLOOR,)}
    return settings_text({**data, "excitation": {"program": project.settings.program, **given}}, comments)


def _data(project: ExcitationProject) -> tuple[Mapping[str, Any], Path]:
    """Return the settings of the configuration, at least of the model, and the folder that its names start at."""
    if project.config is not None:
        data = load_yaml(project.config.text, project.config.path)
        file = isinstance(data["model"], str) and robot_settings(data["model"]) is not None
        return data | ({"model": {"file": data["model"]}} if file else {}), Path(project.config.path).parent
    found = project.known.found
    source = SourceFile(str(project.path)) if found is None else found.provenance.model
    return ({} if source is None else {"model": {"file": source.path}}), Path()


def _channels(joints: tuple[Joint, ...]) -> dict[str, Any]:
    """Return the channels of a recording whose columns are named as those of the motion are."""
    t, q, tau = OWN
    return {
        "time": {"column": t, "unit": "s"},
        "position": {one.name: {"column": f"{q}_{one.name}", "unit": one.unit} for one in joints},
        "torque": {one.name: {"column": f"{tau}_{one.name}", "unit": one.effort} for one in joints},
        "estimator": {"kind": "consistent"},
    }


def _label(log: Mapping[str, Any]) -> str:
    """Return the name of a log, as far as a new one may clash with it."""
    file = log["file"]
    return str(log.get("name") or Path(str(next(iter(file.values())) if isinstance(file, Mapping) else file)).stem)


def _free(like: Mapping[str, Any], name: str, taken: Collection[str]) -> dict[str, Any]:
    """Return a log whose name is free, with a number where need be."""
    logs = (_log(like, name if k == 1 else f"{name}_{k}") for k in count(1))
    return next(one for one in logs if _label(one) not in taken)


def _log(like: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a recording as a configuration names it, of the kind and in as many files as another one."""
    file = like.get("file", ".csv")
    width = {"width": like["width"]} if "width" in like else {}
    if isinstance(file, Mapping):
        return {"file": {key: f"{name}_{key}{_kind(one)}" for key, one in file.items()}, **width}
    return {"file": f"{name}{_kind(file)}", **width}


def _kind(file: Any) -> str:
    return Path(f"x{file}" if str(file).startswith(".") else str(file)).suffix or ".csv"
