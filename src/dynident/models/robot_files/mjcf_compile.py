"""Compiles an MJCF by MuJoCo, with what of it the arm is made of: other files are not opened.

What is nominal here is no reason to refuse a file: springs and inertias are taken out before, as the file gives them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any
from warnings import catch_warnings
from xml.etree.ElementTree import Element, tostring

import numpy as np

from dynident.models.inertia import from_physical
from dynident.models.robot_files.xml import MAX_NUMBER, Shape, ShapeKind, check_unique, exact_angle, placement
from dynident.runtime import ModelError, Noun, install_command
from dynident.runtime.arrays import Array

WORLD = "world"
UNNAMED = "body {}"  # the name of a body that has none, by its place in the file
SECTIONS = ("compiler", "option", "default", "asset", "worldbody", "equality", "tendon")  # of which an arm is made
LOOKS = ("camera", "light")
UNREAD = ("attach", "replicate", "composite", "flexcomp", "plugin")
ANGLES = {"euler": -3, "axisangle": -1}  # attributes, and from which number on they are angles
MAX_FILE_JOINTS = 5000  # the memory of a compiled model grows with its joints times their depth
MIN_INERTIA = 1e-15  # kg, kg m^2: the least that MuJoCo takes for a moving body; those without inertia get it
MIN_MASS = 1e-14  # kg: lighter bodies and shapes have no inertia
NUMBERS = (
    "body_mass", "body_inertia", "body_ipos", "body_pos", "jnt_pos", "jnt_range", "jnt_actfrcrange", "qpos0",
    "dof_damping", "dof_frictionloss", "dof_armature", "eq_data", "geom_pos", "geom_size",
)  # fmt: skip


class CompiledMjcf(Noun):
    """A file as MuJoCo has compiled it, ``spec`` to ``model``.

    ``springs`` say of joints, by their index, what springs they have; ``meshes`` are the meshes of geoms, by their
    index, with unit frames. ``inertias`` (10) are about the frames of the bodies in the file, by name; None where a
    mesh that is not read is part of it. ``mesh_files`` are the names of all files of meshes; ``alters``: the compiler
    changes inertias that the file gives.
    """

    source: str
    spec: Any
    model: Any
    springs: Mapping[int, str]
    meshes: Mapping[int, Shape]
    inertias: Mapping[str, Array | None]
    mesh_files: tuple[str, ...]
    alters: bool

    def frame(self, kind: str, k: int) -> Array:
        """Return the placement (4, 4) of the k-th "body" or "geom" in its parent."""
        return _frame(self.model, f"{kind}_pos", f"{kind}_quat", k)

    def joint(self, k: int) -> str:
        """Return the name of the k-th joint; empty where it has none."""
        return str(self.model.joint(k).name)


def compile_mjcf(root: Element, source: str, contents: Mapping[str, bytes] | None = None) -> CompiledMjcf:
    """Return what MuJoCo makes of the element; ``contents`` are those of ``mesh_files``, by their names.

    Raises ModelError as ``read_mjcf`` does.
    """
    try:
        import mujoco
    except ImportError:
        raise ModelError(
            f"{source}: it is an MJCF, which MuJoCo compiles, and that is not installed: {install_command('mujoco')}"
        ) from None
    _check_read(root, source)
    check_unique([WORLD, *(body.get("name", "") for body in named_bodies(root))], "body", source)
    _reduce_to_arm(root)
    try:
        spec = mujoco.MjSpec.from_string(tostring(root, encoding="unicode"))
        springs = [(joint, _take_spring(joint)) for joint in spec.joints]
        mesh_files = tuple(path for mesh in spec.meshes if (path := _mesh_path(mesh, spec)))
        shapes, unknown = _take_meshes(spec, mujoco, contents or {})
        alters = _alters_inertias(spec, mujoco)
        inertias = {} if alters else _take_inertias(spec)
        compiler = spec.compiler
        compiler.fusestatic = compiler.discardvisual = False
        compiler.boundmass, compiler.boundinertia = (
            max(bound, MIN_INERTIA) for bound in (compiler.boundmass, compiler.boundinertia)
        )
        with catch_warnings(action="ignore"):  # of settings that MuJoCo will no longer have
            model = spec.compile()
    except (ValueError, RuntimeError, TypeError, mujoco.FatalError) as error:
        raise ModelError(f"{source}: MuJoCo cannot compile it: {_reason(str(error))}; correct the file.") from error
    for name in NUMBERS:
        if not (np.abs(getattr(model, name)) < MAX_NUMBER).all():
            raise ModelError(f"{source}: its {name} has no numbers below {MAX_NUMBER:g}; correct the file.")
    if not np.concatenate([model.body_quat, model.body_iquat, model.geom_quat]).any(axis=1).all():
        raise ModelError(f"{source}: an orientation overflows; correct the numbers of its quat, euler or axes.")
    thetas = {body.name: _body_inertia(model, body.id, inertias.get(body.name)) for body in spec.bodies[1:]}
    # the factor to a total mass needs the masses of all bodies: where one is not known, no inertia is
    if unknown and compiler.settotalmass > 0:
        unknown |= {name for name, theta in thetas.items() if theta.any()}
    return CompiledMjcf(
        source,
        spec,
        model,
        {joint.id: spring for joint, spring in springs if spring},
        {geom.id: shape for geom, shape in shapes},
        {name: None if name in unknown else theta for name, theta in thetas.items()},
        mesh_files,
        alters,
    )


def named_bodies(root: Element) -> list[Element]:
    """Return all bodies, those without a name named by their place in the file; MuJoCo needs none."""
    bodies = [body for world in root.findall("worldbody") for body in world.iter("body")]
    for place, body in enumerate(bodies, start=1):
        if not body.get("name"):
            body.set("name", UNNAMED.format(place))
    return bodies


def _check_read(root: Element, source: str) -> None:
    """Raise ModelError for elements that are not supported, and a file that would need much memory."""
    elements = [inner for world in root.findall("worldbody") for inner in world.iter()]
    for element in elements:
        if element.tag in UNREAD:
            raise ModelError(
                f"{source}: <{element.tag}> is not supported; save the compiled model from MuJoCo "
                "(mj_saveLastXML), which writes it out, and use that file."
            )
    if any(True for _ in root.iter("include")):
        raise ModelError(
            f"{source}: <include> names another file, and this text is read without files; give the path of the file "
            "(`dynident.read_robot`), or write the included elements out."
        )
    if (count := sum(element.tag in ("joint", "freejoint") for element in elements)) > MAX_FILE_JOINTS:
        raise ModelError(f"{source}: it has {count} joints, and {MAX_FILE_JOINTS} are the most; delete other robots.")


def _reduce_to_arm(root: Element) -> None:
    """Remove what has nothing to do with the arm and may need other files; make rounded angles exact."""
    for section in [section for section in root if section.tag not in SECTIONS]:
        root.remove(section)
    for asset in root.findall("asset"):
        asset[:] = asset.findall("mesh")
    for parent in root.iter():
        for child in [child for child in parent if child.tag in LOOKS and parent.tag != "default"]:
            parent.remove(child)
        parent.attrib.pop("material", None)
        if parent.tag in ("joint", "freejoint"):
            parent.attrib.pop("align", None)  # it would move the frame of the body
    if is_in_radians(root):
        for element, key in elements_with_angles(root):
            words, start = element.attrib[key].split(), ANGLES[key]
            element.set(key, " ".join([*words[:start], *(repr(exact(word)) for word in words[start:])]))


def is_in_radians(root: Element) -> bool:
    """Return whether the angles of a file are in rad; of several settings the last one counts."""
    return [compiler.get("angle") for compiler in root.findall("compiler") if compiler.get("angle")][-1:] == ["radian"]


def elements_with_angles(root: Element) -> Iterator[tuple[Element, str]]:
    """Yield the elements of the bodies that have angles, with the attribute."""
    for world in root.findall("worldbody"):
        yield from ((element, key) for element in world.iter() for key in ANGLES if key in element.attrib)


def exact(word: str) -> float | str:
    """Return the number that a rounded angle (rad) stands for, or the word where it is no number."""
    try:
        return exact_angle(word)
    except (ValueError, ArithmeticError):
        return word  # MuJoCo says what is wrong with it


def _take_spring(joint: Any) -> str:
    """Return what the spring of a joint is, and remove it: it is no reason not to compile the file."""
    for key in ("stiffness", "springdamper"):
        if (values := np.array(getattr(joint, key), ndmin=1)).any():
            joint.stiffness, joint.springdamper = np.zeros(3), np.zeros(2)
            return f"{key} {' '.join(f'{x:g}' for x in np.trim_zeros(values, 'b'))}"
    return ""


def _take_meshes(spec: Any, mujoco: Any, contents: Mapping[str, bytes]) -> tuple[list[tuple[Any, Shape]], set[str]]:
    """Make weightless balls of shapes whose files are not there, and pass the contents of the others.

    Return all meshes, by their geoms, and the names of bodies whose inertia is not known without those missing.
    """
    kinds, files, assets = mujoco.mjtGeom, {}, {}
    for k, mesh in enumerate(spec.meshes):
        path = _mesh_path(mesh, spec)
        # a mesh with a placement of its own would be drawn at a wrong place
        placed = np.any(mesh.refpos) or not np.array_equal(mesh.refquat, [1, 0, 0, 0])
        shape = Shape(ShapeKind.MESH, tuple(mesh.scale.tolist()), np.eye(4), "" if placed else path)
        files[mesh.name] = mesh, path, shape
        if path in contents:
            mesh.file = f"{k}{PurePosixPath(path).suffix}"
            assets[mesh.file] = contents[path]
    shapes, unknown = [], set()
    for geom in list(spec.geoms):
        if geom.type == kinds.mjGEOM_HFIELD:
            spec.delete(geom)
        elif geom.meshname or geom.type in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
            nothing = None, "", Shape(ShapeKind.MESH, (1.0, 1.0, 1.0), np.eye(4))
            mesh, path, shape = files.get(geom.meshname, nothing)
            shapes.append((geom, shape))
            if mesh is None or not (path in contents or len(mesh.uservert)):
                unknown |= {geom.parent.name} if _adds_inertia(geom, spec.compiler, mujoco) else set()
                geom.type, geom.meshname, geom.mass = kinds.mjGEOM_SPHERE, "", 0.0
                geom.size, geom.fromto = [1e-3, 0, 0], [np.nan] * 6
    for mesh, path, _ in files.values():
        if path not in contents and not len(mesh.uservert):
            spec.delete(mesh)
    spec.meshdir, spec.strippath, spec.assets = "", False, assets
    return shapes, unknown - {WORLD}


def _mesh_path(mesh: Any, spec: Any) -> str:
    """Return the name of a mesh's file from the folder of the model, empty where it has none."""
    name = PurePosixPath(mesh.file).name if spec.strippath else mesh.file
    return str(PurePosixPath(spec.meshdir) / name) if name else ""


