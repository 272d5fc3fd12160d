"""Constraints from physics and from the user: linear limits, and matrices that must be positive definite.

The matrices are the pseudo-inertia of each body, or the mass matrix of a model without bodies.

Wensing, Kim and Slotine (2018), "Linear matrix inequalities for physically consistent inertial parameter
identification: a statistical perspective on the mass distribution".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.models import INERTIAL, Model, Parameter, to_pseudo
from dynident.regression import TriangularFactors
from dynident.runtime import ConfigError, Noun, choices
from dynident.runtime.arrays import Array

Bounds = tuple[float | None, float | None]
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
INERTIA = "pseudo-inertia"
# the roles of parameters that are never negative
NONNEGATIVE_ROLES = {"viscous": "viscous friction", "coulomb": "Coulomb friction", "rotor": "rotor inertia"}
DEFAULT_MASS, DEFAULT_LENGTH = 1.0, 0.1  # the size (kg, m) of a body whose nominal mass and inertia are not known


class Limit(Noun):
    """A family of linear limits lower <= rows theta <= upper: ``rows`` (k, p), ``lower`` and ``upper`` (k)."""

    family: str
    labels: tuple[str, ...]
    rows: Array
    lower: Array
    upper: Array

    def violation(self, theta: Array) -> float:
        """Return the largest violation of the limits by theta (p), in their units; negative values are slack."""
        value = self.rows @ theta
        return float(np.maximum(self.lower - value, value - self.upper).max(initial=-np.inf))

    def scale_rows(self, scale: Array) -> Limit:
        """Return the limits, each row divided by its largest entry, in parameters of size ``scale`` (p)."""
        size = np.exp2(np.round(np.log2(np.abs(self.rows * scale).max(axis=1))))  # a power of two changes no digit
        return replace(self, rows=self.rows / size[:, None], lower=self.lower / size, upper=self.upper / size)


class PsdConstraint(Noun):
    """Matrices (K, s, s) = ``offset`` + ``slopes`` (K, s, s, v) x that must be positive definite.

    x (v) is theta, or coordinates along some directions. ``offset`` (K, s, s) is zero where it is None. ``centre``
    (K, s, s), where given, is the prior of the matrices: the cost is then the log-det divergence from it, which also
    keeps undetermined bodies finite.
    """

    slopes: Array
    centre: Array | None = None
    offset: Array | None = None
    label: str = "a positive definite matrix"

    @property
    def constant(self) -> Array:
        """The offset (K, s, s)."""
        return np.zeros(self.slopes.shape[:-1]) if self.offset is None else self.offset

    def at(self, x: Array) -> Array:
        """Return the matrices (K, s, s) at x (v)."""
        return np.asarray(self.constant + self.slopes @ x)

    def restrict(self, origin: Array, directions: Array) -> PsdConstraint:
        """Return the constraint on y (w), where x = origin (v) + directions (v, w) y."""
        return replace(self, slopes=self.slopes @ directions, offset=self.at(origin))

    @cached_property
    def linear_gradient(self) -> Array:
        """Gradient (v) of the part of the divergence that is linear in x; zero without a centre."""
        if self.centre is None:
            return np.zeros(self.slopes.shape[-1])
        products = np.linalg.solve(self.centre[:, None], np.moveaxis(self.slopes, -1, 1))
        return np.asarray(np.trace(products, axis1=-2, axis2=-1).mean(axis=0))


class BodyConstraint(Noun):
    """A rigid body: the ``columns`` (10) of its parameters, and ``size`` (4), which scales its pseudo-inertia.

    ``size`` is sqrt(mass) (l, l, l, 1) with the usual mass (kg) and length l (m) of the body.
    """

    name: str
    columns: NDArray[np.intp]
    size: Array

    def scaled_inertia(self, theta: Array) -> Array:
        """Return the scaled pseudo-inertia (4, 4) at theta (p), or its changes (v, 4, 4) along directions (p, v).

        It is dimensionless, and about one for a body of the typical size.
        """
        return np.asarray(to_pseudo(theta[self.columns].T) / np.outer(self.size, self.size))

    def min_eigenvalue(self, theta: Array) -> float:
        """Return the smallest eigenvalue of the scaled pseudo-inertia at theta (p)."""
        return float(np.linalg.eigvalsh(self.scaled_inertia(theta))[0])

    def psd_constraint(self, p: int, margin: float = 0.0) -> PsdConstraint:
        """Return the constraint on theta (p) that the scaled pseudo-inertia's eigenvalues exceed ``margin``."""
        slopes = np.moveaxis(self.scaled_inertia(np.eye(p)), 0, -1)[None]
        label = f"a positive definite pseudo-inertia of {self.name}"
        return PsdConstraint(slopes, offset=-margin * np.eye(4)[None], label=label)


