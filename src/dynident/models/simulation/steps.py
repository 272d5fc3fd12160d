"""The steps of a free simulation: the midpoint rule, with friction that can hold a joint at rest (Moreau, 1988)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import zip_longest
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.models.simulation.trace import (
    MAX_POSITION,
    Machine,
    Trace,
    divide_steps,
    held_torques,
    initial_state,
    sample_gaps,
)
from dynident.motion.log import Controller, HasState, Motion
from dynident.runtime import DynidentError
from dynident.runtime.arrays import Array

ScalarLaw = Callable[[int, float, float, Any], tuple[float, Any]]  # sample, q, dq, state; torque and the next state
_State = tuple[float, float, float, float, float, Any]  # q, dq, ddq, q at the last sample, tau, state of the controller
MAX_LOOKAHEAD = 1024  # steps that are taken at most before the model is asked whether it has not changed
MAX_SMOOTH_LOOKAHEAD, MAX_ROUNDS = 64, 10  # steps at most of a model that changes, and how often they are repeated


@runtime_checkable
class HasScalarLaw(Protocol):
    """A controller that works with plain numbers for a single joint."""

    def scalar_law(self, t: Array, /) -> ScalarLaw:
        """Return torque and next state as a function of the number of an instant of t (N), of q, dq and the state."""


class OneJoint:
    """The steps of ``integrate_arrays``, equal to these up to rounding.

    Mass and bias are first taken to stay as they are for some steps. Then the model is evaluated at all of these
    at once, and the steps are repeated with its mass and bias. The steps before the first at which the model then
    differs are those of a model that is evaluated at each, and are kept. The number of steps doubles as long as
    they soon agree, at once as on a level rail or after a few repetitions as of a pendulum, and halves where they
    do not.
    """

    def __init__(self, machine: Machine, motion: Motion, row: NDArray[np.intp], controller: Controller | None) -> None:
        t = motion.t[row]
        self.steps, begins = divide_steps(np.diff(t))
        self.begins: list[int] = begins.tolist()  # by step: the sample that it begins with, or -1
        self.h: list[float] = self.steps.tolist()  # of the steps, s
        self.gaps: list[float] = sample_gaps(t).tolist()  # before each sample, s
        if controller is None:
            numbers = held_torques(motion, row[None])[:, 0, 0].tolist()
            self.drive: ScalarLaw = lambda k, _q, _dq, z: (numbers[k], z)
        else:
            self.drive = _controller_law(controller, t)
        self.states, self.applied = list[_State](), [np.nan] * len(t)
        self.remembered = list[Any]([0.0]) * len(t)  # of the controller, before each sample
        self.machine, self.V = machine, float(machine.V[0, 0])
        self.friction = float(np.abs(machine.J[:, 0]) @ machine.F)  # N m or N
        q, dq = float(motion.q[row[0], 0]), float(motion.dq[row[0], 0])
        z = np.zeros(0) if controller is None else initial_state(controller, motion, row)
        self.m = len(z)
        # laws of plain numbers have a plain state
        first_state = float(z[0]) if self.m == 1 and isinstance(controller, HasScalarLaw) else z
        self.start: _State = (q, dq, 0.0, q - dq * self.gaps[0], 0.0, first_state)

    def run(self) -> Trace:
        """Return what ``integrate`` does."""
        s, state, lookahead, self.states = 0, self.start, 1, [self.start]
        # mass and bias of the first step must be known before any can be assumed
        mass_and_bias = self._evaluate_model(s, [state])[0]
        while not self._is_over(s, state):
            states, next_mass_and_bias, rounds = self._agree_steps(s, state, lookahead, mass_and_bias)
            self.states += states
            s, state, mass_and_bias = s + len(states), states[-1], next_mass_and_bias or mass_and_bias
            # look further ahead while the assumed masses prove right, less far where they do not
            longest = MAX_LOOKAHEAD if rounds == 1 else MAX_SMOOTH_LOOKAHEAD
            lookahead = min(2 * lookahead, longest) if rounds else max(lookahead // 2, 1)
        self._torque(self.begins[s], state[0], state[3], state[5])
        q, dq = np.full((2, len(self.h) + 1, 1, 1), np.inf)
        for out, which in ((q, 0), (dq, 1)):
            out[: len(self.states), 0, 0] = [state[which] for state in self.states]
        memory = np.reshape(self.remembered, (len(self.applied), -1)) if self.m else np.zeros((len(self.applied), 0))
        return Trace(self.steps, np.array(self.begins), q, dq, np.reshape(self.applied, (-1, 1, 1)), memory)

    def _is_over(self, s: int, state: _State) -> bool:
        """Whether the run ends before step s: after the last one, or at a sample that is too far away."""
        return s == len(self.h) or (self.begins[s] >= 0 and not abs(state[0]) < MAX_POSITION)

    def _agree_steps(
        self, s: int, state: _State, lookahead: int, mass_and_bias: tuple[float, float]
    ) -> tuple[list[_State], tuple[float, float] | None, int]:
        """Take steps from the step s on until assumed and evaluated mass and bias agree.

        Return the states after these steps, mass and bias of the next step unless none follows, and the number of
        rounds after which all agreed, 0 if they did not.
        """
        states, evaluated, correct = list[_State](), list[tuple[float, float]](), 0
        assumed = [mass_and_bias] * lookahead
        for rounds in range(1, MAX_ROUNDS + 1):
            states = self._take_steps(s, state, assumed)
            ends = self._is_over(s + len(states), states[-1])  # there, no model is needed
            needed = len(states) - ends
            evaluated = self._evaluate_model(s + 1, states[:needed])
            # the model failed on the way of a wrong guess: only the first step, whose mass is known, is certain
            if len(evaluated) < needed:
                return states[:1], evaluated[0], 0
            # the first step had the true mass and bias; step i is right as long as those before it were
            pairs = zip(evaluated, assumed[1:], strict=False)
            correct = next((i for i, (actual, expected) in enumerate(pairs) if actual != expected), len(states))
            if correct == len(states):
                return states, None if ends else evaluated[-1], rounds
            assumed = [mass_and_bias, *evaluated[: len(states) - 1]]
        return states[: correct + 1], evaluated[correct], 0

    def _take_steps(self, s: int, state: _State, assumed: list[tuple[float, float]]) -> list[_State]:
        """Return the states after each step from the step s on with these masses and biases, until the run ends."""
        states = list[_State]()
        q, dq, ddq, last_q, tau, z = state
        for i, (mass, bias) in zip(range(s, len(self.h)), assumed, strict=False):
            if (k := self.begins[i]) >= 0:
                if not abs(q) < MAX_POSITION:
                    break
                tau, z = self._torque(k, q, last_q, z)
                last_q = q
            h = self.h[i]
            effective_mass = mass + 0.5 * h * self.V
            if not effective_mass:
                raise np.linalg.LinAlgError("Singular matrix")
            # velocity without dry friction, which then stops the joint or acts against its motion
            free = dq + h * (tau - bias - self.V * dq) / effective_mass
            brake = h * self.friction / effective_mass  # by which friction can change the velocity
            free = 0.0 if abs(free) <= brake else free - brake if free > 0 else free + brake
            q, dq, ddq = q + 0.5 * h * (dq + free), free, (free - dq) / h
            states.append((q, dq, ddq, last_q, tau, z))
        return states

    def _torque(self, k: int, q: float, last_q: float, z: Any) -> tuple[float, Any]:
        """Return the torque from sample k on and the next state of the controller, and keep both.

        The position is q, and was ``last_q`` at the last sample.
        """
        self.remembered[k] = z
        tau, z = self.drive(k, q, (q - last_q) / self.gaps[k], z)
        self.applied[k] = tau
        return tau, z

    def _evaluate_model(self, s: int, states: list[_State]) -> list[tuple[float, float]]:
        """Return mass and bias in the middle of the steps s, s + 1, ... that begin with these states.

        Where the model fails, only those of the first: a wrong guess may lead to where it has no value.
        """
        if not states:
            return []
        q, dq, ddq = np.array([state[:3] for state in states]).T
        half = 0.5 * np.array(self.h[s : s + len(states)])
        try:
            mass, bias = self.machine.mass_and_bias((q + half * dq)[:, None], (dq + half * ddq)[:, None])
        except DynidentError:
            if len(states) == 1:
                raise
            return self._evaluate_model(s, states[:1])
        return list(zip(mass[:, 0, 0].tolist(), bias[:, 0].tolist(), strict=True))


def _controller_law(controller: Controller, t: Array) -> ScalarLaw:
    if isinstance(controller, HasScalarLaw):
        return controller.scalar_law(t)
    if not isinstance(controller, HasState):
        return lambda k, q, dq, z: (float(controller(float(t[k]), np.array([q]), np.array([dq]))[0]), z)
    gaps = sample_gaps(t)

    def law(k: int, q: float, dq: float, z: Array) -> tuple[float, Array]:
        tau, z = controller.advance(float(t[k]), float(gaps[k]), np.array([q]), np.array([dq]), z)
        return float(tau[0]), z

    return law


def integrate(machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None) -> Trace:
    """Simulate pieces of a motion, the samples ``rows`` (B, K); with a controller, of one piece.

    Positions are infinite after a sample at which they are beyond ``MAX_POSITION``.
    """
    machine.begin(motion, rows[:, 0])
    if len(rows) == len(motion.joints) == 1 and not machine.model.memory:
        return OneJoint(machine, motion, rows[0], controller).run()
    return integrate_arrays(machine, motion, rows, controller)


def integrate_arrays(machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None) -> Trace:
    """Return what ``integrate`` does, for any number of joints and pieces."""
    t = motion.t[rows]
    h, begins = divide_steps(np.diff(t).mean(axis=0))
    q, dq = np.full((2, len(h) + 1, len(rows), len(motion.joints)), np.inf)
    q[0], dq[0] = motion.q[rows[:, 0]], motion.dq[rows[:, 0]]
    drive = None if controller is None else _Drive(controller, motion, rows[0])
    tau = held_torques(motion, rows) if drive is None else np.full((rows.shape[1], 1, q.shape[2]), np.nan)
    ddq, samples = np.zeros_like(q[0]), np.flatnonzero(begins >= 0).tolist()
    for k, (start, stop) in enumerate(zip_longest(samples, samples[1:])):
        # at a sample the torque changes, and the run ends where it is over or has diverged
        if drive is not None:
            tau[k, 0] = drive(k, q[start, 0])
        if stop is None or not (np.abs(q[start]) < MAX_POSITION).all():
            break
        machine.take_steps(q[start : stop + 1], dq[start : stop + 1], ddq, tau[k], h[start:stop])
    return Trace(h, begins, q, dq, tau, np.zeros((len(tau), 0)) if drive is None else np.array(drive.states))


class _Drive:
    """A controller in its loop: it sees the difference quotient of the positions, and may have a state."""

    def __init__(self, controller: Controller, motion: Motion, row: NDArray[np.intp]) -> None:
        t = motion.t[row]
        self._controller = controller
        self._with_state = controller if isinstance(controller, HasState) else None  # asked once: that takes long
        self._t, self._gaps = t.tolist(), sample_gaps(t).tolist()
        # as if the velocity before the first sample had been constant
        self._before = motion.q[row[0]] - motion.dq[row[0]] * self._gaps[0]
        self._state = initial_state(controller, motion, row)
        self.states = np.zeros((len(row), len(self._state)))

    def __call__(self, k: int, q: Array) -> Array:
        """Return the torque (n) from sample k on, at the positions q (n)."""
        self.states[k] = self._state
        rate, self._before = (q - self._before) / self._gaps[k], q
        if self._with_state is None:
            return self._controller(self._t[k], q, rate)
        tau, self._state = self._with_state.advance(self._t[k], self._gaps[k], q, rate, self._state)
        return tau
