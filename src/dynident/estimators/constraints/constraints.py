"""Constraints from physics and from the user: linear limits, and matrices that must be positive definite.

The matrices are the pseudo-inertia of each body, or the mass matrix of a model without bodies.

Wensing, Kim and Slotine (2018), "Linear matrix inequalities for physically consistent inertial parameter
identification: a statistical perspective on the mass distribution".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, choices
from dynident.models import INERTIAL, Model, Parameter, to_pseudo

__all__ = [
    "SIGNED",
    "BodyConstraint",
    "Bounds",
    "Constraints",
    "Corners",
    "Limit",
    "PsdConstraint",
    "bodies_of",
    "box",
    "interval",
    "physics",
    "scales",
    "signs",
    "total",
    "with_mass",
]  # fmt: skip

Array = NDArray[np.float64]
Bounds = tuple[float | None, float | None]
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]
INERTIA = "pseudo-inertia"
SIGNED = {"viscous": "viscous friction", "coulomb": "Coulomb friction", "rotor": "rotor inertia"}  # never negative
MASS, LENGTH = 1.0, 0.1  # the size (kg, m) of a body whose nominal mass and inertia are not known


@dataclass(frozen=True, eq=False)
class Limit:
    """A family of linear limits lower <= rows theta <= upper: ``rows`` (k, p), ``lower`` and ``upper`` (k)."""

    family: str
    labels: tuple[str, ...]
    rows: Array
    lower: Array
    upper: Array

    def violation(self, theta: Array) -> float:
        """Return the largest violation of the limits by theta (p), in their units (negative: the slack)."""
        value = self.rows @ theta
        return float(np.maximum(self.lower - value, value - self.upper).max(initial=-np.inf))

    def scaled(self, scale: Array) -> Limit:
        """Return the same limits with each row divided by the usual size (p) of its largest entry."""
        size = np.exp2(np.round(np.log2(np.abs(self.rows * scale).max(axis=1))))  # a power of two changes no digit
        return replace(self, rows=self.rows / size[:, None], lower=self.lower / size, upper=self.upper / size)


@dataclass(frozen=True, eq=False)
class PsdConstraint:
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

    def along(self, origin: Array, directions: Array) -> PsdConstraint:
        """Return the constraint on y (w) where x = origin (v) + directions (v, w) y."""
        return replace(self, slopes=self.slopes @ directions, offset=self.at(origin))

    @cached_property
    def linear_gradient(self) -> Array:
        """Gradient (v) of the part of the divergence that is linear in x; zero without a centre."""
        if self.centre is None:
            return np.zeros(self.slopes.shape[-1])
        turned = np.linalg.solve(self.centre[:, None], np.moveaxis(self.slopes, -1, 1))
        return np.asarray(np.trace(turned, axis1=-2, axis2=-1).mean(axis=0))


@dataclass(frozen=True, eq=False)
class BodyConstraint:
    """A rigid body: the ``columns`` (10) of its parameters, and ``size`` (4), which scales its pseudo-inertia.

    ``size`` is sqrt(mass) (l, l, l, 1) with the usual mass (kg) and length l (m) of the body.
    """

    name: str
    columns: NDArray[np.intp]
    size: Array

    def scaled(self, theta: Array) -> Array:
        """Return the pseudo-inertia (4, 4) at theta (p), or its changes (v, 4, 4) along directions (p, v).

        It is dimensionless, and about one for a body of the usual size.
        """
        return np.asarray(to_pseudo(theta[self.columns].T) / np.outer(self.size, self.size))

    def psd_constraint(self, p: int, margin: float = 0.0) -> PsdConstraint:
        """Return the constraint on theta (p) that the scaled pseudo-inertia's eigenvalues exceed ``margin``."""
        slopes = np.moveaxis(self.scaled(np.eye(p)), 0, -1)[None]
        label = f"a positive definite pseudo-inertia of {self.name}"
        return PsdConstraint(slopes, offset=-margin * np.eye(4)[None], label=label)


