"""The links of an identified robot: mass, centre of mass and principal moments, beside those of the robot file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators import Provenance
from dynident.models import INERTIAL, RigidBodies
from dynident.models.inertia import COLUMNS, ROWS, to_physical

if TYPE_CHECKING:
    from dynident.identification.result import Identification

__all__ = ["BodyInertia", "DeterminedBy", "LinkInertia", "determined_by", "link_inertias", "rigid_bodies"]

Array = NDArray[np.float64]
EXACT = 1e-6  # share of a quantity's gradient off the determined directions below which it is rounding
TINY = 1e-9  # weight of a base parameter in a quantity, relative to the largest, that is rounding
SIZE = 7  # mass, centre of mass (3), principal moments (3)


class DeterminedBy(StrEnum):
    """What determined a parameter, from the best to the worst: the data alone, the data together with others, the
    prior, a bound, or nothing."""

    DATA = "data"
    COMBINATION = "combination"
    PRIOR = "prior"
    BOUND = "bound"
    NOTHING = "nothing"


OF_PROVENANCE = {
    Provenance.DATA: DeterminedBy.DATA,
    Provenance.PRIOR: DeterminedBy.PRIOR,
    Provenance.BOUND: DeterminedBy.BOUND,
    Provenance.UNIDENTIFIABLE: DeterminedBy.NOTHING,
}


@dataclass(frozen=True, eq=False)
class BodyInertia:
    """A body in physical terms: ``mass`` (kg), ``centre`` of mass (3) in m in its joint frame, principal ``moments``
    (3) in kg m^2 about that centre, the smallest first, and their ``axes`` (3, 3), one a column, in the same frame."""

    mass: float
    centre: Array
    moments: Array
    axes: Array

    __repr__ = brief

    @property
    def values(self) -> Array:
        """Mass, centre and moments (7)."""
        return np.array([self.mass, *self.centre, *self.moments])

    @property
    def ellipsoid(self) -> Array | None:
        """Half axes (3), in m, along ``axes`` of the solid ellipsoid of even density with this mass and these moments;
        None where there is none: no mass, or moments that no body has."""
        squares = 2.5 * (self.moments.sum() - 2 * self.moments) / self.mass if self.mass > 0 else np.full(3, np.nan)
        if not (squares > -EXACT * np.abs(squares).max()).all():
            return None
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


@dataclass(frozen=True, eq=False)
class LinkInertia:
    """A link, with the ``links`` fixed to it, and its place in ``Arm.bodies``: its inertia in the robot ``file`` and as
    ``found``, None where not known, and what its ten parameters are determined ``by``, of those that matter.

    ``std`` (7) are standard errors of the mass, centre and moments found, to first order; nan where they are not known.
    Those that the data alone determine are ``sure`` (7). What they leave open of the others was decided by the prior,
    whose error comes on top; where the estimator has none, such a value of ``found`` is nan.
    """

    links: tuple[str, ...]
    body: int
    file: BodyInertia | None
    found: BodyInertia | None
    std: Array
    sure: NDArray[np.bool_]
    by: Mapping[DeterminedBy, int]

    __repr__ = brief

    @property
    def name(self) -> str:
        """The name of the first link."""
        return self.links[0]

    @property
    def mostly(self) -> DeterminedBy:
        """What determined most of its parameters; of as many, the worse."""
        return max(reversed(DeterminedBy), key=lambda one: self.by.get(one, 0))


def rigid_bodies(identification: Identification) -> RigidBodies | None:
    """Return the bodies of the model, None where it is not made of a robot file."""
    return next((one for one in identification.model.terms if isinstance(one, RigidBodies)), None)


def determined_by(identification: Identification) -> tuple[DeterminedBy, ...]:
    """Return what determined each parameter (p), for an estimator that does not tell as the base parameters show it;
    empty where all are by the data alone."""
    estimate, basis = identification.estimate, identification.base.on_data
    if estimate.provenance:
        return tuple(OF_PROVENANCE[one] for one in estimate.provenance)
    if basis is None:
        return ()
    known = dict.fromkeys(basis.without_effect, DeterminedBy.NOTHING)
    known |= dict.fromkeys(basis.determined, DeterminedBy.DATA)
    return tuple(known.get(name, DeterminedBy.COMBINATION) for name in estimate.names)


def link_inertias(identification: Identification) -> tuple[LinkInertia, ...]:
    """Return the links that have parameters, in the order of these; none where the model is not of a robot file."""
    bodies = rigid_bodies(identification)
    if bodies is None:
        return ()
    parameters, by = identification.model.parameters, determined_by(identification)
    structural = identification.base.structural
    idle = set() if structural is None else set(structural.without_effect)
    columns: dict[str, dict[str, int]] = {}
    for k, parameter in enumerate(parameters):
        if parameter.body and parameter.role in INERTIAL:
            columns.setdefault(parameter.body, {})[parameter.role] = k
    found = []
    for place in bodies.arm.listed:
        body = bodies.arm.bodies[place]
        own = [columns[body.name][role] for role in INERTIAL]
        counted = [k for k in own if parameters[k].name not in idle] or own
        kinds = Counter(by[k] for k in counted) if by else Counter({DeterminedBy.DATA: len(own)})
        inertia = _inertia(identification.estimate.value[own])
        std, sure = _errors(identification, own, inertia)
        shown = inertia if identification.estimate.provenance else _only(inertia, sure)
        found.append(LinkInertia(body.links, place, _inertia(body.theta), shown, std, sure, dict(kinds)))
    return tuple(found)


def _inertia(theta: Array) -> BodyInertia | None:
    """Return ten parameters (10) in physical terms, None where there are none, or no mass."""
    if not np.isfinite(theta).all() or theta[0] == 0:
        return None
    mass, centre, tensor = to_physical(theta)
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 0] *= np.sign(np.linalg.det(axes))  # a rotation
    return BodyInertia(float(mass), centre, moments, axes)


def _only(found: BodyInertia | None, sure: NDArray[np.bool_]) -> BodyInertia | None:
    """Return of a body what is sure, and nan for the rest."""
    if found is None or not sure.any():
        return None
    values = np.where(sure, found.values, np.nan)
    return BodyInertia(float(values[0]), values[1:4], values[4:], found.axes)


def _errors(
    identification: Identification, own: list[int], found: BodyInertia | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the standard errors (7) of mass, centre and moments by those of the base parameters, with what these leave
    open held, and which of them depend on nothing else."""
    basis, covariance = identification.base.on_data, _covariance(identification)
    if found is None or covariance is None:
        return np.full(SIZE, np.nan), np.zeros(SIZE, dtype=bool)
    gradient = np.zeros((SIZE, len(identification.model.parameters)))
    gradient[:, own] = _gradient(found)
    along: Array = gradient
    sure = np.ones(SIZE, dtype=bool)
    if basis is not None:
        scaled, rows = gradient / basis.scale, basis.combination / basis.scale
        along = np.asarray(np.linalg.lstsq(rows.T, scaled.T)[0].T, dtype=np.float64)
        sure = np.linalg.norm(scaled - along @ rows, axis=1) <= EXACT * np.linalg.norm(scaled, axis=1)
    along = np.where(np.abs(along) > TINY * np.abs(along).max(axis=1, keepdims=True), along, 0.0)
    return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", along, covariance, along), 0.0)), sure


