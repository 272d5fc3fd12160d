"""Grippers are told by structure, held still, and named; whoever wants them exercised says so."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from dynident.apps.excitation.files import recording_config
from dynident.apps.excitation.robot import read_excitation
from tests.apps.excitation.arms import TWO
from tests.robots import joint, link

LIMIT = '<limit effort="{}" velocity="1" lower="{}" upper="{}"/>'


def finger(name: str, kind: str = "prismatic", mass: float = 0.02, parent: str = "lower", mimic: str = "") -> str:
    """A light link that slides or turns, with a name that says nothing."""
    limits = LIMIT.format(20, 0.01, 0.04) + (f'<mimic joint="{mimic}"/>' if mimic else "")
    return link(f"{name}_link", mass, (0.02, 0, 0)) + joint(
        name, kind, parent, f"{name}_link", (0.1, 0, 0), axis=(0, 1, 0), inside=limits
    )


def held(folder: Path, *parts: str, **changes: object) -> dict[str, float]:
    (folder / "arm.urdf").write_text(TWO.replace("</robot>", "".join(parts) + "</robot>"))
    gripper = read_excitation(folder / "arm.urdf", None, {"duration": 9, **changes}).gripper
    return {} if gripper is None else dict(gripper.positions)


@pytest.mark.parametrize(
    ("parts", "positions"),
    [
        ((finger("x"), finger("y")), {"x": 0.01, "y": 0.01}),
        ((finger("x", "revolute"), finger("y", "revolute")), {"x": 0.01, "y": 0.01}),
        ((finger("x"), finger("y", mimic="x")), {"x": 0.01}),
        ((finger("x"), finger("y"), finger("z", "revolute", parent="x_link")), {"x": 0.01, "y": 0.01, "z": 0.01}),
        ((finger("x", mass=2.0), finger("y", mass=2.0)), {}),  # two heavy branches: not fingers
        ((finger("gripper_finger"),), {}),  # a lone joint, whatever its name
        ((), {}),
    ],
)
def test_fingers_are_told_by_structure(tmp_path: Path, parts: tuple[str, ...], positions: dict[str, float]) -> None:
    assert held(tmp_path, *parts) == positions
    assert held(tmp_path, *parts, grippers=True) == {}


def test_the_recordings_are_read_with_the_gripper_held_as_the_note_says(tmp_path: Path) -> None:
    held(tmp_path, finger("x"), finger("y", mimic="x"))
    project = read_excitation(tmp_path / "arm.urdf", None, {"duration": 9})
    assert project.limits.joints == ("lift", "bend")
    data = yaml.safe_load(recording_config(project, tmp_path))
    assert data["model"]["lock"] == {"x": 0.01}
    assert list(data["position"]) == ["lift", "bend"]
    assert str(project.gripper).startswith("x: left out as joints of a gripper")