@dataclass(frozen=True, eq=False)
class Constraints:
    """Linear limits, scaled pseudo-inertias whose smallest eigenvalue is at least ``margin``, other ``matrices``."""

    limits: tuple[Limit, ...] = ()
    bodies: tuple[BodyConstraint, ...] = ()
    margin: float = 0.0
    matrices: tuple[PsdConstraint, ...] = ()

    @property
    def families(self) -> tuple[str, ...]:
        """Names of the families of constraints."""
        return (*([INERTIA] if self.bodies else []), *(limit.family for limit in self.limits))

    def only(self, family: str) -> Constraints:
        """Return the constraints of one family."""
        limits = tuple(limit for limit in self.limits if limit.family == family)
        return replace(self, limits=limits, bodies=self.bodies if family == INERTIA else (), matrices=())

    def relaxed(self, share: float) -> Constraints:
        """Return the constraints with ``share`` of the margin, so that feasible points of these are strictly inside."""
        return replace(self, margin=share * self.margin)

    def violation(self, theta: Array) -> float:
        """Return the largest violation of the constraints by theta (p); not positive where it satisfies all."""
        lines = [limit.violation(theta) for limit in self.limits]
        cones = [self.margin - float(np.linalg.eigvalsh(body.scaled(theta))[0]) for body in self.bodies]
        others = [-float(np.linalg.eigvalsh(one.at(theta)).min()) for one in self.matrices]
        return max(lines + cones + others, default=-np.inf)

    def psd_constraints(self, origin: Array, directions: Array) -> tuple[PsdConstraint, ...]:
        """Return the matrices along theta = origin (p) + directions (p, v) x: those of the bodies, then the others."""
        bodies = [body.psd_constraint(len(origin), self.margin) for body in self.bodies]
        return tuple(one.along(origin, directions) for one in (*bodies, *self.matrices))

    def numbers(self, origin: Array, directions: Array) -> tuple[PsdConstraint, ...]:
        """Return the inequalities of the limits along theta = origin (p) + directions (p, v) x, as matrices of one."""
        found = []
        for limit in self.limits:
            slope, value = limit.rows @ directions, limit.rows @ origin
            for sign, slack in ((1.0, value - limit.lower), (-1.0, limit.upper - value)):
                used = np.flatnonzero(np.isfinite(slack) & (limit.lower < limit.upper))
                shape = (1, 1, 1)
                found += [
                    PsdConstraint(sign * slope[k].reshape(*shape, -1), None, slack[k].reshape(shape), limit.labels[k])
                    for k in used
                ]
        return tuple(found)


def physics(model: Model, q: Array) -> Constraints:
    """Return the physical constraints: friction and rotor inertia not negative, pseudo-inertias positive definite.

    A model without bodies must have a positive definite mass matrix at the configurations q (K, n), unless that is
    zero.
    """
    bodies = bodies_of(model.parameters)
    return Constraints(signs(model.parameters), bodies) if bodies else with_mass(model, q)


def with_mass(model: Model, q: Array) -> Constraints:
    """Return the signs of friction and rotor inertia, and a positive definite mass matrix at the configurations q (K,
    n), unless that of a joint is zero."""
    slopes = np.stack([model.mass_matrix(q, one) for one in np.eye(len(model.parameters))], axis=-1)
    seen = bool((np.abs(slopes).sum(axis=(0, 2, 3)) > 0).all())
    matrices = (PsdConstraint(slopes, label="a positive definite mass matrix"),) if seen else ()
    return Constraints(signs(model.parameters), matrices=matrices)


def signs(parameters: Sequence[Parameter], roles: Iterable[str] = tuple(SIGNED)) -> tuple[Limit, ...]:
    """Return the limits, one family for each of the roles, that friction and rotor inertia are not negative."""
    found = []
    for role in roles:
        columns: dict[int, Bounds] = {k: (0.0, None) for k, x in enumerate(parameters) if x.role == role}
        found.append(interval(SIGNED[role], parameters, columns))
    return tuple(found)


def bodies_of(parameters: Sequence[Parameter]) -> tuple[BodyConstraint, ...]:
    """Return the bodies that have all ten inertial parameters; others are treated as lumped parameters."""
    place = {(x.body, x.role): k for k, x in enumerate(parameters)}
    names = dict.fromkeys(x.body for x in parameters if x.role in INERTIAL)
    whole = [name for name in names if all((name, role) in place for role in INERTIAL)]
    return tuple(_body(name, [place[name, role] for role in INERTIAL], parameters) for name in whole)


