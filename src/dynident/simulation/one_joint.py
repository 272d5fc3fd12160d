"""The steps of a free simulation of one joint and one piece in plain numbers: arrays of one take ten times as long."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError
from dynident.log import Controller, HasState, Motion
from dynident.simulation.machine import Machine
from dynident.simulation.trace import FAR, Trace, begun, divided, gaps_of, held

__all__ = ["AHEAD", "OfNumbers", "OneJoint"]

Array = NDArray[np.float64]
Law = Callable[[int, float, float, Any], tuple[float, Any]]  # sample, q, dq, state; torque and the next state
_State = tuple[float, float, float, float, float, Any]  # q, dq, ddq, q at the last sample, tau, state of the controller
AHEAD = 1024  # steps that are taken at most before the model is asked whether it has not changed
SMOOTH, ROUNDS = 64, 10  # steps at most of a model that changes, and how often they are repeated


@runtime_checkable
class OfNumbers(Protocol):
    """A controller that works with plain numbers for a single joint."""

    def of_numbers(self, t: Array, /) -> Law:
        """Return torque and next state as a function of the number of an instant of t (N), of q, dq and the state."""


class OneJoint:
    """The steps of ``in_arrays`` to rounding.

    Mass and bias are first taken to stay as they are for some steps, then the model is asked at all of these at once,
    and these steps are repeated with what it says. The steps before the first where it then says otherwise are those
    of a model asked at each, and stay. The number of steps doubles as long as they soon agree, at once as on a level
    rail or after a few repetitions as of a pendulum, and halves where they do not.
    """

    def __init__(self, machine: Machine, motion: Motion, row: NDArray[np.intp], controller: Controller | None) -> None:
        t = motion.t[row]
        self.steps, begins = divided(np.diff(t))
        self.begins: list[int] = begins.tolist()  # by step: the sample that it begins with, or -1
        self.h: list[float] = self.steps.tolist()  # of the steps, s
        self.gaps: list[float] = gaps_of(t).tolist()  # before each sample, s
        self.drive = _held(held(motion, row[None])) if controller is None else _of_numbers(controller, t)
        self.states, self.applied = list[_State](), [np.nan] * len(t)
        self.remembered = list[Any]([0.0]) * len(t)  # of the controller, before each sample
        self.machine, self.V = machine, float(machine.V[0, 0])
        self.friction = float(np.abs(machine.J[:, 0]) @ machine.F)  # N m or N
        q, dq = float(motion.q[row[0], 0]), float(motion.dq[row[0], 0])
        z = np.zeros(0) if controller is None else begun(controller, motion, row)
        self.m = len(z)
        known = float(z[0]) if self.m == 1 and isinstance(controller, OfNumbers) else z
        self.start: _State = (q, dq, 0.0, q - dq * self.gaps[0], 0.0, known)

    def run(self) -> Trace:
        """Return what ``integrate`` does."""
        s, state, ahead, self.states = 0, self.start, 1, [self.start]
        known = self._asked(s, [state])[0]
        while not self._over(s, state):
            states, asked, rounds = self._agreed(s, state, ahead, known)
            self.states += states
            s, state, known = s + len(states), states[-1], asked or known
            ahead = min(2 * ahead, AHEAD) if rounds == 1 else min(2 * ahead, SMOOTH) if rounds else max(ahead // 2, 1)
        self._torque(self.begins[s], state[0], state[3], state[5])
        return self._trace()

    def _trace(self) -> Trace:
        q, dq = np.full((2, len(self.h) + 1, 1, 1), np.inf)
        for out, which in ((q, 0), (dq, 1)):
            out[: len(self.states), 0, 0] = [state[which] for state in self.states]
        states = np.reshape(self.remembered, (len(self.applied), -1)) if self.m else np.zeros((len(self.applied), 0))
        return Trace(self.steps, np.array(self.begins), q, dq, np.reshape(self.applied, (-1, 1, 1)), states)

    def _over(self, s: int, state: _State) -> bool:
        """Whether the run ends before step s: after the last one, or at a sample that is too far away."""
        return s == len(self.h) or (self.begins[s] >= 0 and not abs(state[0]) < FAR)

    def _agreed(
        self, s: int, state: _State, ahead: int, known: tuple[float, float]
    ) -> tuple[list[_State], tuple[float, float] | None, int]:
        """Return the states after steps from the step s on, mass and bias of the next one unless none follows, and
        after how many rounds all agreed, 0 if they did not.
        """
        states, asked, right, guess = list[_State](), list[tuple[float, float]](), 0, [known] * ahead
        for rounds in range(1, ROUNDS + 1):
            states = self._ahead(s, state, guess)
            ends = self._over(s + len(states), states[-1])  # there, no model is needed
            wanted = len(states) - ends
            asked = self._asked(s + 1, states[:wanted])
            if len(asked) < wanted:
                return states[:1], asked[0], 0
            pairs = zip(asked, guess[1:], strict=False)
            right = next((i for i, (one, two) in enumerate(pairs) if one != two), len(states))
            if right == len(states):
                return states, None if ends else asked[-1], rounds
            guess = [known, *asked[: len(states) - 1]]
        return states[: right + 1], asked[right], 0

    def _ahead(self, s: int, state: _State, guess: list[tuple[float, float]]) -> list[_State]:
        """Return the states after each step from the step s on with these masses and biases, until the run ends."""
        states = list[_State]()
        q, dq, ddq, before, tau, z = state
        for i, (mass, bias) in zip(range(s, len(self.h)), guess, strict=False):
            if (k := self.begins[i]) >= 0:
                if not abs(q) < FAR:
                    break
                tau, z = self._torque(k, q, before, z)
                before = q
            h = self.h[i]
            whole = mass + 0.5 * h * self.V
            if not whole:
                raise np.linalg.LinAlgError("Singular matrix")
            free = dq + h * (tau - bias - self.V * dq) / whole
            brake = h * self.friction / whole  # by which friction can change the velocity
            free = 0.0 if abs(free) <= brake else free - brake if free > 0 else free + brake
            q, dq, ddq = q + 0.5 * h * (dq + free), free, (free - dq) / h
            states.append((q, dq, ddq, before, tau, z))
        return states

    def _torque(self, k: int, q: float, before: float, z: Any) -> tuple[float, Any]:
        """Return the torque from sample k on, at the position q, which was ``before`` at the last one, and the next
        state of the controller; keep torque and state.
        """
        self.remembered[k] = z
        tau, z = self.drive(k, q, (q - before) / self.gaps[k], z)
        self.applied[k] = tau
        return tau, z

    def _asked(self, s: int, states: list[_State]) -> list[tuple[float, float]]:
        """Return mass and bias in the middle of the steps s, s + 1, ... that begin with the states.

        Only those of the first where the model fails: a wrong guess may lead to where it has no value.
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
            return self._asked(s, states[:1])
        return list(zip(mass[:, 0, 0].tolist(), bias[:, 0].tolist(), strict=True))


def _held(tau: Array) -> Law:
    numbers = tau[:, 0, 0].tolist()
    return lambda k, _q, _dq, z: (numbers[k], z)


def _of_numbers(controller: Controller, t: Array) -> Law:
    if isinstance(controller, OfNumbers):
        return controller.of_numbers(t)
    if isinstance(controller, HasState):
        return _advanced(controller, t)
    return lambda k, q, dq, z: (float(controller(float(t[k]), np.array([q]), np.array([dq]))[0]), z)


def _advanced(controller: HasState, t: Array) -> Law:
    gaps = gaps_of(t)

    def law(k: int, q: float, dq: float, z: Array) -> tuple[float, Array]:
        tau, z = controller.advance(float(t[k]), float(gaps[k]), np.array([q]), np.array([dq]), z)
        return float(tau[0]), z

    return law
