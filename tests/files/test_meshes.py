"""Meshes: where they are found, how they are read, and the inertia that follows from them."""

import importlib.util
import struct
import tracemalloc
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import dynident as dy
from dynident.files import meshes as module
from dynident.files.meshes import read_geometry, read_mesh, result_geometry
from dynident.files.opener import refuse_inputs, watch_inputs
from dynident.identification import SourceFile
from dynident.models import Mesh, RigidBodies, ShapeSource
from dynident.models import lagrangian as gallery
from dynident.models.geometry import build_geometry
from dynident.project.config import robot_text
from dynident.report.identification.report import run_files
from dynident.runtime import ConfigError, InputError, ModelError
from tests.apps.excitation.meshes import BENT, volume
from tests.report.robots import identified
from tests.robots import joint, link, urdf


def stl(mesh, head=b"solid by a program that calls itself so"):
    data = np.zeros(len(mesh.triangles), dtype=module.FACET)
    data["corners"] = mesh.vertices[mesh.triangles]
    return head.ljust(80) + len(data).to_bytes(4, "little") + data.tobytes()


def text_stl(mesh):
    corners = mesh.vertices[mesh.triangles]
    facets = (
        "facet normal 0 0 0\n outer loop\n"
        + "".join(f"  vertex {x:g} {y:g} {z:g}\n" for x, y, z in triangle)
        + " endloop\nendfacet\n"
        for triangle in corners
    )
    return f"solid bent\n{''.join(facets)}endsolid bent\n".encode()


def obj(mesh):
    lines = ["# bent", "mtllib none.mtl", *(f"v {x:g} {y:g} {z:g}" for x, y, z in mesh.vertices), "vn 0 0 1"]
    faces = [f"f {a + 1}/1/1 {b + 1}//1 {c - len(mesh.vertices)}" for a, b, c in mesh.triangles.tolist()]
    return "\n".join([*lines, *faces]).encode()


# what takes most memory for its length
DENSE = {
    "binary.stl": b"\0" * 80 + (5000).to_bytes(4, "little") + np.random.default_rng(0).bytes(5000 * 50),
    "text.stl": b"solid\n" + b"facet\nvertex 0 0 1\nvertex 1 0 0\nvertex 0 1 0\n" * 5000,
    "corners.obj": b"v 1 2 3\n" * 10_000 + b"f 1 2 3\n",
    "faces.obj": b"v 0 0 1\nv 1 0 0\nv 0 1 0\n" + b"f 1 2 3\n" * 10_000,
    "fan.obj": b"v 0 0 1\nv 1 0 0\nv 0 1 0\nf " + b"1 2 " * 10_000,
}


@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("name", DENSE)
def test_a_mesh_takes_no_more_memory_than_is_counted(name, tmp_path) -> None:
    path = tmp_path / name
    path.write_bytes(DENSE[name])
    tracemalloc.start()
    try:
        with suppress(InputError):  # random bytes are no numbers everywhere
            read_mesh(path)
        assert tracemalloc.get_traced_memory()[1] <= module.MEMORY_PER_BYTE[path.suffix] * len(DENSE[name])
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("name", ["a.stl", "a.obj", "a.dae", "a.ply"])
def test_a_mesh_beyond_the_memory_is_refused_with_the_fix(name, tmp_path, monkeypatch) -> None:
    (tmp_path / name).write_bytes(b" " * 100_000)
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.001")
    with pytest.raises(InputError, match=rf"{name}: as a mesh it would take .* raise this by --memory"):
        read_mesh(tmp_path / name)


