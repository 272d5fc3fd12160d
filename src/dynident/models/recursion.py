"""Rigid-body dynamics of a tree of joints for many samples at once, by NumPy.

All vectors have the axes of the base; those of a body are about the origin of its joint frame. Motions go from the base
to the tips, and the torque of a joint is what its axis takes of the wrench of all that it carries (Featherstone 2008,
"Rigid body dynamics algorithms"). The derivatives need also the momentum, and the moments U = sum v r' dm of the
velocity, of what a joint carries (Singh, Russo and Wensing 2022, "Efficient analytical derivatives of rigid-body
dynamics using spatial vector algebra"; 12 numbers remain of their 6 x 6 matrices). Arrays begin with the components of
vectors, and end with bodies and samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.models.inertia import cross, diagonal, dot, matmul, matvec, outer, transposed_matvec
from dynident.models.tree import Chain, Layout, Tree
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Integers = NDArray[np.intp]
AT_ONCE = 12_000  # samples times bodies: temporary arrays stay in the cache
INERTIAS = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))  # rows and columns of the inertia, as INERTIAL has them


class Recursion(Noun):
    """The dynamics of a ``tree`` under ``gravity`` (3), m/s^2, for states q, dq, ddq (N, n) of its joints.

    ``theta`` (B, 10) holds the parameters of the bodies, any numbers. ``CompiledRecursion`` is the same in C.
    """

    tree: Tree
    gravity: Array

    @property
    def layout(self) -> Layout:
        """The layout of the tree."""
        return self.tree.layout

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y (N, n, 10 L) for the parameters of the L listed bodies."""
        layout = self.layout
        Y = np.zeros((len(q), layout.joints, len(layout.parameter_bodies), 10))
        for part, motion in self._motions(q, dq, ddq):
            for chain in layout.chains:
                Y[part, chain.joint_index, chain.place] = self._columns(motion, chain).T
        return Y.reshape(len(q), layout.joints, 10 * len(layout.parameter_bodies))

    def entries(self, q: Array, dq: Array, ddq: Array, joint: Integers, parameter: Integers) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows (M, N)."""
        out = np.zeros((len(joint), len(q)))
        place, role = np.divmod(parameter, 10)
        # per body: which entries are of its parameters, and where they are in its columns
        sources = []
        for chain in self.layout.chains:
            selected = np.flatnonzero((place == chain.place) & np.isin(joint, chain.joints))
            if len(selected):
                sources.append((chain, selected, (role[selected], np.searchsorted(chain.joints, joint[selected]))))
        for part, motion in self._motions(q, dq, ddq):
            for chain, selected, source in sources:
                out[selected, part] = self._columns(motion, chain)[source]
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the inverse dynamics (N, n)."""
        tau = np.empty((len(q), len(self.layout)))
        for part, motion in self._motions(q, dq, ddq):
            tau[part] = _CompositeBodies(motion, theta).torque.T
        return tau if self.layout.is_identity else tau @ self.layout.drive

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration."""
        bodies, drive = len(self.layout), self.layout.drive
        mass, bias = np.zeros((len(q), bodies, bodies)), np.empty((len(q), bodies))
        # composite bodies: a unit acceleration of joint k takes a wrench on all k carries, which joints j above feel
        j, k = self.layout.pairs
        for part, motion in self._motions(q, dq, np.zeros_like(dq)):
            load = _CompositeBodies(motion, theta)
            bias[part] = load.torque.T
            force, moment = load.inertial_wrench
            w, u = motion.screws(j, k)
            mass[part, j, k] = mass[part, k, j] = (dot(w, moment[:, k]) + dot(u, force[:, k])).T
        return (mass, bias) if self.layout.is_identity else (drive.T @ mass @ drive, bias @ drive)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the derivatives (3, N, n, n) of the torque by q, dq and ddq."""
        bodies, drive = len(self.layout), self.layout.drive
        out = np.zeros((3, len(q), bodies, bodies))
        j, k = self.layout.pairs
        for part, motion in self._motions(q, dq, ddq):
            load = _CompositeBodies(motion, theta)
            w, u = motion.screws(j, k)
            by_push, by_turn = load.inertial_wrench
            by_turn = by_turn[:, k] + cross(motion.away(j, k), by_push[:, k])
            # j is above k: the torque of k changes by the motion that j adds, that of j by the wrench of k
            for slope, change in zip(out, motion.changes, strict=True):
                bends, turns, pushes = (part_change[:, j] for part_change in change)
                force, moment = load.change_wrench(*change)
                slope[part, k, j] = (
                    dot(load.bend_torques[:, k], bends) + dot(by_turn, turns) + dot(by_push[:, k], pushes)
                ).T
                # a change of position turns the wrench of all that is carried, too
                if change is motion.changes[0]:
                    force, moment = load.add_wrench_motion(force, moment)
                slope[part, j, k] = (dot(w, moment[:, k]) + dot(u, force[:, k])).T  # of a joint itself, too
        return out if self.layout.is_identity else np.asarray(drive.T @ out @ drive)

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array) -> Array:
        """Return the derivatives (3, N, n) of the sums <G_i, Y_i> by q, dq and ddq, for weights G (N, n, 10 L)."""
        layout = self.layout
        weights = weights.reshape(len(q), layout.joints, len(layout.parameter_bodies), 10)
        out = np.empty((3, len(q), len(layout)))
        for part, motion in self._motions(q, dq, ddq):
            for slope, gradient in zip(out, _GradientSums(motion, weights[part]).slopes, strict=True):
                slope[part] = gradient.T
        return out if layout.is_identity else out @ layout.drive

    def _columns(self, motion: _Motion, chain: Chain) -> Array:
        """Return the torques (10, J, S) of the joints that move a body per unit of each of its parameters."""
        columns = motion.columns(chain)
        return columns if self.layout.is_identity else np.asarray(chain.shares(self.layout.gain) @ columns)

    def _motions(self, q: Array, dq: Array, ddq: Array) -> Iterator[tuple[slice, _Motion]]:
        """Yield the motion of the bodies by block of samples."""
        states = [np.ascontiguousarray(state.T) for state in self.layout.body_states(q, dq, ddq)]
        # blocks of samples whose temporary arrays stay in the cache
        step = max(AT_ONCE // len(self.layout), 1)
        for start in range(0, len(q), step):
            part = slice(start, start + step)
            yield part, _Motion(self.tree, self.gravity, *(state[:, part] for state in states))


class _Motion:
    """The motion of the bodies, in the axes of the base.

    These are the axes R (3, 3, B, N) of the bodies; the axes of joints that turn, zw (3, B, N), and of those that
    slide, zu (None: none slides); origins p, and from those of the parents d; velocities v and accelerations a of
    the origins, the latter less gravity; rotation w and dw, of the bodies and of their parents.
    """

    def __init__(self, tree: Tree, gravity: Array, q: Array, dq: Array, ddq: Array) -> None:
        self.layout = layout = tree.layout
        constant_part, sine_part, cosine_part = tree.turns.transpose(0, 2, 3, 1)[..., None]
        relative = sine_part * np.sin(q)
        relative += cosine_part * np.cos(q)
        relative += constant_part
        R, hosts = np.empty((3, 3, len(layout) + 1, q.shape[1])), layout.hosts  # the first is that of the base
        R[:, :, 0] = np.eye(3)[..., None]
        # rotations from the base to the tips; all sums over carriers below are products with ``above``
        for k, parent in enumerate(layout.parent):
            R[:, :, k + 1] = matmul(R[:, :, parent + 1], relative[:, :, k])
        self.R, base = R[:, :, 1:], R[:, :, hosts]
        z, d = matvec(base, tree.axis.T[..., None]), matvec(base, tree.origin.T[..., None])
        rate, gain, slides = z * dq, z * ddq, bool(layout.prismatic.any())
        self.d, self.zw, self.zu, spin = d, z, None, rate
        if slides:
            spins, slide = ~layout.prismatic[:, None], layout.prismatic[:, None]
            self.d, self.zw, self.zu, spin = d + slide * z * q, spins * z, slide * z, spins * rate
        self.p, w = layout.above @ self.d, _sum_from_base(layout, spin)
        self.w, self.w_parent = w[:, 1:], w[:, hosts]
        # dw of a joint: its own acceleration along z, and the change of z with the parent
        gain += cross(self.w_parent, rate)
        dw = _sum_from_base(layout, spins * gain if slides else gain)
        self.dw, self.dw_parent = dw[:, 1:], dw[:, hosts]
        # velocity and acceleration of an origin in the rotating frame of its parent
        self.swept = cross(self.w_parent, self.d)
        origin_acceleration = cross(self.dw_parent, self.d)
        origin_acceleration += cross(self.w_parent, self.swept)
        if slides:
            # a joint that slides adds its rate and its acceleration, half of the Coriolis term being in ``gain``
            self.swept += slide * rate
            origin_acceleration += slide * (gain + cross(self.w_parent, rate))
        self.a = layout.above @ origin_acceleration - gravity[:, None, None]

    @cached_property
    def v(self) -> Array:
        """The velocities of the origins."""
        return np.asarray(self.layout.above @ self.swept)

    def away(self, j: Integers | slice, k: Integers | int) -> Array:
        """Return the vectors (3, P, N) from origins j to origins k."""
        return np.asarray((self.p[:, k, None] if isinstance(k, int) else self.p[:, k]) - self.p[:, j])

    def screws(self, j: Integers | slice, k: Integers | int) -> tuple[Array, Array]:
        """Return rotation and velocity (3, P, N) of origins k by unit rates of the joints of bodies j."""
        w = self.zw[:, j]
        u = cross(w, self.away(j, k))
        if self.zu is not None:
            u += self.zu[:, j]
        return w, u

    def columns(self, chain: Chain) -> Array:
        """Return the torques (10, V, N) of the joints above a body per unit of each of its parameters."""
        k, out = chain.body, np.empty((10, len(chain.via), self.w.shape[2]))
        # in the axes of the body, in which its parameters are constant
        R = self.R[:, :, k, None]
        w, dw, a = (transposed_matvec(R, vectors[:, k, None]) for vectors in (self.w, self.dw, self.a))
        W, U = (transposed_matvec(R, vectors) for vectors in self.screws(chain.path, k))
        # the Newton-Euler equations as products of the screws W, U with force and moment, sorted by parameter
        out[0], out[1:4], spin = dot(U, a), cross(U, dw) + cross(w, cross(w, U)) + cross(a, W), cross(W, w)
        for row, (i, j) in zip(out[4:], INERTIAS, strict=True):
            row[:] = W[i] * dw[j] + spin[i] * w[j]
            if i != j:
                row += W[j] * dw[i] + spin[j] * w[i]
        return out

    @cached_property
    def changes(self) -> tuple[tuple[Array, Array, Array], ...]:
        """How a unit change of q, of dq, and of ddq of a body's joint changes the accelerations of what it carries.

        Each is a triple bends, turns, pushes: the acceleration at r from the origin of the body changes by ``pushes``
        + ``turns`` x r + 2 ``bends`` x (velocity).
        """
        w, dw, z, slide, zero = self.w_parent, self.dw_parent, self.zw, self.zu, np.zeros_like(self.zw)
        wz = cross(w, z)
        by_q = wz, cross(dw, z) + cross(w, wz), cross(self.a, z) - 2 * cross(wz, self.v)
        by_dq = z, 2 * wz, -2 * cross(z, self.v)
        if slide is None:
            return by_q, by_dq, (zero, z, zero)
        across = cross(w, slide)
        return (
            (*by_q[:2], by_q[2] + cross(dw, slide) + cross(w, across)),
            (*by_dq[:2], by_dq[2] + 2 * across),
            (zero, z, slide),
        )


class _CompositeBodies:
    """Sums over each body and all that it carries, about its origin.

    These are force and moment (3, B, N); mass, first and second moments of mass; momentum, and moments of
    velocity.
    """

    def __init__(self, motion: _Motion, theta: Array) -> None:
        self.motion = motion
        self.below, self.inner = motion.layout.above.T, motion.layout.above.T - np.eye(len(theta))
        R, w, dw, a, columns = motion.R, motion.w, motion.dw, motion.a, theta.T[..., None]
        self.m, self.h = columns[0], matvec(R, columns[1:4])
        tensor = columns[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3, -1, 1)
        self.J = matmul(matmul(R, tensor), R.swapaxes(0, 1))
        # Newton-Euler equations of each body alone, about the origin of its frame
        force = self.m * a + cross(dw, self.h) + cross(w, cross(w, self.h))
        moment = cross(self.h, a) + matvec(self.J, dw) + cross(w, matvec(self.J, w))
        # sums over what is carried; a force acts on the parent with the arm d
        self.force = self.below @ force
        self.moment = self.below @ moment + self.inner @ cross(motion.d, self.force)

    @property
    def torque(self) -> Array:
        """The torque (B, N) of each body's joint."""
        tau = dot(self.motion.zw, self.moment)
        return tau if self.motion.zu is None else tau + dot(self.motion.zu, self.force)

    @cached_property
    def masses(self) -> tuple[Array, Array, Array]:
        """Mass (B, 1), first moment (3, B, N) and tensor (3, 3, B, N)."""
        d, m = self.motion.d, self.below @ self.m
        # parallel axes: shift the moments of what is carried by d, to the origin of the parent
        shift = m * d
        h = self.below @ self.h + self.inner @ shift
        shifted = h + shift
        shift_tensor = diagonal(dot(h, d) + dot(shifted, d)) - outer(h, d) - outer(d, shifted)
        return m, h, self.below @ self.J + self.inner @ shift_tensor

    @cached_property
    def inertial_wrench(self) -> tuple[Array, Array]:
        """Force and moment (3, B, N) by a unit acceleration of each body's joint."""
        (m, h, J), z, slide = self.masses, self.motion.zw, self.motion.zu
        force, moment = cross(z, h), matvec(J, z)
        return (force, moment) if slide is None else (force + m * slide, moment + cross(h, slide))

    @cached_property
    def flow(self) -> tuple[Array, Array]:
        """Momentum (3, B, N), and 2 (tr(U) - U) (3, 3, B, N) of the moments of velocity U."""
        motion, J = self.motion, self.J
        # the second moments of mass, tr(J)/2 E - J, give those of the velocity w x r
        second_moments = diagonal(0.5 * (J[0, 0] + J[1, 1] + J[2, 2])) - J
        momentum = self.below @ (self.m * motion.v + cross(motion.w, self.h))
        rotation_part = cross(motion.w[:, None], second_moments)
        U = self.below @ (outer(motion.v, self.h) + rotation_part) + self.inner @ outer(momentum, motion.d)
        return momentum, 2 * (diagonal(U[0, 0] + U[1, 1] + U[2, 2]) - U)

    @cached_property
    def bend_torques(self) -> Array:
        """The torque (3, B, N) of each body's joint by unit ``bends`` of the accelerations."""
        momentum, T = self.flow
        torques = transposed_matvec(T, self.motion.zw)
        return torques if self.motion.zu is None else torques + 2 * cross(momentum, self.motion.zu)

    def change_wrench(self, bends: Array, turns: Array, pushes: Array) -> tuple[Array, Array]:
        """Return the changes of force and moment (3, B, N) by those of the accelerations."""
        (m, h, J), (momentum, T) = self.masses, self.flow
        force = m * pushes + cross(turns, h) + 2 * cross(bends, momentum)
        return force, cross(h, pushes) + matvec(J, turns) + matvec(T, bends)

    def add_wrench_motion(self, force: Array, moment: Array) -> tuple[Array, Array]:
        """Return the changes of force and moment with that of a wrench that the joint moves along."""
        z, slide = self.motion.zw, self.motion.zu
        force, moment = force + cross(z, self.force), moment + cross(z, self.moment)
        return (force, moment) if slide is None else (force, moment + cross(slide, self.force))


class _GradientSums:
    """The derivatives (3, B, N) of the sum <G, Y> of each sample by the motion of each body.

    They are by unit changes of its rotation (``bends``), of the acceleration of its rotation (``turns``) and of
    that of its origin (``pushes``), as in ``_Motion.changes``; ``crossed`` (B, N) is the derivative by each
    joint's q through the screws.
    """

    def __init__(self, motion: _Motion, weights: Array) -> None:
        self.motion, layout = motion, motion.layout
        self.bends, self.turns, self.pushes = np.zeros((3, *motion.w.shape))
        self.crossed = np.zeros(motion.w.shape[1:])
        for chain in layout.chains:
            theta = weights[:, layout.column[chain.via], chain.place] * layout.gain[chain.via, None]
            self._add(chain, np.ascontiguousarray(theta.T))

    @property
    def slopes(self) -> list[Array]:
        """The derivatives (B, N) by q, dq and ddq."""
        motion, below = self.motion, self.motion.layout.above.T
        # a change of a joint moves all that it carries: sum, and shift pushes to the joint's origin
        bends, pushes = below @ self.bends, below @ self.pushes
        turns = below @ self.turns + (below - np.eye(len(below))) @ cross(motion.d, pushes)
        derivatives = [
            dot(bends, change[0]) + dot(turns, change[1]) + dot(pushes, change[2]) for change in motion.changes
        ]
        return [derivatives[0] - self.crossed, *derivatives[1:]]

    def _add(self, chain: Chain, theta: Array) -> None:
        """Add the torques of one body at the joints above it, where each joint has its own parameters (10, V, N)."""
        motion, k = self.motion, chain.body
        # in the axes of the body, in which its parameters are constant
        R = motion.R[:, :, k, None]
        w, dw, a = (transposed_matvec(R, vectors[:, k, None]) for vectors in (motion.w, motion.dw, motion.a))
        W, U = (transposed_matvec(R, vectors) for vectors in motion.screws(chain.path, k))
        m, h, J = theta[0], theta[1:4], theta[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3, *theta.shape[1:])
        wh, Jw = cross(w, h), matvec(J, w)
        force, moment = m * a + cross(dw, h) + cross(w, wh), cross(h, a) + matvec(J, dw) + cross(w, Jw)
        # a joint moves the screws of those before it, which take the wrench
        wrench_above = [
            np.cumsum(vectors, axis=1) - vectors for vectors in (cross(W, moment) + cross(U, force), cross(W, force))
        ]
        self.crossed[chain.via] += dot(W, wrench_above[0]) + dot(U, wrench_above[1])
        pushes, turns = m * U + cross(W, h), cross(h, U) + matvec(J, W)
        spins = cross(wh, U) + cross(h, cross(U, w)) + cross(Jw, W) + matvec(J, cross(W, w))
        spin, self.turns[:, k], self.pushes[:, k] = (matvec(R[:, :, 0], x.sum(axis=1)) for x in (spins, turns, pushes))
        self.bends[:, k] = spin + cross(motion.w[:, k], self.turns[:, k]) + 2 * cross(motion.v[:, k], self.pushes[:, k])


def _sum_from_base(layout: Layout, vectors: Array) -> Array:
    """Return the sums (3, B + 1, N) of vectors over the bodies from the base, which is the first, to each."""
    out = np.zeros((3, len(layout) + 1, vectors.shape[2]))
    np.matmul(layout.above, vectors, out=out[:, 1:])
    return out
