"""The meshes that a robot file names: finding them, and reading STL and OBJ; other formats where Coal is installed."""

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
from numpy.typing import NDArray

from dynident.errors import InputError, ModelError, install_command
from dynident.excitation.spaces.geometry import Geometry, Mesh, geometry_of, rods_of
from dynident.identification import Identification
from dynident.identification.links import rigid_bodies
from dynident.io.opener import content, find, opened
from dynident.models import RigidBodies

__all__ = ["read_geometry", "read_mesh", "result_geometry"]

Array = NDArray[np.float64]
FACET = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
HEAD = 84  # bytes before the facets of a binary STL
LARGEST = 50.0  # m
PACKAGED = ("package", "model")
WEIGHT = 12  # memory of a mesh, per byte of its file


def read_geometry(bodies: RigidBodies, robot: Path, packages: Sequence[Path] = ()) -> Geometry:
    """Return the shapes of an arm, with the meshes that its file names, as far as they are found and can be read.
    Those that are only seen are read where those for collision are not all there.

    ``package://NAME/...`` is sought in the folders ``packages`` (of a package or around it), those of ROS_PACKAGE_PATH
    and AMENT_PREFIX_PATH, and in and around that of the file ``robot``; other names are relative to the last. Raises
    ModelError for a wrong size of a shape, or a mesh above 50 m.
    """
    missing: dict[str, str] = {}

    @cache
    def mesh(name: str) -> Mesh | None:
        found = _found(name, robot, packages)
        try:
            if found is None:
                raise InputError("there is no such file.")
            return read_mesh(found)
        except InputError as error:
            missing[name] = str(error)
            return None

    geometry = geometry_of(bodies, mesh)
    for solid in geometry.solids:
        if solid.mesh is not None and (size := float(np.ptp(solid.mesh.vertices, axis=0).max())) > LARGEST:
            raise ModelError(
                f"{bodies.source}, link {solid.link!r}: its mesh is {size:.4g} m large; give it a scale, such as "
                "'0.001 0.001 0.001' for a file in mm."
            )
    return replace(geometry, missing=missing)


def result_geometry(identification: Identification) -> Geometry | None:
    """Return the shapes of an identified robot, with the meshes that are found from where its file was; None where
    the model is not of a robot file.

    A shape with a wrong size is no error here: it is among what is missing, and only the joints are used.
    """
    bodies, file = rigid_bodies(identification), identification.provenance.model
    if bodies is None:
        return None
    try:
        return read_geometry(bodies, Path(file.path if file else bodies.source))
    except ModelError as error:
        return replace(rods_of(bodies), missing={bodies.source: str(error)})


def read_mesh(path: Path) -> Mesh:
    """Return the surface that a file holds.

    Raises InputError where it cannot be read, or has no triangles.
    """
    reader = READERS.get(path.suffix.lower(), _by_coal)
    mesh = reader(path)
    if not len(mesh.triangles) or not np.isfinite(mesh.vertices).all():
        raise InputError(f"{path}: has no triangles with finite corners.")
    if mesh.triangles.min() < 0 or mesh.triangles.max() >= len(mesh.vertices):
        raise InputError(f"{path}: a triangle has a corner that the file does not have.")
    return mesh


def _found(name: str, robot: Path, packages: Sequence[Path]) -> Path | None:
    return next((path for path in _candidates(name, robot, packages) if os.path.isfile(path)), None)


def _candidates(name: str, robot: Path, packages: Sequence[Path]) -> Iterator[Path]:
    """Yield where a file may be that a robot file names."""
    url, folder = urlparse(name), Path(os.path.abspath(robot)).parent
    if url.scheme in PACKAGED:
        package, rest = url.netloc, unquote(url.path).lstrip("/")
        for root in (*packages, *_from_environment(), folder, *folder.parents):
            yield root / package / rest
            if root.name == package:
                yield root / rest
        yield folder / rest
    elif url.scheme == "file":
        yield Path(unquote(url.path))
    elif url.scheme not in ("http", "https"):
        yield folder / name


def _from_environment() -> Iterator[Path]:
    for one in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep):
        if one:
            yield Path(one)
    for one in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if one:
            yield Path(one) / "share"


def _stl(path: Path) -> Mesh:
    data = content(path, weight=WEIGHT)
    count = int.from_bytes(data[HEAD - 4 : HEAD], "little")
    if len(data) >= HEAD and len(data) >= HEAD + count * FACET.itemsize and not _is_text(data):
        corners = np.frombuffer(data, FACET, count, HEAD)["corners"].astype(float).reshape(-1, 3)
    else:
        words = [line.split()[1:] for line in data.decode("utf-8", "replace").splitlines() if _vertex(line)]
        corners = _numbers(words, path)
    if len(corners) % 3:
        raise InputError(f"{path}: is cut off, or no STL: it has {len(corners)} corners, which are no triangles.")
    vertices, places = np.unique(corners, axis=0, return_inverse=True)
    return Mesh(vertices, places.reshape(-1, 3).astype(np.intp))


def _is_text(data: bytes) -> bool:
    """Whether an STL is a text; some binary ones begin like one."""
    return data[:5] == b"solid" and b"facet" in data[:1000] and (len(data) - HEAD) % FACET.itemsize != 0


def _vertex(line: str) -> bool:
    return line.lstrip().startswith("vertex")


def _obj(path: Path) -> Mesh:
    vertices, faces = [], []
    for line in content(path, weight=WEIGHT).decode("utf-8", "replace").splitlines():
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append(words[1:4])
        elif words[:1] == ["f"]:
            faces.append([word.partition("/")[0] for word in words[1:]])
    points, triangles = _numbers(vertices, path), []
    for face in faces:
        corners = [_corner(word, len(points), path) for word in face]
        triangles += [(corners[0], *pair) for pair in pairwise(corners[1:])]
    return Mesh(points, np.array(triangles, dtype=np.intp).reshape(-1, 3))


def _corner(word: str, count: int, path: Path) -> int:
    """Return the place of a corner: numbers count from 1, negative ones from the end."""
    try:
        number = int(word)
    except ValueError as error:
        raise InputError(f"{path}: {word!r} is no number of a corner.") from error
    return number - 1 if number > 0 else count + number


def _numbers(words: list[list[str]], path: Path) -> Array:
    try:
        return np.array(words, dtype=float).reshape(-1, 3)
    except ValueError as error:
        raise InputError(f"{path}: a corner does not have three numbers.") from error


def _by_coal(path: Path) -> Mesh:
    """Return a mesh as Coal's loader (Assimp) reads it: Collada and others."""
    if importlib.util.find_spec("coal") is None:
        raise InputError(f"{path.suffix or path.name} needs Coal; {install_command('pin')}, or save it as STL.")
    with opened(path):  # a regular file, which is remembered; Assimp opens it itself
        find(path)
    coal = importlib.import_module("coal")
    try:
        surface = coal.MeshLoader().load(str(path), np.ones(3))
    except Exception as error:
        raise InputError(f"{path}: cannot be read as a mesh: {error}") from error
    triangles = [[surface.tri_indices(k)[c] for c in range(3)] for k in range(surface.num_tris)]
    return Mesh(np.array(surface.vertices(), dtype=float), np.array(triangles, dtype=np.intp).reshape(-1, 3))


READERS: dict[str, Callable[[Path], Mesh]] = {".stl": _stl, ".obj": _obj}
