"""The recursion over bodies by the kernel (``kernel/bodies.h``): what ``recursion.py`` computes, faster."""

from __future__ import annotations

from ctypes import c_int64, c_void_p
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.kernel import function
from dynident.models.recursion import Recursion
from dynident.models.tree import Tree

__all__ = ["CompiledRecursion", "recursion"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]
ROOM = 8 * 100  # doubles of work for each body: the most lanes, and more than the numbers in each
STATES = (c_void_p, c_void_p, c_int64, *[c_void_p] * 4, c_int64)
TILE = 128  # samples of entries that the kernel gathers before it writes them
ANGLES = 5e5  # rad; the kernel's sine is of smaller angles
KINDS = {
    "regressor": (*STATES, c_void_p, c_int64, c_void_p, c_void_p, c_int64, c_void_p),
    "entries": (*STATES, c_void_p, c_int64, *[c_void_p] * 3, c_int64, c_void_p),
    "torque": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
    "mass": (*STATES, *[c_void_p] * 3, c_int64, c_void_p),
    "partials": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
    "weighted": (*STATES, c_void_p, c_void_p, c_int64, c_void_p, c_int64, c_void_p),
}


def recursion(tree: Tree, gravity: Array) -> Recursion:
    """Return the recursion by the kernel where there is one, else by NumPy."""
    found = function("bodies_torque", *KINDS["torque"])
    return Recursion(tree, gravity) if found is None else CompiledRecursion(tree, gravity)


class CompiledRecursion(Recursion):
    """A ``Recursion`` in C, with samples as the lanes of vectors."""

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y (N, n, 10 L) for the parameters of the L listed bodies."""
        layout, (_, pairs, via) = self.layout, self.layout.tables
        Y = np.empty((len(q), layout.joints, 10 * len(layout.listed)))
        self._call("regressor", (q, dq, ddq), _at(pairs), len(pairs), _at(via), _at(Y), Y.shape[1] * Y.shape[2])
        return Y

    def entries(self, q: Array, dq: Array, ddq: Array, joint: Integers, parameter: Integers) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows (M, N)."""
        layout, (_, pairs, via) = self.layout, self.layout.tables
        rows = np.full((layout.joints, 10 * len(layout.listed)), -1, dtype=np.int64)
        rows[joint, parameter] = np.arange(len(joint))
        to = rows.reshape(-1)[pairs[:, 1:2] + np.arange(10)]
        wanted = (to >= 0).any(axis=1)
        pairs, to = pairs[wanted], to[wanted]
        out = np.empty((len(joint), len(q)))
        rest = (_at(pairs), len(pairs), _at(via), _at(to), _at(out), len(joint))
        self._call("entries", (q, dq, ddq), *rest, room=TILE * len(joint))
        source = rows[joint, parameter]
        if (source != np.arange(len(joint))).any():  # of entries that are asked for twice, one was computed
            out = out[source]
        out[~layout.support[joint, parameter]] = 0.0
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the inverse dynamics (N, n)."""
        out = np.empty((len(q), self.layout.joints))
        self._call("torque", (q, dq, ddq), _at(theta), _at(out), self.layout.joints)
        return out

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration."""
        n = self.layout.joints
        mass, bias = np.empty((len(q), n, n)), np.empty((len(q), n))
        self._call("mass", (q, dq, np.zeros_like(dq)), _at(theta), _at(mass), _at(bias), n)
        return mass, bias

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the derivatives (3, N, n, n) of the torque by q, dq and ddq."""
        n = self.layout.joints
        out = np.empty((3, len(q), n, n))
        self._call("partials", (q, dq, ddq), _at(theta), _at(out), n)
        return out

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array) -> Array:
        """Return the derivatives (3, N, n) of the sums <G_i, Y_i> by q, dq and ddq, for weights G (N, n, 10 L)."""
        n, width = self.layout.joints, 10 * len(self.layout.listed)
        weights, out = np.ascontiguousarray(weights), np.empty((3, len(q), n))
        place = np.full(len(self.layout), -1, dtype=np.int64)
        place[self.layout.listed] = np.arange(0, width, 10)
        self._call("weighted", (q, dq, ddq), _at(place), _at(weights), width, _at(out), n)
        return out

    def _call(self, name: str, states: tuple[Array, Array, Array], *rest: Any, room: int = 0) -> None:
        call: Any = function(f"bodies_{name}", *KINDS[name])
        q, dq, ddq = self.layout.moved(*states)
        if not np.abs(q).max(initial=0.0) < ANGLES:
            q = np.where(self.layout.prismatic, q, np.arctan2(np.sin(q), np.cos(q)))
        arrays = [np.ascontiguousarray(x) for x in (q, dq, ddq)]
        work = np.empty(ROOM * (len(self.layout) + 1) + room)
        call(*self._robot[1], *map(_at, arrays), len(q), *rest, _at(work))

    @cached_property
    def _robot(self) -> tuple[tuple[Array | Integers, ...], tuple[int, ...]]:
        """The robot as the kernel has it, its geometry as (B, 34): arrays, and the first arguments of all functions."""
        tree, layout = self.tree, self.layout
        turns = tree.turns.transpose(1, 0, 2, 3).reshape(len(layout), 27)
        fixed = np.hstack((turns, tree.origin, tree.axis, layout.gain[:, None]))
        bodies = layout.tables[0]
        return (bodies, fixed, self.gravity), (_at(bodies), _at(fixed), len(layout), _at(self.gravity))


def _at(array: Array | Integers) -> int:
    """Return the address of a contiguous array."""
    return array.ctypes.data
