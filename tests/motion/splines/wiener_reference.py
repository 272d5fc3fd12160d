"""Integrated Wiener processes in dense algebra: independent of all banded systems."""

from __future__ import annotations

from math import factorial

import numpy as np


def covariance(s: np.ndarray, t: np.ndarray, order: int, a: int, b: int) -> np.ndarray:
    """That of derivatives a at s and b at t, for intensity one and a start at zero; a = order is the white noise."""
    s, t = np.meshgrid(s, t, indexing="ij")
    if a == order:
        return np.where(t > s, (t - s) ** (order - 1 - b) / factorial(order - 1 - b), 0.0)
    x, w = np.polynomial.legendre.leggauss(4)  # exact: the integrand is a polynomial of degree 4 at most
    end = np.minimum(s, t)
    u = 0.5 * end[..., None] * (1 + x)
    left = (s[..., None] - u) ** (order - 1 - a) / factorial(order - 1 - a)
    right = (t[..., None] - u) ** (order - 1 - b) / factorial(order - 1 - b)
    return 0.5 * end * (left * right * w).sum(axis=-1)


def dense(t: np.ndarray, y: np.ndarray, order: int, r: float, q: float) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Posterior mean of q, dq, ddq at the samples for a diffuse start, and variance of those that have one."""
    t = t - t[0]
    K = q * covariance(t, t, order, 0, 0) + r * np.eye(len(t))
    X = [np.vander(t, order, increasing=True)]
    for a in (1, 2):
        X.append(np.column_stack([_derived(t, k, a) for k in range(order)]))
    inverse = np.linalg.inv(K)
    gram = np.linalg.inv(X[0].T @ inverse @ X[0])
    beta = gram @ X[0].T @ inverse @ y
    means, variances = [], []
    for a in range(3):
        cross = q * covariance(t, t, order, a, 0)
        means.append(X[a] @ beta + cross @ inverse @ (y - X[0] @ beta))
        if a < order:
            open_ = X[a] - cross @ inverse @ X[0]
            spread = q * covariance(t, t, order, a, a) - cross @ inverse @ cross.T + open_ @ gram @ open_.T
            variances.append(np.diag(spread))
    return means, variances


def _derived(t: np.ndarray, power: int, a: int) -> np.ndarray:
    return np.zeros_like(t) if power < a else factorial(power) / factorial(power - a) * t ** (power - a)


def likelihood(t: np.ndarray, y: np.ndarray, order: int, r: float, q: float) -> float:
    """The log-likelihood for a diffuse start, up to a constant of the times: the restricted one."""
    t = t - t[0]
    inverse = np.linalg.inv(q * covariance(t, t, order, 0, 0) + r * np.eye(len(t)))
    X = np.vander(t, order, increasing=True)
    gram = X.T @ inverse @ X
    left = y - X @ np.linalg.solve(gram, X.T @ inverse @ y)
    return 0.5 * float(np.linalg.slogdet(inverse)[1] - np.linalg.slogdet(gram)[1] - left @ inverse @ y)


def _step(h: float, order: int, q: float) -> tuple[np.ndarray, np.ndarray]:
    if order == 2:
        return np.array([[1, h], [0, 1]]), q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    rows = [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    return np.array([[1, h, h**2 / 2], [0, 1, h], [0, 0, 1]]), q * np.array(rows)


def sampled(t: np.ndarray, order: int, q: float, rng: np.random.Generator) -> np.ndarray:
    """A process (N, m) from rest."""
    out = np.zeros((len(t), order))
    for k, h in enumerate(np.diff(t)):
        F, Q = _step(h, order, q)
        out[k + 1] = F @ out[k] + np.linalg.cholesky(Q) @ rng.standard_normal(order)
    return out
