"""The last stage of a search: sequential quadratic programming within a region in which the limits are nearly linear.

Each step minimises a quadratic model of the criterion, whose curvature is that of BFGS with Powell's damping (Nocedal
and Wright 2006, "Numerical optimization", secs. 18.3 and 18.5), subject to the limits linearised. Of these a step has
only those that it can reach within its region: of ten thousand some hundreds. A motion that exceeds a limit by little
is made smaller, so that all iterates keep to all limits.
"""

from __future__ import annotations

import numpy as np

from dynident.apps.excitation.interior import Interior
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

MAX_JACOBIAN_SIZE = 1_500_000  # entries of the constraints' derivatives: with more, a step takes too long
CONSTRAINT_RESERVE = 1e-3  # of each limit, that the iterates leave
EXCESS = 0.1  # that a motion may exceed a limit by to be made smaller
# the size of the region: of the change of a coefficient by which one limit changes by its whole half range
FIRST_SIZE = 0.1
GOOD_SHARE, POOR_SHARE = 0.5, 0.2  # of the gain that the model predicts
GROWTH, REDUCTION, RETREAT = 1.6, 0.6, 0.35  # of the size after a good step, a poor one, and one without gain
DAMPED_SHARE = 0.2  # of the curvature of the model, that a new pair has at least
ROUND, MIN_ROUND_GAIN = 8, 0.02  # steps of a round, and what it must gain for another to follow


def is_small_enough(interior: Interior) -> bool:
    """Return whether the problem is small enough for this method."""
    # entries of the dense Jacobian of all constraints
    n, K = len(interior.limits.joints), interior.family.size
    rows = sum(len(rows) for rows in interior.guard.rows) + len(interior.grid)
    return (2 * n * rows + len(interior.grid) * len(interior.feasible.space.pairs)) * n * K <= MAX_JACOBIAN_SIZE


class _Linearisation(Noun):
    """A motion x (n, K) that keeps to the limits, with its ``criterion`` and the ``gradient`` (n K) of that, and the
    ``slack`` (m) of the limits with its ``jacobian`` (m, n K)."""

    x: Array
    criterion: float
    gradient: Array
    slack: Array
    jacobian: Array

    @classmethod
    def at(cls, interior: Interior, x: Array) -> _Linearisation:
        """Linearise at x."""
        value, gradients = interior.information.value_and_gradients(*interior.states(x)[:3])
        gradient = np.einsum("din,dik->nk", gradients, interior.functions[:3]).ravel()
        slack = limit_slacks(interior, x) - CONSTRAINT_RESERVE
        return cls(x, value, gradient, slack, slack_jacobian(interior, x))


def polish_motion(interior: Interior, x: Array, steps: int) -> tuple[Array, float]:
    """Return the best motion (n, K) within ``steps`` from one that keeps to the limits, and its criterion."""
    point, last_criterion = _Linearisation.at(interior, x), np.inf
    # the curvature of a long way back misleads, so that each round begins without any
    for start in range(0, steps, ROUND):
        if not point.criterion < last_criterion - MIN_ROUND_GAIN * interior.unit:
            break
        last_criterion, point = point.criterion, _polish_round(interior, point, min(ROUND, steps - start))
    return point.x, point.criterion


