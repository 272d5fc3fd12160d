"""The second program of a consistent fit: towards a prior, only in directions that the data do not determine.

The first program gives a feasible point, from which a barrier method with Newton steps in the few free
directions always returns a feasible point; a general conic solver may fail where a body lies on the boundary
and the feasible set is thin. Boyd and Vandenberghe (2004), "Convex optimization", chapter 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dynident.estimators.barrier import Barrier, PenalisedQuadratic
from dynident.estimators.cone import minimise
from dynident.estimators.physical_constraints import BodyConstraint, Constraints
from dynident.regression import Rank
from dynident.runtime import ConfigError, ModelError, Noun
from dynident.runtime.arrays import Array

MARGIN_FACTORS = (1e4, 1e3, 1e2, 10.0, 3.0)  # times the margin, at the point from which the path begins
MAX_START_SIZE = 10.0  # usual sizes, of a parameter at that point
LIMIT_INSET = 1e-3  # limits there, in usual sizes
FINAL_WEIGHT = 1e-3  # of the barrier in the end, in squared standard errors: each limit costs as much at most


def minimise_from_inside(
    quadratic: Array, origin: Array, directions: Array, constraints: Constraints, scale: Array
) -> Array | None:
    """Return the x (v) that minimises x' quadratic x / 2 with theta = origin (p) + directions (p, v) x constrained.

    ``scale`` (p) is the usual size of the parameters. None where no point inside the constraints is found.
    """
    start = _interior_point(constraints, origin, scale)
    if start is None:
        return None
    scale_lengths = np.linalg.norm(directions / scale[:, None], axis=0)
    # the coordinates of the interior point, in unit directions
    unit_directions = directions / scale_lengths / scale[:, None]
    x = np.linalg.lstsq(unit_directions, (start - origin) / scale, rcond=1e-14)[0] / scale_lengths
    inner_directions = directions @ (null_space := equality_null_space(constraints, directions))
    inner_point = origin + directions @ x
    # equalities are kept by moving in their null space: a barrier knows inequalities only
    matrices = (
        *constraints.psd_constraints(inner_point, inner_directions),
        *constraints.scalar_constraints(inner_point, inner_directions),
    )
    barrier = Barrier(matrices, FINAL_WEIGHT)
    if not barrier.is_inside(np.zeros(inner_directions.shape[1])):
        return None
    H, g = null_space.T @ quadratic @ null_space, -null_space.T @ (quadratic @ x)
    return np.asarray(x + null_space @ barrier.minimum(H, g, 0.1 * FINAL_WEIGHT))


def equality_null_space(constraints: Constraints, directions: Array) -> Array:
    """Return coordinates (v, r) of the directions (p, v) along which no equality changes."""
    rows = [limit.rows[limit.lower == limit.upper] @ directions for limit in constraints.limits]
    fixed = np.concatenate([np.zeros((1, directions.shape[1])), *rows])
    _, s, Vt = np.linalg.svd(fixed)
    return np.asarray(Vt[int((s > 1e-9).sum()) :].T)


def _interior_point(constraints: Constraints, origin: Array, scale: Array) -> Array | None:
    """Return a point (p) inside the constraints, near bodies of their typical size."""
    target, p = np.clip(origin, -MAX_START_SIZE * scale, MAX_START_SIZE * scale), len(scale)
    for body in constraints.bodies:
        length = body.size[:3] / body.size[3]
        target[body.columns[[0, 4, 6, 9]]] = body.size[3] ** 2 * np.append(1.0, 2.0 * length**2)
    insets = [np.minimum(LIMIT_INSET, 0.25 * (x.upper - x.lower)) for x in constraints.limits]
    limits = tuple(
        replace(x, lower=x.lower + by, upper=x.upper - by) for x, by in zip(constraints.limits, insets, strict=True)
    )
    # the further inside, the better the path begins, but a thin feasible set may have no such point
    for times in MARGIN_FACTORS:
        tighter = replace(constraints, limits=limits, margin=min(times * constraints.margin, 0.1))
        try:
            optimum = minimise(np.eye(p), np.zeros(p), tighter, target, np.diag(scale))
        except (ConfigError, ModelError):
            continue
        theta = np.asarray(target + scale * optimum.point)
        matrices = (*constraints.psd_constraints(theta, np.eye(p)), *constraints.scalar_constraints(theta, np.eye(p)))
        if Barrier(matrices).is_inside(np.zeros(p)):
            return theta
    return None


FREE_PENALTY = 1.0  # squared standard errors for one usual size along a free direction: it keeps bodies finite
FREE_SCALES = (1.0, 10.0, 100.0, 1e3)  # times the usual size, where the penalty is more than
MAX_PENALTY_SHARE = 0.01  # of the squared residual of all rows
MIN_RELATIVE_NOISE = 1e-5  # of the torque: its noise at least
STEP_UNITS = (1.0, 1e3, 1e6)  # of d, in standard errors
MAX_MARGIN_LOSS = 0.4  # share of the margin that the solver may use up; the second program keeps half of the margin


class Information(Noun):
    """The data's information on theta = base + informed d + free w, from the weighted triangular factor.

    ``base`` (p): the least-squares solution without a free part; ``informed`` (p, k): steps of ``unit`` in the weighted
    residual, so that the squared error is rss + unit^2 |d|^2; ``free`` (p, p - k): directions that the data do not
    determine, orthonormal in units of the parameters' ``scale`` (p); ``directions``: the rank that separates them;
    ``variance`` of the weighted residual; ``torque``: the norm of the weighted torque.
    """

    base: Array
    informed: Array
    free: Array
    scale: Array
    directions: Rank
    unit: float
    rss: float
    torque: float
    variance: float

    @classmethod
    def from_factor(cls, factor: Array, scale: Array, rank: Rank, rows: int) -> Information:
        """Split the parameter space by the ``rank`` of the factor (p + 1, p + 1) of ``rows`` weighted rows.

        The torque is its last column; ``scale`` (p) is the typical size of each parameter.
        """
        p, k = len(factor) - 1, rank.rank
        y = factor[:p, p]
        target = rank.left_vectors[:, :k].T @ y
        rss = float(np.sum((y - rank.left_vectors[:, :k] @ target) ** 2) + factor[p, p] ** 2)
        torque = float(np.linalg.norm(factor[:, p]))
        # for exact data, a tiny share of the torque instead of the noise
        step = max(np.sqrt(rss / max(rows - k, 1)), MIN_RELATIVE_NOISE * torque / np.sqrt(rows)) or 1.0
        half = rank.determined_directions / rank.values[:k]
        free, _ = np.linalg.qr(rank.free_directions / scale[:, None])
        return cls(
            base=half @ target,
            informed=half * step,
            free=free * scale[:, None],
            scale=scale,
            directions=rank,
            unit=float(step),
            rss=rss,
            torque=torque,
            variance=rss / max(rows - k, 1),
        )

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        return int(self.informed.shape[1])

    @property
    def noise(self) -> float:
        """The squared residual of all rows, in squared standard errors."""
        return max(self.rss, (MIN_RELATIVE_NOISE * self.torque) ** 2) / self.unit**2

    def theta(self, x: Array) -> Array:
        """Return theta (p) for x = (d, w)."""
        return np.asarray(self.base + self.informed @ x[: self.rank] + self.free @ x[self.rank :])

    def error(self, excess: float) -> float:
        """Return the weighted relative error of the training data in percent where |d|^2 is ``excess``."""
        return 100.0 * float(np.sqrt(self.rss + self.unit**2 * excess)) / self.torque if self.torque > 0 else 0.0


def staged_fit(information: Information, constraints: Constraints, start: Array) -> tuple[Array, float]:
    """Return the theta (p) of least squared error under the constraints, and |d|^2 there.

    ``start``, an unconstrained solution, is returned where it is feasible. Raises ConfigError where the
    constraints contradict each other, ModelError where the solver fails.
    """
    # cheapest first: the start itself, then a move that costs no error, then the full program
    if constraints.violation(start) <= 0:
        return start, 0.0
    if (theta := _move_free_part(information, constraints, start)) is not None:
        return theta, 0.0
    x = _solve_program(information, constraints)
    return information.theta(x), float(np.sum(x[: information.rank] ** 2))


def _move_free_part(information: Information, constraints: Constraints, start: Array) -> Array | None:
    """Return a feasible unconstrained solution, ``start`` moved along free directions, or None."""
    q = information.free.shape[1]
    try:
        optimum = minimise(np.eye(q), np.zeros(q), constraints, start, information.free) if q else None
    except (ConfigError, ModelError):
        return None
    if optimum is None or not optimum.is_optimal:
        return None
    theta = start + information.free @ optimum.point
    return theta if constraints.violation(theta) <= MAX_MARGIN_LOSS * constraints.margin else None


def _solve_program(information: Information, constraints: Constraints) -> Array:
    """Return x = (d, w) (p), with w in units in which the penalty is far below the noise."""
    free = np.arange(information.scale.size) >= information.rank
    # widen the units of the free part until the penalty on it no longer matters
    for factor in FREE_SCALES:
        x = _solve_scaled(replace(information, free=information.free * factor), constraints)
        penalty = FREE_PENALTY * float(np.sum(x[free] ** 2))
        if penalty <= MAX_PENALTY_SHARE * (information.noise + float(np.sum(x[~free] ** 2))):
            break
    return np.where(free, factor * x, x)


def _solve_scaled(information: Information, constraints: Constraints) -> Array:
    """Return x = (d, w).

    Where d is so large that the conic solver fails, d is scaled; the barrier method is the last resort.
    """
    p, k = information.scale.size, information.rank
    failure: ConfigError | ModelError | None = None
    # large |d| spoils the accuracy of the conic solver: try coarser units of d
    for unit in STEP_UNITS:
        sizes = np.where(np.arange(p) < k, unit, 1.0)
        quadratic = np.diag(np.where(np.arange(p) < k, 1.0, max(FREE_PENALTY / unit**2, 1e-8)))
        directions = np.concatenate((information.informed, information.free), axis=1) * sizes
        try:
            optimum = minimise(quadratic, np.zeros(p), constraints, information.base, directions)
        except (ConfigError, ModelError) as error:
            failure = error
            continue
        violation = constraints.violation(information.theta(optimum.point * sizes))
        if optimum.is_optimal and violation <= MAX_MARGIN_LOSS * constraints.margin:
            return optimum.point * sizes
        failure = ModelError(
            f"the consistent fit failed: the conic solver stopped with {optimum.status}; its optimality conditions "
            f"hold to {max(optimum.stationarity, optimum.gap):.1e} (1e-05 is required), the constraints to "
            f"{violation:.1e}; check nominal values and bounds for wrong units, or raise the threshold, the margin, or "
            "both."
        )
    # last resort: the barrier method from inside the feasible set
    quadratic = np.diag(np.where(np.arange(p) < k, 1.0, FREE_PENALTY))
    directions = np.concatenate((information.informed, information.free), axis=1)
    x = minimise_from_inside(quadratic, information.base, directions, constraints, information.scale)
    if x is None or not constraints.violation(information.theta(x)) <= MAX_MARGIN_LOSS * constraints.margin:
        raise failure or ModelError("the consistent fit failed: no point inside the constraints was found.")
    return x


ACTIVE_SLACK = 1e-9  # slack given to limits that are active after the first program
TARGET_GAP = 1e-8  # distance from the optimum, relative to the objective, at which the barrier method stops
MAX_NEWTON_STEPS = 60  # Newton steps for one weight of the barrier; about ten are needed


def nearest_to_prior(information: Information, theta: Array, prior: Array) -> Array:
    """Return theta (p) moved along the free directions to the point nearest to the prior (p)."""
    target = (prior - theta) / information.scale
    return np.asarray(theta + information.free @ ((information.free / information.scale[:, None]).T @ target))


def add_prior(information: Information, prior: Array, strength: float) -> Information:
    """Return the information with a penalty on the distance from the prior (p, nan where there is none), in d alone.

    The penalty is ``strength`` times the squared residual where a parameter is one typical size away from the
    prior; w, which the data do not determine, is where the distance is least. The base is the optimum, and |d|^2
    the increase from it.
    """
    has_prior = ~np.isnan(prior)
    if not strength or not has_prior.any():
        return information
    unit = (1.0 / information.scale)[has_prior, None]
    # eliminate the free directions: they take the point of least distance for any d
    free, _ = np.linalg.qr(information.free[has_prior] * unit)
    A = information.informed[has_prior] * unit
    offset = (prior - information.base)[has_prior] * unit[:, 0]
    A, offset = A - free @ (free.T @ A), offset - free @ (free.T @ offset)
    share = strength * information.noise
    # |d|^2 plus the penalty becomes |d|^2 again in the coordinates of its eigenvectors
    values, vectors = np.linalg.eigh(np.eye(information.rank) + share * A.T @ A)
    half = vectors / np.sqrt(values)
    d = half @ (half.T @ (share * A.T @ offset))
    return replace(information, base=information.base + information.informed @ d, informed=information.informed @ half)


def move_to_prior(
    information: Information, constraints: Constraints, theta: Array, prior: Array, entropic: Sequence[BodyConstraint]
) -> tuple[Array, float]:
    """Return theta (p) moved along the free directions towards the prior (p), and the remaining duality gap.

    The distance is tr(P0^-1 P) - log det(P0^-1 P) of the pseudo-inertia P from the prior's P0 for the bodies in
    ``entropic``: Lee, Wensing and Park (2020), "Geometric robot dynamic identification". It is half the squared
    Euclidean one, in units of the parameters' scale, for all other parameters.
    """
    directions = information.free @ equality_null_space(constraints, information.free)
    if not directions.shape[1]:
        return theta, 0.0
    relaxed = replace(constraints, margin=0.5 * constraints.margin)
    # the unconstrained optimum is used where it is feasible, without a barrier
    if not entropic and relaxed.violation(closest := nearest_to_prior(information, theta, prior)) <= 0:
        return closest, 0.0
    is_euclidean = np.ones(len(theta), dtype=bool)
    is_euclidean[[k for body in entropic for k in body.columns]] = False
    slope = directions / information.scale[:, None] * is_euclidean[:, None]
    offset = is_euclidean * (theta - prior) / information.scale
    centred = [replace(body.psd_constraint(len(theta)), centre=body.scaled_inertia(prior)[None]) for body in entropic]
    prior_barrier = Barrier(tuple(constraint.restrict(theta, directions) for constraint in centred), 1.0)
    limit_barrier = _limit_barrier(relaxed, theta, directions)
    x, gap = _PriorProgram(slope.T @ slope, -slope.T @ offset, prior_barrier, limit_barrier).follow_path()
    return theta + directions @ x, gap


class _PriorProgram(Noun):
    """Minimise x' H x / 2 - g' x + ``prior_barrier`` at x (v), inside ``limit_barrier``."""

    H: Array
    g: Array
    prior_barrier: Barrier
    limit_barrier: Barrier

    def follow_path(self) -> tuple[Array, float]:
        """Follow the central path from x = 0; return x and a bound on the distance of the objective from its
        optimum."""
        x = np.zeros(len(self.g))
        weight = max(1.0, self._penalised(1.0).newton(x)[1])  # smaller beside the way to go, it takes too many steps
        while True:
            # solve to a fraction of the weight, then lower it: the gap is the weight times the number of eigenvalues
            x, decrement = self._penalised(weight).minimise(x, 1e-2 * weight, MAX_NEWTON_STEPS)
            cost = float(0.5 * x @ self.H @ x - self.g @ x) + self.prior_barrier.value(x)
            gap = (weight * self.limit_barrier.degree + decrement) / max(1.0, abs(cost))
            if gap < TARGET_GAP or weight < 1e-2 * TARGET_GAP:
                return x, gap
            weight *= 0.1

    def _penalised(self, weight: float) -> PenalisedQuadratic:
        return PenalisedQuadratic(self.H, self.g, ((self.prior_barrier, 1.0), (self.limit_barrier, weight)))


def _limit_barrier(constraints: Constraints, theta: Array, directions: Array) -> Barrier:
    """Return the barrier of the constraints that the free directions move."""
    movable = [
        constraint
        for constraint in constraints.psd_constraints(theta, directions)
        if np.abs(constraint.slopes).max(initial=0.0) > ACTIVE_SLACK
    ]
    movable += [
        replace(constraint, offset=np.maximum(constraint.constant, ACTIVE_SLACK))
        for constraint in constraints.scalar_constraints(theta, directions)
        if (np.abs(constraint.slopes) > ACTIVE_SLACK).any()
    ]
    return Barrier(tuple(movable))
