"""A body of an MJCF that is made of meshes weighs what their files say, wherever its text is read later."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from dynident.models import RigidBodies
from dynident.project.config import robot_text

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)  # mm
ARM = """<mujoco><compiler angle="radian" meshdir="parts" {compiler}/>
<asset><mesh name="legs" file="legs.stl" scale="0.001 0.001 0.001"/></asset><worldbody>
<body pos="0 0 1"><joint name="hinge" axis="0 1 0" pos="0.1 0 0"/><geom type="mesh" mesh="legs" density="6e9"/></body>
</worldbody></mujoco>"""


def tetrahedron() -> bytes:
    facets = [CORNERS[[0, 2, 1]], CORNERS[[0, 1, 3]], CORNERS[[1, 2, 3]], CORNERS[[0, 3, 2]]]
    return bytes(80) + struct.pack("<I", 4) + b"".join(struct.pack("<12fH", 0, 0, 0, *f.ravel(), 0) for f in facets)


def write(folder: Path, mesh: bytes | None = None, compiler: str = "") -> Path:
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "arm.xml").write_text(ARM.format(compiler=compiler), encoding="utf-8")
    if mesh is not None:
        (folder / "parts" / "legs.stl").write_bytes(mesh)
    return folder / "arm.xml"


def test_its_inertia_is_that_of_the_files(tmp_path: Path) -> None:
    text = robot_text(write(tmp_path, tetrahedron()))
    (tmp_path / "parts" / "legs.stl").unlink()
    theta = np.array([parameter.value for parameter in RigidBodies(text).parameters])
    np.testing.assert_allclose(theta[:4], [1, 0.00025 - 0.1, 0.00025, 0.00025], rtol=1e-6)
    # of a mass of 1 the integral of x^2 is a tenth of the square of a leg; the joint is 0.1 m away
    by_offset = 0.1**2 - 2 * 0.1 * 0.00025
    np.testing.assert_allclose(theta[[4, 6, 9]], np.array([0, by_offset, by_offset]) + 2e-7, rtol=1e-6)
    assert RigidBodies(text).notes == ()


@pytest.mark.parametrize(
    ("mesh", "compiler"), [(None, ""), (b"no mesh", ""), (tetrahedron(), 'inertiafromgeom="true"')]
)
def test_a_text_stays_as_it_is_where_they_cannot_be_read(tmp_path: Path, mesh: bytes | None, compiler: str) -> None:
    path = write(tmp_path, mesh, compiler)
    assert robot_text(path) == path.read_text(encoding="utf-8")
    assert any("follows from meshes" in note for note in RigidBodies(robot_text(path)).notes)


def test_they_are_read_within_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, tetrahedron() + bytes(100_000))
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.001")
    assert robot_text(path) == path.read_text(encoding="utf-8")
