"""The moving bodies of an arm as arrays: what the recursion over bodies needs, in NumPy and in the kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models.robot_file import Arm

__all__ = ["Chain", "Tree"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Chain:
    """How joints move one ``body``, the parameters of which begin at 10 * ``place``: by the bodies ``via`` (J) from the
    base to itself, joint ``joints[k]`` by those where ``of`` (J) is k.
    """

    body: int
    place: int
    via: Integers
    joints: Integers
    of: Integers

    __repr__ = brief

    @cached_property
    def path(self) -> Integers | slice:
        """``via``, as a slice where it is one: that takes no copy."""
        return _sliced(self.via)

    @cached_property
    def moved(self) -> Integers | slice:
        """``joints``, as a slice where they are one."""
        return _sliced(self.joints)

    def shares(self, gain: Array) -> Array:
        """Return the rates of the bodies ``via`` (columns) by those of the joints (rows), for gains (B)."""
        out = np.zeros((len(self.joints), len(self.via)))
        out[self.of, np.arange(len(self.via))] = gain[self.via]
        return out


@dataclass(frozen=True, eq=False)
class Tree:
    """The B bodies of an arm, each after its ``parent`` (B; -1: the base), by joints that are ``prismatic`` (B) or turn.

    The frame of a body in its parent's is turns[0] + sin(q) turns[1] + cos(q) turns[2], ``turns`` (3, B, 3, 3), at
    ``origin`` (B, 3), if it does not slide, which is along ``axis`` (B, 3), in the parent's frame as well. The positions q (B) of the bodies are ``drive`` (B, n) @ (positions of the n joints) + ``rest`` (B), with one joint for each body. ``listed``
    are the L bodies that have parameters, in the order of these.
    """

    parent: Integers
    prismatic: NDArray[np.bool_]
    turns: Array
    origin: Array
    axis: Array
    drive: Array
    rest: Array
    listed: Integers

    __repr__ = brief

    @classmethod
    def of(cls, arm: Arm) -> Tree:
        """Return the tree of an arm."""
        bodies = arm.bodies
        parent = np.array([-1 if body.parent is None else body.parent for body in bodies], dtype=np.intp)
        prismatic = np.array([body.joint.kind == "prismatic" for body in bodies])
        axis = np.array([body.joint.axis for body in bodies], dtype=float)
        place = np.array([body.placement for body in bodies], dtype=float)
        R, origin = place[:, :3, :3], place[:, :3, 3].copy()
        origin[parent < 0] -= place[0, :3, 3]  # numbers are small, wherever the base stands
        along, across = R @ (axis[:, :, None] * axis[:, None, :]), R @ _across(axis)
        turns = np.array([along, across, R - along])
        turns[:, prismatic], turns[0, prismatic] = 0.0, R[prismatic]
        listed = np.array(arm.listed, dtype=np.intp)
        return cls(parent, prismatic, turns, origin, (R @ axis[:, :, None])[..., 0], arm.drive, arm.rest, listed)

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def joints(self) -> int:
        """The number n of joints."""
        return self.drive.shape[1]

    @cached_property
    def column(self) -> Integers:
        """The joint that drives each body (B)."""
        return np.abs(self.drive).argmax(axis=1)

    @cached_property
    def gain(self) -> Array:
        """What a body's position changes with its joint's (B)."""
        return self.drive[np.arange(len(self)), self.column]

    @cached_property
    def pairs(self) -> tuple[Integers, Integers]:
        """All pairs of a body, and one that it carries or is."""
        carrier, carried = np.nonzero(self.above.T)
        return carrier, carried

    @cached_property
    def plain(self) -> bool:
        """Whether each body has a joint of its own, in the order of the bodies."""
        return np.array_equal(self.drive, np.eye(len(self))) and not self.rest.any()

    def moved(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        """Return the states (N, B) of the bodies' joints from those of the joints (N, n)."""
        if self.plain:
            return q, dq, ddq
        q, dq, ddq = (state[:, self.column] * self.gain for state in (q, dq, ddq))
        return q + self.rest, dq, ddq

    @cached_property
    def hosts(self) -> Integers | slice:
        """The places of the parents (B) where the base comes before the bodies."""
        return _sliced(self.parent + 1)

    @cached_property
    def above(self) -> Array:
        """Whether a body (row) is another (column), or carried by it: ones and zeros (B, B)."""
        out = np.eye(len(self))
        for k, parent in enumerate(self.parent):
            if parent >= 0:
                out[k] += out[parent]
        return out

    @cached_property
    def chains(self) -> tuple[Chain, ...]:
        """How the joints move each body that has parameters, in the order of the bodies."""
        out = []
        for place in np.argsort(self.listed):
            body = int(self.listed[place])
            via = np.flatnonzero(self.above[body])
            joints, of = np.unique(self.column[via], return_inverse=True)
            out.append(Chain(body, int(place), via, joints, of))
        return tuple(out)

    @cached_property
    def support(self) -> NDArray[np.bool_]:
        """Where the regressor can be other than zero: (n, 10 L)."""
        out = np.zeros((self.joints, len(self.listed), 10), dtype=bool)
        for chain in self.chains:
            for k, joint in enumerate(chain.joints):
                via = chain.via[chain.of == k]
                turning = not self.prismatic[via].all()
                out[joint, chain.place, :4], out[joint, chain.place, 4:] = True, turning
                if turning and via.tolist() == [chain.body]:  # a mass at the origin has no moment about it
                    out[joint, chain.place, 0] = False
        return out.reshape(self.joints, -1)


def _across(axis: Array) -> Array:
    """Return the matrices (B, 3, 3) whose products with vectors are cross products of axes (B, 3)."""
    x, y, z = axis.T
    zero = np.zeros_like(x)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)


def _sliced(numbers: Integers) -> Integers | slice:
    first, count = int(numbers[0]), len(numbers)
    return slice(first, first + count) if np.array_equal(numbers, np.arange(first, first + count)) else numbers