def test_all_meshes_together_keep_to_the_memory(tmp_path, monkeypatch) -> None:
    names = [f"m{k}.stl" for k in range(30)]
    for name in names:
        (tmp_path / name).write_bytes(stl(BENT))
    shape = '<collision><geometry><mesh filename="{}"/></geometry></collision></link>'
    links = [link(f"l{k}", 1.0).replace("</link>", shape.format(name)) for k, name in enumerate(names)]
    joints = [joint(f"j{k}", "revolute", f"l{k - 1}" if k else "base", f"l{k}") for k in range(30)]
    text = urdf(link("base"), *links, *joints)
    kept = BENT.vertices.nbytes + BENT.triangles.nbytes
    monkeypatch.setenv("DYNIDENT_MEMORY", str((10 * kept + 20 * len(stl(BENT))) / 1e9))
    missing = read_geometry(RigidBodies(text), tmp_path / "arm.urdf").missing
    assert 15 < len(missing) < 25
    assert all("with the meshes before it would take" in reason for reason in missing.values())


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("a.stl", b"solid nothing\nendsolid\n", "has no triangles"),
        ("a.stl", b"", "has no triangles"),
        ("a.stl", stl(BENT)[:-60], "has no triangles|cut off"),
        ("a.stl", text_stl(BENT).replace(b"vertex", b"vortex", 1), "cut off, or no STL"),
        ("a.stl", b"solid x\nfacet\nvertex 0 zero 0\n", "does not have three numbers"),
        ("a.stl", text_stl(BENT).replace(b"vertex 0 0 0", b"vertex 0 0 inf", 1), "finite"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "a corner that the file does not have"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n", "'x' is no number of a corner"),
        ("a.obj", b"v 0 0\n", "does not have three numbers"),
        *(
            ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 %d\n" % corner, "a corner that the file does not have")
            for corner in (0, -4, 10**19, -(10**19), 10**400)
        ),
    ],
)
def test_a_file_that_is_no_mesh_is_refused(name, data, what, tmp_path) -> None:
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(InputError, match=what):
        read_mesh(path)


def test_formats_of_others_need_coal(tmp_path, monkeypatch) -> None:
    path = tmp_path / "a.dae"
    path.write_text("<COLLADA/>")
    monkeypatch.setattr(module.importlib.util, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"\.dae needs Coal; .*install.* pin"):
        read_mesh(path)


@pytest.mark.skipif(importlib.util.find_spec("coal") is None, reason="Coal is not installed: nothing reads Collada")
def test_coal_reads_other_formats(tmp_path) -> None:
    path = tmp_path / "a.ply"
    head = f"ply\nformat ascii 1.0\nelement vertex {len(BENT.vertices)}\nproperty float x\nproperty float y\n"
    head += (
        f"property float z\nelement face {len(BENT.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(map(str, row)) for row in BENT.vertices] + [
        "3 " + " ".join(map(str, row)) for row in BENT.triangles
    ]
    path.write_text(head + "\n".join(rows) + "\n")
    mesh = read_mesh(path)
    assert abs(volume(mesh)) == pytest.approx(volume(BENT), rel=1e-6)
    path.write_text("no mesh")
    with pytest.raises(InputError, match="cannot be read as a mesh"):
        read_mesh(path)


def robot(name):
    part = f'<collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
    return urdf(link("base"), link("arm", 1.0).replace("</link>", part), joint("one", "revolute", "base", "arm"))


@pytest.mark.parametrize(
    ("name", "place"),
    [
        ("meshes/arm.stl", "robots/urdf/meshes/arm.stl"),
        ("../meshes/arm.stl", "robots/meshes/arm.stl"),
        ("package://robots/meshes/arm.stl", "robots/meshes/arm.stl"),
        ("package://other/meshes/arm.stl", "other/meshes/arm.stl"),
        ("model://other/meshes/arm%20one.stl", "other/meshes/arm one.stl"),
        ("package://copied/meshes/arm.stl", "robots/urdf/meshes/arm.stl"),
        ("package://given/meshes/arm.stl", "elsewhere/given/meshes/arm.stl"),
        ("package://elsewhere/meshes/arm.stl", "elsewhere/meshes/arm.stl"),
        ("package://ros/meshes/arm.stl", "environment/ros/meshes/arm.stl"),
        ("package://ament/meshes/arm.stl", "environment/share/ament/meshes/arm.stl"),
        ("file://{here}/arm.stl", "arm.stl"),
    ],
)
def test_a_mesh_is_found_where_robots_keep_it(name, place, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "environment"))
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "environment"))
    name, path, mesh = (
        name.replace("{here}", str(tmp_path)),
        tmp_path / "robots" / "urdf" / "arm.urdf",
        tmp_path / place,
    )
    for case in (path, mesh):
        case.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(robot(name))
    mesh.write_bytes(stl(BENT))
    with watch_inputs():
        geometry = read_geometry(dy.RigidBodies(path.read_text()), path, [tmp_path / "elsewhere"])
        with pytest.raises(ConfigError, match="this run reads it"):
            refuse_inputs(mesh)
    assert geometry.missing == {}
    assert geometry.sources == {0: ShapeSource.COLLISION}


