"""Exact derivatives of a simulation: of its discrete steps, with what sticks and what is limited as it was found.

Each step is M(m) a + b(m, r) + V (dq + dq')/2 + J' f = tau at m = q + h dq/2, r = dq + h a'/2, where a = (dq' - dq)/h
and a' is a of the step before: what ``Machine.step`` solves. Its derivatives are those of the inverse dynamics, which
``Model.partials`` has, with J dq' = 0 kept where friction holds, and f = F sign(J dq') elsewhere. They are found for
many steps at once; only a product of small matrices goes from step to step. The rules of forward sensitivities, here
of the discrete equations instead of the continuous ones, are in Maly and Petzold (1996).
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models.evaluation import kinds_that_remember
from dynident.models.model import Model
from dynident.models.simulation.run import SimulatedRecording
from dynident.models.simulation.trace import DIFFERENCE_STEP, ControllerInput, Machine, Trace, sample_gaps
from dynident.motion.log import Controller, HasState
from dynident.runtime import InputError, ModelError, Noun
from dynident.runtime.arrays import Array

Output = Literal["q", "dq", "tau"]
AT_ONCE = 1 << 22  # numbers in the matrices that are made together


class Sensitivity(Noun):
    """Derivatives of a simulation's q, dq and tau (N, n, k) by k combinations of the parameters.

    ``start`` are those (N, n, 2 n) by q and dq at the start of each piece.
    """

    q: Array
    dq: Array
    tau: Array
    start: Sensitivity | None = None


def sensitivities(
    model: Model,
    theta: ArrayLike,
    run: SimulatedRecording,
    controller: Controller | None = None,
    directions: ArrayLike | None = None,
    *,
    only: Output | None = None,
) -> Sensitivity:
    """Return the derivatives of a simulation with the same model, theta (p) and controller.

    ``directions`` (p, k) are the combinations of parameters, by default each alone. The derivatives of a
    controller that does not know them are by differences. Where ``only`` those of q, dq or tau are asked for, the
    others are empty, and need no memory. Raises InputError where the simulation failed, ModelError for a model
    that remembers (hysteresis, friction by the load), which has no derivatives here, or without ``partials``.
    """
    if run.failure is not None or run.trace is None:
        raise InputError("a simulation that failed has no derivatives; start from other parameters.")
    if model.memory:
        kinds = ", ".join(dict.fromkeys(kinds_that_remember(model.terms)))
        raise ModelError(
            f"{model.name}: derivatives of a simulation are not known for terms that remember ({kinds}); leave them "
            "out, or use an estimator that needs no simulation, such as maximum likelihood."
        )
    p = len(model.parameters)
    combinations = np.eye(p) if directions is None else np.asarray(directions, dtype=float)
    if combinations.ndim != 2 or len(combinations) != p:
        raise InputError(f"directions has shape {combinations.shape}, expected ({p}, k): a row for each parameter.")
    steps = _Steps(model, np.asarray(theta, dtype=float), run.trace, combinations)
    derivatives = steps.propagate(_SampleUpdate(run, controller, len(run.joints)), only)
    q, dq, tau = (array.reshape(len(run.t), len(run.joints), array.shape[3]) for array in derivatives)
    k = combinations.shape[1]
    return Sensitivity(q[..., :k], dq[..., :k], tau[..., :k], Sensitivity(q[..., k:], dq[..., k:], tau[..., k:]))


class _SampleUpdate:
    """How a sample changes the state: q, dq, a; in a loop also the last q, the controller's state, and tau."""

    def __init__(self, run: SimulatedRecording, controller: Controller | None, n: int) -> None:
        self.run, self.controller, self.n = run, controller, n
        states = np.zeros((len(run.t), 0)) if run.trace is None else run.trace.states
        self.m = states.shape[1]
        self.size = 3 * n if controller is None else 5 * n + self.m
        if controller is not None:
            gaps = sample_gaps(run.t)
            # the velocity that the controller saw: backward differences of positions
            before = np.vstack((run.q[:1] - gaps[0] * run.dq[:1], run.q[:-1]))
            rate = (run.q - before) / gaps[:, None]
            self.slopes = ControllerInput(run.t, gaps, run.q, rate, states).slopes_of(controller)
            self.gaps = gaps[:, None, None]

    @property
    def parts(self) -> tuple[slice, slice, slice]:
        """Where q at the last sample, the controller's state, and tau are in the state."""
        n, m = self.n, self.m
        return slice(3 * n, 4 * n), slice(4 * n, 4 * n + m), slice(4 * n + m, None)

    def update(self, k: slice) -> Array:
        """Return the derivatives (., size, size) of the state after samples by that before them."""
        n, (last, inner, tau_part), q = self.n, self.parts, slice(0, self.n)
        gaps = self.gaps[k]
        out = np.tile(np.eye(self.size), (len(gaps), 1, 1))
        out[:, tau_part, tau_part] = out[:, last, last] = 0.0
        out[:, last, q] = np.eye(n)
        # the velocity fed back is (q - q at the last sample) / gap
        for rows, (by_q, by_dq, by_state) in ((tau_part, self.slopes.tau), (inner, self.slopes.state)):
            rate = by_dq[k] / gaps
            out[:, rows, q], out[:, rows, last], out[:, rows, inner] = by_q[k] + rate, -rate, by_state[k]
        return out

    def updates(self, begins: NDArray[np.intp]) -> dict[int, Array]:
        """Return the update by those of some steps that begin with a sample, none without a controller."""
        at = np.flatnonzero(begins >= 0)
        if self.controller is None or not len(at):
            return {}
        matrices = self.update(slice(int(begins[at[0]]), int(begins[at[-1]]) + 1))
        return dict(zip(at.tolist(), matrices, strict=True))

    def start(self, width: int) -> Array:
        """Return the state (size, width + 2 n) before the first sample, the last columns by q and dq there."""
        n, (last, inner, _) = self.n, self.parts
        out = np.zeros((self.size, width + 2 * n))
        out[: 2 * n, width:] = np.eye(2 * n)
        # q at the sample before the first is q - gap dq
        if self.controller is not None:
            gap = float(self.gaps[0, 0, 0])
            out[last, width : width + n], out[last, width + n :] = np.eye(n), -gap * np.eye(n)
            if isinstance(self.controller, HasState):
                out[inner, width:] = self._initial_slopes(self.controller, gap)
        return out

    def _initial_slopes(self, controller: HasState, gap: float) -> Array:
        """Return the derivatives (m, 2 n) of the first state of the controller, by differences."""
        run, n = self.run, self.n
        start = np.concatenate((run.q[0], run.dq[0]))

        def state_at(row: Array) -> Array:
            return controller.begin(float(run.t[0]), gap, row[:n], row[n:], run.measured)

        steps = DIFFERENCE_STEP * np.maximum(np.abs(start), 1.0)
        pairs = zip(np.diag(steps), steps, strict=True)
        return np.stack([(state_at(start + by) - state_at(start - by)) / (2 * h) for by, h in pairs], axis=1)


