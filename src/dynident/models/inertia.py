"""A rigid body's inertia in three forms: ten parameters, mass with centre and tensor, and the 4x4 pseudo-inertia.

The ten parameters are (m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz), in kg, kg m and kg m^2, all about the origin of
the joint frame; the tensor of the second form is about the centre of mass, with the axes of the same frame, as a URDF
gives it. The pseudo-inertia is [[Sigma, h], [h', m]] with Sigma = tr(I)/2 E - I (Wensing, Kim and Slotine 2018, "Linear
matrix inequalities for physically consistent inertial parameter identification"). Leading axes are batches.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

EVEN_PERMUTATIONS = ((0, 1, 2), (1, 2, 0), (2, 0, 1))  # the even permutations of the components


def dot(a: Array, b: Array) -> Array:
    """Return a . b for vectors (3, ...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Array, b: Array) -> Array:
    """Return a x b for vectors (3, ...), whose shapes may differ as NumPy allows."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape))
    for i, j, k in EVEN_PERMUTATIONS:
        np.subtract(a[j] * b[k], a[k] * b[j], out=out[i])
    return out


def matvec(A: Array, b: Array) -> Array:
    """Return A b for matrices (3, 3, ...) and vectors (3, ...)."""
    out: Array = A[:, 0] * b[0]
    out += A[:, 1] * b[1]
    out += A[:, 2] * b[2]
    return out


def transposed_matvec(A: Array, b: Array) -> Array:
    """Return A' b for matrices (3, 3, ...) and vectors (3, ...)."""
    return matvec(A.swapaxes(0, 1), b)


def matmul(A: Array, B: Array) -> Array:
    """Return A B for matrices (3, 3, ...)."""
    out: Array = A[:, 0, None] * B[0]
    out += A[:, 1, None] * B[1]
    out += A[:, 2, None] * B[2]
    return out


def outer(a: Array, b: Array) -> Array:
    """Return a b' (3, 3, ...) for vectors (3, ...)."""
    return np.asarray(a[:, None] * b[None])


def diagonal(x: Array) -> Array:
    """Return the unit matrix times x (...): (3, 3, ...)."""
    return np.asarray(np.eye(3).reshape(3, 3, *[1] * x.ndim) * x)


ROWS, COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
ROUNDING = 1e-9  # share of a body's inertia below which a violated inequality is rounding


def from_physical(mass: ArrayLike, centre: ArrayLike, tensor: ArrayLike) -> Array:
    """Return the ten parameters (..., 10) of a mass (...) in kg, its centre (..., 3) in m in the joint frame, and its
    tensor (..., 3, 3) in kg m^2 about that centre.

    Mass and tensor need not be physical. Raises ModelError for a wrong shape or an asymmetric tensor.

    >>> import numpy as np
    >>> from_physical(2.0, [0.5, 0.0, 0.0], np.eye(3)).tolist()  # m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz
    [2.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.5, 0.0, 0.0, 1.5]
    """
    m, c, tensor = (np.asarray(value, dtype=float) for value in (mass, centre, tensor))
    _check("centre of mass", c, (3,))
    _check("inertia tensor", tensor, (3, 3))
    if not np.allclose(tensor, tensor.swapaxes(-1, -2), rtol=1e-9, atol=0):
        raise ModelError(f"The inertia tensor {tensor.tolist()} is not symmetric; give Ixy = Iyx, and so on.")
    # parallel axes: from the centre of mass to the origin of the joint frame
    return _pack_parameters(m, m[..., None] * c, tensor + _steiner(m, c))


def to_physical(theta: ArrayLike, name: str = "the body") -> tuple[Array, Array, Array]:
    """Return mass (...), centre of mass (..., 3) and tensor about it (..., 3, 3) of the parameters (..., 10).

    Raises ModelError, with the ``name`` of the body, where the mass is zero: the centre is then undefined.
    """
    m, h, inertia = _unpack_parameters(theta)
    if (m == 0).any():
        raise ModelError(
            f"{name} has mass 0 and so no centre of mass; give it a mass, or use its ten parameters directly."
        )
    centre = h / m[..., None]
    return m, centre, inertia - _steiner(m, centre)


