"""The links of an identified robot: mass, centre of mass and principal moments, beside those of the robot file."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Provenance
from dynident.models import INERTIAL, RigidBodies, to_physical
from dynident.models.inertia import COLUMNS, ROWS
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from dynident.identification.result import Identification


ROUNDING_SHARE = 1e-6  # share of a quantity's gradient off the determined directions below which it is rounding
MIN_WEIGHT = 1e-9  # weight of a base parameter in a quantity, relative to the largest, that is rounding
N_VALUES = 7  # mass, centre of mass (3), principal moments (3)


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


class BodyInertia(Noun):
    """A body in physical terms: ``mass`` (kg), ``centre`` of mass (3) in m in its joint frame, principal ``moments``
    (3) in kg m^2 about that centre, the smallest first, and their ``axes`` (3, 3), one a column, in the same frame."""

    mass: float
    centre: Array
    moments: Array
    axes: Array

    @property
    def values(self) -> Array:
        """Mass, centre and moments (7)."""
        return np.array([self.mass, *self.centre, *self.moments])

    @property
    def ellipsoid(self) -> Array | None:
        """Half axes (3), in m, along ``axes`` of the solid ellipsoid of even density with this mass and these moments;
        None where there is none: no mass, or moments that no body has."""
        squares = 2.5 * (self.moments.sum() - 2 * self.moments) / self.mass if self.mass > 0 else np.full(3, np.nan)
        if not (squares > -ROUNDING_SHARE * np.abs(squares).max()).all():
            return None
        return np.asarray(np.sqrt(np.maximum(squares, 0.0)))


class LinkInertia(Noun):
    """A link with the ``links`` fixed to it, at index ``body`` of ``Arm.bodies``.

    ``file`` and ``identified`` are its inertia in the robot file and as identified, None where not known; ``by``
    counts what its ten parameters are determined by, of those that matter.

    ``std`` (7) are standard errors of the identified mass, centre and moments, to first order; nan where they are
    not known. ``sure`` (7) marks those that the data alone determine. What the data leave open of the others was
    decided by the prior, whose error comes on top; where the estimator has none, such a value of ``identified`` is
    nan.
    """

    links: tuple[str, ...]
    body: int
    file: BodyInertia | None
    identified: BodyInertia | None
    std: Array
    sure: NDArray[np.bool_]
    by: Mapping[DeterminedBy, int]

    @property
    def name(self) -> str:
        """The name of the first link."""
        return self.links[0]

    @property
    def main_source(self) -> DeterminedBy:
        """What determined most of its parameters; of equal counts, the worse."""
        return max(reversed(DeterminedBy), key=lambda source: self.by.get(source, 0))


def rigid_bodies(identification: Identification) -> RigidBodies | None:
    """Return the bodies of the model, None where it is not made of a robot file."""
    return next((term for term in identification.model.terms if isinstance(term, RigidBodies)), None)


def determined_by(identification: Identification) -> tuple[DeterminedBy, ...]:
    """Return what determined each parameter (p); empty where all are determined by the data alone.

    For an estimator without provenance it is derived from the base parameters.
    """
    estimate, basis = identification.estimate, identification.base.on_data
    if estimate.provenance:
        return tuple(OF_PROVENANCE[provenance] for provenance in estimate.provenance)
    if basis is None:
        return ()
    by_name = dict.fromkeys(basis.without_effect, DeterminedBy.NOTHING)
    by_name |= dict.fromkeys(basis.single_parameters, DeterminedBy.DATA)
    return tuple(by_name.get(name, DeterminedBy.COMBINATION) for name in estimate.names)


def link_inertias(identification: Identification) -> tuple[LinkInertia, ...]:
    """Return the links that have parameters, in the order of these; none where the model is not of a robot file."""
    bodies = rigid_bodies(identification)
    if bodies is None:
        return ()
    parameters, by = identification.model.parameters, determined_by(identification)
    structural = identification.base.structural
    without_effect = set() if structural is None else set(structural.without_effect)
    columns: dict[str, dict[str, int]] = {}
    for k, parameter in enumerate(parameters):
        if parameter.body and parameter.role in INERTIAL:
            columns.setdefault(parameter.body, {})[parameter.role] = k
    links = []
    for place in bodies.arm.parameter_bodies:
        body = bodies.arm.bodies[place]
        indices = [columns[body.name][role] for role in INERTIAL]
        # Parameters without effect on any torque do not count, unless there are no others.
        counted = [k for k in indices if parameters[k].name not in without_effect] or indices
        kinds = Counter(by[k] for k in counted) if by else Counter({DeterminedBy.DATA: len(indices)})
        inertia = body_inertia(identification.estimate.value[indices])
        std, sure = _inertia_std(identification, indices, inertia)
        reported = inertia if identification.estimate.provenance else _keep_certain(inertia, sure)
        links.append(LinkInertia(body.links, place, body_inertia(body.theta), reported, std, sure, dict(kinds)))
    return tuple(links)


def body_inertia(theta: Array) -> BodyInertia | None:
    """Return ten parameters (10) in physical terms, None where there are none, or no mass."""
    if not np.isfinite(theta).all() or theta[0] == 0:
        return None
    mass, centre, tensor = to_physical(theta)
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 0] *= np.sign(np.linalg.det(axes))  # a rotation
    return BodyInertia(float(mass), centre, moments, axes)


def _keep_certain(inertia: BodyInertia | None, sure: NDArray[np.bool_]) -> BodyInertia | None:
    """Return the body with only its certain values, nan for the others."""
    if inertia is None or not sure.any():
        return None
    values = np.where(sure, inertia.values, np.nan)
    return BodyInertia(float(values[0]), values[1:4], values[4:], inertia.axes)


def _inertia_std(
    identification: Identification, columns: list[int], inertia: BodyInertia | None
) -> tuple[Array, NDArray[np.bool_]]:
    """Return the standard errors (7) of mass, centre and moments, and which of these the data alone determine.

    They follow from those of the base parameters, with what these leave open held fixed.
    """
    basis, covariance = identification.base.on_data, scaled_covariance(identification)
    if inertia is None or covariance is None:
        return np.full(N_VALUES, np.nan), np.zeros(N_VALUES, dtype=bool)
    gradient = np.zeros((N_VALUES, len(identification.model.parameters)))
    gradient[:, columns] = _gradient(inertia)
    weights: Array = gradient
    sure = np.ones(N_VALUES, dtype=bool)
    if basis is not None:
        # A quantity is determined by the data where its gradient lies in the span of the base parameters.
        scaled_gradient, rows = gradient / basis.scale, basis.combination / basis.scale
        weights = np.asarray(np.linalg.lstsq(rows.T, scaled_gradient.T)[0].T, dtype=np.float64)
        sure = np.linalg.norm(scaled_gradient - weights @ rows, axis=1) <= ROUNDING_SHARE * np.linalg.norm(
            scaled_gradient, axis=1
        )
    # Rounding would otherwise pick up the variance of a badly known base parameter.
    weights = np.where(np.abs(weights) > MIN_WEIGHT * np.abs(weights).max(axis=1, keepdims=True), weights, 0.0)
    return np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", weights, covariance, weights), 0.0)), sure


def scaled_covariance(identification: Identification) -> Array | None:
    """Return the covariance (r, r) of the base parameters, scaled to the standard errors in the report."""
    errors = identification.errors
    std = errors.std if identification.base.on_data is None else errors.base_std
    if std is None:
        return None
    covariance = errors.base_covariance
    if covariance is None or not np.isfinite(std).all():
        return None
    size = np.sqrt(np.diag(covariance))
    scale = np.divide(std, size, out=np.zeros_like(size), where=size > 0)
    return np.asarray(scale[:, None] * covariance * scale)


def _gradient(inertia: BodyInertia) -> Array:
    """Return the derivatives (7, 10) of mass, centre and principal moments by the ten parameters.

    A principal moment changes with the tensor C about the centre as v' dC v along its axis v (of a double one, in one
    of the directions that it has); C = I - (h'h E - h h') / m.
    """
    out, m, c = np.zeros((N_VALUES, 10)), inertia.mass, inertia.centre
    out[0, 0] = 1.0
    out[1:4, 0], out[1:4, 1:4] = -c / m, np.eye(3) / m
    for k, v in enumerate(inertia.axes.T):
        out[4 + k, 0] = c @ c - (c @ v) ** 2
        out[4 + k, 1:4] = -2 * (c - (c @ v) * v)
        out[4 + k, 4:] = np.where(ROWS == COLUMNS, 1.0, 2.0) * v[ROWS] * v[COLUMNS]
    return out
