"""The last part of a search: sequential quadratic programming with all limits as constraints, from within them.

Its iterates may leave the limits by a little; kept are only those that do not, or that keep to them when they are made
a little smaller (Kraft 1988, "A software package for sequential quadratic programming"; SciPy's SLSQP).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.interior import Interior

__all__ = ["fits", "polished"]

Array = NDArray[np.float64]
MOST = 1_500_000  # entries of the constraints' derivatives: with more, a step takes too long
RESERVE = 1e-3  # of each limit, that the iterates leave
EXCESS = 0.02  # that a motion may exceed a limit by to be made smaller


def fits(interior: Interior) -> bool:
    """Whether the problem is small enough."""
    n, K = len(interior.limits.joints), interior.family.size
    rows = sum(len(rows) for rows in interior.guard.rows) + len(interior.grid)
    return (2 * n * rows + len(interior.grid) * len(interior.space.pairs)) * n * K <= MOST


def polished(interior: Interior, x: Array, steps: int) -> tuple[Array, float]:
    """Return the best motion (n, K) of at most so many steps from one that keeps to the limits, and its criterion."""
    from scipy.optimize import minimize

    found = [(x, _criterion(interior, x))]

    def keep(flat: Array) -> None:
        new = flat.reshape(x.shape)
        if _slacks(interior, new).min() > -EXCESS and (kept := interior.smaller(new)) is not None:
            value = _criterion(interior, kept)
            if value < found[0][1]:
                found[0] = kept, value

    minimize(
        lambda flat: _sloped(interior, flat.reshape(x.shape)),
        x.ravel(),
        jac=True,
        method="SLSQP",
        constraints={
            "type": "ineq",
            "fun": lambda flat: _slacks(interior, flat.reshape(x.shape)) - RESERVE,
            "jac": lambda flat: _slopes(interior, flat.reshape(x.shape)),
        },
        callback=keep,
        options={"maxiter": steps, "ftol": 1e-3 * interior.unit},
    )
    return found[0]


def _criterion(interior: Interior, x: Array) -> float:
    return interior.information.value(*interior.states(x)[:3])


def _sloped(interior: Interior, x: Array) -> tuple[float, Array]:
    """Return the criterion and its gradient (n K)."""
    value, slopes = interior.information.value_and_slopes(*interior.states(x)[:3])
    return value, np.einsum("din,dik->nk", slopes, interior.functions[:3]).ravel()


def _slacks(interior: Interior, x: Array) -> Array:
    """Return what is left of each limit on the grid: shares, and distances in m."""
    states = interior.states(x)
    parts = interior.room(x), interior.torque_room(states), interior.gaps(states[0])
    return np.concatenate([part.ravel() for part in parts])


def _slopes(interior: Interior, x: Array) -> Array:
    """Return the derivatives of these by the coefficients."""
    states, functions = interior.states(x), interior.functions
    n, K = x.shape
    room = np.zeros((len(interior.guard_shares[0]), n, n, K))
    for joint, rows in enumerate(interior.guard_shares):
        room[:, joint, joint] = rows
    partials = interior.torque_partials(states)
    torque = sum(np.einsum("ijk,il->ijkl", one, B) for one, B in zip(partials, functions[:3], strict=True))
    torque = torque / interior.limits.torque[:, None, None]
    gaps = np.einsum("ipk,il->ipkl", interior.space.gradients(states[0])[1], functions[0])
    return np.concatenate([part.reshape(-1, n * K) for part in (-room, room, -torque, torque, gaps)])
