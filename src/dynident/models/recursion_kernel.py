"""The recursion over bodies by the kernel (``kernel/bodies.h``): what ``recursion.py`` computes, faster."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import c_int64, c_void_p
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models.recursion import Recursion
from dynident.models.tree import Layout, Tree
from dynident.runtime.arrays import Array
from dynident.runtime.kernel import function

Integers = NDArray[np.intp]
WORK_PER_BODY = 8 * 100  # doubles of work for each body: the most lanes, and more than the numbers in each
STATES = (c_void_p, c_void_p, c_int64, *[c_void_p] * 4, c_int64)
TILE = 128  # samples of entries that the kernel gathers before it writes them
MAX_ANGLE = 5e5  # rad; the kernel's sine is of smaller angles
SIGNATURES = {
    "regressor": (*STATES, c_void_p, c_int64, c_void_p, c_void_p, c_int64, c_void_p),
    "entries": (*STATES, c_void_p, c_int64, *[c_void_p] * 3, c_int64, c_void_p),
    "torque": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
    "mass": (*STATES, *[c_void_p] * 3, c_int64, c_void_p),
    "partials": (*STATES, c_void_p, c_void_p, c_int64, c_void_p),
    "weighted": (*STATES, c_void_p, c_void_p, c_int64, c_void_p, c_int64, c_void_p),
    "steps": (*STATES[:3], *[c_void_p] * 3, c_int64, c_int64, *[c_void_p] * 4, c_int64, c_void_p, c_int64, c_void_p),
}


def make_recursion(tree: Tree, gravity: Array) -> Recursion:
    """Return the recursion by the kernel where there is one, else by NumPy."""
    kernel_function = function("bodies_torque", *SIGNATURES["torque"])
    return Recursion(tree, gravity) if kernel_function is None else CompiledRecursion(tree, gravity)


@lru_cache(maxsize=8)
def body_tables(layout: Layout) -> tuple[Integers, Integers, Integers]:
    """Return the tables that the kernel walks over.

    The first holds the parent of each body, whether its joint is prismatic, and the joint that drives it (B, 3).
    The second has for each pair of a body and a joint that moves it (P, 4) the body, the entry of its first
    parameter in the regressor, and where the bodies that this joint moves are in the third, with their number.
    """
    rows: list[tuple[int, int, int, int]] = []
    via: list[int] = []
    for chain in layout.chains:
        for k, joint in enumerate(chain.joints.tolist()):
            movers = chain.via[chain.joint_place == k].tolist()
            entry = 10 * (joint * len(layout.parameter_bodies) + chain.place)
            rows.append((chain.body, entry, len(via), len(movers)))
            via += movers
    bodies = np.stack((layout.parent, layout.prismatic, layout.column), axis=1)
    return bodies.astype(np.int64), np.array(rows, dtype=np.int64), np.array(via, dtype=np.int64)


class CompiledRecursion(Recursion):
    """A ``Recursion`` in C, with samples as the lanes of vectors."""

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y (N, n, 10 L) for the parameters of the L listed bodies."""
        layout, (_, pairs, via) = self.layout, body_tables(self.layout)
        Y = np.empty((len(q), layout.joints, 10 * len(layout.parameter_bodies)))
        self._call(
            "regressor", (q, dq, ddq), _address(pairs), len(pairs), _address(via), _address(Y), Y.shape[1] * Y.shape[2]
        )
        return Y

    def entries(self, q: Array, dq: Array, ddq: Array, joint: Integers, parameter: Integers) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows (M, N)."""
        layout, (_, pairs, via) = self.layout, body_tables(self.layout)
        # the output row of each entry, -1 where it is not asked for; pairs without any are left out
        rows = np.full((layout.joints, 10 * len(layout.parameter_bodies)), -1, dtype=np.int64)
        rows[joint, parameter] = np.arange(len(joint))
        targets = rows.reshape(-1)[pairs[:, 1:2] + np.arange(10)]
        is_used = (targets >= 0).any(axis=1)
        pairs, targets = pairs[is_used], targets[is_used]
        out = np.empty((len(joint), len(q)))
        arguments = (_address(pairs), len(pairs), _address(via), _address(targets), _address(out), len(joint))
        self._call("entries", (q, dq, ddq), *arguments, extra_work=TILE * len(joint))
        source = rows[joint, parameter]
        if (source != np.arange(len(joint))).any():  # of entries that are asked for twice, one was computed
            out = out[source]
        out[~layout.support[joint, parameter]] = 0.0
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the inverse dynamics (N, n)."""
        out = np.empty((len(q), self.layout.joints))
        self._call("torque", (q, dq, ddq), _address(theta), _address(out), self.layout.joints)
        return out

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration."""
        n = self.layout.joints
        mass, bias = np.empty((len(q), n, n)), np.empty((len(q), n))
        self._call("mass", (q, dq, np.zeros_like(dq)), _address(theta), _address(mass), _address(bias), n)
        return mass, bias

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the derivatives (3, N, n, n) of the torque by q, dq and ddq."""
        n = self.layout.joints
        out = np.empty((3, len(q), n, n))
        self._call("partials", (q, dq, ddq), _address(theta), _address(out), n)
        return out

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array) -> Array:
        """Return the derivatives (3, N, n) of the sums <G_i, Y_i> by q, dq and ddq, for weights G (N, n, 10 L)."""
        n, width = self.layout.joints, 10 * len(self.layout.parameter_bodies)
        weights, out = np.ascontiguousarray(weights), np.empty((3, len(q), n))
        # the first of the ten parameters of each body, -1 for bodies that have none
        place = np.full(len(self.layout), -1, dtype=np.int64)
        place[self.layout.parameter_bodies] = np.arange(0, width, 10)
        self._call("weighted", (q, dq, ddq), _address(place), _address(weights), width, _address(out), n)
        return out

    def steps(
        self, q: Array, dq: Array, ddq: Array, tau: Array, h: Array, theta: Array, others: Sequence[Array]
    ) -> bool:
        """Take the steps of ``Machine.step`` from the first of q, dq (S + 1, P, n) and from ddq (P, n), in place.

        ``others`` are mass and bias of other terms, V, J and F; ``h`` (S) is in s. Return False where the mass matrix
        is singular at a step. Raises ValueError where the three are not contiguous.
        """
        call: Any = function("bodies_steps", *SIGNATURES["steps"], result=c_int64)
        pieces, n, m, bodies = q.shape[1], q.shape[2], len(others[-1]), len(self.layout)
        settings = np.concatenate([self.layout.offset, *map(np.ravel, others)])
        work = np.zeros(
            pieces * (n * (n + 3) + 3 * bodies) + n * (n + 1 + m) + m * (m + 2) + WORK_PER_BODY * (bodies + 1)
        )
        # what is written in place cannot be a copy; with other strides the kernel would write elsewhere
        if not all(array.flags.c_contiguous and array.dtype == np.float64 for array in (q, dq, ddq)):
            raise ValueError("q, dq and ddq must be contiguous arrays of float64.")
        tau, h = np.ascontiguousarray(tau), np.ascontiguousarray(h)
        arguments = [_address(array) for array in (q, dq, ddq, tau)]
        sizes = pieces, _address(h), len(h), _address(work)
        taken = call(*self._robot_arguments[1], _address(theta), _address(settings), n, m, *arguments, *sizes)
        return bool(taken == len(h))

    def _call(self, name: str, states: tuple[Array, Array, Array], *arguments: Any, extra_work: int = 0) -> None:
        call: Any = function(f"bodies_{name}", *SIGNATURES[name])
        q, dq, ddq = self.layout.body_states(*states)
        # reduce large angles to one turn; positions that slide must stay
        if not np.abs(q).max(initial=0.0) < MAX_ANGLE:
            q = np.where(self.layout.prismatic, q, np.arctan2(np.sin(q), np.cos(q)))
        arrays = [np.ascontiguousarray(x) for x in (q, dq, ddq)]
        work = np.empty(WORK_PER_BODY * (len(self.layout) + 1) + extra_work)
        call(*self._robot_arguments[1], *map(_address, arrays), len(q), *arguments, _address(work))

    @cached_property
    def _robot_arguments(self) -> tuple[tuple[Array | Integers, ...], tuple[int, ...]]:
        """The robot as the kernel has it, its geometry as (B, 34): arrays, and the first arguments of all functions."""
        tree, layout = self.tree, self.layout
        turns = tree.turns.transpose(1, 0, 2, 3).reshape(len(layout), 27)
        fixed = np.hstack((turns, tree.origin, tree.axis, layout.gain[:, None]))
        bodies = body_tables(layout)[0]
        return (bodies, fixed, self.gravity), (_address(bodies), _address(fixed), len(layout), _address(self.gravity))


def _address(array: Array | Integers) -> int:
    """Return the address of a contiguous array."""
    return array.ctypes.data
