"""Series to smooth; the matrices of the article; and its spline in 50 digits, an independent solution of eq. (32)."""

from collections.abc import Sequence

import mpmath
import numpy as np


def grid(n: int, h: float, kind: str, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    factor = {"uniform": 0.0, "jittered": 0.3}.get(kind)
    steps = (
        h * (1 + factor * rng.uniform(-1, 1, n - 1)) if factor is not None else h * np.exp(rng.uniform(-2, 2, n - 1))
    )
    return np.arange(n) * h if kind == "uniform" else np.concatenate(([0.0], np.cumsum(steps)))


def series(n: int = 300, h: float = 0.01, kind: str = "jittered", sigma: float = 1e-2) -> tuple[np.ndarray, np.ndarray]:
    t = grid(n, h, kind)
    return t, np.sin(3 * t) + 0.5 * np.sin(9.3 * t) + sigma * np.random.default_rng(1).standard_normal(n)


def matrices(t: np.ndarray, delta: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, N, Q as printed: eqs. (27)-(31)."""
    h, n = np.diff(t), len(t) - 1
    N, Q = np.zeros((n - 1, n - 1)), np.zeros((n + 1, n - 1))
    for i in range(n - 1):
        N[i, i] = 2 * (h[i] + h[i + 1]) / 3
        if i + 1 < n - 1:
            N[i, i + 1] = N[i + 1, i] = h[i + 1] / 3
        Q[i, i], Q[i + 1, i], Q[i + 2, i] = 1 / h[i], -1 / h[i] - 1 / h[i + 1], 1 / h[i + 1]
    return np.diag(delta), N, Q


def second_derivative(t: Sequence[float], y: Sequence[float], p: float, delta: Sequence[float]) -> np.ndarray:
    """Return g'' = 2 c at the samples, rounded from 50 digits: a banded Cholesky solution with mpmath."""
    with mpmath.workdps(50):
        return np.array([float(x) for x in _exact(t, y, p, delta)])


def _exact(t: Sequence[float], y: Sequence[float], p: float, delta: Sequence[float]) -> list[mpmath.mpf]:
    f = mpmath.mpf
    n = len(t)
    tt, yy, d2, p = [f(float(x)) for x in t], [f(float(x)) for x in y], [f(float(x)) ** 2 for x in delta], f(float(p))
    h = [tt[i + 1] - tt[i] for i in range(n - 1)]
    q = [(1 / h[i], -1 / h[i] - 1 / h[i + 1], 1 / h[i + 1]) for i in range(n - 2)]
    z = [sum(q[i][k] * yy[i + k] for k in range(3)) for i in range(n - 2)]

    def entry(i: int, j: int) -> mpmath.mpf:
        gram = sum(q[i][k] * q[j][i + k - j] * d2[i + k] for k in range(3) if 0 <= i + k - j < 3)
        mass = 2 * (h[i] + h[i + 1]) / 3 if i == j else (h[max(i, j)] / 3 if abs(i - j) == 1 else f(0))
        return gram + p * mass

    lower: list[dict[int, mpmath.mpf]] = []
    for i in range(n - 2):
        row: dict[int, mpmath.mpf] = {}
        for j in range(max(0, i - 2), i + 1):
            reference = row if i == j else lower[j]
            s = entry(i, j) - sum((row[k] * reference[k] for k in row if k < j and k in reference), f(0))
            row[j] = s / lower[j][j] if j < i else mpmath.sqrt(s)
        lower.append(row)
    x: list[mpmath.mpf] = []
    for i in range(n - 2):
        x.append((z[i] - sum((v * x[k] for k, v in lower[i].items() if k < i), f(0))) / lower[i][i])
    for i in reversed(range(n - 2)):
        below = [(r, lower[r][i]) for r in (i + 1, i + 2) if r < n - 2]
        x[i] = (x[i] - sum((x[r] * v for r, v in below), f(0))) / lower[i][i]
    return [f(0), *(2 * p * v for v in x), f(0)]