def _covariance(identification: Identification) -> Array | None:
    """Return the covariance (r, r) of the base parameters with the standard errors that the report has of them."""
    errors = identification.errors
    best = errors.best if identification.base.on_data is None else errors.best_base
    if best is None:
        return None
    together = errors.base_covariance
    if together is None or not np.isfinite(best).all():
        return None
    size = np.sqrt(np.diag(together))
    scale = np.divide(best, size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(scale[:, None] * together * scale)


def _gradient(found: BodyInertia) -> Array:
    """Return the derivatives (7, 10) of mass, centre and principal moments by the ten parameters.

    A principal moment changes with the tensor C about the centre as v' dC v along its axis v (of a double one, in one
    of the directions that it has); C = I - (h'h E - h h') / m.
    """
    out, m, c = np.zeros((SIZE, 10)), found.mass, found.centre
    out[0, 0] = 1.0
    out[1:4, 0], out[1:4, 1:4] = -c / m, np.eye(3) / m
    for k, v in enumerate(found.axes.T):
        out[4 + k, 0] = c @ c - (c @ v) ** 2
        out[4 + k, 1:4] = -2 * (c - (c @ v) * v)
        out[4 + k, 4:] = np.where(ROWS == COLUMNS, 1.0, 2.0) * v[ROWS] * v[COLUMNS]
    return out