class _Steps:
    """The derivatives of all steps of a trace, computed in blocks of steps."""

    def __init__(self, model: Model, theta: Array, trace: Trace, directions: Array) -> None:
        self.model, self.trace, self.directions = model, trace, directions
        self.machine = Machine(model, theta)
        # the acceleration before the first step of a piece is zero, as in the simulation
        after = np.diff(trace.dq, axis=0) / trace.h[:, None, None]
        self.before = np.concatenate((np.zeros_like(after[:1]), after))[:-1]  # acceleration of the step before
        self.after = after
        self.sample = np.maximum.accumulate(trace.begins)[:-1]  # the last one (S) before each step

    def propagate(self, loop: _SampleUpdate, only: Output | None) -> list[Array]:
        """Return the derivatives of q, dq and tau (B, K, n, k + 2 n) at the samples, empty where not asked for."""
        trace, n = self.trace, loop.n
        (rows, pieces, _), width = trace.q.shape, self.directions.shape[1]
        wide, shape = width + 2 * n, (pieces, len(trace.tau), n)
        out = [np.zeros((*shape, wide if only in (None, name) else 0)) for name in get_args(Output)]
        X = np.broadcast_to(loop.start(width), (pieces, loop.size, wide)).copy()
        # blocks of steps, whose matrices are made at once within bounded memory
        block = max(AT_ONCE // (pieces * loop.size * (loop.size + wide)), 1)
        for start in range(0, rows - 1, block):
            part = slice(start, min(start + block, rows - 1))
            by_state, by_theta = self.linearise(part, loop)
            path = np.empty((len(by_state) + 1, *X.shape))
            path[0] = X
            updates = loop.updates(trace.begins[part])
            for i, h in enumerate(trace.h[part].tolist()):
                # a step that begins with a sample starts from the state that the sample has changed
                before = updates[i] @ path[i] if i in updates else path[i]
                after, q, dq = path[i + 1], before[:, :n], before[:, n : 2 * n]
                new_dq = np.matmul(by_state[i], before, out=after[:, n : 2 * n])
                new_dq[..., :width] += by_theta[i]
                # q' = q + h (dq + dq') / 2 and a = (dq' - dq) / h follow from the new velocity
                after[:, :n] = q + 0.5 * h * (dq + new_dq)
                after[:, 2 * n : 3 * n] = (new_dq - dq) / h
                after[:, 3 * n :] = before[:, 3 * n :]
            X = path[-1]
            self._store_samples(loop, slice(start, start + len(path)), path, out)
        return out

    def _store_samples(self, loop: _SampleUpdate, steps: slice, path: Array, out: list[Array]) -> None:
        """Write what belongs to samples among the states before these steps."""
        n, begins = loop.n, self.trace.begins[steps]
        at = np.flatnonzero(begins >= 0)
        samples = slice(int(begins[at[0]]), int(begins[at[-1]]) + 1) if len(at) else slice(0, 0)
        states = path[at]
        for array, rows in zip(out, (slice(0, n), slice(n, 2 * n)), strict=False):
            if array.shape[3]:
                array[:, samples] = states[:, :, rows].swapaxes(0, 1)
        if loop.controller is not None and out[2].shape[3]:
            out[2][:, samples] = (loop.update(samples)[:, None, loop.parts[2]] @ states).swapaxes(0, 1)

    def linearise(self, part: slice, loop: _SampleUpdate) -> tuple[Array, Array]:
        """Return the derivatives of the velocity after steps by the states before them, (s, B, n, size), and by the
        directions, (s, B, n, k)."""
        n, h = loop.n, self.trace.h[part, None, None, None]
        G, (by_q, by_dq, inertia), by_theta = self._velocity_slopes(part)
        by_state = np.zeros((*G.shape[:2], n, loop.size))
        q, dq, a = (slice(k * n, k * n + n) for k in range(3))
        by_state[..., q], by_state[..., a] = -G @ by_q, -0.5 * h * (G @ by_dq)
        by_state[..., dq] = G @ (inertia / h - 0.5 * self.machine.V - 0.5 * h * by_q - by_dq)
        if loop.controller is not None:
            by_state[..., loop.parts[2]] = G
        return by_state, by_theta

    def _velocity_slopes(self, part: slice) -> tuple[Array, tuple[Array, Array, Array], Array]:
        """Return the derivatives of dq after steps by a torque (s, B, n, n), those of the inverse dynamics by q, dq and
        ddq, and those of dq by the directions (s, B, n, k), at constant states.
        """
        trace, machine = self.trace, self.machine
        count, pieces, n = self.after[part].shape
        # the state in the middle of the step, as Machine.step has it
        q, dq, after = (array[part].reshape(-1, n) for array in (trace.q[:-1], trace.dq[:-1], self.after))
        h = np.repeat(trace.h[part], pieces)[:, None]
        middle, rate = q + 0.5 * h * dq, dq + 0.5 * h * self.before[part].reshape(-1, n)
        tau = trace.tau[self.sample[part]].reshape(-1, n)
        slopes = machine.model.partials(middle, rate, after, machine.theta)
        # derivative of the equation of the step by the new velocity
        A = slopes.ddq / h[:, None] + 0.5 * machine.V
        sides = np.broadcast_to(np.hstack((np.eye(n), machine.J.T)), (len(q), n, n + len(machine.J)))
        solved = np.linalg.solve(A, sides)
        G, response = np.asarray(solved[..., :n], dtype=float), np.asarray(solved[..., n:], dtype=float)
        Y = self.model.regressor(middle, rate, after)
        # viscous columns act at the mean velocity of the step, as V does
        for k, slope in machine.slopes.items():
            Y[:, :, k] = (dq + 0.5 * h * after) @ slope.T
        if len(machine.F):
            # whether friction holds or slides is taken from the step as it was
            push = tau - machine.model.bias(middle, rate, machine.theta) - dq @ machine.V.T
            free = dq + (G @ push[..., None])[..., 0]
            W = machine.J @ response / h[..., None]
            impulse = machine.impulse(free @ machine.J.T, W, h * machine.F)
            holds = np.abs(impulse) < h * machine.F
            Y[:, :, machine.separated] = np.where(holds, 0.0, np.sign(impulse))[:, None] * machine.J.T
            G = _constrain_response(G, response, machine.J, holds)
        by_theta = -G @ (Y @ self.directions)
        shape = (count, pieces, n, -1)
        by_q, by_dq, inertia = (array.reshape(shape) for array in (slopes.q, slopes.dq, slopes.ddq))
        return G.reshape(shape), (by_q, by_dq, inertia), by_theta.reshape(shape)


def _constrain_response(G: Array, response: Array, J: Array, holds: NDArray[np.bool_]) -> Array:
    """Return the response (R, n, n) of velocities to torques where friction holds some J dq (R, m) at zero."""
    is_held = holds.any(axis=1)
    if not is_held.any():
        return G
    # remove what the response has along the held rows; by pinv, because these may be dependent
    held_rows = holds[is_held][:, :, None] * J
    held_response = response[is_held] * holds[is_held][:, None, :]
    G = G.copy()
    G[is_held] -= held_response @ np.linalg.pinv(held_rows @ held_response, rcond=1e-10) @ (held_rows @ G[is_held])
    return G
