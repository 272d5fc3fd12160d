"""What a motion tells as one number, with its exact derivatives by the motion.

Along samples i of a motion the torque has the information M = sum_i Y_i' W Y_i + P on the base parameters, with Y_i the
regressor's independent columns, W the samples by variance and P what is known before. A function f of M changes by
df = <F, dM> = 2 sum_i <W Y_i F, dY_i>, F = df / dM: a weighted sum of the regressor, of which
``Model.weighted_gradient`` gives the derivatives without forming those of the regressor. The criteria are those of
optimal design (Pukelsheim 2006, "Optimal design of experiments", ch. 6).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve, cholesky
from scipy.special import logsumexp, softmax

from dynident.errors import ModelError, brief
from dynident.excitation.request import Criterion
from dynident.regression import BaseParameters

if TYPE_CHECKING:
    from dynident.models import Model

__all__ = ["InformationCriterion", "base_information"]

Array = NDArray[np.float64]
FLOOR = 1e-12  # of the information of random states: so much counts as known of each parameter
SAMPLES = 300  # of these states
SHARP = 16.0  # order of the norms in place of the largest and the smallest eigenvalue
DOUBT = 1e-8  # of the information's largest entry: a smaller asymmetry or negative eigenvalue is rounding


@dataclass(frozen=True, eq=False)
class InformationCriterion:
    """What is to be small along a motion of ``model`` of which r ``columns`` are independent (``BaseParameters``).

    ``weights``, (n) or (N, n), are the samples that each point stands for divided by the variance of a joint's torque;
    ``prior`` (r, r) is information on the base parameters, in their SI units, that is added. The value is, by ``kind``,

    * D: -log det of the information, in units of each column's size at random states of the arm;
    * A: log of the sum of the variances of ``named`` (k, r) @ (base parameters), a row divided by the size that a
      standard error is to be compared with; None: of all base parameters, in units of what random states show;
    * condition: log of the condition number of the weighted regressor with columns of length one, in norms of order 16
      of the eigenvalues, which have derivatives everywhere and exceed it by at most 2 log(r) / 32.

    Where a motion and the prior show nothing of a parameter, 1e-12 of the information of as many random states stands
    in: the value is finite, far from that of any motion that shows all, and has derivatives. Those are exact, but for
    jumps of dry friction with the sign of a velocity: give these a smooth sign (``HasSign``).
    Raises ModelError for a model with terms that remember, and where a shape does not fit.
    """

    model: Model
    columns: tuple[int, ...]
    weights: Array
    kind: Criterion = Criterion.D_OPTIMAL
    prior: Array | None = None
    named: Array | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(int(k) for k in self.columns))
        n, p, r = len(self.model.joints), len(self.model.parameters), len(self.columns)
        if self.model.memory:
            raise ModelError(
                f"{self.model.name}: terms that remember the motion have no information by samples: leave them out."
            )
        if not r or not 0 <= min(self.columns) <= max(self.columns) < p:
            raise ModelError(f"{self.model.name}: columns are {self.columns}, expected some below {p}.")
        weights = np.asarray(self.weights, dtype=float)
        if weights.ndim not in (1, 2) or weights.shape[-1] != n or not (np.isfinite(weights) & (weights >= 0)).all():
            raise ModelError(f"{self.model.name}: weights are {weights}, expected {n} numbers that are not negative.")
        if self.prior is not None and np.shape(self.prior) != (r, r):
            raise ModelError(f"{self.model.name}: prior has shape {np.shape(self.prior)}, expected ({r}, {r}).")
        if self.named is not None and (np.ndim(self.named) != 2 or np.shape(self.named)[1] != r):
            raise ModelError(f"{self.model.name}: named has shape {np.shape(self.named)}, expected (k, {r}).")

    def value_and_slopes(self, q: Array, dq: Array, ddq: Array) -> tuple[float, Array]:
        """Return the value along a motion (N, n), and its derivatives (3, N, n) by q, dq and ddq."""
        X = self._rows(q, dq, ddq)
        value, F = VALUES[self.kind](self._total(X), self._named)
        wide = np.zeros((len(F), len(self.model.parameters)))
        wide[:, self.columns] = 2 * F / self.scale
        weights = (X @ wide).reshape(*q.shape, -1) * self._root
        return value, self.model.weighted_gradient(q, dq, ddq, weights)

    def value(self, q: Array, dq: Array, ddq: Array) -> float:
        """Return the value along a motion (N, n)."""
        return VALUES[self.kind](self._total(self._rows(q, dq, ddq)), self._named)[0]

    @cached_property
    def scale(self) -> Array:
        """The size (r) of each weighted column at a random state of the arm; one where it is zero."""
        Y = self.model.regressor(**self.model.random_states(np.random.default_rng(0), SAMPLES))[:, :, self.columns]
        weights = np.atleast_2d(self.weights).mean(axis=0)
        size = np.sqrt(weights @ np.square(Y).mean(axis=0))
        return np.where(size > 0, size, 1.0)

    @cached_property
    def _named(self) -> Array:
        """The rows of the A criterion for parameters in units of 1 / scale."""
        return np.eye(len(self.columns)) if self.named is None else self.named / self.scale

    @cached_property
    def _root(self) -> Array:
        """The roots of the weights, (n, 1) or (N, n, 1)."""
        return np.asarray(np.sqrt(np.asarray(self.weights, dtype=float))[..., None])

    def _rows(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the weighted rows (N n, r) of scaled columns."""
        Y = self.model.regressor(q, dq, ddq)[:, :, self.columns]
        return np.asarray(Y * (self._root / self.scale)).reshape(-1, len(self.columns))

    def _total(self, X: Array) -> Array:
        """Return the information (r, r) with what is known before and what stands in for parameters not shown."""
        samples = len(X) / len(self.model.joints)
        out = X.T @ X + FLOOR * max(samples, 1.0) * np.eye(len(self.columns))
        return out if self.prior is None else out + self.prior / np.outer(self.scale, self.scale)