def _polish_round(interior: Interior, point: _Linearisation, steps: int) -> _Linearisation:
    """Return the last motion of so many steps, each of which gains or makes the region smaller."""
    # how far each coefficient can go until a limit changes by its whole half range
    reach = 1.0 / np.abs(interior.guard_shares).max(axis=1).ravel()
    curvature = np.diag(np.abs(point.gradient * reach).mean() / reach**2)
    size = FIRST_SIZE
    for _ in range(steps):
        # the limits that may be reached within the region are those of the step
        box = size * reach
        near = np.flatnonzero(point.slack < np.abs(point.jacobian) @ box)
        step, multipliers = _solve_step(curvature, point.gradient, point.jacobian[near], point.slack[near], box)
        target = point.x + step.reshape(point.x.shape)
        # made smaller where it exceeds a limit by little
        candidate = interior.shrink(target) if limit_slacks(interior, target).min() > -EXCESS else None
        criterion = np.inf if candidate is None else interior.information.value(*interior.states(candidate)[:3])
        # no gain: the model holds in a smaller region only
        if candidate is None or not criterion < point.criterion:
            size *= RETREAT
            continue
        gain, predicted = point.criterion - criterion, -float(step @ (point.gradient + 0.5 * curvature @ step))
        if gain > GOOD_SHARE * predicted and (np.abs(step) > 0.99 * box).any():
            size *= GROWTH
        elif gain < POOR_SHARE * predicted:
            size *= REDUCTION
        next_point = _Linearisation.at(interior, candidate)
        # the curvature of the Lagrangian: of the criterion less the multipliers times the limits
        bend = next_point.gradient - point.gradient - multipliers @ (next_point.jacobian[near] - point.jacobian[near])
        curvature = _update_curvature(curvature, (candidate - point.x).ravel(), bend)
        point = next_point
    return point


def _solve_step(curvature: Array, gradient: Array, jacobian: Array, slack: Array, box: Array) -> tuple[Array, Array]:
    """Return the step d with the least g'd + d'Bd / 2 within the box that keeps the slack s + Jd >= 0, and the
    multipliers of these limits; no step where the solver fails."""
    import clarabel  # type: ignore[import-untyped, unused-ignore]
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    identity = np.eye(len(box))
    A, b = np.concatenate([-jacobian, identity, -identity]), np.concatenate([np.maximum(slack, 0.0), box, box])
    cones = [clarabel.NonnegativeConeT(len(b))]
    solution = clarabel.DefaultSolver(
        csc_matrix(np.triu(curvature)), gradient, csc_matrix(A), b, cones, settings
    ).solve()
    step, multipliers = np.array(solution.x), np.array(solution.z)[: len(slack)]
    if not (np.isfinite(step).all() and np.isfinite(multipliers).all()):
        return np.zeros(len(box)), np.zeros(len(slack))
    return step, multipliers


def _update_curvature(B: Array, change: Array, bend: Array) -> Array:
    """Return the curvature after a change of x, by which the gradient bends: BFGS, damped so that it stays positive."""
    expected = B @ change
    size, bent = float(change @ expected), float(change @ bend)
    share = 1.0 if bent >= DAMPED_SHARE * size else (1.0 - DAMPED_SHARE) * size / (size - bent)
    damped_bend = share * bend + (1.0 - share) * expected
    return np.asarray(
        B - np.outer(expected, expected) / size + np.outer(damped_bend, damped_bend) / (change @ damped_bend)
    )


def limit_slacks(interior: Interior, x: Array) -> Array:
    """Return the slack (m) of each limit on the grid: shares, and distances in m."""
    states = interior.states(x)
    slacks = interior.range_slack(x), interior.torque_slack(states), interior.gaps(states[0])
    return np.concatenate([slack.ravel() for slack in slacks])


def slack_jacobian(interior: Interior, x: Array) -> Array:
    """Return the derivatives (m, n K) of the slacks by the coefficients."""
    states, functions = interior.states(x), interior.functions
    n, K = x.shape
    # ranges act on each joint by itself, so their Jacobian is block diagonal
    range_jacobian = np.zeros((len(interior.guard_shares[0]), n, n, K))
    for joint, rows in enumerate(interior.guard_shares):
        range_jacobian[:, joint, joint] = rows
    partials = interior.torque_partials(states)
    torque_jacobian = sum(
        np.einsum("ijk,il->ijkl", partial, B) for partial, B in zip(partials, functions[:3], strict=True)
    )
    torque_jacobian = torque_jacobian / interior.limits.torque[:, None, None]
    gap_jacobian = np.einsum("ipk,il->ipkl", interior.feasible.space.gradients(states[0])[1], functions[0])
    jacobians = -range_jacobian, range_jacobian, -torque_jacobian, torque_jacobian, gap_jacobian
    return np.concatenate([jacobian.reshape(-1, n * K) for jacobian in jacobians])
