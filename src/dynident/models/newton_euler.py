"""Torque and regressor of a tree of joints for many samples at once, by NumPy, in the axes of the bodies.

The recursion of Luh, Walker and Paul (1980), "On-line computational scheme for mechanical manipulators". The axes of a
body are turned so that z is the axis of its joint: then all but a turn about z is constant from body to body, and the
wrench of a body is constant in w w', dw and the acceleration of its origin less gravity: products of small constant
matrices and long rows of samples, which BLAS has.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models.tree import Tree

__all__ = ["AT_ONCE", "NewtonEuler"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]
AT_ONCE = 6000  # samples times bodies: temporary arrays stay in the cache
INERTIAS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
SQUARES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of w
EPSILON = np.zeros((3, 3, 3))  # that of Levi-Civita
EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]], EPSILON[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0


def _symmetric(pairs: tuple[tuple[int, int], ...]) -> Array:
    """Return the matrices (6, 3, 3) that, times its entries at ``pairs``, sum to a symmetric matrix."""
    out = np.zeros((6, 3, 3))
    for one, (i, j) in zip(out, pairs, strict=True):
        one[i, j] = one[j, i] = 1.0
    return out


TENSORS = _symmetric(INERTIAS)
TURNS = _symmetric(SQUARES) - np.trace(_symmetric(SQUARES), axis1=1, axis2=2)[:, None, None] * np.eye(3)  # [w][w]


def _wrenches() -> Array:
    """Return moment and force (6, 10, 12) by parameters in the axes of a body, and dw, acceleration and squares."""
    out = np.zeros((6, 10, 12))
    dw, a, ww = out[..., :3], out[..., 3:6], out[..., 6:]
    a[3:, 0] = np.eye(3)
    a[:3, 1:4] = EPSILON
    dw[3:, 1:4] = EPSILON.swapaxes(1, 2)
    ww[3:, 1:4] = TURNS.transpose(1, 2, 0)
    dw[:3, 4:] = TENSORS.transpose(1, 0, 2)
    ww[:3, 4:] = np.einsum("ijk,ckl,pjl->icp", EPSILON, TENSORS, _symmetric(SQUARES))
    return out


WRENCHES = _wrenches()


class NewtonEuler:
    """A ``tree`` under ``gravity`` (3), m/s^2. States q, dq, ddq (B, N) are those of the joints of its B bodies."""

    def __init__(self, tree: Tree, gravity: Array) -> None:
        self.layout, self.gravity = tree.layout, gravity
        R = tree.turns[0] + tree.turns[2]
        Q = _along(np.einsum("bij,bi->bj", R, tree.axis))
        host = np.concatenate([np.eye(3)[None], Q])[tree.layout.parent + 1].swapaxes(1, 2)
        back, origin = (host @ R @ Q).swapaxes(1, 2), np.einsum("bij,bj->bi", host, tree.origin)
        cross = np.einsum("ijk,bj->bik", EPSILON, origin)
        self.moves = np.zeros((len(R), 9, 15))  # w, dw, a of a body by those of its parent, and the squares
        for k in range(3):
            self.moves[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = back
        self.moves[:, 6:, 3:6] = -back @ cross
        self.moves[:, 6:, 9:] = back @ np.einsum("cij,bj->bic", TURNS, origin)
        self.screws = np.zeros((len(R), 6, 6))  # rates of rotation and origin by the same of the parent
        self.screws[:, :3, :3] = self.screws[:, 3:, 3:] = back
        self.screws[:, 3:, :3] = -back @ cross
        self.wrenches = np.einsum("rci,bcd->brdi", WRENCHES, _turned(Q))

    __repr__ = brief

    def torque(self, states: list[Array], theta: Array) -> Array:
        """Return the torques (B, N) of the joints of bodies with parameters ``theta`` (B, 10)."""
        layout = self.layout
        out = np.empty(states[0].shape)
        wrenches = np.einsum("brdi,bd->bri", self.wrenches, theta)
        for part, turn, motion in self._motions(states):
            F = wrenches @ motion[1:, 3:]
            for k in range(len(layout) - 1, -1, -1):
                out[k, part] = F[k, 5 if layout.prismatic[k] else 2]
                if layout.parent[k] >= 0:
                    self._across(k, turn, F[k], -1.0)
                    F[layout.parent[k]] += self.screws[k].T @ F[k]
        return out

    def columns(self, states: list[Array], roles: dict[int, Integers]) -> Iterator[tuple[slice, int, Array]]:
        """Return for some samples after the other, and each body k of ``roles``, the columns (R, V, S) of its
        parameters ``roles[k]`` (R), which increase, in the torques of the bodies above it and its own (V).
        """
        layout = self.layout
        for part, turn, motion in self._motions(states):
            size, screws = motion.shape[2], list[Array]()
            for k, parent in enumerate(layout.parent):
                above = screws[parent] if parent >= 0 else np.empty((0, 6, size))
                own = np.empty((len(above) + 1, 6, size))
                np.matmul(self.screws[k], above, out=own[:-1])
                self._across(k, turn, own[:-1], 1.0)
                own[-1] = 0.0
                own[-1, 5 if layout.prismatic[k] else 2] = 1.0
                screws.append(own)
                if k in roles:
                    yield part, k, self._products(k, roles[k], motion[k + 1, 3:], own)

    def _products(self, k: int, roles: Integers, motion: Array, screws: Array) -> Array:
        """Return screws (V, 6, S) times the wrenches of parameters of body k: (R, V, S)."""
        turns, pushes = roles[roles > 0], roles[roles < 4]  # a mass has no moment, an inertia no force
        moments, forces = (
            (self.wrenches[k, rows][:, some].reshape(-1, 12) @ motion).reshape(3, len(some), motion.shape[1])
            for rows, some in ((slice(3), turns), (slice(3, 6), pushes))
        )
        out = np.empty((len(roles), len(screws), motion.shape[1]))
        turned, pushed = out[len(roles) - len(turns) :], out[: len(pushes)]
        out[: len(roles) - len(turns)] = 0.0
        np.einsum("irs,vis->rvs", moments, screws[:-1, :3], out=turned[:, :-1])
        pushed[:, :-1] += np.einsum("irs,vis->rvs", forces, screws[:-1, 3:])
        turned[:, -1] = 0.0 if self.layout.prismatic[k] else moments[2]  # its own joint is along z
        pushed[:, -1] += forces[2] if self.layout.prismatic[k] else 0.0
        return out

    def _motions(self, states: list[Array]) -> Iterator[tuple[slice, Array, Array]]:
        """Return for some samples after the other cosine and sine of the joints that turn, the positions of those that
        slide (3, B, S); and w, dw, a, squares (B + 1, 15, S), first of the base.
        """
        step = max(AT_ONCE // len(self.layout), 1)
        for first in range(0, states[0].shape[1], step):
            q, dq, ddq = (state[:, first : first + step] for state in states)
            turn, out = np.stack((np.cos(q), np.sin(q), q)), np.empty((len(q) + 1, 15, q.shape[1]))
            out[0] = 0.0
            out[0, 6:9] = -self.gravity[:, None]
            for k, parent in enumerate(self.layout.parent):
                own = out[k + 1]
                np.matmul(self.moves[k], out[parent + 1], out=own[:9])
                self._moved(k, turn, own, dq[k], ddq[k])
                np.multiply(own[0], own[:3], out=own[9:12])
                np.multiply(own[1], own[1:3], out=own[12:14])
                np.multiply(own[2], own[2], out=own[14])
            yield slice(first, first + step), turn, out

    def _moved(self, k: int, turn: Array, own: Array, dq: Array, ddq: Array) -> None:
        """Add to the motion of body k what its joint does."""
        w, dw, a = own[:3], own[3:6], own[6:9]
        if self.layout.prismatic[k]:
            q = turn[2, k]
            a[0] += q * (dw[1] + w[0] * w[2]) + 2 * w[1] * dq
            a[1] += q * (w[1] * w[2] - dw[0]) - 2 * w[0] * dq
            a[2] += ddq - q * (w[0] * w[0] + w[1] * w[1])
            return
        _rotate(own[:9], turn[0, k], turn[1, k], 1.0)
        w[2] += dq
        dw[0] += w[1] * dq
        dw[1] -= w[0] * dq
        dw[2] += ddq

    def _across(self, k: int, turn: Array, pairs: Array, sign: float) -> None:
        """Take pairs of vectors (..., 6, S) across the joint of body k: screws to its tip, or wrenches (-1) back."""
        if not self.layout.prismatic[k]:
            _rotate(pairs, turn[0, k], turn[1, k], sign)
        elif sign > 0:
            pairs[..., 3, :] += turn[2, k] * pairs[..., 1, :]
            pairs[..., 4, :] -= turn[2, k] * pairs[..., 0, :]
        else:
            pairs[..., 0, :] -= turn[2, k] * pairs[..., 4, :]
            pairs[..., 1, :] += turn[2, k] * pairs[..., 3, :]


def _rotate(vectors: Array, cosine: Array, sine: Array, sign: float) -> None:
    """Turn the x and y of vectors (..., 3 V, S), in place, by minus the angle, or by the angle (-1)."""
    x, y = vectors[..., 0::3, :], vectors[..., 1::3, :]
    across, back = sine * x, sine * y
    x *= cosine
    y *= cosine
    if sign > 0:
        x += back
        y -= across
    else:
        x -= back
        y += across


def _along(axes: Array) -> Array:
    """Return rotations (B, 3, 3) of z to unit vectors (B, 3)."""
    other = np.eye(3)[np.abs(axes).argmin(axis=1)]
    x = np.cross(other, axes)
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack((x, np.cross(axes, x), axes), axis=2)


def _turned(Q: Array) -> Array:
    """Return the parameters (B, 10, 10) in axes Q (B, 3, 3) of a body by its own."""
    out = np.zeros((len(Q), 10, 10))
    out[:, 0, 0] = 1.0
    out[:, 1:4, 1:4] = Q.swapaxes(1, 2)
    tensors = Q.swapaxes(1, 2)[:, None] @ TENSORS @ Q[:, None]
    for row, (i, j) in enumerate(INERTIAS):
        out[:, 4 + row, 4:] = tensors[:, :, i, j]
    return out