class Constraints(Noun):
    """Linear limits, scaled pseudo-inertias whose smallest eigenvalue is at least ``margin``, other ``matrices``."""

    limits: tuple[Limit, ...] = ()
    bodies: tuple[BodyConstraint, ...] = ()
    margin: float = 0.0
    matrices: tuple[PsdConstraint, ...] = ()

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families of constraints."""
        return (*([INERTIA] if self.bodies else []), *(limit.family for limit in self.limits))

    def select_family(self, family: str) -> Constraints:
        """Return the constraints of one family."""
        limits = tuple(limit for limit in self.limits if limit.family == family)
        return replace(self, limits=limits, bodies=self.bodies if family == INERTIA else (), matrices=())

    def violation(self, theta: Array) -> float:
        """Return the largest violation of the constraints by theta (p); not positive where it satisfies all."""
        lines = [limit.violation(theta) for limit in self.limits]
        cones = [self.margin - body.min_eigenvalue(theta) for body in self.bodies]
        other_matrices = [-float(np.linalg.eigvalsh(constraint.at(theta)).min()) for constraint in self.matrices]
        return max(lines + cones + other_matrices, default=-np.inf)

    def psd_constraints(self, origin: Array, directions: Array) -> tuple[PsdConstraint, ...]:
        """Return the matrix constraints on x (v), where theta = origin (p) + directions (p, v) x: bodies first."""
        bodies = [body.psd_constraint(len(origin), self.margin) for body in self.bodies]
        return tuple(constraint.restrict(origin, directions) for constraint in (*bodies, *self.matrices))

    def scalar_constraints(self, origin: Array, directions: Array) -> tuple[PsdConstraint, ...]:
        """Return the inequality limits as constraints on 1 x 1 matrices, where theta = origin (p) + directions (p,
        v) x."""
        scalars = []
        for limit in self.limits:
            slope, value = limit.rows @ directions, limit.rows @ origin
            for sign, slack in ((1.0, value - limit.lower), (-1.0, limit.upper - value)):
                # equalities are left to the caller: a barrier has no interior there
                finite = np.flatnonzero(np.isfinite(slack) & (limit.lower < limit.upper))
                scalars += [
                    PsdConstraint(sign * slope[k][None, None, None], None, slack[k].reshape(1, 1, 1), limit.labels[k])
                    for k in finite
                ]
        return tuple(scalars)


def physical_constraints(model: Model, q: Array) -> Constraints:
    """Return the physical constraints: nonnegative friction and rotor inertia, positive definite pseudo-inertias.

    A model without bodies must have a positive definite mass matrix at the configurations q (K, n), unless that
    is zero.
    """
    bodies = bodies_of(model.parameters)
    return Constraints(sign_limits(model.parameters), bodies) if bodies else mass_constraints(model, q)


def mass_constraints(model: Model, q: Array) -> Constraints:
    """Return nonnegative friction and rotor inertia, and a positive definite mass matrix at q (K, n).

    The mass matrix is not constrained where that of a joint is zero.
    """
    slopes = np.stack([model.mass_matrix(q, unit_vector) for unit_vector in np.eye(len(model.parameters))], axis=-1)
    acts_on_all_joints = bool((np.abs(slopes).sum(axis=(0, 2, 3)) > 0).all())
    matrices = (PsdConstraint(slopes, label="a positive definite mass matrix"),) if acts_on_all_joints else ()
    return Constraints(sign_limits(model.parameters), matrices=matrices)


def sign_limits(parameters: Sequence[Parameter], roles: Iterable[str] = tuple(NONNEGATIVE_ROLES)) -> tuple[Limit, ...]:
    """Return the limits, one family for each of the roles, that keep friction and rotor inertia nonnegative."""
    limits = []
    for role in roles:
        columns: dict[int, Bounds] = {k: (0.0, None) for k, x in enumerate(parameters) if x.role == role}
        limits.append(interval_limit(NONNEGATIVE_ROLES[role], parameters, columns))
    return tuple(limits)


def bodies_of(parameters: Sequence[Parameter]) -> tuple[BodyConstraint, ...]:
    """Return the bodies that have all ten inertial parameters; others are treated as lumped parameters."""
    index = {(x.body, x.role): k for k, x in enumerate(parameters)}
    names = dict.fromkeys(x.body for x in parameters if x.role in INERTIAL)
    complete = [name for name in names if all((name, role) in index for role in INERTIAL)]
    return tuple(_body_constraint(name, [index[name, role] for role in INERTIAL], parameters) for name in complete)


def _body_constraint(name: str, columns: list[int], parameters: Sequence[Parameter]) -> BodyConstraint:
    values = [parameters[k].value for k in columns]
    nominal = np.array([np.nan if value is None else value for value in values])
    # half the trace of the inertia is the second moment about the origin: its ratio to the mass is a squared length
    mass, moment = nominal[0], 0.5 * nominal[[4, 6, 9]].sum()
    has_nominal = bool(mass > 0) and bool(moment > 0)
    mass, length = (mass, np.sqrt(moment / mass)) if has_nominal else (DEFAULT_MASS, DEFAULT_LENGTH)
    return BodyConstraint(name, np.array(columns), np.sqrt(mass) * np.array([length, length, length, 1.0]))


def parameter_scales(
    parameters: Sequence[Parameter], bodies: Iterable[BodyConstraint], effect: Array, torque: float
) -> Array:
    """Return the typical size (p) of each parameter, in its unit.

    For a body's parameters it follows from mass and length; else it is the nominal value, or, where that is
    unknown or zero, the value at which the parameter's ``effect`` (p, torque per unit) equals the whole
    ``torque``.
    """
    torque_scale = np.where(effect > 0, torque / np.where(effect > 0, effect, 1.0), 1.0)
    nominal = np.array([abs(x.value or 0.0) for x in parameters])
    out = np.where(nominal > 0, nominal, np.where(torque_scale > 0, torque_scale, 1.0))
    for body in bodies:
        mass, length = body.size[3] ** 2, body.size[0] / body.size[3]
        out[body.columns] = mass * length ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    return np.asarray(out)


def interval_limit(family: str, parameters: Sequence[Parameter], limits: Mapping[int, Bounds]) -> Limit:
    """Return limits (lower, upper) on single parameters by index; None leaves a side open."""
    rows = np.eye(len(parameters))[list(limits)]
    labels = tuple(f"{_limit_label(parameters[k].name, *limits[k])}" for k in limits)
    return Limit(family, labels, rows, *_bound_arrays(limits.values()))


def total_mass_limit(family: str, bodies: Sequence[BodyConstraint], p: int, limit: Bounds) -> Limit:
    """Return the limit (lower, upper) on the sum of all bodies' masses, in kg."""
    row = np.zeros((1, p))
    row[0, [body.columns[0] for body in bodies]] = 1.0
    return Limit(family, (_limit_label("the total mass", *limit),), row, *_bound_arrays([limit]))


