"""The meshes of a robot file: finding and reading them (STL, OBJ; others where Coal is installed), inertias."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlparse

import numpy as np

from dynident.files.opener import afford, content, file_status, open_input
from dynident.files.xml_text import XmlNode, XmlText
from dynident.identification import Identification
from dynident.identification.links import rigid_bodies
from dynident.models import Geometry, Mesh, RigidBodies, rod_geometry, to_physical
from dynident.models.geometry import build_geometry
from dynident.models.robot_files import UNNAMED, compile_mjcf, parse
from dynident.runtime import InputError, ModelError, install_command
from dynident.runtime.arrays import Array

FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
STL_HEADER_SIZE = 84  # bytes before the facets of a binary STL
MAX_MESH_SIZE = 50.0  # m
PACKAGE_SCHEMES = ("package", "model")
# the most memory that reading a mesh takes, per byte of its file; of other suffixes that of Assimp
MEMORY_PER_BYTE, ASSIMP_MEMORY_PER_BYTE = {".stl": 20, ".obj": 100}, 100


def read_geometry(bodies: RigidBodies, robot: Path, packages: Sequence[Path] = ()) -> Geometry:
    """Return the shapes of an arm, with those meshes of its file that are found and can be read.

    Visual shapes are read where those for collision are incomplete. ``package://NAME/...`` is searched in the
    folders ``packages`` (of a package or around it), those of ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and in and
    around the folder of the file ``robot``; other names are relative to the latter. Raises ModelError for a wrong
    size of a shape, or a mesh above 50 m.
    """
    missing: dict[str, str] = {}
    meshes: list[Mesh] = []

    @cache
    def mesh(name: str) -> Mesh | None:
        try:
            path = next((path for path in _candidates(name, robot, packages) if os.path.isfile(path)), None)
            if path is None:
                raise InputError("there is no such file.")
            # those that are read already stay in memory while this one is read
            held = sum(mesh.vertices.nbytes + mesh.triangles.nbytes for mesh in meshes)
            afford(held + _reading_memory(path), f"{path}: with the meshes before it would take")
            meshes.append(read_mesh(path))
            return meshes[-1]
        except InputError as error:
            missing[name] = str(error)
            return None

    geometry = build_geometry(bodies, mesh)
    for solid in geometry.solids:
        # a mesh in mm that is read in m would be a thousand times too large
        if solid.mesh is not None and (size := float(np.ptp(solid.mesh.vertices, axis=0).max())) > MAX_MESH_SIZE:
            raise ModelError(
                f"{bodies.source}, link {solid.link!r}: its mesh is {size:.4g} m large; give it a scale, such as "
                "'0.001 0.001 0.001' for a file in mm."
            )
    return replace(geometry, missing=missing)


def result_geometry(identification: Identification) -> Geometry | None:
    """Return the shapes of an identified robot, with the meshes that are found from where its file was.

    None where the model does not come from a robot file. A shape that cannot be used is not an error here: it is
    listed as missing, and only the joints are used.
    """
    bodies, file = rigid_bodies(identification), identification.provenance.model
    if bodies is None:
        return None
    try:
        return read_geometry(bodies, Path(file.path if file else bodies.source))
    except Exception as error:  # a picture may not cost the result, whatever a mesh holds
        return rods_for(bodies, error)


def rods_for(bodies: RigidBodies, error: Exception) -> Geometry:
    """Return rods between the joints in place of shapes that cannot be drawn, and that they are missing."""
    return replace(rod_geometry(bodies), missing={bodies.source: str(error) or type(error).__name__})


def read_mesh(path: Path) -> Mesh:
    """Return the surface that a file holds.

    Raises InputError where it cannot be read, or has no triangles.
    """
    afford(_reading_memory(path), f"{path}: as a mesh it would take")
    mesh = READERS.get(path.suffix.lower(), _read_with_coal)(path)
    if not len(mesh.triangles) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: has no triangles with finite corners.")
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        raise InputError(f"{path}: a triangle has a corner that the file does not have.")
    return mesh


def _reading_memory(path: Path) -> int:
    """Return the memory (bytes) that reading a mesh may take."""
    return MEMORY_PER_BYTE.get(path.suffix.lower(), ASSIMP_MEMORY_PER_BYTE) * file_status(path).st_size


def _candidates(name: str, robot: Path, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield where a file may be that a robot file names."""
    folder = Path(os.path.abspath(robot)).parent
    try:
        url = urlparse(name)
    except ValueError as error:
        raise InputError(f"{name!r} is no name of a file, and no URL.") from error
    if url.scheme in PACKAGE_SCHEMES:
        package, mesh_path = url.netloc, unquote(url.path).lstrip("/")
        # given packages, the environment, then around the file; a root contains the package or is it
        for root in (*packages, *_environment_folders(), folder, *folder.parents):
            yield root / package / mesh_path
            if root.name == package:
                yield root / mesh_path
        yield folder / mesh_path
    elif url.scheme == "file":
        yield Path(unquote(url.path))
    elif url.scheme not in ("http", "https"):
        yield folder / name


def _environment_folders() -> Iterator[Path]:
    for folder in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if folder:
            yield Path(folder)
    for folder in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if folder:
            yield Path(folder) / "share"