def to_pseudo(theta: ArrayLike) -> Array:
    """Return the pseudo-inertia (..., 4, 4) of the parameters (..., 10); it is positive semi-definite for a body."""
    m, h, inertia = _unpack_parameters(theta)
    out = np.empty((*m.shape, 4, 4))
    half_trace = np.trace(inertia, axis1=-2, axis2=-1)[..., None, None] / 2
    # Sigma = tr(I)/2 E - I holds the second moments of mass, which is what T P T' transforms
    out[..., :3, :3] = half_trace * np.eye(3) - inertia
    out[..., :3, 3] = out[..., 3, :3] = h
    out[..., 3, 3] = m
    return out


def from_pseudo(pseudo: ArrayLike) -> Array:
    """Return the parameters (..., 10) of symmetric pseudo-inertias (..., 4, 4)."""
    P = np.asarray(pseudo, dtype=float)
    _check("pseudo-inertia", P, (4, 4))
    sigma = P[..., :3, :3]
    inertia = np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) - sigma
    return _pack_parameters(P[..., 3, 3], P[..., :3, 3], inertia)


def change_frame(theta: ArrayLike, placement: ArrayLike) -> Array:
    """Return the parameters (..., 10) in another frame; ``placement`` (..., 4, 4) is the pose of the old frame in it.

    Exact for any parameters, also for a mass of zero or below: the pseudo-inertia P becomes T P T'.
    """
    T = np.asarray(placement, dtype=float)
    _check("placement", T, (4, 4))
    return from_pseudo(T @ to_pseudo(theta) @ T.swapaxes(-1, -2))


def smallest_eigenvalue(theta: ArrayLike) -> Array:
    """Return the smallest eigenvalue (...) of the pseudo-inertias; only its sign is meaningful (mixed units)."""
    return np.asarray(np.linalg.eigvalsh(to_pseudo(theta))[..., 0])


def consistency_violations(theta: ArrayLike) -> tuple[str, ...]:
    """Return why ten parameters (10) are not physically consistent, as sentences; empty where they are.

    The limits are allowed: point masses, thin rods and plates are consistent. Raises ModelError for another shape.

    >>> consistency_violations([-1.0, 0, 0, 0, 0, 0, 0, 0, 0, 0])
    ('negative mass -1 kg',)
    """
    m, h, inertia = _unpack_parameters(theta)
    if m.ndim:
        raise ModelError(
            f"consistency violations: expected the ten parameters of one body, got shape {np.shape(theta)}."
        )
    mass = float(m)
    if mass < 0:
        return (f"negative mass {mass:g} kg",)
    if mass == 0:
        moments_without_mass = (("a first moment", h), ("an inertia", inertia))
        return tuple(f"{quantity} without mass" for quantity, value in moments_without_mass if value.any())
    # the inequalities hold for principal moments about the centre of mass; rounding is a share of the inertia as given
    tensor = inertia - _steiner(m, h / m)
    moments = np.linalg.eigvalsh(tensor)
    tolerance = ROUNDING * float(np.abs(inertia).max())
    moments_text = f"{', '.join(f'{x:.4g}' for x in moments)} kg m^2"
    if moments[0] < -tolerance:
        return (
            f"negative principal moment about the centre of mass ({moments_text}): is the tensor about another point?",
        )
    if moments[0] + moments[1] < moments[2] - tolerance:
        words = "break the triangle inequality: the largest exceeds the sum of the others"
        return (f"principal moments {moments_text} {words}",)
    return ()


def _steiner(mass: Array, centre: Array) -> Array:
    """Return the tensor (..., 3, 3) about the origin of a point mass at ``centre``."""
    square = (centre**2).sum(axis=-1)[..., None, None] * np.eye(3)
    return np.asarray(mass[..., None, None] * (square - centre[..., :, None] * centre[..., None, :]))


def _pack_parameters(mass: Array, moment: Array, inertia: Array) -> Array:
    return np.concatenate([mass[..., None], moment, inertia[..., ROWS, COLUMNS]], axis=-1)


def _unpack_parameters(theta: ArrayLike) -> tuple[Array, Array, Array]:
    values = np.asarray(theta, dtype=float)
    _check("set of inertial parameters", values, (10,))
    inertia = np.empty((*values.shape[:-1], 3, 3))
    inertia[..., ROWS, COLUMNS] = inertia[..., COLUMNS, ROWS] = values[..., 4:]
    return values[..., 0], values[..., 1:4], inertia


def _check(quantity: str, value: Array, shape: tuple[int, ...]) -> None:
    if value.shape[-len(shape) :] != shape:
        expected = ", ".join(["...", *map(str, shape)])
        raise ModelError(f"A {quantity} has shape {value.shape}, expected ({expected}).")
