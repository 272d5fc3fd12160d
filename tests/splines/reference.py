"""The smoothing spline in 50 digits: an independent banded Cholesky solution of eq. (32) with mpmath."""

from __future__ import annotations

from collections.abc import Sequence

import mpmath
import numpy as np


def second_derivative(t: Sequence[float], y: Sequence[float], p: float, delta: Sequence[float]) -> np.ndarray:
    """Return g'' = 2 c at the samples, rounded from 50 digits."""
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
            known = row if i == j else lower[j]
            s = entry(i, j) - sum((row[k] * known[k] for k in row if k < j and k in known), f(0))
            row[j] = s / lower[j][j] if j < i else mpmath.sqrt(s)
        lower.append(row)
    x: list[mpmath.mpf] = []
    for i in range(n - 2):
        x.append((z[i] - sum((v * x[k] for k, v in lower[i].items() if k < i), f(0))) / lower[i][i])
    for i in reversed(range(n - 2)):
        below = [(r, lower[r][i]) for r in (i + 1, i + 2) if r < n - 2]
        x[i] = (x[i] - sum((x[r] * v for r, v in below), f(0))) / lower[i][i]
    return [f(0), *(2 * p * v for v in x), f(0)]
