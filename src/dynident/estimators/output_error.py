"""Output error: the simulated positions are fitted to the measured ones, in closed loop or between restarts."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

from dynident.estimators.estimator import Problem
from dynident.estimators.least_squares import MAX_ITERATIONS, LinearFit, SampledEstimator, rows_by_joint
from dynident.estimators.output_error_descent import Descent
from dynident.estimators.simulated_recordings import Shots, loop_shots, no_controller_error, open_shots
from dynident.runtime import MEMORY_VARIABLE, InputError, MissingInputError, format_bytes, memory_budget, settings_text

BYTES_PER_DERIVATIVE = 20  # for each sample, joint and direction: the derivatives, and what the starts leave of them


class SimulatingEstimator(SampledEstimator):
    """Base of the estimators that fit the outputs of simulations, in at most ``iterations`` steps."""

    iterations: int

    @abstractmethod
    def shots(self, problem: Problem) -> Iterator[Shots]:
        """Yield the stretches to be simulated."""

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the value with its information, as rows to which constraints can be added.

        Undetermined directions are as at the start; a note says where the iteration did not converge. Raises
        InputError where the derivatives need more memory than there is.
        """
        shots, plain = tuple(self.shots(problem)), rows_by_joint(problem)
        rank, r = plain.directions, plain.directions.rank
        _check_memory(problem, shots, r)
        # directions in which the weighted regressor is orthonormal: those that least squares does not see stay
        basis = rank.determined_directions / rank.values[:r]
        descent = Descent(problem, basis, self.iterations).fit(plain.solution.value, shots)
        to_basis = rank.values[:r, None] * rank.vectors[:, :r].T * rank.scale
        information = to_basis.T @ descent.information @ to_basis
        fit = LinearFit.from_information(descent.value, information, rank, descent.samples, descent.notes)
        return replace(fit, value=descent.value, weights=plain.weights, correlated=True)


def _check_memory(problem: Problem, shots: Sequence[Shots], directions: int) -> None:
    """Raise InputError where the derivatives of all simulations need more memory than the budget has."""
    samples, n = sum(recording.samples for recording in shots), len(problem.model.joints)
    needed = BYTES_PER_DERIVATIVE * samples * n * (directions + 2 * n)
    if needed <= memory_budget():
        return
    sources = ", ".join(dict.fromkeys(recording.source for recording in problem.motions))
    raise InputError(
        f"{sources}: the derivatives of the simulation, {samples} samples of each joint by {directions} directions of "
        f"the parameters, would take {format_bytes(needed)} of memory, more than {format_bytes(memory_budget())}. "
        f"Take a shorter `window` ({100 * memory_budget() / needed:.2g} % of it fit), an estimator that simulates "
        f"nothing, or raise this by --memory or {MEMORY_VARIABLE} (in GB)."
    )


@dataclass(frozen=True)
class Didim(SimulatingEstimator):
    """The theta with which the recorded controller asks for the measured torque, each joint weighted by its residual.

    The model is simulated in the loop of the recorded controller (``Log.controller``) under the recorded reference,
    from an unknown state at the start; minimised is the difference of the controller's torque to the measured one.
    Measured positions are not used but for the first guess: no noise of theirs is in a regressor, and none is
    differentiated.
    Where the published method takes the regressor of the simulated motion for the derivatives of that torque, which a
    stiff loop justifies, these are exact here, so that the iteration of Gauss and Newton, with Levenberg's damping,
    converges in a soft loop, too. It begins with least squares, or with another fit where this is nearer when
    simulated; ``iterations`` is the most steps.

    The covariance allows for residuals that are correlated in time and between joints, among them what the loop makes
    of disturbances. The controller must be the one that ran: what it is wrong by is an error of the parameters.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises MissingInputError where a recording does not know its
    controller, InputError where no first model can be simulated in the loop or the controller does not see the
    positions, ModelError for terms that remember, ConfigError for bad settings. Reference: Gautier, Janot and Vandanjon
    (2013).

    A mass in the loop of a PD controller, of whose positions 1 mm of noise hides the acceleration:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import slider
    >>> from dynident.models.simulation import PD, simulate_recording
    >>> rail, t, one = slider(values=(5.0, 8.0, 3.0, 0.5)), np.arange(1000) * 0.005, np.ones(1)
    >>> path, zero = 0.2 * np.sin(3 * t[:, None]) + 0.1 * np.sin(7 * t[:, None]), np.zeros((1000, 1))
    >>> drive = PD(("slider",), t, path, 400 * one, 80 * one, one, np.inf * one, zero)
    >>> still = dy.Motion(t, zero, zero, zero, zero, ("slider",), np.ones(1000, dtype=bool))
    >>> run, rng = simulate_recording(rail, rail.values, still, drive), np.random.default_rng(0)
    >>> q, tau = run.q + 1e-3 * rng.standard_normal(zero.shape), run.tau + 0.1 * rng.standard_normal(zero.shape)
    >>> log = dy.Log(t, q, tau, ("slider",), controller=drive)
    >>> for estimator in (dy.LeastSquares(), dy.Didim()):
    ...     recipe = dy.Recipe(smoother=dy.Difference(), estimator=estimator, time_offset=0.0025)
    ...     found = dy.identify(rail, log, recipe=recipe).estimate
    ...     print(f"M = {found.value[0]:.3f} +- {found.std[0]:.3f}")
    M = 0.053 +- 0.010
    M = 4.999 +- 0.001
    """

    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 30

    title = "DIDIM, the torque of the simulated loop"

    def shots(self, problem: Problem) -> Iterator[Shots]:
        """Yield the recordings in their loops, with the torque as output."""
        for k, motion in enumerate(problem.motions):
            controller = problem.controller(k)
            if controller is None:
                raise no_controller_error(motion, "the closed loop is", "use an estimator that simulates nothing")
            yield loop_shots(problem, k, controller, "tau")


