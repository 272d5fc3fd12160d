"""The recursion over bodies by the kernel (``kernel/bodies.c``): what ``recursion.py`` computes, faster."""

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
STATES = (c_void_p, c_void_p, c_int64, *[c_void_p] * 6, c_int64)
KINDS = {
    "regressor": (*STATES, c_void_p, c_int64, c_void_p, c_void_p, c_int64, c_void_p),
    "entries": (*STATES, c_void_p, c_int64, *[c_void_p] * 3, c_int64, c_void_p),
    "torque": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
    "mass": (*STATES, *[c_void_p] * 3, c_int64, c_void_p),
    "partials": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
}


def recursion(tree: Tree, gravity: Array) -> Recursion:
    """Return the recursion by the kernel where there is one, else by NumPy."""
    return Recursion(tree, gravity) if function("bodies_torque", *KINDS["torque"]) is None else CompiledRecursion(tree, gravity)


class CompiledRecursion(Recursion):
    """A ``Recursion`` in C, with samples as the lanes of vectors."""

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y (N, n, 10 L) for the parameters of the L listed bodies."""
        tree, (pairs, via) = self.tree, self._pairs
        Y = np.empty((len(q), tree.joints, 10 * len(tree.listed)))
        size = Y.shape[1] * Y.shape[2]
        self._call("regressor", (q, dq, ddq), _at(pairs), len(pairs), _at(via), _at(Y), size)
        return Y

    def entries(self, q: Array, dq: Array, ddq: Array, joint: Integers, parameter: Integers) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows (M, N)."""
        pairs, via = self._pairs
        rows = np.full((self.tree.joints, 10 * len(self.tree.listed)), -1, dtype=np.int64)
        rows[joint, parameter] = np.arange(len(joint))
        places = pairs[:, 1:2] + np.arange(10)
        to = rows.reshape(-1)[places]
        wanted = (to >= 0).any(axis=1)
        pairs, to = np.ascontiguousarray(pairs[wanted]), np.ascontiguousarray(to[wanted])
        out = np.empty((len(joint), len(q)))
        out[~self.tree.support[joint, parameter]] = 0.0
        self._call("entries", (q, dq, ddq), _at(pairs), len(pairs), _at(via), _at(to), _at(out), len(q))
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the inverse dynamics (N, n)."""
        out = np.empty((len(q), self.tree.joints))
        theta = np.ascontiguousarray(theta)
        self._call("torque", (q, dq, ddq), _at(theta), _at(out), self.tree.joints)
        return out

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration."""
        n = self.tree.joints
        mass, bias = np.empty((len(q), n, n)), np.empty((len(q), n))
        theta = np.ascontiguousarray(theta)
        self._call("mass", (q, dq, np.zeros_like(dq)), _at(theta), _at(mass), _at(bias), n)
        return mass, bias

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the derivatives (3, N, n, n) of the torque by q, dq and ddq."""
        n = self.tree.joints
        out = np.empty((3, len(q), n, n))
        theta = np.ascontiguousarray(theta)
        self._call("partials", (q, dq, ddq), _at(theta), _at(out), n)
        return out

    def _call(self, name: str, states: tuple[Array, Array, Array], *rest: Any) -> None:
        call: Any = function(f"bodies_{name}", *KINDS[name])
        q, dq, ddq = self.tree.moved(*states)
        arrays = [np.ascontiguousarray(x) for x in (q, np.sin(q), np.cos(q), dq, ddq)]
        work = np.empty(ROOM * (len(self.tree) + 1))
        tree, fixed = self._described
        call(_at(tree), _at(fixed), len(self.tree), _at(self.gravity), *map(_at, arrays), len(q), *rest, _at(work))

    @cached_property
    def _described(self) -> tuple[Integers, Array]:
        """The tree as the kernel has it."""
        tree = self.tree
        turns = tree.turns.transpose(1, 0, 2, 3).reshape(len(tree), 27)
        fixed = np.hstack([turns, tree.origin, tree.axis, tree.gain[:, None]])
        return np.stack([tree.parent, tree.prismatic, tree.column], axis=1).astype(np.int64), fixed

    @cached_property
    def _pairs(self) -> tuple[Integers, Integers]:
        """Body, first entry of its parameters in the regressor, and bodies by which a joint moves it: (P, 4), (V)."""
        rows: list[tuple[int, int, int, int]] = []
        via: list[int] = []
        for chain in self.tree.chains:
            for k, joint in enumerate(chain.joints.tolist()):
                by = chain.via[chain.of == k].tolist()
                rows.append((chain.body, 10 * (joint * len(self.tree.listed) + chain.place), len(via), len(by)))
                via += by
        return np.array(rows, dtype=np.int64), np.array(via, dtype=np.int64)


def _at(array: Array | Integers) -> int:
    """Return the address of a contiguous array."""
    return array.ctypes.data
