"""Optimality criteria of a motion, with their exact derivatives by the motion.

Along samples i of a motion the torque holds the information M = sum_i Y_i' W Y_i + P on the base parameters, with Y_i
the independent columns of the regressor, W the samples divided by the variance and P the prior information. A function
f of M changes by df = <F, dM> = 2 sum_i <W Y_i F, dY_i>, F = df / dM. This is a weighted sum of the regressor, of which
``Model.weighted_gradient`` returns the derivatives without forming those of the regressor. The criteria are those of
optimal design (Pukelsheim 2006, "Optimal design of experiments", ch. 6).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from enum import StrEnum
from functools import cached_property

import numpy as np
from scipy.linalg import cho_solve, cholesky
from scipy.special import logsumexp, softmax

from dynident.models import Model
from dynident.regression import BaseParameters
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

INFORMATION_FLOOR = 1e-12  # of the information of random states: so much counts as known of each parameter
SCALE_SAMPLES = 300  # of these states
NORM_ORDER = 16.0  # order of the norms in place of the largest and the smallest eigenvalue
MAX_ASYMMETRY = 1e-8  # of the largest information: less is rounding


class Criterion(StrEnum):
    """Criterion that is optimised.

    The volume of the confidence region (D); the sum of relative variances of named parameters, or of all in
    units of what random states show (A); or the condition number.
    """

    D_OPTIMAL = "d"
    A_OPTIMAL = "a"
    CONDITION = "condition"


class InformationCriterion(Noun):
    """Criterion to minimise along a motion of ``model``, from its r independent ``columns`` (``BaseParameters``).

    ``weights``, (n) or (N, n), are the samples that each point stands for, divided by the variance of a joint's torque.
    ``prior`` (r, r) is information on the base parameters, in SI units, that is added. The value depends on ``kind``:

    * D: -log det of the information, in units of the size of each column at random states of the arm;
    * A: log of the sum of the variances of ``named`` (k, r) @ (base parameters), each row divided by the size
      that its standard error is compared with; None: all base parameters, in units of what random states show;
    * condition: log of the condition number of the weighted regressor with columns of length one, in norms of
      order 16 of the eigenvalues, which are differentiable and exceed it by at most 2 log(r) / 32.

    Where neither a motion nor the prior shows a parameter, 1e-12 of the information of as many random states
    stands in: the value stays finite and differentiable, and far from that of any motion that shows all. The
    derivatives are exact except at jumps of dry friction with the sign of a velocity: give such terms a
    smooth sign (``Term.with_smooth_sign``).
    """

    model: Model
    columns: tuple[int, ...]
    weights: Array
    kind: Criterion = Criterion.D_OPTIMAL
    prior: Array | None = None
    named: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "columns", tuple(int(k) for k in self.columns))

    def value_and_gradients(self, q: Array, dq: Array, ddq: Array) -> tuple[float, Array]:
        """Return the value along a motion (N, n), and its derivatives (3, N, n) by q, dq and ddq."""
        X = self._weighted_regressor(q, dq, ddq)
        value, F = CRITERION_FUNCTIONS[self.kind](self._information(X), self._scaled_rows)
        # chain rule: with F the derivative by the scaled information, the regressor has the weights 2 W Y F; columns
        # that are not independent have none
        full_gradient = np.zeros((len(F), len(self.model.parameters)))
        full_gradient[:, self.columns] = 2 * F / self.scale
        weights = (X @ full_gradient).reshape(*q.shape, -1) * self._root_weights
        return value, self.model.weighted_gradient(q, dq, ddq, weights)

    def value(self, q: Array, dq: Array, ddq: Array) -> float:
        """Return the value along a motion (N, n)."""
        return CRITERION_FUNCTIONS[self.kind](
            self._information(self._weighted_regressor(q, dq, ddq)), self._scaled_rows
        )[0]

    @cached_property
    def scale(self) -> Array:
        """Size (r) of each weighted column at random states of the arm; one where it is zero."""
        Y = self.model.regressor(**self.model.random_states(np.random.default_rng(0), SCALE_SAMPLES))[
            :, :, self.columns
        ]
        weights = np.atleast_2d(self.weights).mean(axis=0)
        size = np.sqrt(weights @ np.square(Y).mean(axis=0))
        return np.where(size > 0, size, 1.0)

    @cached_property
    def _scaled_rows(self) -> Array:
        """Rows of the A criterion for parameters in units of 1 / scale."""
        return np.eye(len(self.columns)) if self.named is None else self.named / self.scale

    @cached_property
    def _root_weights(self) -> Array:
        """Square roots of the weights, (n, 1) or (N, n, 1)."""
        return np.asarray(np.sqrt(np.asarray(self.weights, dtype=float))[..., None])

    def _weighted_regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the weighted regressor (N n, r) with scaled columns."""
        Y = self.model.regressor(q, dq, ddq)[:, :, self.columns]
        return np.asarray(Y * (self._root_weights / self.scale)).reshape(-1, len(self.columns))

    def _information(self, X: Array) -> Array:
        """Return the information (r, r), with the prior and the floor for parameters that are not shown."""
        samples = len(X) / len(self.model.joints)
        # the floor keeps the information invertible, and the criterion differentiable, where a motion shows nothing of
        # a parameter
        out = X.T @ X + INFORMATION_FLOOR * max(samples, 1.0) * np.eye(len(self.columns))
        return out if self.prior is None else out + self.prior / np.outer(self.scale, self.scale)


