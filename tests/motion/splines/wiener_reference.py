"""Integrated Wiener processes in dense algebra, and by the textbook's recursion: independent of all banded systems."""

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


def recursion(t: np.ndarray, y: np.ndarray, order: int, r: float, q: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Kalman filter and backward pass of Rauch, Tung and Striebel: means (N, m), covariances, log-likelihood.

    The first m samples tell the start exactly; the likelihood is that of the others given them.
    """
    x, P = _start(t[:order], y[:order], order, r, q)
    means, spreads, ahead, full = [x], [P], [], 0.0
    for k in range(order, len(t)):
        F, Q = _step(t[k] - t[k - 1], order, q)
        x, P = F @ x, F @ P @ F.T + Q
        ahead.append((F, x, P))
        error, variance = y[k] - x[0], P[0, 0] + r
        full -= 0.5 * (np.log(2 * np.pi * variance) + error**2 / variance)
        gain = P[:, 0] / variance
        x, keep = x + gain * error, np.eye(order) - np.outer(gain, np.eye(order)[0])
        P = keep @ P @ keep.T + r * np.outer(gain, gain)
        means.append(x)
        spreads.append(P)
    for k in reversed(range(len(means) - 1)):
        F, x, P = ahead[k]
        gain = spreads[k] @ F.T @ np.linalg.inv(P)
        means[k] = means[k] + gain @ (means[k + 1] - x)
        spreads[k] = spreads[k] + gain @ (spreads[k + 1] - P) @ gain.T
    return np.array(means), np.array(spreads), full


def _step(h: float, order: int, q: float) -> tuple[np.ndarray, np.ndarray]:
    if order == 2:
        return np.array([[1, h], [0, 1]]), q * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])
    rows = [[h**5 / 20, h**4 / 8, h**3 / 6], [h**4 / 8, h**3 / 3, h**2 / 2], [h**3 / 6, h**2 / 2, h]]
    return np.array([[1, h, h**2 / 2], [0, 1, h], [0, 0, 1]]), q * np.array(rows)


def _start(t: np.ndarray, y: np.ndarray, order: int, r: float, q: float) -> tuple[np.ndarray, np.ndarray]:
    """State at the last of m samples of which nothing else is known."""
    back = t[-1] - t[::-1]  # the process runs backward from the last of them
    K = q * covariance(back, back, order, 0, 0) + r * np.eye(order)
    inverse = np.linalg.inv(np.column_stack([back**k / factorial(k) * (-1) ** k for k in range(order)]))
    return inverse @ y[::-1], inverse @ K @ inverse.T


def sampled(t: np.ndarray, order: int, q: float, rng: np.random.Generator) -> np.ndarray:
    """A process (N, m) from rest."""
    out = np.zeros((len(t), order))
    for k, h in enumerate(np.diff(t)):
        F, Q = _step(h, order, q)
        out[k + 1] = F @ out[k] + np.linalg.cholesky(Q) @ rng.standard_normal(order)
    return out