def base_information(basis: BaseParameters, information: Array) -> Array:
    """Return the information (r, r) on the base parameters that information (p, p) on the standard ones holds.

    What it says of directions without effect on the torque is of use where it ties these to others. Raises ModelError
    where it is no symmetric matrix (p, p) without negative eigenvalues.
    """
    p, kept = len(basis.names), list(basis.independent)
    information = np.asarray(information, dtype=float)
    if information.shape != (p, p) or not np.isfinite(information).all():
        raise ModelError(f"prior information has shape {information.shape}, expected finite numbers ({p}, {p}).")
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    scaled = information / np.outer(*[np.where(size > 0, size, 1.0)] * 2)
    if np.abs(scaled - scaled.T).max(initial=0.0) > DOUBT or np.linalg.eigvalsh(scaled).min(initial=0.0) < -DOUBT * p:
        raise ModelError("prior information is not symmetric, or has negative eigenvalues; give a covariance inverse.")
    free = basis.null / np.linalg.norm(basis.scale[:, None] * basis.null, axis=0)
    known, vectors = np.linalg.eigh(free.T @ information @ free)
    held = known > DOUBT * (np.diag(information) / np.square(basis.scale)).max(initial=0.0)  # less is rounding
    cross = (information @ free @ vectors[:, held])[kept]
    out = information[np.ix_(kept, kept)] - (cross / known[held]) @ cross.T
    return np.asarray((out + out.T) / 2)


def _log_det(M: Array, named: Array) -> tuple[float, Array]:  # noqa: ARG001
    """Return -log det M and its derivative by M."""
    L = cholesky(M, lower=True, check_finite=False)
    return -2 * float(np.log(np.diag(L)).sum()), -cho_solve((L, True), np.eye(len(M)), check_finite=False)


def _variance(M: Array, named: Array) -> tuple[float, Array]:
    """Return the log of tr(C M^-1 C') for rows C (k, r), and its derivative by M."""
    spread = cho_solve((cholesky(M, lower=True, check_finite=False), True), named.T, check_finite=False)
    total = float((named.T * spread).sum())
    return float(np.log(total)), -spread @ spread.T / total


def _condition(M: Array, named: Array) -> tuple[float, Array]:  # noqa: ARG001
    """Return half of the log of the condition number of M with a unit diagonal, and its derivative by M."""
    size = np.sqrt(np.diag(M))
    values, vectors = np.linalg.eigh(M / np.outer(size, size))
    logs = SHARP * np.log(np.maximum(values, FLOOR * FLOOR))
    value = float(logsumexp(logs) + logsumexp(-logs)) / (2 * SHARP)
    shares = (softmax(logs) - softmax(-logs)) / 2
    F = (vectors * (shares / np.exp(logs / SHARP))) @ vectors.T
    F[np.diag_indices(len(F))] -= np.square(vectors) @ shares
    return value, F / np.outer(size, size)


VALUES: Mapping[Criterion, Callable[[Array, Array], tuple[float, Array]]] = {
    Criterion.D_OPTIMAL: _log_det,
    Criterion.A_OPTIMAL: _variance,
    Criterion.CONDITION: _condition,
}
