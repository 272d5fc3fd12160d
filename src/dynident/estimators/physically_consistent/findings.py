"""What is found of a consistent fit: what determines each parameter, what the constraints cost, and what they hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note
from dynident.estimators.constraints import BodyConstraint, Constraints
from dynident.estimators.estimator import Provenance
from dynident.estimators.notes import (
    ConstraintsCostly,
    DecidedByPrior,
    HeldByConstraints,
    NotIdentifiable,
    PriorApproached,
    RankDeficient,
)
from dynident.estimators.physically_consistent.staged import Information, staged_fit
from dynident.models import Parameter
from dynident.regression import base_parameters

__all__ = ["CLOSE", "costly", "costs_of", "eigenvalues", "held", "notes_of", "provenance_of"]

Array = NDArray[np.float64]
CLOSED = 1e-6  # duality gap above which the prior was not reached
COSTLY, LEAST_COST = 0.25, 0.5  # share of the error without constraints, and percentage points, that are said
FAR = 3.0  # standard errors: noise alone moves an estimate as far in 0.3 % of all cases
CLOSE = 1e-7  # how near a limit counts as at it, in units of the parameter's size


def eigenvalues(bodies: Sequence[BodyConstraint], theta: Array) -> dict[str, float]:
    """Return the smallest eigenvalue of each body's pseudo-inertia, relative to its usual mass and length."""
    return {body.name: float(np.linalg.eigvalsh(body.scaled(theta))[0]) for body in bodies}


def provenance_of(
    theta: Array, known: Information, constraints: Constraints, prior: NDArray[np.bool_]
) -> tuple[Provenance, ...]:
    """Return what determines each parameter; ``prior`` (p) says which have one."""
    free = known.directions.undetermined
    at = np.zeros(len(theta), dtype=bool)
    for body in constraints.bodies:
        if np.linalg.eigvalsh(body.scaled(theta))[0] < 10 * constraints.margin:
            at[body.columns[~free[body.columns]]] = True
    for limit in constraints.limits:
        value = limit.rows @ theta
        near = np.minimum(np.abs(value - limit.lower), np.abs(limit.upper - value)) < CLOSE
        single = (limit.rows != 0).sum(axis=1) == 1
        at |= (limit.rows[near & single] != 0).any(axis=0)
    chosen = np.select([at, ~free, prior], [0, 1, 2], 3)
    order = (Provenance.BOUND, Provenance.DATA, Provenance.PRIOR, Provenance.UNIDENTIFIABLE)
    return tuple(order[k] for k in chosen)


def costs_of(known: Information, constraints: Constraints, start: Array, excess: float) -> dict[str, float]:
    """Return the increase of the error, in percentage points, by each family of constraints alone and by "all"."""
    alone = {family: staged_fit(known, constraints.only(family), start)[1] for family in constraints.families}
    return {family: known.error(more) - known.error(0.0) for family, more in (alone | {"all": excess}).items()}


def costly(known: Information, costs: Mapping[str, float]) -> tuple[ConstraintsCostly, ...]:
    """Return a note where the constraints cost much of the error that there is without them."""
    free, families = known.error(0.0), [name for name in costs if name != "all"]
    if not families or costs["all"] < max(COSTLY * free, LEAST_COST):
        return ()
    return (ConstraintsCostly(max(families, key=lambda name: costs[name]), free + costs["all"], free),)


def held(known: Information, theta: Array, parameters: Sequence[Parameter]) -> tuple[HeldByConstraints, ...]:
    """Return a note on the base parameters that the constraints moved far from where the data alone have them."""
    basis = base_parameters(known.directions, parameters)
    std = np.linalg.norm(basis.combination @ known.informed, axis=1)
    moved = np.abs(basis.to_base(theta - known.base)) / std
    far = tuple((basis.groupings[k], float(moved[k])) for k in np.argsort(-moved) if moved[k] > FAR)
    return (HeldByConstraints(far),) if far else ()


def notes_of(known: Information, provenance: tuple[Provenance, ...], gap: float) -> tuple[Note, ...]:
    """Return the notes on what the data do not determine, and on a prior that was not reached (duality ``gap``)."""
    kinds: dict[Provenance, type[DecidedByPrior | NotIdentifiable]] = {
        Provenance.PRIOR: DecidedByPrior,
        Provenance.UNIDENTIFIABLE: NotIdentifiable,
    }
    return (
        *([RankDeficient(known.rank, len(provenance))] if known.rank < len(provenance) else []),
        *(kind(provenance.count(which)) for which, kind in kinds.items() if which in provenance),
        *([PriorApproached(gap)] if gap > CLOSED else []),
    )