def centre_of_mass_limit(family: str, bodies: Sequence[BodyConstraint], p: int, boxes: Mapping[str, Corners]) -> Limit:
    """Return lower m <= (mx, my, mz) <= upper m for bodies by name, with corners (3) in m in the joint frame."""
    bodies_by_name = {body.name: body for body in bodies}
    rows, labels = [], []
    for name, corners in boxes.items():
        if name not in bodies_by_name:
            raise ConfigError(
                f"centre of mass: no body {name!r} with ten inertial parameters; {choices(name, bodies_by_name)}"
            )
        columns = bodies_by_name[name].columns
        for sign, side, corner in zip((1.0, -1.0), ("from", "to"), corners, strict=True):
            for axis, edge in enumerate(corner):
                row = np.zeros(p)
                # upper and lower sides of the box: (m c - m edge) with either sign must not be negative
                row[columns[1 + axis]], row[columns[0]] = sign, -sign * edge
                rows.append(row)
                labels.append(f"centre of mass of {name} {side} {edge:g} m along {'xyz'[axis]}")
    zero = np.zeros(len(rows))
    return Limit(family, tuple(labels), np.array(rows).reshape(-1, p), zero, zero + np.inf)


def _bound_arrays(limits: Iterable[Bounds]) -> tuple[Array, Array]:
    lower, upper = np.array(list(limits), dtype=float).reshape(-1, 2).T  # None becomes nan
    return np.where(np.isnan(lower), -np.inf, lower), np.where(np.isnan(upper), np.inf, upper)


def _limit_label(name: str, lower: float | None, upper: float | None) -> str:
    if lower is not None and lower == upper:
        return f"{name} = {lower:g}"
    sides = ([] if lower is None else [f"{name} >= {lower:g}"]) + ([] if upper is None else [f"{name} <= {upper:g}"])
    return " and ".join(sides)


MIN_LENGTH_SHARE = 0.1  # of the longest lever arm: the length of a body whose joints meet in a point
MIN_MASS_SHARE = 1e-3  # of the heaviest body
ROUNDING = 1e-9  # of the largest column: rounding
# nominal mass over that from the torques, where it is right: wrists move friction, not mass
PLAUSIBLE_MASS_RATIO = 1e-3, 30.0
MOMENT_COLUMNS = (slice(0, 1), slice(1, 4), slice(4, 10))  # mass, first and second moments


