"""Gains proposed for motor currents in a drafted configuration: those with which the robot file's masses are right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from dynident.checks import relative_gains
from dynident.errors import DynidentError
from dynident.io.column_mapping import ColumnMapping
from dynident.io.config_draft import draft_config
from dynident.io.match import JointFacts
from dynident.io.project import parse_project
from dynident.io.sources import Source
from dynident.smoothers import Spline, motion_of

__all__ = ["with_gains"]

SMOOTH = Spline(factor=8.0)  # position noise may not be white, and the slow torque of gravity tells most


def with_gains(
    robot: str, joints: Sequence[JointFacts], mapping: ColumnMapping, sources: Sequence[Source], folder: Path
) -> ColumnMapping:
    """Return the mapping with a proposed ``factor`` for the currents of which the motion shows it; arguments as of
    ``draft_config``.

    It is unchanged where no gain is wanted, or the logs cannot be read yet, as where the time is not known.
    """
    if not any(one.gain for one in mapping.torque.values()):
        return mapping
    plain = replace(mapping, torque={name: replace(one, gain="") for name, one in mapping.torque.items()})
    try:
        project = parse_project(draft_config(robot, joints, plain, sources, folder).text, folder / "draft.yaml")
        logs = project.logs()[0]["train"].values()
        names = tuple(joint.name for joint in project.model.joints)
        found = relative_gains(project.model, [motion_of(SMOOTH, log.select(names)) for log in logs])
    except DynidentError:  # whatever it is, it is said where the configuration is read
        return mapping
    torque = {
        name: replace(one, factor=(found[name].value, found[name].std)) if name in found else one
        for name, one in mapping.torque.items()
    }
    return replace(mapping, torque=torque)