def _read_stl(path: Path) -> Mesh:
    data = content(path)
    count = int.from_bytes(data[STL_HEADER_SIZE - 4 : STL_HEADER_SIZE], "little")
    # binary if the file is as long as its count of facets says, and it is no text
    if len(data) >= STL_HEADER_SIZE and len(data) >= STL_HEADER_SIZE + count * FACET.itemsize and not _is_text(data):
        corners = np.frombuffer(data, FACET, count, STL_HEADER_SIZE)["corners"].astype(float).reshape(-1, 3)
    else:
        lines = data.decode("utf-8", "replace").splitlines()
        words = [line.split()[1:] for line in lines if line.lstrip().startswith("vertex")]
        corners = _parse_corners(words, path)
    if len(corners) % 3:
        raise InputError(f"{path}: is cut off, or no STL: it has {len(corners)} corners, which are no triangles.")
    # STL repeats each corner: shared ones become one vertex
    vertices, places = np.unique(corners, axis=0, return_inverse=True)
    return Mesh(vertices, places.reshape(-1, 3).astype(np.intp))


def _is_text(data: bytes) -> bool:
    """Return whether an STL is a text; some binary ones begin like one."""
    return data[:5] == b"solid" and b"facet" in data[:1000] and (len(data) - STL_HEADER_SIZE) % FACET.itemsize != 0


def _read_obj(path: Path) -> Mesh:
    vertices, faces = [], []
    for line in content(path).decode("utf-8", "replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append(words[1:4])
        elif words[:1] == ["f"]:
            faces.append([word.partition("/")[0] for word in words[1:]])
    points, triangles = _parse_corners(vertices, path), []
    for face in faces:
        corners = [_corner_index(word, len(points), path) for word in face]
        # a polygon becomes a fan of triangles from its first corner
        triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    return Mesh(points, np.array(triangles, dtype=np.intp).reshape(-1, 3))


def _corner_index(word: str, count: int, path: Path) -> int:
    """Return the index of a corner: numbers count from 1, negative ones from the end."""
    try:
        number = int(word)
    except ValueError as error:
        raise InputError(f"{path}: {word!r} is no number of a corner.") from error
    if not 0 < abs(number) <= count:
        raise InputError(f"{path}: a triangle has a corner that the file does not have: {word}.")
    return number - 1 if number > 0 else count + number


def _parse_corners(words: list[list[str]], path: Path) -> Array:
    try:
        return np.array(words, dtype=float).reshape(-1, 3)
    except ValueError as error:
        raise InputError(f"{path}: a corner does not have three numbers.") from error


def _read_with_coal(path: Path) -> Mesh:
    """Read a mesh by Coal's loader (Assimp): Collada and other formats."""
    if importlib.util.find_spec("coal") is None:
        raise InputError(f"{path.suffix or path.name} needs Coal; {install_command('pin')}, or save it as STL.")
    with open_input(path):  # a regular file, which is remembered; Assimp opens it itself
        pass
    coal = importlib.import_module("coal")
    try:
        surface = coal.MeshLoader().load(str(path), np.ones(3))
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a mesh: {error}") from error
    triangles = [[surface.tri_indices(k)[c] for c in range(3)] for k in range(surface.num_tris)]
    return Mesh(np.array(surface.vertices(), dtype=float), np.array(triangles, dtype=np.intp).reshape(-1, 3))


READERS: dict[str, Callable[[Path], Mesh]] = {".stl": _read_stl, ".obj": _read_obj}


FULL_INERTIA = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # rows and columns of a tensor
MESH_WEIGHT = 40  # memory of a compiled mesh, per byte of its file


def with_mesh_inertias(xml: str, path: Path) -> str:
    """Return the text of an MJCF at ``path`` with an ``<inertial>`` in each body whose inertia follows from meshes.

    It is what MuJoCo computes from the files, which are named from the folder of ``path``. A body of which one is not
    there, or is no mesh, stays as it is, and so does a file whose compiler changes inertias. Raises ModelError for a
    file that MuJoCo cannot compile.
    """
    if "<mesh" not in xml or (root := parse(xml, path.name)).tag != "mujoco":
        return xml
    compiled = compile_mjcf(root, path.name)
    unknown = {name for name, theta in compiled.inertias.items() if theta is None}
    if not unknown or compiled.alters:
        return xml
    contents: dict[str, bytes] = {}
    for name in compiled.mesh_files:
        try:
            contents[name] = content(path.parent / name, weight=MESH_WEIGHT)
        except InputError:
            continue
        afford(MESH_WEIGHT * sum(map(len, contents.values())), f"{path.name}: its meshes would take", ModelError)
    try:
        thetas = compile_mjcf(parse(xml, path.name), path.name, contents).inertias
    except ModelError:
        return xml  # a file that is no mesh
    text = XmlText(xml)
    for name, node in named_body_nodes(text):
        if name in unknown and (theta := thetas[name]) is not None and theta.any():
            text.insert(node, inertial_element(theta, np.zeros(3), name))
    return str(text)


def named_body_nodes(text: XmlText) -> Iterator[tuple[str, XmlNode]]:
    """Yield the bodies of an MJCF with their names; those without one are numbered, as the reader of models does."""
    nodes = [node for world in text.root.children if world.tag == "worldbody" for node in world.walk()]
    for place, node in enumerate((node for node in nodes if node.tag == "body"), start=1):
        yield node.attributes.get("name") or UNNAMED.format(place), node


def inertial_element(theta: Array, origin: Array, name: str) -> str:
    """Return an <inertial> of parameters (10) about ``origin`` (3) in the frame of the body ``name``."""
    mass, centre, tensor = to_physical(theta, name)
    pos, full = (" ".join(repr(float(x)) for x in values) for values in (origin + centre, tensor[FULL_INERTIA]))
    return f'<inertial pos="{pos}" mass="{float(mass)!r}" fullinertia="{full}"/>'
