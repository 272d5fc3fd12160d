"""The Cramer-Rao bound of eq. (7): the least variance that any unbiased method can reach from positions and torques.

Positions and torques are both measured with white noise; the true torque is free at every sample and linear between
samples; the motion follows from it exactly. What is left for the parameters is their information after the torque and
the initial state have been profiled out.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynident.estimators.maximum_likelihood.trajectory import Arrow, add_ahead, add_rows, band_of, places
from dynident.models import Model
from dynident.motion.log import Motion
from dynident.motion.splines import stretches
from dynident.motion.splines.quintic import local_basis
from dynident.regression import EVERYTHING, Selection, fitted_rows, rank_of_information
from dynident.runtime import ConfigError, ModelError, Noun
from dynident.runtime.arrays import Array


def cramer_rao_bound(
    model: Model,
    theta: ArrayLike,
    motions: Motion | Sequence[Motion],
    sigma_q: ArrayLike,
    sigma_tau: ArrayLike,
    *,
    rest: bool = False,
    substeps: int = 4,
) -> Array:
    """Return the least covariance (p, p) of any unbiased estimator, in the parameters' units.

    The arguments are those of ``information``, for one motion or several, whose informations add. Raises ModelError
    where the motions do not determine every parameter, and as ``information`` does.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t = pendulum(), np.arange(1001) * 0.01
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> least = np.sqrt(np.diag(dy.cramer_rao_bound(arm, arm.values, motion, sigma_q=1e-4, sigma_tau=0.01)))
    >>> dict(zip(arm.names, least.tolist()))
    {'J': 3.74e-05, 'h': 1.155e-04}
    """
    all_motions = (motions,) if isinstance(motions, Motion) else tuple(motions)
    total = sum(
        information(model, theta, single_motion, sigma_q, sigma_tau, rest=rest, substeps=substeps)
        for single_motion in all_motions
    )
    S = np.asarray(total, dtype=float)
    rank = rank_of_information(S)
    if rank.groups:
        unexcited = [model.names[group[0]] for group in rank.groups if len(group) == 1]
        if unexcited:
            raise ModelError(f"{model.name}: these motions do not excite {', '.join(unexcited)}; no bound exists.")
        combined = ", ".join(model.names[k] for k in rank.groups[0])
        raise ModelError(f"{model.name}: these motions determine only combinations of {combined}; no bound exists.")
    return rank.inverse


def information(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    sigma_q: ArrayLike,
    sigma_tau: ArrayLike,
    *,
    rest: bool = False,
    substeps: int = 4,
) -> Array:
    """Return the Fisher information (p, p) of theta (p) in one noisy recording of ``motion``.

    ``motion`` is exact, as ``simulate`` returns it; all its samples count. ``sigma_q`` (rad, m) and ``sigma_tau``
    (N m, N) are one number or one per joint. ``rest``: the velocity at the first sample is known to be zero.
    ``substeps`` of a fourth-order Runge-Kutta rule are taken from sample to sample. Raises ConfigError for a deviation
    that is not positive, and ModelError where the model fails. What a model remembers counts as known.
    """
    n, p = len(model.joints), len(model.parameters)
    R, U = (np.diag(variance(*pair, n)) for pair in (("sigma_q", sigma_q), ("sigma_tau", sigma_tau)))
    steps = _transitions(model, np.asarray(theta, dtype=float), motion, substeps)
    nuisance = n if rest else 2 * n
    # A Kalman filter of (q, dq, u): the measured torque drives it with known noise, the positions are its measurements,
    # and M is how its state depends on the initial state and theta. Its innovations are independent.
    M = np.eye(3 * n, nuisance + p)
    M[:, nuisance:] = 0.0
    P = np.zeros((3 * n, 3 * n))
    P[2 * n :, 2 * n :] = U
    S = np.zeros((nuisance + p, nuisance + p))
    for k in range(len(motion)):
        # covariance F of the innovation, its derivatives V, and the gain K
        F = P[:n, :n] + R
        V, K = M[:n], np.linalg.solve(F, P[:n]).T
        S += V.T @ np.linalg.solve(F, V)
        if k == len(steps):
            break
        M, P = M - K @ V, P - K @ P[:n]
        M, P = _predict(M, P, steps[k], U, nuisance)
    # the Schur complement profiles the initial state out
    cross = S[:nuisance, nuisance:]
    S = S[nuisance:, nuisance:] - cross.T @ np.linalg.solve(S[:nuisance, :nuisance], cross)
    return np.asarray((S + S.T) / 2)


def variance(name: str, sigma: ArrayLike, n: int) -> Array:
    """Return the variances (n) of a standard deviation, one or one per joint; ConfigError unless all are positive."""
    value = np.asarray(sigma, dtype=float)
    if value.shape not in ((), (n,)) or not ((value > 0) & np.isfinite(value)).all():
        raise ConfigError(f"{name} is {value.tolist()}; give one positive number, or one for each of {n} joints.")
    return np.broadcast_to(value**2, (n,))


def _predict(M: Array, P: Array, step: Array, U: Array, nuisance: int) -> tuple[Array, Array]:
    """Carry sensitivities and covariance of (q, dq, u) over one sample, to the next torque."""
    n = len(U)
    now, following, by_theta = step[:, : 3 * n], step[:, 3 * n : 4 * n], step[:, 4 * n :]
    sensitivity, covariance = np.zeros_like(M), np.empty_like(P)
    sensitivity[: 2 * n] = now @ M
    sensitivity[: 2 * n, nuisance:] += by_theta
    # the torque at the next sample is measured anew, with its own noise
    drive = following @ U
    covariance[: 2 * n, : 2 * n] = now @ P @ now.T + drive @ following.T
    covariance[: 2 * n, 2 * n :] = drive
    covariance[2 * n :, : 2 * n] = drive.T
    covariance[2 * n :, 2 * n :] = U
    return sensitivity, (covariance + covariance.T) / 2


def _transitions(model: Model, theta: Array, motion: Motion, substeps: int) -> Array:
    """Return the derivatives (N - 1, 2 n, 4 n + p) of the next state by (q, dq), this torque, the next, and theta."""
    n, p = len(model.joints), len(theta)
    x = np.concatenate([motion.q, motion.dq], axis=1)[:-1]
    span = np.diff(motion.t)[:, None]
    h = span / substeps
    before, after = motion.tau[:-1], motion.tau[1:]
    memory = model.remembering(motion).memory
    slopes = np.zeros((len(x), 2 * n, 4 * n + p))
    slopes[:, range(2 * n), range(2 * n)] = 1.0

    def rate(x: Array, slopes: Array, part: float) -> tuple[Array, Array]:
        """Return the rates of the state and of its derivatives, ``part`` of the way between two samples."""
        # the torque is linear between samples
        u = (1 - part) * before + part * after
        q, dq = x[:, :n], x[:, n:]
        memory_there = None if memory is None else (1 - part) * memory[:-1] + part * memory[1:]
        ddq = model.forward_dynamics(q, dq, u, theta, memory_there)
        partials = model.partials(q, dq, ddq, theta, memory_there)
        # implicit differentiation of tau(q, dq, ddq; theta) = u gives the derivatives of ddq
        push = -(partials.q @ slopes[:, :n] + partials.dq @ slopes[:, n:])
        push[:, range(n), range(2 * n, 3 * n)] += 1 - part
        push[:, range(n), range(3 * n, 4 * n)] += part
        push[:, :, 4 * n :] -= model.regressor(q, dq, ddq, memory_there)
        ddq_slopes = np.linalg.solve(partials.ddq, push)
        return np.concatenate([dq, ddq], axis=1), np.concatenate([slopes[:, n:], ddq_slopes], axis=1)

    # Runge-Kutta of fourth order, for the state together with its derivatives
    for k in range(substeps):
        a = [rate(x, slopes, k / substeps)]
        for size in (0.5, 0.5, 1.0):
            dx, ds = a[-1]
            a.append(rate(x + size * h * dx, slopes + size * h[..., None] * ds, (k + size) / substeps))
        x = x + h / 6 * sum(f * dx for f, (dx, _) in zip((1, 2, 2, 1), a, strict=True))
        slopes = slopes + h[..., None] / 6 * sum(f * ds for f, (_, ds) in zip((1, 2, 2, 1), a, strict=True))
    return slopes


CHUNK_SIZE = 2048  # samples whose products are held at once
MIN_SAMPLES = 8  # least number of samples of an uninterrupted stretch


class NormalMatrix(Noun):
    """The normal matrix of one uninterrupted recording of N samples: m = (N + 2) n coefficients, r parameters.

    ``position`` and ``torque`` (3 n, m) are the lower bands of the information of the two measurements on the
    coefficients, ``border`` (m, r) and ``corner`` (r, r) that of the torques on the parameters.
    """

    position: Array
    torque: Array
    border: Array
    corner: Array

    def information(self, finer_q: float = 1.0, finer_tau: float = 1.0) -> Array:
        """Return the information (r, r) of the parameters, with sigma_q and sigma_tau divided by these factors."""
        a, b = finer_q**2, finer_tau**2
        arrow = Arrow(a * self.position + b * self.torque, b * self.border)
        return np.asarray(b * self.corner - arrow.lost_information)


def normal_matrices(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    sigma_q: ArrayLike,
    sigma_tau: ArrayLike,
    columns: Sequence[int] | None = None,
    selection: Selection = EVERYTHING,
) -> Iterator[NormalMatrix]:
    """Yield the normal matrix of each uninterrupted stretch of usable samples of ``motion``, about theta (p).

    ``sigma_q`` (rad, m) and ``sigma_tau`` (N m, N) are one number or one per joint. ``columns`` (r) of the regressor
    are the parameters, for example those that lead base parameters; None takes all. Torques of a joint slower than
    the minimum speed are not used. Raises ConfigError for a deviation that is not positive, and ModelError where the
    model fails.
    """
    n = len(model.joints)
    precision = [1.0 / variance(*pair, n) for pair in (("sigma_q", sigma_q), ("sigma_tau", sigma_tau))]
    selected = list(range(len(model.parameters)) if columns is None else columns)
    linearisation = _LocalModel(
        model, np.asarray(theta, dtype=float), motion, precision[0], precision[1], selected, selection
    )
    for part in stretches(motion.mask):
        if part.stop - part.start >= MIN_SAMPLES:
            yield _build_matrix(linearisation, part)


@dataclass(frozen=True, eq=False)
class _LocalModel:
    """A model about theta (p) and a motion, the precision (n) of positions and torques, and the columns that count."""

    model: Model
    theta: Array
    motion: Motion
    position: Array
    torque: Array
    columns: list[int]
    selection: Selection

    def rows(self, at: slice, local: Array) -> tuple[Array, Array, Array]:
        """Return the torque's derivatives by coefficients (k, n, 3 n) and parameters (k, n, r), and weights (k, n).

        ``local`` (3, k, 3) are the splines and their derivatives at the samples.
        """
        states = self.motion.states(at)
        Y, slopes = self.model.regressor(**states)[:, :, self.columns], self.model.partials(**states, theta=self.theta)
        # chain rule from coefficients by q, dq and ddq to the torque; three splines act on each sample
        k, n = states["q"].shape
        J = sum(
            np.einsum("ka,kij->kiaj", V, by).reshape(k, n, 3 * n)
            for V, by in zip(local, (slopes.q, slopes.dq, slopes.ddq), strict=True)
        )
        keep = fitted_rows(self.motion, self.selection.min_speed, at)
        return np.asarray(J), Y, np.broadcast_to(self.torque, (k, n)) * (1.0 if keep is None else keep)


def _build_matrix(linearisation: _LocalModel, part: slice) -> NormalMatrix:
    n, r, rows = len(linearisation.model.joints), len(linearisation.columns), part.stop - part.start
    w, m = 3 * n, rows + 2
    local = _cubic(linearisation.motion.t[part])
    position, torque, border, corner = (np.zeros(size) for size in ((m, n, w), (m, n, w), (m, n, r), (r, r)))
    # chunks of samples bound the memory of the products
    for start in range(0, rows, CHUNK_SIZE):
        chunk = slice(start, min(start + CHUNK_SIZE, rows))
        k, V = chunk.stop - chunk.start, local[0, chunk]
        J, Y, weight = linearisation.rows(slice(part.start + chunk.start, part.start + chunk.stop), local[:, chunk])
        # products with the weights once, for the torques' share of all three blocks
        pull = (J * weight[:, :, None]).swapaxes(1, 2)  # (k, w, n)
        position_part = np.einsum("ka,kb,ij->kaibj", V, V, np.diag(linearisation.position))
        at = places(np.arange(chunk.start, chunk.stop), 3)
        add_ahead(torque, (pull @ J).reshape(k, 3, n, w), at)
        add_ahead(position, position_part.reshape(k, 3, n, w), at)
        add_rows(border, (pull @ Y).reshape(k, 3, n, r), at)
        corner += (Y * weight[:, :, None]).reshape(-1, r).T @ Y.reshape(-1, r)
    return NormalMatrix(band_of(position), band_of(torque), border.reshape(m * n, r), corner)


def _cubic(t: Array) -> Array:
    """Return values, first and second derivatives (3, N, 3) at the knots t (N) of the three cubic B-splines there."""
    h = np.diff(t)
    # the knots beyond the ends continue the spacing there
    before, after = t[0] - np.cumsum(h[:2])[::-1], t[-1] + np.cumsum(h[:-4:-1])
    # the fourth spline begins at the knot: it and its derivatives are zero there
    return local_basis(np.concatenate([before, t, after]), 3, np.arange(len(t)) + 2, t)[:, :, :3]
