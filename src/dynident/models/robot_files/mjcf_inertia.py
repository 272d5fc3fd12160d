"""The inertia of an MJCF body: as given, or of its shapes as MuJoCo computes it, with the compiler's corrections.

References: https://mujoco.readthedocs.io/en/stable/XMLreference.html (body/inertial, body/geom, compiler); solid and
thin-walled shapes are the textbook ones. Meshes and height fields are not read: their inertia is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.models.inertia import from_physical, to_physical
from dynident.models.robot_files.mjcf_defaults import Attributes, Defaults, rotation_from_z
from dynident.models.robot_files.xml import numbers, placement, unit_vector
from dynident.runtime import ModelError, choices

Array = NDArray[np.float64]
DENSITY = "1000"  # kg/m^3, or kg/m^2 for a thin wall
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}
UNREAD = ("mesh", "sdf", "hfield")  # shapes of files
WEIGHTLESS = "plane"
MIN_MASS = 1e-14  # kg: lighter shapes do not count


def body_inertia(body: Element, inherited: str, defaults: Defaults, where: str) -> Array | None:
    """Return the parameters (10) about the body's frame; None where a shape's inertia is not known.

    Raises ModelError, led by ``where``, for invalid numbers, and shapes that do not exist.
    """
    rule = defaults.compiler.get("inertiafromgeom", "auto")
    inner = list(defaults.inside(body, inherited, where))
    inertial = next((child for child, _, _ in inner if child.tag == "inertial"), None)
    shapes = [entry for entry in inner if entry[0].tag == "geom"]
    # inertiafromgeom: true prefers shapes, false never takes them, auto only where no <inertial> is given
    if rule == "true" or (inertial is None and rule != "false"):
        shape_inertia = _sum_shapes(shapes, defaults, where)
        if shape_inertia is None:
            return None
        theta = (
            shape_inertia if shape_inertia.any() or inertial is None else _explicit_inertia(inertial, defaults, where)
        )
    else:
        theta = np.zeros(10) if inertial is None else _explicit_inertia(inertial, defaults, where)
    return _apply_bounds(theta, defaults.compiler, where)


def with_total_mass(links: Mapping[str, Array | None], compiler: Attributes, where: str) -> dict[str, Array | None]:
    """Return the links scaled to the total mass that the compiler sets; where it cannot be known, without inertia."""
    total = float(numbers(compiler, "settotalmass", "-1", where)[0])
    known_inertias = [theta for theta in links.values() if theta is not None]
    mass = sum(float(theta[0]) for theta in known_inertias)
    # the factor needs the masses of all links: where one is not known, no inertia is
    if total <= 0 or (len(known_inertias) == len(links) and mass <= 0):
        return dict(links)
    if len(known_inertias) < len(links):
        return {name: None if theta is None or theta.any() else theta for name, theta in links.items()}
    return {name: theta * (total / mass) for name, theta in links.items() if theta is not None}


def _explicit_inertia(inertial: Element, defaults: Defaults, where: str) -> Array:
    frame = defaults.frame(inertial.attrib, where)
    if "fullinertia" in inertial.attrib:
        tensor = numbers(inertial, "fullinertia", "", where, 6)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
    else:
        tensor = np.diag(numbers(inertial, "diaginertia", "0 0 0", where, 3))
    return _inertia_in_frame(float(numbers(inertial, "mass", "", where)[0]), tensor, frame)


def _inertia_in_frame(mass: float, tensor: Array, frame: Array) -> Array:
    """Return the parameters (10) of a mass whose centre and principal axes are those of ``frame`` (4, 4)."""
    about_centre = frame[:3, :3] @ tensor @ frame[:3, :3].T
    return from_physical(mass, frame[:3, 3], (about_centre + about_centre.T) / 2)


def _sum_shapes(shapes: list[tuple[Element, str, Array]], defaults: Defaults, where: str) -> Array | None:
    """Return the sum of all shapes; None where one is not known."""
    low, high = numbers(defaults.compiler, "inertiagrouprange", "0 5", where, 2)
    total = np.zeros(10)
    for element, inherited, above in shapes:
        attributes = defaults.resolve(element, inherited)
        if low <= numbers(attributes, "group", "0", where)[0] <= high:
            theta = _shape_inertia(attributes, above, defaults, f"{where}, <geom> {attributes.get('name', '')!r}")
            if theta is None:
                return None
            total += theta
    return total


def _shape_inertia(attributes: Attributes, above: Array, defaults: Defaults, where: str) -> Array | None:
    kind = attributes.get("type", "sphere")
    density = float(numbers(attributes, "density", DENSITY, where)[0])
    mass = float(numbers(attributes, "mass", "", where)[0]) if "mass" in attributes else None
    if kind == WEIGHTLESS or (density if mass is None else mass) <= MIN_MASS:
        return np.zeros(10)
    if kind in UNREAD or "mesh" in attributes:
        return None
    if kind not in SIZES:
        raise ModelError(f"{where}: type {kind!r}; {choices(kind, [*SIZES, *UNREAD, WEIGHTLESS])}")
    size, frame = shape_size(kind, attributes, defaults, where)
    is_shell = attributes.get("shellinertia") == "true"
    volume, gyration = (SHELLS if is_shell else SOLIDS)[kind](*size)
    mass = density * volume if mass is None else mass
    return (
        _inertia_in_frame(mass, np.diag(mass * np.array(gyration)), above @ frame) if mass > MIN_MASS else np.zeros(10)
    )


def shape_size(kind: str, attributes: Attributes, defaults: Defaults, where: str) -> tuple[list[float], Array]:
    """Return the sizes (m) of a shape and its frame (4, 4); ``fromto`` gives the ends of its z axis."""
    has_ends = "fromto" in attributes
    if has_ends and kind == "sphere":
        raise ModelError(f"{where}: fromto is given for a sphere, which has no ends; give its pos.")
    count = 1 if has_ends else SIZES[kind]
    words = attributes.get("size", "").split()[:3]
    size = numbers({"size": " ".join(words[:count])}, "size", "", where, count).tolist()
    if min(size) <= 0:
        raise ModelError(f"{where}: size = {attributes.get('size')!r}; a {kind} needs {count} positive numbers.")
    if not has_ends:
        return size, defaults.frame(attributes, where)
    # fromto gives the axis and the half length, so that the size holds the radius alone
    ends = numbers(attributes, "fromto", "", where, 6).reshape(2, 3)
    half = float(np.linalg.norm(ends[0] - ends[1])) / 2
    radii = size * (SIZES[kind] - 1)
    return [*radii, half], placement(rotation_from_z(unit_vector(ends[0] - ends[1], where)), ends.mean(axis=0))


def _apply_bounds(theta: Array, compiler: Attributes, where: str) -> Array:
    """Apply the least mass and principal moments, and the balance of moments that break the triangle inequality."""
    min_mass, min_moment = (float(numbers(compiler, key, "0", where)[0]) for key in ("boundmass", "boundinertia"))
    balanced = compiler.get("balanceinertia") == "true"
    if not (min_mass > 0 or min_moment > 0 or balanced) or theta[0] < 0:
        return theta
    if theta[0] == 0:
        body_mass, centre, moments, axes = 0.0, np.zeros(3), np.zeros(3), np.eye(3)
    else:
        mass_value, centre, tensor = to_physical(theta)
        body_mass = float(mass_value)
        moments, axes = np.linalg.eigh(tensor)
    moments = np.maximum(moments, min_moment)
    # MuJoCo replaces all three moments by their mean
    if balanced and 2 * moments.max() > moments.sum():
        moments = np.full(3, moments.mean())
    tensor = axes * moments @ axes.T
    return from_physical(max(body_mass, min_mass), centre, (tensor + tensor.T) / 2)


VolumeAndGyration = tuple[float, tuple[float, float, float]]
"""The volume in m^3, or for thin walls the area in m^2, and the squared radii of gyration about the three axes."""


def _ball(r: float) -> VolumeAndGyration:
    return 4 / 3 * np.pi * r**3, (0.4 * r**2,) * 3


def _ellipsoid(a: float, b: float, c: float) -> VolumeAndGyration:
    return 4 / 3 * np.pi * a * b * c, ((b**2 + c**2) / 5, (a**2 + c**2) / 5, (a**2 + b**2) / 5)


def _box(a: float, b: float, c: float) -> VolumeAndGyration:
    return 8 * a * b * c, ((b**2 + c**2) / 3, (a**2 + c**2) / 3, (a**2 + b**2) / 3)


def _cylinder(r: float, half: float) -> VolumeAndGyration:
    across = (3 * r**2 + 4 * half**2) / 12
    return 2 * np.pi * r**2 * half, (across, across, r**2 / 2)


def _capsule(r: float, half: float) -> VolumeAndGyration:
    """A cylinder between two half balls."""
    volume, (wide, _, long) = _cylinder(r, half)
    ball = _ball(r)[0]
    # half balls by parallel axes: their centres of mass are 3 r / 8 beyond the ends of the cylinder
    across = wide * volume + ball * (0.4 * r**2 + half * (3 * r + 4 * half) / 4)
    total = volume + ball
    return total, (across / total, across / total, (long * volume + 0.4 * r**2 * ball) / total)


def _sphere_wall(r: float) -> VolumeAndGyration:
    return 4 * np.pi * r**2, (2 / 3 * r**2,) * 3


def _ellipsoid_wall(a: float, b: float, c: float) -> VolumeAndGyration:
    """Thomsen's approximation of the area, and the difference of two solids, as in MuJoCo."""
    power = 1.6075
    area = 4 * np.pi * (((a * b) ** power + (b * c) ** power + (c * a) ** power) / 3) ** (1 / power)
    # the solids differ by 1e-6 m, MuJoCo's thickness of a wall
    (inner, small), (outer, large) = _ellipsoid(a, b, c), _ellipsoid(a + 1e-6, b + 1e-6, c + 1e-6)
    gyration = [(outer * y - inner * x) / (outer - inner) for x, y in zip(small, large, strict=True)]
    return area, (gyration[0], gyration[1], gyration[2])


