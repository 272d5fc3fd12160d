"""Conic programs over robot parameters: solved with Clarabel; the optimality conditions are checked afterwards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dynident.estimators.physical_constraints import Constraints, Limit, PsdConstraint
from dynident.runtime import ConfigError, ModelError, Noun
from dynident.runtime.arrays import Array

MAX_OPTIMALITY_ERROR = 1e-5


class Optimum(Noun):
    """A solved program: the ``point`` (v) and the solver's own ``status``.

    ``stationarity`` and ``gap`` are the errors of the optimality conditions, relative to the size of their terms.
    """

    point: Array
    status: str
    stationarity: float
    gap: float

    @property
    def is_optimal(self) -> bool:
        """Whether the optimality conditions hold, whatever the solver's status."""
        return self.stationarity < MAX_OPTIMALITY_ERROR and self.gap < MAX_OPTIMALITY_ERROR


def minimise(
    quadratic: Array,
    linear: Array,
    constraints: Constraints,
    origin: Array,
    directions: Array,
) -> Optimum:
    """Minimise x' quadratic x / 2 + linear' x over x (v), with theta = origin (p) + directions (p, v) x constrained.

    Raises ConfigError that names the constraints which contradict each other, and ModelError where the solver returns
    no finite solution.
    """
    program = _ConicProgram(len(linear))
    for limit in constraints.limits:
        _add_limit(program, limit, origin, directions)
    for constraint in constraints.psd_constraints(origin, directions):
        _add_matrices(program, constraint)
    return program.solve(quadratic, linear)


def nearest_feasible(theta: Array, hessian: Array, matrices: Sequence[Array], slack: Sequence[float]) -> Array:
    """Return the point (p) nearest to theta in the quadratic form ``hessian`` at which all matrices are positive.

    ``matrices`` (K, s, s, p) times the point must have eigenvalues of at least their ``slack``. Raises ModelError
    where there is no such point, or the solver finds none.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.diag(hessian), 1e-12 * np.diag(hessian).max()))
    # where the form is almost singular, scale by the matrices: else rounding decides whether the solver succeeds
    reach = np.sqrt(sum((slopes.reshape(-1, len(theta)) ** 2).sum(axis=0) for slopes in matrices)) * scale
    unit = scale / np.maximum(reach, 1.0)
    program = _ConicProgram(len(theta))
    for slopes, min_eigenvalue in zip(matrices, slack, strict=True):
        offset = np.broadcast_to(-min_eigenvalue * np.eye(slopes.shape[1]), slopes.shape[:-1])
        _add_matrices(program, PsdConstraint(slopes, None, offset, "a positive inertia").restrict(theta, np.diag(unit)))
    scaled_hessian = hessian * np.outer(unit, unit) + 1e-9 * np.diag((unit / scale) ** 2)
    try:
        point = program.solve(scaled_hessian, np.zeros(len(theta))).point
    except ConfigError as error:
        raise ModelError(f"no parameters are physical: {error}") from error
    return np.asarray(theta + unit * point)


@dataclass(eq=False)
class _ConicProgram:
    """The constraints b - A x in K, gathered block by block."""

    size: int
    cones: list[tuple[str, int]] = field(default_factory=list)
    A: list[Array] = field(default_factory=list)
    b: list[Array] = field(default_factory=list)
    labels: list[tuple[str, ...]] = field(default_factory=list)

    def add(self, cone: str, order: int, A: Array, b: Array, labels: tuple[str, ...]) -> None:
        """Add a block of rows; one label for each row, or for the whole block."""
        if len(b):
            self.cones.append((cone, order))
            self.A.append(A)
            self.b.append(b)
            self.labels.append(labels)

    def solve(self, hessian: Array, cost: Array) -> Optimum:
        """Run Clarabel and check its solution."""
        import clarabel  # type: ignore[import-untyped, unused-ignore]
        from scipy.sparse import csc_matrix

        settings = clarabel.DefaultSettings()
        settings.verbose, settings.max_threads, settings.chordal_decomposition_enable = False, 1, False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
        A = np.concatenate(self.A) if self.A else np.zeros((0, self.size))
        b = np.concatenate(self.b) if self.b else np.zeros(0)
        cones = [getattr(clarabel, name)(order) for name, order in self.cones]
        # Clarabel wants the upper triangle of the Hessian only
        upper = csc_matrix(np.triu(hessian))
        solution = clarabel.DefaultSolver(upper, cost, csc_matrix(A), b, cones, settings).solve()
        return self._check_solution(solution, hessian, cost, A, b)

    def _check_solution(self, solution: Any, hessian: Array, cost: Array, A: Array, b: Array) -> Optimum:
        import clarabel  # type: ignore[import-untyped, unused-ignore]

        x, z, statuses = np.array(solution.x), np.array(solution.z), clarabel.SolverStatus
        if solution.status in (statuses.PrimalInfeasible, statuses.AlmostPrimalInfeasible):
            raise ConfigError(
                f"these constraints contradict each other: {'; '.join(self._conflicting_labels(z))}. "
                "Relax or drop one of them."
            )
        if not (np.isfinite(x).all() and np.isfinite(z).all()):
            raise ModelError(
                f"the conic solver failed ({solution.status}); check the nominal values and bounds for wrong units, or "
                "raise the margin or the threshold of the estimator."
            )
        # check the optimality conditions here: the solver's status is not reliable for badly scaled programs
        gradient = hessian @ x
        multipliers = A.T @ z
        size = max(1.0, *(float(np.abs(term).max(initial=0.0)) for term in (gradient, cost, multipliers)))
        stationarity = float(np.abs(gradient + cost + multipliers).max(initial=0.0)) / size
        primal, dual = 0.5 * x @ gradient + cost @ x, -0.5 * x @ gradient - b @ z
        gap = float(abs(primal - dual)) / max(1.0, abs(float(primal)), abs(float(dual)))
        return Optimum(x, str(solution.status), stationarity, gap)

    def _conflicting_labels(self, z: Array) -> list[str]:
        """Return the names of the constraints with a multiplier in the solver's certificate of infeasibility."""
        blocks = np.split(z, np.cumsum([len(b) for b in self.b])[:-1])
        multipliers: dict[str, float] = {}
        for labels, block in zip(self.labels, blocks, strict=True):
            sizes = np.abs(block) if len(labels) == len(block) else [np.linalg.norm(block)]
            for label, size in zip(labels, map(float, sizes), strict=True):
                multipliers[label] = max(size, multipliers.get(label, 0.0))
        largest = max(multipliers.values())
        return [label for label, size in multipliers.items() if size > 1e-3 * largest]


