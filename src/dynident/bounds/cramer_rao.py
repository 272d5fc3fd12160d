"""The Cramer-Rao bound of eq. (7): the least variance that any unbiased method can reach from positions and torques.

Positions and torques are both measured with white noise; the true torque is free at every sample and linear between
samples; the motion follows from it exactly. What is left for the parameters is their information after the torque and
the initial state have been profiled out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, ModelError
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import rank_of_information

__all__ = ["cramer_rao_bound", "information", "variance"]

Array = NDArray[np.float64]


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
    >>> from dynident.models.gallery import pendulum
    >>> arm, t = pendulum(), np.arange(1001) * 0.01
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> least = np.sqrt(np.diag(dy.cramer_rao_bound(arm, arm.values, motion, sigma_q=1e-4, sigma_tau=0.01)))
    >>> dict(zip(arm.names, least.tolist()))
    {'J': 3.74e-05, 'h': 1.155e-04}
    """
    several = (motions,) if isinstance(motions, Motion) else tuple(motions)
    total = sum(information(model, theta, one, sigma_q, sigma_tau, rest=rest, substeps=substeps) for one in several)
    S = np.asarray(total, dtype=float)
    found = rank_of_information(S)
    if found.groups:
        lone = [model.names[group[0]] for group in found.groups if len(group) == 1]
        if lone:
            raise ModelError(f"{model.name}: these motions do not excite {', '.join(lone)}; no bound exists.")
        tied = ", ".join(model.names[k] for k in found.groups[0])
        raise ModelError(f"{model.name}: these motions determine only combinations of {tied}; no bound exists.")
    return found.inverse


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
        F = P[:n, :n] + R
        V, K = M[:n], np.linalg.solve(F, P[:n]).T
        S += V.T @ np.linalg.solve(F, V)
        if k == len(steps):
            break
        M, P = M - K @ V, P - K @ P[:n]
        M, P = _predict(M, P, steps[k], U, nuisance)
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
        u = (1 - part) * before + part * after
        q, dq = x[:, :n], x[:, n:]
        known = None if memory is None else (1 - part) * memory[:-1] + part * memory[1:]
        ddq = model.forward_dynamics(q, dq, u, theta, known)
        partials = model.partials(q, dq, ddq, theta, known)
        push = -(partials.q @ slopes[:, :n] + partials.dq @ slopes[:, n:])
        push[:, range(n), range(2 * n, 3 * n)] += 1 - part
        push[:, range(n), range(3 * n, 4 * n)] += part
        push[:, :, 4 * n :] -= model.regressor(q, dq, ddq, known)
        turned = np.linalg.solve(partials.ddq, push)
        return np.concatenate([dq, ddq], axis=1), np.concatenate([slopes[:, n:], turned], axis=1)

    for k in range(substeps):
        a = [rate(x, slopes, k / substeps)]
        for size in (0.5, 0.5, 1.0):
            dx, ds = a[-1]
            a.append(rate(x + size * h * dx, slopes + size * h[..., None] * ds, (k + size) / substeps))
        x = x + h / 6 * sum(f * dx for f, (dx, _) in zip((1, 2, 2, 1), a, strict=True))
        slopes = slopes + h[..., None] / 6 * sum(f * ds for f, (_, ds) in zip((1, 2, 2, 1), a, strict=True))
    return slopes