LoopMode = Literal["auto", "closed", "open"]
TorqueSource = Literal["measured", "commanded"]
MEASURED_SEGMENT = 1.0  # s, of a measured torque: its noise moves the model more than sensors of positions have noise
COMMANDED_SEGMENT = 5.0  # s, of a commanded torque, which has none
MAX_SEGMENT = 1e4  # s


@dataclass(frozen=True)
class OutputError(SimulatingEstimator):
    """The theta whose simulated positions are nearest to the measured ones, each joint weighted by its residual.

    ``loop``: "closed" simulates the model in the loop of the recorded controller (``Log.controller``) under the
    recorded reference, from an unknown state at the start; "open" drives the model with the ``torque`` that was
    "measured", or, where it is known, "commanded" (``Log.command``), in segments of ``segment`` s (by default 1 s, of a
    commanded torque 5 s), whose states at the start are all unknown (multiple shooting): a robot would run away from
    one start. "auto" closes the loop where all recordings know their controller.

    Gauss and Newton's iteration with Levenberg's damping, by the exact derivatives of the discrete simulation. It
    begins with least squares, or with another fit where this is nearer when simulated: there are several minima;
    ``iterations`` is the most steps.
    The covariance allows for residuals that are correlated in time and between joints: what noise of a measured torque
    does to the model is in them, as is all that the model lacks. Such noise is not modelled: with a measured torque
    that has much of it, maximum likelihood has smaller errors; with an exact one, output error uses that it is.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises MissingInputError where a recording lacks the controller
    or the command that is asked for, InputError where no first model can be simulated, ModelError for terms that
    remember, ConfigError for bad settings. References: Landau and Karimi (1997); Jubien, Gautier and Janot (2014); of
    multiple shooting, Bock (1983).

    Driven by the torque, a pendulum whose positions have 0.2 mrad of noise:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(2001) * 0.005, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(2 * s) + np.sin(3 * s)], t)
    >>> log = dy.record(motion, sigma_q=2e-4, sigma_tau=1e-3, rng=rng).log
    >>> for estimator in (dy.LeastSquares(), dy.OutputError()):
    ...     found = dy.identify(arm, log, recipe=dy.Recipe(smoother=dy.Difference(), estimator=estimator)).estimate
    ...     print(f"J = {found.value[0]:.5f} +- {found.std[0]:.1e}")
    J = 0.02057 +- 8.0e-04
    J = 0.08250 +- 1.5e-06
    """

    loop: LoopMode = "auto"
    torque: TorqueSource = "measured"
    segment: Annotated[float, Gt(0), Le(MAX_SEGMENT)] | None = None
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 30

    def shots(self, problem: Problem) -> Iterator[Shots]:
        """Yield the recordings in their loops, or their segments, with the positions as output."""
        controllers = [problem.controller(k) for k in range(len(problem.motions))]
        if self.loop == "closed" and None in controllers:
            raise no_controller_error(
                problem.motions[controllers.index(None)], "the closed loop is", "leave `loop` at auto"
            )
        closed = [] if self.loop == "open" else [entry for entry in controllers if entry is not None]
        for k in range(len(problem.motions)):
            if len(closed) == len(problem.motions):
                yield loop_shots(problem, k, closed[k])
            else:
                yield from self._open_segments(problem, k)

    def _open_segments(self, problem: Problem, k: int) -> Iterator[Shots]:
        """Return the segments of the k-th recording, driven by its torque."""
        if self.torque == "measured":
            return open_shots(problem, k, self.segment or MEASURED_SEGMENT)
        log = problem.log(k)
        if log is None or log.command is None:
            raise MissingInputError(
                f"{problem.motions[k].source}: the commanded torque is to drive the model, and the recording does not "
                "have it (Log.command). Give it, or leave `torque` at measured."
            )
        return open_shots(problem, k, self.segment or COMMANDED_SEGMENT, log.command)

    def __str__(self) -> str:
        where = {"auto": "", "closed": " in the loop", "open": ", driven by the torque"}[self.loop]
        return settings_text("output error of simulated positions" + where, self, ("loop",))