def base_information(basis: BaseParameters, information: Array) -> Array:
    """Convert prior information (p, p) on the standard parameters to information (r, r) on the base parameters.

    Information on directions that do not act on the torque is used where it ties them to others.
    """
    independent = list(basis.independent)
    # eliminate the null directions by a Schur complement: they do not act on the torque, but the prior may tie them to
    # others
    free = basis.null_directions / np.linalg.norm(basis.scale[:, None] * basis.null_directions, axis=0)
    eigenvalues, vectors = np.linalg.eigh(free.T @ information @ free)
    # below this, an eigenvalue is rounding: dividing by it would spoil the complement
    is_informative = eigenvalues > MAX_ASYMMETRY * (np.diag(information) / np.square(basis.scale)).max(
        initial=0.0
    )  # less is rounding
    cross = (information @ free @ vectors[:, is_informative])[independent]
    out = information[np.ix_(independent, independent)] - (cross / eigenvalues[is_informative]) @ cross.T
    return np.asarray((out + out.T) / 2)


def _log_det(M: Array, rows: Array) -> tuple[float, Array]:  # noqa: ARG001
    """Return -log det M and its derivative by M."""
    L = cholesky(M, lower=True, check_finite=False)
    return -2 * float(np.log(np.diag(L)).sum()), -cho_solve((L, True), np.eye(len(M)), check_finite=False)


def _variance(M: Array, rows: Array) -> tuple[float, Array]:
    """Return the log of tr(C M^-1 C') for the rows C (k, r), and its derivative by M."""
    inverse_rows = cho_solve((cholesky(M, lower=True, check_finite=False), True), rows.T, check_finite=False)
    trace = float((rows.T * inverse_rows).sum())
    return float(np.log(trace)), -inverse_rows @ inverse_rows.T / trace


def _condition(M: Array, rows: Array) -> tuple[float, Array]:  # noqa: ARG001
    """Return half the log of the condition number of M scaled to a unit diagonal, and its derivative by M."""
    scale = np.sqrt(np.diag(M))
    # norms of a high order stand for the extreme eigenvalues, which have no derivative where two are equal
    values, vectors = np.linalg.eigh(M / np.outer(scale, scale))
    logs = NORM_ORDER * np.log(np.maximum(values, INFORMATION_FLOOR * INFORMATION_FLOOR))
    value = float(logsumexp(logs) + logsumexp(-logs)) / (2 * NORM_ORDER)
    weights = (softmax(logs) - softmax(-logs)) / 2
    F = (vectors * (weights / np.exp(logs / NORM_ORDER))) @ vectors.T
    # the unit diagonal depends on M, too: subtract its part of the derivative
    F[np.diag_indices(len(F))] -= np.square(vectors) @ weights
    return value, F / np.outer(scale, scale)


CRITERION_FUNCTIONS: Mapping[Criterion, Callable[[Array, Array], tuple[float, Array]]] = {
    Criterion.D_OPTIMAL: _log_det,
    Criterion.A_OPTIMAL: _variance,
    Criterion.CONDITION: _condition,
}