def _add_limit(program: _ConicProgram, limit: Limit, origin: Array, directions: Array) -> None:
    slope, value = limit.rows @ directions, limit.rows @ origin
    # equal bounds become one equality: two opposite inequalities would leave the program without an interior
    equal = limit.lower == limit.upper
    parts = (
        ("ZeroConeT", equal, 1.0, limit.lower),
        ("NonnegativeConeT", np.isfinite(limit.lower) & ~equal, -1.0, limit.lower),
        ("NonnegativeConeT", np.isfinite(limit.upper) & ~equal, 1.0, limit.upper),
    )
    for cone, rows, sign, side in parts:
        labels = tuple(label for label, row in zip(limit.labels, rows, strict=True) if row)
        program.add(cone, int(rows.sum()), sign * slope[rows], sign * (side - value)[rows], labels)


def _add_matrices(program: _ConicProgram, constraint: PsdConstraint) -> None:
    for offset, slopes in zip(constraint.constant, constraint.slopes, strict=True):
        A, b = -_pack_triangle(np.moveaxis(slopes, -1, 0)).T, _pack_triangle(offset)
        program.add("PSDTriangleConeT", len(offset), A, b, (constraint.label,))


def _pack_triangle(matrices: Array) -> Array:
    """Return the upper triangle of symmetric matrices (..., n, n), column by column, whose dot products are traces."""
    # off-diagonal entries are scaled by sqrt(2), so that dot products of triangles are traces of products
    rows, columns = np.tril_indices(matrices.shape[-1])
    return np.asarray(matrices[..., rows, columns] * np.where(rows == columns, 1.0, np.sqrt(2.0)))