def _body(name: str, columns: list[int], parameters: Sequence[Parameter]) -> BodyConstraint:
    values = [parameters[k].value for k in columns]
    nominal = np.array([np.nan if value is None else value for value in values])
    mass, moment = nominal[0], 0.5 * nominal[[4, 6, 9]].sum()
    known = bool(mass > 0) and bool(moment > 0)
    mass, length = (mass, np.sqrt(moment / mass)) if known else (MASS, LENGTH)
    return BodyConstraint(name, np.array(columns), np.sqrt(mass) * np.array([length, length, length, 1.0]))


def scales(parameters: Sequence[Parameter], bodies: Iterable[BodyConstraint], effect: Array, torque: float) -> Array:
    """Return the usual size (p) of each parameter, in its unit.

    For a body's parameters it follows from mass and length; else it is the nominal value, or, where that is unknown or
    zero, the value at which the parameter's ``effect`` (p, torque per unit) equals the whole ``torque``.
    """
    rest = np.where(effect > 0, torque / np.where(effect > 0, effect, 1.0), 1.0)
    nominal = np.array([abs(x.value or 0.0) for x in parameters])
    out = np.where(nominal > 0, nominal, np.where(rest > 0, rest, 1.0))
    for body in bodies:
        mass, length = body.size[3] ** 2, body.size[0] / body.size[3]
        out[body.columns] = mass * length ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2])
    return np.asarray(out)


def interval(family: str, parameters: Sequence[Parameter], limits: Mapping[int, Bounds]) -> Limit:
    """Return limits (lower, upper) on single parameters by index; None leaves a side open."""
    rows = np.eye(len(parameters))[list(limits)]
    labels = tuple(f"{_worded(parameters[k].name, *limits[k])}" for k in limits)
    return Limit(family, labels, rows, *_sides(limits.values()))


def total(family: str, bodies: Sequence[BodyConstraint], p: int, limit: Bounds) -> Limit:
    """Return the limit (lower, upper) on the sum of all bodies' masses, in kg."""
    row = np.zeros((1, p))
    row[0, [body.columns[0] for body in bodies]] = 1.0
    return Limit(family, (_worded("the total mass", *limit),), row, *_sides([limit]))


def box(family: str, bodies: Sequence[BodyConstraint], p: int, boxes: Mapping[str, Corners]) -> Limit:
    """Return lower m <= (mx, my, mz) <= upper m for bodies by name, with corners (3) in m in the joint frame."""
    known = {body.name: body for body in bodies}
    rows, labels = [], []
    for name, corners in boxes.items():
        if name not in known:
            raise ConfigError(f"centre of mass: no body {name!r} with ten inertial parameters; {choices(name, known)}")
        columns = known[name].columns
        for sign, side, corner in zip((1.0, -1.0), ("from", "to"), corners, strict=True):
            for axis, edge in enumerate(corner):
                row = np.zeros(p)
                row[columns[1 + axis]], row[columns[0]] = sign, -sign * edge
                rows.append(row)
                labels.append(f"centre of mass of {name} {side} {edge:g} m along {'xyz'[axis]}")
    zero = np.zeros(len(rows))
    return Limit(family, tuple(labels), np.array(rows).reshape(-1, p), zero, zero + np.inf)


def _sides(limits: Iterable[Bounds]) -> tuple[Array, Array]:
    pairs = list(limits)
    lower = np.array([-np.inf if low is None else low for low, _ in pairs], dtype=float)
    upper = np.array([np.inf if high is None else high for _, high in pairs], dtype=float)
    return lower, upper


def _worded(name: str, lower: float | None, upper: float | None) -> str:
    if lower is not None and lower == upper:
        return f"{name} = {lower:g}"
    sides = ([] if lower is None else [f"{name} >= {lower:g}"]) + ([] if upper is None else [f"{name} <= {upper:g}"])
    return " and ".join(sides)