def _box_wall(a: float, b: float, c: float) -> VolumeAndGyration:
    """Six plates."""
    plates = [(b * c, (a, 0, 0), (0, b, c)), (c * a, (0, b, 0), (a, 0, c)), (a * b, (0, 0, c), (a, b, 0))]
    area = 2 * sum(4 * share for share, _, _ in plates)
    # second moments along the three axes, of plates at a distance and of their own extent
    second_moments = (
        sum(8 * share * (np.array(distance) ** 2 + np.array(extent) ** 2 / 3) for share, distance, extent in plates)
        / area
    )
    x, y, z = np.asarray(second_moments).tolist()
    return area, (y + z, x + z, x + y)


def _cylinder_wall(r: float, half: float) -> VolumeAndGyration:
    """A tube and two disks."""
    tube, disks = 4 * np.pi * r * half, 2 * np.pi * r**2
    total = tube + disks
    across = (tube * (6 * r**2 + 4 * half**2) / 12 + disks * (r**2 / 4 + half**2)) / total
    return total, (across, across, (tube * r**2 + disks * r**2 / 2) / total)


def _capsule_wall(r: float, half: float) -> VolumeAndGyration:
    """A tube and two half spheres, whose centres of mass are half a radius out."""
    tube, ends = 4 * np.pi * r * half, 4 * np.pi * r**2
    total = tube + ends
    out = (half + r / 2) ** 2 - (r / 2) ** 2
    across = (tube * (6 * r**2 + 4 * half**2) / 12 + ends * (2 / 3 * r**2 + out)) / total
    return total, (across, across, (tube * r**2 + ends * 2 / 3 * r**2) / total)


SOLIDS: dict[str, Callable[..., VolumeAndGyration]] = {
    "sphere": _ball, "capsule": _capsule, "cylinder": _cylinder, "ellipsoid": _ellipsoid, "box": _box,
}  # fmt: skip
SHELLS: dict[str, Callable[..., VolumeAndGyration]] = {
    "sphere": _sphere_wall, "capsule": _capsule_wall, "cylinder": _cylinder_wall, "ellipsoid": _ellipsoid_wall,
    "box": _box_wall,
}  # fmt: skip