def estimate_sizes(parameters: Sequence[Parameter], triangular: TriangularFactors) -> tuple[BodyConstraint, ...]:
    """Return the bodies of ``bodies_of``, with estimated sizes where nominal mass or inertia are missing.

    In each joint's equation, the column of a body's mass is a multiple of those of its first moments; the factor
    is the distance of the body's origin from the joint's axis, its lever arm (m). The length of a body is the
    distance of the next one that these show, for the last one that of the one before. The mass is the largest for
    which no joint's torque is too small, with the body alone at its origin or this length from it. Nominal values
    far from it count as unknown.
    """
    bodies, torque = bodies_of(parameters), np.linalg.norm(triangular.factors[:, :, -1], axis=1)
    effect = np.linalg.norm(triangular.factors[:, :, :-1], axis=1)
    effects = np.stack([effect[:, body.columns] for body in bodies]) if bodies else np.zeros((0, len(effect), 10))
    if not effects.any() or not torque.any():
        return bodies
    # largest effect of mass, first and second moments of each body on each joint
    mass, first_moments, second_moments = (np.transpose(effects[..., part].max(axis=2)) for part in MOMENT_COLUMNS)
    acts = np.logical_or.reduce([part > ROUNDING * part.max() for part in (mass, first_moments, second_moments)])
    is_seen = first_moments > ROUNDING * first_moments.max()
    length = _body_lengths(np.divide(mass, first_moments, out=np.zeros_like(mass), where=is_seen), acts)
    # torque that a unit mass at the body's length makes, from the largest of the three effects
    torque_per_mass = np.maximum.reduce([mass, first_moments * length, second_moments * length**2])  # N m/kg
    max_mass = np.divide(
        torque[:, None], torque_per_mass, out=np.full_like(mass, np.inf), where=acts & (torque > 0)[:, None]
    ).min(axis=0)
    if not np.isfinite(max_mass).any():
        return tuple(bodies)
    # bodies that no torque bounds are taken as heavy as the heaviest of the others
    max_mass[~np.isfinite(max_mass)] = max_mass[np.isfinite(max_mass)].max()
    has_first_moments = acts.any(axis=0) & is_seen.any(axis=0)
    if has_first_moments.any():  # of the others only the inertia about an axis is seen, behind that of all they carry
        max_mass = np.where(has_first_moments, max_mass, np.minimum(max_mass, max_mass[has_first_moments].max()))
    max_mass = np.maximum(max_mass, MIN_MASS_SHARE * max_mass.max())
    return tuple(_resize_body(body, parameters, *size) for body, *size in zip(bodies, max_mass, length, strict=True))


def _resize_body(
    body: BodyConstraint, parameters: Sequence[Parameter], max_mass: float, length: float
) -> BodyConstraint:
    """Return the body with this mass and length, unless its nominal values are known and plausible beside them."""
    nominal = np.array([parameters[k].value or 0.0 for k in body.columns])
    is_plausible = PLAUSIBLE_MASS_RATIO[0] * max_mass < nominal[0] < PLAUSIBLE_MASS_RATIO[1] * max_mass
    if is_plausible and nominal[[4, 6, 9]].sum() > 0:
        return body
    mass = nominal[0] if is_plausible else max_mass
    return replace(body, size=np.sqrt(mass) * np.array([length, length, length, 1.0]))


def _body_lengths(lever: Array, acts: NDArray[np.bool_]) -> Array:
    """Return the length (K) of each body from the lever arms (n, K) of all bodies about the joints that move them."""
    longest = float(lever.max())
    if not longest > 0:  # one joint, or joints that meet in a point
        return np.full(lever.shape[1], DEFAULT_LENGTH)
    joints = acts.sum(axis=0)  # the more of them move a body, the further out it is
    distance = np.zeros((lever.shape[1],) * 2)  # of the origins of two bodies, as far as a common joint shows it
    # neighbours: one joint more moves the outer body, and all joints of the inner one do
    for k, b in np.argwhere((joints[:, None] + 1 == joints) & (joints[:, None] > 0)):
        if (acts[:, b] >= acts[:, k]).all():
            distance[k, b] = np.abs(lever[:, b] - lever[:, k])[acts[:, k]].max()
    outward, inward = distance.max(axis=1), distance.max(axis=0)
    return np.asarray(np.maximum(np.where(outward > 0, outward, inward), MIN_LENGTH_SHARE * longest))
