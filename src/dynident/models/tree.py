"""The moving bodies of an arm as arrays: what the recursion over bodies needs, in NumPy and in the kernel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.models.robot_file import Arm

__all__ = ["Chain", "Layout", "Tree"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Chain:
    """How joints move one ``body``, the parameters of which begin at 10 * ``place``: by the bodies ``via`` (V) from the
    base to itself, joint ``joints[k]`` (J) by those where ``of`` (V) is k.
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
        """Return the rates of the bodies ``via`` by those of the joints (J, V), for gains (B)."""
        out = np.zeros((len(self.joints), len(self.via)))
        out[self.of, np.arange(len(self.via))] = gain[self.via]
        return out


@dataclass(frozen=True, eq=False)
class Layout:
    """Which of the B bodies is on which ``parent`` (B; -1: the base), before it in their order, by a joint that is
    ``prismatic`` (B) or turns.

    The positions of these joints are ``drive`` (B, n) @ (positions of the n joints of the arm) + ``rest`` (B), with one
    joint for each body. ``listed`` are the L bodies that have parameters, in the order of these.
    """

    parent: Integers
    prismatic: NDArray[np.bool_]
    drive: Array
    rest: Array
    listed: Integers

    __repr__ = brief

    @classmethod
    def of(cls, arm: Arm) -> Layout:
        """Return the layout of an arm."""
        parent = np.array([-1 if body.parent is None else body.parent for body in arm.bodies], dtype=np.intp)
        prismatic = np.array([body.joint.kind == "prismatic" for body in arm.bodies])
        return cls(parent, prismatic, arm.drive, arm.rest, np.array(arm.listed, dtype=np.intp))

    def __len__(self) -> int:
        return len(self.parent)

    @property
    def joints(self) -> int:
        """The number n of the joints of the arm."""
        return int(self.drive.shape[1])

    @cached_property
    def slides(self) -> bool:
        """Whether any joint is prismatic."""
        return bool(self.prismatic.any())

    @cached_property
    def plain(self) -> bool:
        """Whether each body has a joint of its own, in the order of the bodies."""
        return np.array_equal(self.drive, np.eye(len(self))) and not self.rest.any()

    @cached_property
    def complete(self) -> bool:
        """Whether each body has parameters, in the order of the bodies."""
        return np.array_equal(self.listed, np.arange(len(self)))

    @cached_property
    def column(self) -> Integers:
        """The joint that drives each body (B)."""
        return np.asarray(np.abs(self.drive).argmax(axis=1))

    @cached_property
    def gain(self) -> Array:
        """What a body's position changes with its joint's (B)."""
        return self.drive[np.arange(len(self)), self.column]

    def moved(self, q: Array, dq: Array, ddq: Array) -> tuple[Array, Array, Array]:
        """Return the states (N, B) of the bodies from those of the joints (N, n); ModelError for other shapes."""
        shapes = q.shape, dq.shape, ddq.shape
        if q.ndim != 2 or set(shapes) != {(len(q), self.joints)}:  # the kernel would read beyond what there is
            raise ModelError(f"q, dq and ddq have the shapes {shapes}, expected (N, {self.joints}) of all.")
        if self.plain:
            return q, dq, ddq
        q, dq, ddq = (state[:, self.column] * self.gain for state in (q, dq, ddq))
        return q + self.rest, dq, ddq

    def filled(self, theta: Array) -> Array:
        """Return the parameters (B, 10) of all bodies from those of the listed (10 L); ModelError for another shape."""
        values = np.asarray(theta, dtype=float)
        if values.shape != (size := 10 * len(self.listed),):
            raise ModelError(f"theta has shape {values.shape}, expected ({size},).")
        values = values.reshape(-1, 10)
        if self.complete:
            return np.ascontiguousarray(values)
        out = np.zeros((len(self), 10))
        out[self.listed] = values
        return out

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
    def pairs(self) -> tuple[Integers, Integers]:
        """All pairs of a body, and one that it carries or is."""
        carrier, carried = np.nonzero(self.above.T)
        return carrier, carried

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

    @cached_property
    def tables(self) -> tuple[Integers, Integers, Integers]:
        """What the kernel walks over: parent, whether prismatic and joint of each body (B, 3); of each pair of a body
        and a joint that moves it (P, 4) the body, the entry of its first parameter in the regressor, and where its
        bodies are in the third, with their number.
        """
        rows: list[tuple[int, int, int, int]] = []
        via: list[int] = []
        for chain in self.chains:
            for k, joint in enumerate(chain.joints.tolist()):
                by = chain.via[chain.of == k].tolist()
                rows.append((chain.body, 10 * (joint * len(self.listed) + chain.place), len(via), len(by)))
                via += by
        bodies = np.stack((self.parent, self.prismatic, self.column), axis=1)
        return bodies.astype(np.int64), np.array(rows, dtype=np.int64), np.array(via, dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Tree:
    """The ``layout`` of an arm with its geometry.

    The axes of a body in its parent's frame are turns[0] + sin(q) turns[1] + cos(q) turns[2], ``turns`` (3, B, 3, 3);
    there its origin is at ``origin`` (B, 3), if it does not slide, and the axis of its joint along ``axis`` (B, 3).
    """

    layout: Layout
    turns: Array
    origin: Array
    axis: Array

    __repr__ = brief

    @classmethod
    def of(cls, arm: Arm, layout: Layout) -> Tree:
        """Return the tree of an arm with this layout."""
        own = np.array([body.joint.axis for body in arm.bodies], dtype=float)
        place = np.array([body.placement for body in arm.bodies], dtype=float)
        R, origin = place[:, :3, :3], place[:, :3, 3].copy()
        origin[layout.parent < 0] -= place[0, :3, 3]  # numbers are small, wherever the base stands
        x, y, z = own.T
        across = np.zeros_like(R)
        across[:, 2, 1], across[:, 0, 2], across[:, 1, 0] = x, y, z
        across -= across.swapaxes(1, 2)
        along = R @ (own[:, :, None] * own[:, None, :])
        turns = np.array([along, R @ across, R - along])
        turns[:, layout.prismatic], turns[0, layout.prismatic] = 0.0, R[layout.prismatic]
        return cls(layout, turns, origin, (R @ own[:, :, None])[..., 0])


def _sliced(numbers: Integers) -> Integers | slice:
    first, count = int(numbers[0]), len(numbers)
    return slice(first, first + count) if np.array_equal(numbers, np.arange(first, first + count)) else numbers