def test_a_mesh_in_millimetres_is_refused(tmp_path) -> None:
    (tmp_path / "arm.stl").write_bytes(stl(Mesh(1e3 * BENT.vertices, BENT.triangles)))
    with pytest.raises(ModelError, match=r"link 'arm': its mesh is 1000 m large; give it a scale, such as '0.001 "):
        read_geometry(dy.RigidBodies(robot("arm.stl")), tmp_path / "arm.urdf")
    scaled = robot("arm.stl").replace('filename="', 'scale="0.001 0.001 0.001" filename="')
    assert read_geometry(dy.RigidBodies(scaled), tmp_path / "arm.urdf").sources == {0: ShapeSource.COLLISION}


NAMES = (
    "package://[x/a.stl", "file://[::1/a.stl", "http://[/", "package://a\u2100b/c.stl", "//[", "a\0b.stl", "", ".", "/",
    "package://", "a" * 300 + ".stl", "..", "~", "\\\\host\\a.stl", "a.stl?x#y", "%zz.stl", "x:" + 9 * "/",
    "\ud800.stl",
)  # fmt: skip


@pytest.mark.parametrize("seed", range(10))
def test_no_name_of_a_mesh_stops_what_draws(seed: int, tmp_path) -> None:
    rng = np.random.default_rng([91, seed])
    pieces = ("package:", "file:", "//", "/", "[", "]", "@", ":99999", "\0", "%00", "\u2100", "..", "a.stl", "?", "#")
    random_names = ["".join(rng.choice(pieces, rng.integers(1, 7)).tolist()) for _ in range(30)]
    bodies = dy.RigidBodies(robot("NAME"))
    for name in (*NAMES, *random_names):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(
                module, "build_geometry", lambda _, mesh, name=name: (mesh(name), build_geometry(bodies, mesh))[1]
            )
            assert name in read_geometry(bodies, tmp_path / "arm.urdf").missing


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
@pytest.mark.parametrize("seed", [0, 1, 4, 5])
def test_no_content_of_a_mesh_costs_the_result(seed: int, suffix: str, tmp_path) -> None:
    """Bytes turned in a right file, numbers of any size, and files that are cut off: the result is written."""
    rng, make = np.random.default_rng([92, seed]), {".stl": (stl, text_stl)[seed % 2], ".obj": obj}[suffix]
    data = bytearray(
        make(Mesh(BENT.vertices * 10.0 ** rng.integers(-30, 30), BENT.triangles)) if seed > 3 else make(BENT)
    )
    for place in rng.integers(0, len(data), rng.integers(1, 8)):
        data[place] = rng.integers(256)
    identification = identified()
    (tmp_path / "missing.stl").write_bytes(data[: rng.integers(len(data) // 2, len(data) + 1)])
    beside = replace(
        identification, provenance=replace(identification.provenance, model=SourceFile(str(tmp_path / "tree.urdf")))
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(module.READERS, ".stl", module.READERS[suffix])
        files = run_files(beside)
    assert files["result.json"]
    assert "</html>" in files["report.html"]


def test_a_picture_that_fails_is_said_and_the_result_written(monkeypatch) -> None:
    def fail(*_: object) -> None:
        raise RuntimeError("no hull")

    identification = identified()
    monkeypatch.setattr(module, "read_geometry", fail)
    assert result_geometry(identification).missing == {identification.model.terms[0].source: "no hull"}
    assert "no hull" in run_files(identification)["report.html"]


def test_the_shapes_of_a_result_are_sought_beside_its_robot_file(tmp_path) -> None:
    identification = identified()
    assert list(result_geometry(identification).missing) == ["missing.stl"]
    (tmp_path / "missing.stl").write_bytes(stl(BENT))
    beside = SourceFile(str(tmp_path / "tree.urdf"))
    moved = replace(identification, provenance=replace(identification.provenance, model=beside))
    geometry = result_geometry(moved)
    assert geometry.missing == {}
    assert geometry.sources[1] is ShapeSource.COLLISION
    (tmp_path / "missing.stl").write_bytes(stl(Mesh(1000 * BENT.vertices, BENT.triangles)))
    large = result_geometry(moved)  # in mm: a report does without
    assert "give it a scale" in large.missing["tree.urdf"]
    assert set(large.sources.values()) == {ShapeSource.JOINTS}
    assert result_geometry(replace(identification, model=gallery.slider())) is None


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
