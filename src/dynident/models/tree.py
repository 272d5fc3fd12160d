"""The moving bodies of an arm as arrays: what the recursion over bodies needs, in NumPy and in the kernel."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.models.robot_files import Arm
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

Integers = NDArray[np.intp]


class Chain(Noun):
    """How the joints of the arm move one ``body``, whose parameters begin at 10 * ``place``.

    The bodies ``via`` (V) lead from the base to the body itself; joint ``joints[k]`` (J) moves those where
    ``joint_place`` (V) is k.
    """

    body: int
    place: int
    via: Integers
    joints: Integers
    joint_place: Integers

    @cached_property
    def path(self) -> Integers | slice:
        """The indices ``via``, as a slice where they are contiguous: a slice takes no copy."""
        return _as_slice(self.via)

    @cached_property
    def joint_index(self) -> Integers | slice:
        """The indices ``joints``, as a slice where they are contiguous."""
        return _as_slice(self.joints)

    def shares(self, gain: Array) -> Array:
        """Return the rates of the bodies ``via`` by those of the joints (J, V), for gains (B)."""
        out = np.zeros((len(self.joints), len(self.via)))
        out[self.joint_place, np.arange(len(self.via))] = gain[self.via]
        return out


class Layout(Noun):
    """Which of the B bodies is on which ``parent`` (B; -1: the base), and by what kind of joint.

    A parent comes before its children; the joint is ``prismatic`` (B) or turns. The positions of these joints are
    ``drive`` (B, n) @ (positions of the n joints of the arm) + ``offset`` (B), with one joint for each body.
    ``parameter_bodies`` are the L bodies that have parameters, in the order of these.
    """

    parent: Integers
    prismatic: NDArray[np.bool_]
    drive: Array
    offset: Array
    parameter_bodies: Integers

    @classmethod
    def of(cls, arm: Arm) -> Layout:
        """Return the layout of an arm."""
        parent = np.array([-1 if body.parent is None else body.parent for body in arm.bodies], dtype=np.intp)
        prismatic = np.array([body.joint.kind == "prismatic" for body in arm.bodies])
        return cls(parent, prismatic, arm.drive, arm.offset, np.array(arm.parameter_bodies, dtype=np.intp))

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def joints(self) -> int:
        """The number n of the joints of the arm."""
        return int(self.drive.shape[1])

    @cached_property
    def is_identity(self) -> bool:
        """Whether each body has a joint of its own, in the order of the bodies."""
        return np.array_equal(self.drive, np.eye(len(self))) and not self.offset.any()

    @cached_property
    def is_complete(self) -> bool:
        """Whether each body has parameters, in the order of the bodies."""
        return np.array_equal(self.parameter_bodies, np.arange(len(self)))

    @cached_property
    def column(self) -> Integers:
        """The joint that drives each body (B)."""
        return np.asarray(np.abs(self.drive).argmax(axis=1))

    @cached_property
    def gain(self) -> Array:
        """The factor (B) between the position of a body's joint and that of the joint that drives it."""
        return self.drive[np.arange(len(self)), self.column]

    def body_states(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        """Return the states (N, B) of the bodies from those of the joints (N, n); ModelError for other shapes."""
        shapes = q.shape, dq.shape, ddq.shape
        if q.ndim != 2 or set(shapes) != {(len(q), self.joints)}:  # the kernel would read beyond what there is
            raise ModelError(f"q, dq and ddq have the shapes {shapes}, expected (N, {self.joints}) of all.")
        if self.is_identity:
            return q, dq, ddq
        q, dq, ddq = (state[:, self.column] * self.gain for state in (q, dq, ddq))
        return q + self.offset, dq, ddq

    def expand_parameters(self, theta: Array) -> Array:
        """Return the parameters (B, 10) of all bodies from those (10 L) of the bodies that have any.

        Raises ModelError for another shape.
        """
        values = np.asarray(theta, dtype=float)
        if values.shape != (size := 10 * len(self.parameter_bodies),):
            raise ModelError(f"theta has shape {values.shape}, expected ({size},).")
        values = values.reshape(-1, 10)
        if self.is_complete:
            return np.ascontiguousarray(values)
        out = np.zeros((len(self), 10))
        out[self.parameter_bodies] = values
        return out

    @cached_property
    def hosts(self) -> Integers | slice:
        """The places of the parents (B) where the base comes before the bodies."""
        return _as_slice(self.parent + 1)

    @cached_property
    def above(self) -> Array:
        """Ones (B, B) where the body of the row is that of the column or carried by it, zeros elsewhere."""
        out = np.eye(len(self))
        # parents come first, so that their rows are complete
        for k, parent in enumerate(self.parent):
            if parent >= 0:
                out[k] += out[parent]
        return out

    @cached_property
    def pairs(self) -> tuple[Integers, Integers]:
        """All pairs of a body, and one that it carries or is."""
        carrier, carried = np.nonzero(self.above.T)
        return carrier, carried

    @cached_property
    def chains(self) -> tuple[Chain, ...]:
        """How the joints move each body that has parameters, in the order of the bodies."""
        out = []
        for place in np.argsort(self.parameter_bodies):
            body = int(self.parameter_bodies[place])
            via = np.flatnonzero(self.above[body])
            joints, joint_place = np.unique(self.column[via], return_inverse=True)
            out.append(Chain(body, int(place), via, joints, joint_place))
        return tuple(out)

    @cached_property
    def support(self) -> NDArray[np.bool_]:
        """Where the regressor can be other than zero: (n, 10 L)."""
        out = np.zeros((self.joints, len(self.parameter_bodies), 10), dtype=bool)
        for chain in self.chains:
            for k, joint in enumerate(chain.joints):
                via = chain.via[chain.joint_place == k]
                turning = not self.prismatic[via].all()
                out[joint, chain.place, :4], out[joint, chain.place, 4:] = True, turning
                if turning and via.tolist() == [chain.body]:  # a mass at the origin has no moment about it
                    out[joint, chain.place, 0] = False
        return out.reshape(self.joints, -1)


class Tree(Noun):
    """The ``layout`` of an arm with its geometry.

    The axes of a body in its parent's frame are turns[0] + sin(q) turns[1] + cos(q) turns[2], ``turns`` (3, B, 3, 3);
    there its origin is at ``origin`` (B, 3), if it does not slide, and the axis of its joint along ``axis`` (B, 3).
    """

    layout: Layout
    turns: Array
    origin: Array
    axis: Array

    @classmethod
    def of(cls, arm: Arm, layout: Layout) -> Tree:
        """Return the tree of an arm with this layout."""
        axes = np.array([body.joint.axis for body in arm.bodies], dtype=float)
        place = np.array([body.placement for body in arm.bodies], dtype=float)
        R, origin = place[:, :3, :3], place[:, :3, 3].copy()
        origin[layout.parent < 0] -= place[0, :3, 3]  # numbers are small, wherever the base stands
        # Rodrigues: a turn by q about the axis z is z z' + sin(q) [z] + cos(q) (1 - z z')
        x, y, z = axes.T
        across = np.zeros_like(R)
        across[:, 2, 1], across[:, 0, 2], across[:, 1, 0] = x, y, z
        across -= across.swapaxes(1, 2)
        along = R @ (axes[:, :, None] * axes[:, None, :])
        turns = np.array([along, R @ across, R - along])
        turns[:, layout.prismatic], turns[0, layout.prismatic] = 0.0, R[layout.prismatic]
        return cls(layout, turns, origin, (R @ axes[:, :, None])[..., 0])


def _as_slice(numbers: Integers) -> Integers | slice:
    start, count = int(numbers[0]), len(numbers)
    return slice(start, start + count) if np.array_equal(numbers, np.arange(start, start + count)) else numbers