def _adds_inertia(geom: Any, compiler: Any, mujoco: Any) -> bool:
    """Return whether the inertia of a shape is part of that of its body."""
    rules, rule = mujoco.mjtInertiaFromGeom, compiler.inertiafromgeom
    low, high = compiler.inertiagrouprange
    return (
        (geom.density if np.isnan(geom.mass) else geom.mass) > MIN_MASS
        and low <= geom.group <= high
        and rule != rules.mjINERTIAFROMGEOM_FALSE
        and (rule == rules.mjINERTIAFROMGEOM_TRUE or not geom.parent.explicitinertial)
    )


def _alters_inertias(spec: Any, mujoco: Any) -> bool:
    """Return whether the compiler changes the inertias that the file gives."""
    compiler = spec.compiler
    from_shapes = compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    settings = compiler.settotalmass, compiler.boundmass, compiler.boundinertia, compiler.balanceinertia
    return bool(from_shapes or max(settings) > 0)


def _take_inertias(spec: Any) -> dict[str, tuple[float, Array]]:
    """Return mass and tensor (3, 3) that bodies are given, by their names, and put those of a ball in their place.

    MuJoCo refuses values that are not physical, which are only nominal here, and rounds when it turns them.
    """
    inertias = {}
    for body in spec.bodies[1:]:
        if body.explicitinertial:
            full = np.array(body.fullinertia)
            tensor = np.diag(body.inertia) if np.isnan(full[0]) else full[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
            inertias[body.name] = float(body.mass), tensor
            body.mass, body.inertia, body.fullinertia = 1.0, np.ones(3), [np.nan] * 6
    return inertias


def _body_inertia(model: Any, k: int, inertia: tuple[float, Array] | None) -> Array:
    """Return the parameters (10) of the k-th body about its frame: of mass and tensor (3, 3) as given, or compiled."""
    frame = _frame(model, "body_ipos", "body_iquat", k)
    moments = np.where(model.body_inertia[k] > MIN_INERTIA, model.body_inertia[k], 0.0)
    mass, tensor = inertia or (float(model.body_mass[k]), np.diag(moments))
    if inertia is None and mass < MIN_MASS:
        return np.zeros(10)
    about_centre = frame[:3, :3] @ tensor @ frame[:3, :3].T
    return from_physical(mass, frame[:3, 3], (about_centre + about_centre.T) / 2)


def _frame(model: Any, position: str, orientation: str, k: int) -> Array:
    from scipy.spatial.transform import Rotation  # slow to import, and needed for MJCF alone

    turn = Rotation.from_quat(getattr(model, orientation)[k], scalar_first=True)
    return placement(turn.as_matrix(), getattr(model, position)[k])


def _reason(message: str) -> str:
    """Return an error of MuJoCo in one line, with the element but not its line, which is not that of the file."""
    lines = [line for line in message.replace("XML Error: ", "").replace("Error: ", "").splitlines() if line.strip()]
    return ", ".join(re.sub(r",( id \d+,)? line \d+$", "", line) for line in lines)[:500]
