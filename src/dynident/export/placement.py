"""Values of equal torque that a format can hold best: what it cannot hold goes into the bodies where these may have it.

Only sums of the standard parameters act on the torque, such as a link's inertia about the axis of the first joint and
the inertia of its rotor. A fit divides such a sum in some way, and a file without rotor inertia would lose a part.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, ModelError
from dynident.estimators.constraints import Constraints, Limit, bodies_of, scales, signs
from dynident.estimators.constraints.cone import minimise
from dynident.export.identified import Identified, holdable
from dynident.models import Model, smallest_eigenvalue
from dynident.regression import BaseParameters, structural_base_parameters

__all__ = ["moves", "placed"]

Array = NDArray[np.float64]
KEPT, MARGIN = 0.5, 1e-3  # of a body's own smallest scaled eigenvalue, but no more than the latter is asked for
WEAK = 1e-9  # the weight of small changes beside that of what is left over
GONE = (1e-2, 1e-4, 0.0)  # what is left of a parameter, as a share of all that can be moved, that may mean zero
SMALL = 1e-8  # a smaller effect of a direction is rounding
SAME = 1e-9  # largest difference of the torque, relative, that rounding may make


@lru_cache(maxsize=4)
def placed(identified: Identified, *, armature: bool) -> Identified:
    """Return values with the same torque, with as little as possible in parameters that a robot file cannot hold.

    ``armature``: whether it can hold rotor inertia. Bodies stay physically consistent, friction and rotor inertia stay
    non-negative; values are unchanged where some body is not consistent. The parameters move along the null space of
    the structural base parameters, by the conic program min |w theta_u|^2 over those u that cannot be held, each with
    the torque w that it makes per unit in random states.
    """
    held = holdable(identified, armature=armature)
    _, values = identified.bodies
    if held.all() or not identified.value[~held].any() or min(map(smallest_eigenvalue, values)) <= 0:
        return identified
    base = structural_base_parameters(identified.model)
    if not base.null[~held].any():
        return identified
    null = _null(identified.model, base)
    parameters, effect = identified.model.parameters, float(np.linalg.norm(base.scale * identified.value))
    scale = scales(parameters, bodies_of(parameters), base.scale, effect)
    directions = scale[:, None] * np.linalg.qr(null / scale[:, None])[0]
    value = _moved(identified, directions, base.scale * ~held)
    return identified if value is None else replace(identified, value=value)


def _null(model: Model, base: BaseParameters) -> Array:
    """Return the directions (p, p - r) that change no torque, without the rounding of the formulas of ``base``."""
    states = _states(model)
    rows = model.regressor(**states).reshape(-1, len(base.names)) / base.scale
    found = np.linalg.svd(rows, full_matrices=False)[2][base.rank :].T / base.scale[:, None]
    found[(base.null == 0).all(axis=1)] = 0.0  # they have no part in any
    return np.asarray(found)


def _states(model: Model) -> dict[str, Array]:
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-3, 3, (3, 200, len(model.joints)))
    return {"q": q, "dq": dq, "ddq": ddq, "memory": rng.uniform(-1, 1, (200, model.memory))}


def moves(identified: Identified, best: Identified) -> tuple[str, ...]:
    """Return notes on the parameters that are part of others after ``placed``."""
    pairs = zip(identified.model.parameters, identified.value, best.value, strict=True)
    gone = [f"{x.name} ({before:.4g} {x.unit})" for x, before, after in pairs if before and not after]
    if not gone:
        return ()
    return (f"{', '.join(gone)}: part of other parameters in the file, as only their sums act on the torque",)


def _moved(identified: Identified, directions: Array, weight: Array) -> Array | None:
    """Return the values (p) moved along ``directions`` (p, v); None where the torque would change."""
    start, constraints = identified.value, _limits(identified)
    U, size, _ = np.linalg.svd(weight[:, None] * directions, full_matrices=False)
    shown = np.linalg.norm(U[:, size > SMALL * size[0]].T @ (weight * start))  # what the directions can change
    if not shown:
        return None
    weight = weight / shown
    slopes, left = weight[:, None] * directions, weight * start
    movable = np.linalg.norm(slopes, axis=1) > SMALL * np.linalg.norm(slopes)

    def step(rows: Array, *exactly: Limit) -> Array:
        """Return the smallest change that makes least of some rows, and nothing of others."""
        quadratic = rows.T @ rows + WEAK * np.eye(rows.shape[1])
        size = np.diag(quadratic).max()
        within = replace(constraints, limits=(*constraints.limits, *exactly))
        return minimise(quadratic / size, rows.T @ left / size, within, start, directions).point

    for share in GONE:
        try:
            gone = np.flatnonzero(movable & (np.abs(left + slopes @ step(slopes)) < share))
            none = Limit(
                "nothing left", ("nothing left",) * len(gone), np.diag(weight)[gone], *np.zeros((2, len(gone)))
            )
            others = np.where(movable & ~np.isin(np.arange(len(left)), gone), 1.0, 0.0)[:, None] * slopes
            last = step(others, none)
        except (ConfigError, ModelError):  # not all of them can be nothing, or the solver has no answer
            continue
        last = last - np.linalg.pinv(slopes[gone], rcond=SMALL) @ (left + slopes @ last)[gone]
        value = start + directions @ last
        value[gone] = np.where(np.abs(weight * value)[gone] < SAME, 0.0, value[gone])
        if _sound(identified, value):
            return value
    return None


def _limits(identified: Identified) -> Constraints:
    """Return what the values must satisfy: bodies about as far from inconsistent as now, signs as they are now."""
    parameters, value = identified.model.parameters, identified.value
    matrices = []
    for body in bodies_of(parameters):
        least = float(np.linalg.eigvalsh(body.scaled(value))[0])
        matrices.append(body.psd_constraint(len(value), min(KEPT * least, MARGIN)))
    limits = []
    for limit in signs(parameters):
        kept = limit.rows @ value >= 0
        labels = tuple(label for label, one in zip(limit.labels, kept, strict=True) if one)
        limits.append(Limit(limit.family, labels, limit.rows[kept], limit.lower[kept], limit.upper[kept]))
    return Constraints(tuple(limits), matrices=tuple(matrices))


def _sound(identified: Identified, value: Array) -> bool:
    """Whether values have the torque of the identified ones, and bodies that are physically consistent."""
    model = identified.model
    states = _states(model)
    torque, again = model.torque(**states, theta=identified.value), model.torque(**states, theta=value)
    same = float(np.linalg.norm(again - torque)) <= SAME * float(np.linalg.norm(torque))
    _, bodies = replace(identified, value=value).bodies
    signed = bool((value[_signed(identified)] >= 0).all())
    return same and signed and all(smallest_eigenvalue(body) > 0 for body in bodies)


def _signed(identified: Identified) -> list[int]:
    rows = np.concatenate([limit.rows for limit in signs(identified.model.parameters)])
    return [int(row.argmax()) for row in rows if row @ identified.value >= 0]
