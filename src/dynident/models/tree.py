"""The moving bodies of an arm as arrays: what the recursion over bodies needs, in NumPy and in the kernel."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.models.inertia import change_frame
from dynident.models.robot_files import Arm
from dynident.runtime import ModelError, brief

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Chain:
    """How the joints of the arm move one ``body``, whose parameters begin at 10 * ``place``.

    The bodies ``via`` (V) lead from the base to the body itself; joint ``joints[k]`` (J) moves those where
    ``joint_place`` (V) is k.
    """

    body: int
    place: int
    via: Integers
    joints: Integers
    joint_place: Integers

    __repr__ = brief

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


@dataclass(frozen=True, eq=False)
class Layout:
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

    __repr__ = brief

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


AT_ONCE = 6000  # samples times bodies: temporary arrays stay in the cache
INERTIAS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))
SQUARES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))  # of w
EPSILON = np.zeros((3, 3, 3))  # that of Levi-Civita
EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]], EPSILON[[0, 1, 2], [2, 0, 1], [1, 2, 0]] = 1.0, -1.0


def _symmetric(pairs: tuple[tuple[int, int], ...]) -> Array:
    """Return the matrices (6, 3, 3) whose sum, weighted by the entries at ``pairs``, is a symmetric matrix."""
    out = np.zeros((6, 3, 3))
    for matrix, (i, j) in zip(out, pairs, strict=True):
        matrix[i, j] = matrix[j, i] = 1.0
    return out


TENSORS = _symmetric(INERTIAS)
TURNS = _symmetric(SQUARES) - np.trace(_symmetric(SQUARES), axis1=1, axis2=2)[:, None, None] * np.eye(3)  # [w][w]


def _wrenches() -> Array:
    """Return the matrices (6, 10, 12) of moment and force by parameter, and by dw, acceleration and squares of w."""
    out = np.zeros((6, 10, 12))
    dw, a, ww = out[..., :3], out[..., 3:6], out[..., 6:]
    # force = m a + dw x h + w x (w x h)
    a[3:, 0] = np.eye(3)
    # moment = h x a + I dw + w x I w
    a[:3, 1:4] = EPSILON
    dw[3:, 1:4] = EPSILON.swapaxes(1, 2)
    ww[3:, 1:4] = TURNS.transpose(1, 2, 0)
    dw[:3, 4:] = TENSORS.transpose(1, 0, 2)
    ww[:3, 4:] = np.einsum("ijk,ckl,pjl->icp", EPSILON, TENSORS, _symmetric(SQUARES))
    return out


WRENCHES = _wrenches()


class NewtonEuler:
    """The recursion for a ``tree`` under ``gravity`` (3), m/s^2.

    States q, dq, ddq (B, N) are those of the joints of its B bodies.
    """

    def __init__(self, tree: Tree, gravity: Array) -> None:
        self.layout, self.gravity = tree.layout, gravity
        # constant rotations at q = 0, and axes of the bodies with z along the axis of the joint
        R = tree.turns[0] + tree.turns[2]
        Q = _rotate_z_to_axes(np.einsum("bij,bi->bj", R, tree.axis))
        host = np.concatenate([np.eye(3)[None], Q])[tree.layout.parent + 1].swapaxes(1, 2)
        back, origin = (host @ R @ Q).swapaxes(1, 2), np.einsum("bij,bj->bi", host, tree.origin)
        cross = np.einsum("ijk,bj->bik", EPSILON, origin)
        self.moves = np.zeros((len(R), 9, 15))  # w, dw, a of a body by those of its parent, and the squares
        # w, dw and a of the parent in the axes of the body, and a at the body's origin: a + dw x r + w x (w x r)
        for k in range(3):
            self.moves[:, 3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = back
        self.moves[:, 6:, 3:6] = -back @ cross
        self.moves[:, 6:, 9:] = back @ np.einsum("cij,bj->bic", TURNS, origin)
        self.screws = np.zeros((len(R), 6, 6))  # rates of rotation and origin by the same of the parent
        self.screws[:, :3, :3] = self.screws[:, 3:, 3:] = back
        self.screws[:, 3:, :3] = -back @ cross
        self.wrenches = np.einsum("rci,bcd->brdi", WRENCHES, _rotate_parameters(Q))

    __repr__ = brief

    def torque(self, states: list[Array], theta: Array) -> Array:
        """Return the torques (B, N) of the joints of bodies with parameters ``theta`` (B, 10)."""
        layout, out = self.layout, np.empty(states[0].shape)
        wrenches = np.einsum("brdi,bd->bri", self.wrenches, theta)
        for part, turn, motion in self._motions(states):
            F = wrenches @ motion[1:, 3:]
            # from the tips to the base: the torque is the wrench along z, the rest goes on to the parent
            for k in range(len(layout) - 1, -1, -1):
                out[k, part] = F[k, 5 if layout.prismatic[k] else 2]
                if layout.parent[k] >= 0:
                    self._across(k, turn, F[k], -1.0)
                    F[layout.parent[k]] += self.screws[k].T @ F[k]
        return out

    def columns(self, states: list[Array], roles: dict[int, Integers]) -> Iterator[tuple[slice, int, Array]]:
        """Yield the columns (R, V, S) of the parameters of bodies in the torques of the joints that carry them.

        They come by block of samples and, in each, by body k of ``roles``: those of its parameters ``roles[k]`` (R),
        which increase, in the torques of the bodies above it and its own (V).
        """
        for part, turn, motion in self._motions(states):
            size, screws = motion.shape[2], list[Array]()
            for k, parent in enumerate(self.layout.parent):
                # screws of the joints above at the origin of the body, and at last that of its own joint, along z
                above = screws[parent] if parent >= 0 else np.empty((0, 6, size))
                body_screws = np.zeros((len(above) + 1, 6, size))
                np.matmul(self.screws[k], above, out=body_screws[:-1])
                self._across(k, turn, body_screws[:-1], 1.0)
                body_screws[-1, 5 if self.layout.prismatic[k] else 2] = 1.0
                screws.append(body_screws)
                if k in roles:
                    yield part, k, self._products(k, roles[k], motion[k + 1, 3:], body_screws)

    def _products(self, k: int, roles: Integers, motion: Array, screws: Array) -> Array:
        """Return the products (R, V, S) of screws (V, 6, S) with the wrenches of parameters of body k."""
        turns, pushes = roles[roles > 0], roles[roles < 4]  # a mass has no moment, an inertia no force
        moments, forces = (
            (self.wrenches[k, rows][:, picked].reshape(-1, 12) @ motion).reshape(3, len(picked), motion.shape[1])
            for rows, picked in ((slice(3), turns), (slice(3, 6), pushes))
        )
        out = np.zeros((len(roles), len(screws), motion.shape[1]))
        turn_columns, push_columns = out[len(roles) - len(turns) :], out[: len(pushes)]
        np.einsum("irs,vis->rvs", moments, screws[:-1, :3], out=turn_columns[:, :-1])
        push_columns[:, :-1] += np.einsum("irs,vis->rvs", forces, screws[:-1, 3:])
        turn_columns[:, -1] = 0.0 if self.layout.prismatic[k] else moments[2]  # its own joint is along z
        push_columns[:, -1] += forces[2] if self.layout.prismatic[k] else 0.0
        return out

    def _motions(self, states: list[Array]) -> Iterator[tuple[slice, Array, Array]]:
        """Yield the motion of the bodies by block of samples: the slice of the samples, joint states, and motions.

        The joint states (3, B, S) are cosine and sine of the joints that turn, and the positions of those that slide;
        the motions (B + 1, 15, S) are w, dw, a and the squares of w, first those of the base.
        """
        # blocks of samples whose temporary arrays stay in the cache
        step = max(AT_ONCE // len(self.layout), 1)
        for start in range(0, states[0].shape[1], step):
            q, dq, ddq = (state[:, start : start + step] for state in states)
            turn, out = np.stack((np.cos(q), np.sin(q), q)), np.empty((len(q) + 1, 15, q.shape[1]))
            out[0] = 0.0
            # gravity enters as an acceleration of the base, so that bodies need no weight
            out[0, 6:9] = -self.gravity[:, None]
            for k, parent in enumerate(self.layout.parent):
                body_motion = out[k + 1]
                np.matmul(self.moves[k], out[parent + 1], out=body_motion[:9])
                self._add_joint_motion(k, turn, body_motion, dq[k], ddq[k])
                # the six products w w' in the order of SQUARES
                np.multiply(body_motion[0], body_motion[:3], out=body_motion[9:12])
                np.multiply(body_motion[1], body_motion[1:3], out=body_motion[12:14])
                np.multiply(body_motion[2], body_motion[2], out=body_motion[14])
            yield slice(start, start + step), turn, out

    def _add_joint_motion(self, k: int, turn: Array, motion: Array, dq: Array, ddq: Array) -> None:
        """Add the share of its joint to the motion of body k, in place."""
        w, dw, a = motion[:3], motion[3:6], motion[6:9]
        if self.layout.prismatic[k]:
            q = turn[2, k]
            a[0] += q * (dw[1] + w[0] * w[2]) + 2 * w[1] * dq
            a[1] += q * (w[1] * w[2] - dw[0]) - 2 * w[0] * dq
            a[2] += ddq - q * (w[0] * w[0] + w[1] * w[1])
            return
        _rotate(motion[:9], turn[0, k], turn[1, k], 1.0)
        w[2] += dq
        dw[0] += w[1] * dq
        dw[1] -= w[0] * dq
        dw[2] += ddq

    def _across(self, k: int, turn: Array, pairs: Array, sign: float) -> None:
        """Carry pairs of vectors (..., 6, S) across the joint of body k in place: screws, or wrenches back (-1)."""
        if not self.layout.prismatic[k]:
            _rotate(pairs, turn[0, k], turn[1, k], sign)
        elif sign > 0:
            pairs[..., 3, :] += turn[2, k] * pairs[..., 1, :]
            pairs[..., 4, :] -= turn[2, k] * pairs[..., 0, :]
        else:
            pairs[..., 0, :] -= turn[2, k] * pairs[..., 4, :]
            pairs[..., 1, :] += turn[2, k] * pairs[..., 3, :]


def _rotate(vectors: Array, cosine: Array, sine: Array, sign: float) -> None:
    """Rotate the x and y of vectors (..., 3 V, S) in place by minus the angle, or by the angle where ``sign`` is -1."""
    x, y = vectors[..., 0::3, :], vectors[..., 1::3, :]
    sine_x, sine_y = sign * sine * x, sign * sine * y
    x *= cosine
    y *= cosine
    x += sine_y
    y -= sine_x


def _rotate_z_to_axes(axes: Array) -> Array:
    """Return rotations (B, 3, 3) of z to unit vectors (B, 3)."""
    # the unit vector farthest from the axis makes the cross product well conditioned
    helper = np.eye(3)[np.abs(axes).argmin(axis=1)]
    x = np.cross(helper, axes)
    x /= np.linalg.norm(x, axis=1)[:, None]
    return np.stack((x, np.cross(axes, x), axes), axis=2)


def _rotate_parameters(Q: Array) -> Array:
    """Return the matrices (B, 10, 10) that take the parameters of bodies to the axes Q (B, 3, 3)."""
    pose = np.tile(np.eye(4), (len(Q), 1, 1, 1))
    pose[:, 0, :3, :3] = Q.swapaxes(1, 2)
    return change_frame(np.eye(10), pose).swapaxes(1, 2)
