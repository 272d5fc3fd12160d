"""The first program of a consistent fit: the directions that the data determine, and their constrained optimum."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, ModelError, brief
from dynident.estimators.constraints import Constraints
from dynident.estimators.constraints.cone import Optimum, minimise
from dynident.estimators.physically_consistent.inner import descended
from dynident.regression import Rank

__all__ = ["Information", "read", "staged_fit"]

Array = NDArray[np.float64]
PULL = 1.0  # penalty, in squared standard errors, of one usual size along a free direction, which keeps bodies finite
WIDER = (1.0, 10.0, 100.0, 1e3)  # times the usual size, where the penalty is more than
BELOW = 0.01  # of the squared residual of all rows
EXACT = 1e-5  # of the torque: its noise at least
UNITS = (1.0, 1e3, 1e6)  # of d, in standard errors
SLACK = 0.4  # share of the margin that the solver may use up; the second program keeps half of the margin


@dataclass(frozen=True, eq=False)
class Information:
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

    __repr__ = brief

    @property
    def rank(self) -> int:
        """Number of directions that the data determine."""
        return int(self.informed.shape[1])

    @property
    def noise(self) -> float:
        """The squared residual of all rows, in squared standard errors."""
        return max(self.rss, (EXACT * self.torque) ** 2) / self.unit**2

    def theta(self, x: Array) -> Array:
        """Return theta (p) for x = (d, w)."""
        return np.asarray(self.base + self.informed @ x[: self.rank] + self.free @ x[self.rank :])

    def error(self, excess: float) -> float:
        """Return the weighted relative error of the training data in percent where |d|^2 is ``excess``."""
        return 100.0 * float(np.sqrt(self.rss + self.unit**2 * excess)) / self.torque if self.torque > 0 else 0.0


def read(factor: Array, scale: Array, rank: Rank, rows: int) -> Information:
    """Split the parameter space by the ``rank`` of the factor (p + 1, p + 1) of ``rows`` weighted rows, torque last.

    ``scale`` (p) is the usual size of each parameter.
    """
    p, k = len(factor) - 1, rank.rank
    y = factor[:p, p]
    target = rank.left[:, :k].T @ y
    rss = float(np.sum((y - rank.left[:, :k] @ target) ** 2) + factor[p, p] ** 2)
    torque = float(np.linalg.norm(factor[:, p]))
    # for exact data, a tiny share of the torque instead of the noise
    step = max(np.sqrt(rss / max(rows - k, 1)), EXACT * torque / np.sqrt(rows)) or 1.0
    half = rank.determined / rank.values[:k]
    free, _ = np.linalg.qr(rank.free / scale[:, None])
    return Information(
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


def staged_fit(known: Information, constraints: Constraints, start: Array) -> tuple[Array, float]:
    """Return the theta (p) of least squared error under the constraints, and |d|^2 there.

    ``start``, an unconstrained solution, is returned where it is feasible. Raises ConfigError where the constraints
    contradict each other, ModelError where the solver fails.
    """
    if constraints.violation(start) <= 0:
        return start, 0.0
    if (theta := _freed(known, constraints, start)) is not None:
        return theta, 0.0
    x = _solved(known, constraints)
    return known.theta(x), float(np.sum(x[: known.rank] ** 2))


def _freed(known: Information, constraints: Constraints, start: Array) -> Array | None:
    """Return a feasible unconstrained solution, ``start`` moved along free directions, or None."""
    q = known.free.shape[1]
    try:
        found = minimise(np.eye(q), np.zeros(q), constraints, start, known.free) if q else None
    except (ConfigError, ModelError):
        return None
    if found is None or not found.good:
        return None
    theta = start + known.free @ found.point
    return theta if constraints.violation(theta) <= SLACK * constraints.margin else None


def _solved(known: Information, constraints: Constraints) -> Array:
    """Return x = (d, w) (p), solved with w in units in which the penalty is far below the noise."""
    free = np.arange(known.scale.size) >= known.rank
    for wider in WIDER:
        x = _solved_for(replace(known, free=known.free * wider), constraints)
        if PULL * float(np.sum(x[free] ** 2)) <= BELOW * (known.noise + float(np.sum(x[~free] ** 2))):
            break
    return np.where(free, wider * x, x)


def _solved_for(known: Information, constraints: Constraints) -> Array:
    """Return x = (d, w). Where d is so large that the conic solver fails, d is scaled; then the path is tried."""
    p, k = known.scale.size, known.rank
    failed: ConfigError | ModelError | None = None
    for unit in UNITS:
        sizes = np.where(np.arange(p) < k, unit, 1.0)
        quadratic = np.diag(np.where(np.arange(p) < k, 1.0, max(PULL / unit**2, 1e-8)))
        directions = np.concatenate((known.informed, known.free), axis=1) * sizes
        try:
            found = minimise(quadratic, np.zeros(p), constraints, known.base, directions)
        except (ConfigError, ModelError) as error:
            failed = error
            continue
        broken = constraints.violation(known.theta(found.point * sizes))
        if found.good and broken <= SLACK * constraints.margin:
            return found.point * sizes
        failed = _failure(found, broken)
    quadratic = np.diag(np.where(np.arange(p) < k, 1.0, PULL))
    directions = np.concatenate((known.informed, known.free), axis=1)
    x = descended(quadratic, known.base, directions, constraints, known.scale)
    if x is None or not constraints.violation(known.theta(x)) <= SLACK * constraints.margin:
        raise failed or ModelError("the consistent fit failed: no point inside the constraints was found.")
    return x


def _failure(found: Optimum, broken: float) -> ModelError:
    return ModelError(
        f"the consistent fit failed: the conic solver stopped with {found.status}; its optimality conditions hold to "
        f"{max(found.stationarity, found.gap):.1e} (1e-05 is required), the constraints to {broken:.1e}; check nominal "
        "values and bounds for wrong units, or raise the threshold, the margin, or both."
    )
