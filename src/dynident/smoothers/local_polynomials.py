"""Polynomials fitted to the samples around each sample, on the times as they are.

Legendre's polynomials over the span of a window are nearly orthogonal on its samples, so that normal equations lose no
digits.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.polynomial import legendre
from numpy.typing import NDArray

__all__ = ["differences", "fitted", "spans"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]
ENTRIES = 2**21  # numbers of the largest work array
WIDE = 64  # samples on either side, from which on sums that go along with the window are faster
UNEVEN = 1e-9  # of a step: stamps that differ by less from equal spacing are equally spaced


def even(t: Array) -> bool:
    """Whether times (N), s, are equally spaced but for rounding."""
    step = (t[-1] - t[0]) / (len(t) - 1)
    rounding = 8 * np.finfo(float).eps * max(abs(t[0]), abs(t[-1]))
    ideal = t[0] + step * np.arange(len(t))
    return bool(np.abs(t - ideal).max() <= max(UNEVEN * step, rounding))


def _first(t: Array, half: int, rows: Index) -> Index:
    """Return the first sample of the 2 half + 1 around each of ``rows``; those at the ends have others beyond them."""
    return np.clip(rows - half, 0, len(t) - 2 * half - 1)


def kernels(t: Array, half: int, orders: tuple[int, ...], rows: Index) -> list[Array]:
    """Return, for each order, what of the samples of its window (B, 3, 2 half + 1) makes q, dq, ddq at each row."""
    size, top = 2 * half + 1, max(orders)
    first = _first(t, half, rows)
    at = t[first[:, None] + np.arange(size)]
    middle, reach = (at[:, -1] + at[:, 0]) / 2, (at[:, -1] - at[:, 0]) / 2
    basis = legendre.legvander((at - middle[:, None]) / reach[:, None], top)
    here = (t[rows] - middle) / reach
    values = _derivatives(here, top, reach)
    found = []
    for order in orders:
        V, wanted = basis[..., : order + 1].transpose(0, 2, 1), values[..., : order + 1].transpose(0, 2, 1)
        weights = np.linalg.solve(np.matmul(V, V.transpose(0, 2, 1)), wanted)
        found.append(np.matmul(weights.transpose(0, 2, 1), V))
    return found


@cache
def _slopes(top: int) -> Array:
    """Return what of Legendre's polynomials up to degree ``top`` makes them, their first and second derivative."""
    out = np.zeros((3, top + 1, top + 1))
    for times in range(3):
        out[times, : top + 1 - times] = legendre.legder(np.eye(top + 1), times)
    return out


def _derivatives(x: Array, top: int, reach: Array) -> Array:
    """Return values and derivatives of the polynomials at x (B), for windows of half the time ``reach``, as (B, 3,
    top + 1)."""
    each = np.matmul(legendre.legvander(x, top), _slopes(top)).transpose(1, 0, 2)
    return np.asarray(each / reach[:, None, None] ** np.arange(3)[:, None])


def fitted(t: Array, q: Array, half: int, order: int) -> tuple[Array, Array, Array, float]:
    """Return q, dq, ddq (N, k) of the polynomials of ``order`` through the 2 half + 1 samples around each sample, and
    the trace of what makes q of the data, their degrees of freedom.

    At the ends it is the polynomial of the first and the last window. ``t`` (N) s, ``q`` (N, k).
    """
    count, size = len(t), 2 * half + 1
    out, trace, rest = np.empty((3, *q.shape)), 0.0, np.r_[0:half, count - half : count]
    if even(t):
        shape = kernels(t, half, (order,), np.array([count // 2]))[0][0]
        trace = float(shape[0, half]) * (count - 2 * half)
        for k, row in enumerate(shape):
            for j, column in enumerate(q.T):
                out[k, half : count - half, j] = np.correlate(column, row, mode="valid")
    elif half >= WIDE:
        for start in range(half, count - half, half):
            rows = slice(start, min(start + half, count - half))
            out[:, rows], more = _swept(t, q, half, order, rows)
            trace += more
    else:
        rest = np.arange(count)
    block = max(1, ENTRIES // (size * (order + 4)))
    for start in range(0, len(rest), block):
        at = rest[start : start + block]
        weights, first = kernels(t, half, (order,), at)[0], _first(t, half, at)
        out[:, at] = np.matmul(weights, q[first[:, None] + np.arange(size)]).transpose(1, 0, 2)
        trace += float(weights[np.arange(len(at)), 0, at - first].sum())
    return out[0], out[1], out[2], trace


def _swept(t: Array, q: Array, half: int, order: int, rows: slice) -> tuple[Array, float]:
    """Return q, dq, ddq (3, B, k) of ``rows``, at most half a window, and their part of the trace.

    The polynomials of all windows have one basis, so that their normal equations are differences of running sums.
    """
    around = slice(rows.start - half, rows.stop + half)
    time, size, base = t[around], 2 * half + 1, q[rows.start]
    middle, reach = (time[-1] + time[0]) / 2, (time[-1] - time[0]) / 2
    V = legendre.legvander((time - middle) / reach, order)
    gram = _running(V[:, :, None] * V[:, None], size)
    right = _running(V[:, :, None] * (q[around] - base)[:, None], size)
    here = (t[rows] - middle) / reach
    wanted = _derivatives(here, order, np.full(len(here), reach)).transpose(0, 2, 1)
    weights = np.linalg.solve(gram, wanted)
    found = np.matmul(weights.transpose(0, 2, 1), right).transpose(1, 0, 2)
    found[0] += base
    return found, float((weights[:, :, 0] * wanted[:, :, 0]).sum())


def _running(x: Array, size: int) -> Array:
    """Return the sums of ``size`` consecutive rows of x (N, ...), as (N - size + 1, ...)."""
    whole = np.concatenate([np.zeros_like(x[:1]), np.cumsum(x, axis=0)])
    return np.asarray(whole[size:] - whole[:-size])


def differences(t: Array, q: Array, half: int, orders: tuple[int, int], rows: Index) -> tuple[Array, float]:
    """Return the mean squares (k) of what ddq differs by between polynomials of two orders at ``rows``, and how many
    times the variance of the first they are where there is noise alone; each row has half a window on either side."""
    size, total, gains = 2 * half + 1, np.zeros(q.shape[1]), np.zeros(2)
    alike = even(t)
    block = max(1, ENTRIES // (size if alike else size * (orders[1] + 4)))
    for start in range(0, len(rows), block):
        part = rows[start : start + block]
        low, high = (one[:, 2] for one in kernels(t, half, orders, part[:1] if alike else part))
        at, change = _first(t, half, part), high - low
        for j, column in enumerate(q.T):
            around = sliding_window_view(column, size)[at]
            apart = around @ change[0] if alike else np.einsum("bs,bs->b", around, change)
            total[j] += float(apart @ apart)
        gains += [float(np.square(one).sum() / len(one) * len(part)) for one in (low, change)]
    return total / len(rows), float(gains[1] / gains[0])


def spans(t: Array, half: int) -> Array:
    """Return the time (N) that the window of each sample takes, s."""
    first = _first(t, half, np.arange(len(t)))
    return np.asarray(t[first + 2 * half] - t[first])
