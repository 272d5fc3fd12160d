"""Rigid-body dynamics of a tree of joints for many samples at once, by NumPy.

Torque and regressor are by ``newton_euler.py``; here are the mass matrix and the derivatives of the torque. All vectors
have the axes of the base; those of a body are about the origin of its joint frame. Motions go from the base to the
tips, and the torque of a joint is what its axis takes of the wrench of all that it carries (Featherstone 2008, "Rigid
body dynamics algorithms"). The derivatives need also the momentum, and the moments U = sum v r' dm of the velocity, of
what a joint carries (Singh, Russo and Wensing 2022, "Efficient analytical derivatives of rigid-body dynamics using
spatial vector algebra"; 12 numbers remain of their 6 x 6 matrices). Arrays begin with the components of vectors, and
end with bodies and samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models.newton_euler import AT_ONCE, NewtonEuler
from dynident.models.tree import Chain, Layout, Tree
from dynident.models.vectors import back, cross, diagonal, dot, outer, product, turn

__all__ = ["Recursion"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Recursion:
    """The dynamics of a ``tree`` under ``gravity`` (3), m/s^2, for states q, dq, ddq (N, n) of its joints.

    ``theta`` (B, 10) holds the parameters of the bodies, any numbers. ``CompiledRecursion`` is the same in C.
    """

    tree: Tree
    gravity: Array

    __repr__ = brief

    @property
    def layout(self) -> Layout:
        """The layout of the tree."""
        return self.tree.layout

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return Y (N, n, 10 L) for the parameters of the L listed bodies."""
        layout = self.layout
        Y = np.zeros((len(q), layout.joints, len(layout.listed), 10))
        chains = {chain.body: chain for chain in layout.chains}
        all_ten = dict.fromkeys(chains, np.arange(10))
        for part, body, columns in self._newton_euler.columns(self._rows(q, dq, ddq), all_ten):
            chain = chains[body]
            Y[part, chain.moved, chain.place] = self._of_joints(chain, columns).T
        return Y.reshape(len(q), layout.joints, 10 * len(layout.listed))

    def entries(self, q: Array, dq: Array, ddq: Array, joint: Integers, parameter: Integers) -> Array:
        """Return Y[:, joint[m], parameter[m]] as rows (M, N)."""
        out = np.zeros((len(joint), len(q)))
        place, role = np.divmod(parameter, 10)
        roles, places = {}, {}
        for chain in self.layout.chains:
            mine = np.flatnonzero((place == chain.place) & np.isin(joint, chain.joints))
            if len(mine):
                roles[chain.body], row = np.unique(role[mine], return_inverse=True)
                places[chain.body] = chain, mine, (row, np.searchsorted(chain.joints, joint[mine]))
        for part, body, columns in self._newton_euler.columns(self._rows(q, dq, ddq), roles):
            chain, mine, source = places[body]
            out[mine, part] = self._of_joints(chain, columns)[source]
        return out

    def torque(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the inverse dynamics (N, n)."""
        tau = self._newton_euler.torque(self._rows(q, dq, ddq), theta)
        return np.ascontiguousarray(tau.T) if self.layout.plain else tau.T @ self.layout.drive

    def mass_and_bias(self, q: Array, dq: Array, theta: Array) -> tuple[Array, Array]:
        """Return the mass matrix (N, n, n), and the torque (N, n) without acceleration."""
        bodies, drive = len(self.layout), self.layout.drive
        mass, bias = np.zeros((len(q), bodies, bodies)), np.empty((len(q), bodies))
        j, k = self.layout.pairs
        for part, motion in self._motions(q, dq, np.zeros_like(dq)):
            load = _Carried(motion, theta)
            bias[part] = load.torque.T
            force, moment = load.inert
            w, u = motion.screws(j, k)
            mass[part, j, k] = mass[part, k, j] = (dot(w, moment[:, k]) + dot(u, force[:, k])).T
        return (mass, bias) if self.layout.plain else (drive.T @ mass @ drive, bias @ drive)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Array:
        """Return the derivatives (3, N, n, n) of the torque by q, dq and ddq."""
        bodies, drive = len(self.layout), self.layout.drive
        out = np.zeros((3, len(q), bodies, bodies))
        j, k = self.layout.pairs
        for part, motion in self._motions(q, dq, ddq):
            load = _Carried(motion, theta)
            w, u = motion.screws(j, k)
            by_push, by_turn = load.inert
            by_turn = by_turn[:, k] + cross(motion.away(j, k), by_push[:, k])
            for slope, change in zip(out, motion.changes, strict=True):
                bends, turns, pushes = (one[:, j] for one in change)
                force, moment = load.changed(*change)
                slope[part, k, j] = (dot(load.bent[:, k], bends) + dot(by_turn, turns) + dot(by_push[:, k], pushes)).T
                if change is motion.changes[0]:
                    force, moment = load.turned(force, moment)
                slope[part, j, k] = (dot(w, moment[:, k]) + dot(u, force[:, k])).T  # of a joint itself, too
        return out if self.layout.plain else np.asarray(drive.T @ out @ drive)

    def weighted_gradient(self, q: Array, dq: Array, ddq: Array, weights: Array) -> Array:
        """Return the derivatives (3, N, n) of the sums <G_i, Y_i> by q, dq and ddq, for weights G (N, n, 10 L)."""
        layout = self.layout
        weights = weights.reshape(len(q), layout.joints, len(layout.listed), 10)
        out = np.empty((3, len(q), len(layout)))
        for part, motion in self._motions(q, dq, ddq):
            for slope, found in zip(out, _Weighted(motion, weights[part]).slopes, strict=True):
                slope[part] = found.T
        return out if layout.plain else out @ layout.drive

    @cached_property
    def _newton_euler(self) -> NewtonEuler:
        return NewtonEuler(self.tree, self.gravity)

    def _rows(self, q: Array, dq: Array, ddq: Array) -> list[Array]:
        """Return the states (B, N) of the bodies."""
        return [np.ascontiguousarray(state.T) for state in self.layout.moved(q, dq, ddq)]

    def _of_joints(self, chain: Chain, columns: Array) -> Array:
        """Return columns (R, J, S) of a body for its joints from those for the bodies of its chain."""
        return columns if self.layout.plain else np.asarray(chain.shares(self.layout.gain) @ columns)

    def _motions(self, q: Array, dq: Array, ddq: Array) -> Iterator[tuple[slice, _Motion]]:
        """Return the motion of some samples after the other."""
        states = self._rows(q, dq, ddq)
        step = max(AT_ONCE // len(self.layout), 1)
        for first in range(0, len(q), step):
            part = slice(first, first + step)
            yield part, _Motion(self.tree, self.gravity, *(state[:, part] for state in states))


class _Motion:
    """The motion of the bodies: axes R (3, 3, B, N), of joints that turn zw (3, B, N), that slide zu (None: no such);
    origins p, from their parents' d; their velocities v and accelerations a, these less gravity; rotation w, dw, and
    of the parents.
    """

    def __init__(self, tree: Tree, gravity: Array, q: Array, dq: Array, ddq: Array) -> None:
        self.layout = layout = tree.layout
        around, across, rest = tree.turns.transpose(0, 2, 3, 1)[..., None]
        relative = across * np.sin(q)
        relative += rest * np.cos(q)
        relative += around
        R, hosts = np.empty((3, 3, len(layout) + 1, q.shape[1])), layout.hosts  # the first is that of the base
        R[:, :, 0] = np.eye(3)[..., None]
        for k, parent in enumerate(layout.parent):
            R[:, :, k + 1] = product(R[:, :, parent + 1], relative[:, :, k])
        self.R, base = R[:, :, 1:], R[:, :, hosts]
        z, d = turn(base, tree.axis.T[..., None]), turn(base, tree.origin.T[..., None])
        rate, gain, slides = z * dq, z * ddq, layout.slides
        self.d, self.zw, self.zu, spin = d, z, None, rate
        if slides:
            spins, slide = ~layout.prismatic[:, None], layout.prismatic[:, None]
            self.d, self.zw, self.zu, spin = d + slide * z * q, spins * z, slide * z, spins * rate
        self.p, w = layout.above @ self.d, _summed(layout, spin)
        self.w, self.w_parent = w[:, 1:], w[:, hosts]
        gain += cross(self.w_parent, rate)
        dw = _summed(layout, spins * gain if slides else gain)
        self.dw, self.dw_parent = dw[:, 1:], dw[:, hosts]
        self.swept = cross(self.w_parent, self.d)
        pulled = cross(self.dw_parent, self.d)
        pulled += cross(self.w_parent, self.swept)
        if slides:
            self.swept += slide * rate
            pulled += slide * (gain + cross(self.w_parent, rate))
        self.a = layout.above @ pulled - gravity[:, None, None]

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

    @cached_property
    def changes(self) -> tuple[tuple[Array, Array, Array], ...]:
        """How a change of a body's q, of dq, and of ddq changes the accelerations of what it carries.

        By ``pushes`` + ``turns`` x r + 2 ``bends`` x (velocity), r from the origin of the body: bends, turns, pushes.
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


class _Carried:
    """What each body and all that it carries hold about its origin: force and moment (3, B, N); mass, first and second
    moments of mass; momentum, and moments of velocity.
    """

    def __init__(self, motion: _Motion, theta: Array) -> None:
        self.motion = motion
        self.below, self.inner = motion.layout.above.T, motion.layout.above.T - np.eye(len(theta))
        R, w, dw, a, columns = motion.R, motion.w, motion.dw, motion.a, theta.T[..., None]
        self.m, self.h = columns[0], turn(R, columns[1:4])
        tensor = columns[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3, -1, 1)
        self.J = product(product(R, tensor), R.swapaxes(0, 1))
        force = self.m * a + cross(dw, self.h) + cross(w, cross(w, self.h))
        moment = cross(self.h, a) + turn(self.J, dw) + cross(w, turn(self.J, w))
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
        shift = m * d
        h = self.below @ self.h + self.inner @ shift
        more = h + shift
        moved = diagonal(dot(h, d) + dot(more, d)) - outer(h, d) - outer(d, more)
        return m, h, self.below @ self.J + self.inner @ moved

    @cached_property
    def inert(self) -> tuple[Array, Array]:
        """Force and moment (3, B, N) by a unit acceleration of each body's joint."""
        (m, h, J), z, slide = self.masses, self.motion.zw, self.motion.zu
        force, moment = cross(z, h), turn(J, z)
        return (force, moment) if slide is None else (force + m * slide, moment + cross(h, slide))

    @cached_property
    def flow(self) -> tuple[Array, Array]:
        """Momentum (3, B, N), and 2 (tr(U) - U) (3, 3, B, N) of the moments of velocity U."""
        motion, J = self.motion, self.J
        second = diagonal(0.5 * (J[0, 0] + J[1, 1] + J[2, 2])) - J
        momentum = self.below @ (self.m * motion.v + cross(motion.w, self.h))
        turned = cross(motion.w[:, None], second)
        U = self.below @ (outer(motion.v, self.h) + turned) + self.inner @ outer(momentum, motion.d)
        return momentum, 2 * (diagonal(U[0, 0] + U[1, 1] + U[2, 2]) - U)

    @cached_property
    def bent(self) -> Array:
        """The torque (3, B, N) of each body's joint by unit ``bends`` of the accelerations."""
        momentum, T = self.flow
        bent = back(T, self.motion.zw)
        return bent if self.motion.zu is None else bent + 2 * cross(momentum, self.motion.zu)

    def changed(self, bends: Array, turns: Array, pushes: Array) -> tuple[Array, Array]:
        """Return the changes of force and moment (3, B, N) by those of the accelerations."""
        (m, h, J), (momentum, T) = self.masses, self.flow
        force = m * pushes + cross(turns, h) + 2 * cross(bends, momentum)
        return force, cross(h, pushes) + turn(J, turns) + turn(T, bends)

    def turned(self, force: Array, moment: Array) -> tuple[Array, Array]:
        """Return changes of force and moment with those of a wrench that a joint moves along."""
        z, slide = self.motion.zw, self.motion.zu
        force, moment = force + cross(z, self.force), moment + cross(z, self.moment)
        return (force, moment) if slide is None else (force, moment + cross(slide, self.force))


class _Weighted:
    """What sums <G, Y> of one sample change by with the motion of each body: (3, B, N).

    By unit changes of its rotation ("bends"), of the acceleration of its rotation ("turns") and of its origin
    ("pushes"), as in ``_Motion.changes``; ``crossed`` (B, N) is the change by that of the screws with each joint's q.
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
        bends, pushes = below @ self.bends, below @ self.pushes
        turns = below @ self.turns + (below - np.eye(len(below))) @ cross(motion.d, pushes)
        found = [dot(bends, one[0]) + dot(turns, one[1]) + dot(pushes, one[2]) for one in motion.changes]
        return [found[0] - self.crossed, *found[1:]]

    def _add(self, chain: Chain, theta: Array) -> None:
        """Add the torques that one body has at the joints above it, each with parameters of its own: (10, V, N)."""
        motion, k = self.motion, chain.body
        R = motion.R[:, :, k, None]
        w, dw, a = (back(R, one[:, k, None]) for one in (motion.w, motion.dw, motion.a))
        W, U = (back(R, one) for one in motion.screws(chain.path, k))
        m, h, J = theta[0], theta[1:4], theta[[4, 5, 7, 5, 6, 8, 7, 8, 9]].reshape(3, 3, *theta.shape[1:])
        wh, Jw = cross(w, h), turn(J, w)
        force, moment = m * a + cross(dw, h) + cross(w, wh), cross(h, a) + turn(J, dw) + cross(w, Jw)
        # a joint moves the screws of those before it, which take the wrench
        before = [np.cumsum(one, axis=1) - one for one in (cross(W, moment) + cross(U, force), cross(W, force))]
        self.crossed[chain.via] += dot(W, before[0]) + dot(U, before[1])
        pushes, turns = m * U + cross(W, h), cross(h, U) + turn(J, W)
        spins = cross(wh, U) + cross(h, cross(U, w)) + cross(Jw, W) + turn(J, cross(W, w))
        spin, self.turns[:, k], self.pushes[:, k] = (turn(R[:, :, 0], x.sum(axis=1)) for x in (spins, turns, pushes))
        self.bends[:, k] = spin + cross(motion.w[:, k], self.turns[:, k]) + 2 * cross(motion.v[:, k], self.pushes[:, k])


def _summed(layout: Layout, vectors: Array) -> Array:
    """Return sums (3, B + 1, N) over the bodies from the base, which is the first, to each."""
    out = np.zeros((3, len(layout) + 1, vectors.shape[2]))
    np.matmul(layout.above, vectors, out=out[:, 1:])
    return out
