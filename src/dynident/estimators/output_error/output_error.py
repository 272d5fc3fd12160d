"""Output error: the simulated positions are fitted to the measured ones, in closed loop or between restarts."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, get_args

from annotated_types import Ge, Gt, Le

from dynident.errors import ConfigError, MissingInputError, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import MOST, LeastSquares
from dynident.estimators.linear import LinearFit
from dynident.estimators.loops import controller_of, log_of, no_controller
from dynident.estimators.output_error.fit import OutputFit, fitted
from dynident.estimators.output_error.recordings import closed_shots, open_shots
from dynident.estimators.output_error.shots import Shots

__all__ = ["Loop", "OutputError", "Torque"]

Loop = Literal["auto", "closed", "open"]
Torque = Literal["measured", "commanded"]
SEGMENT = 1.0  # s, of a measured torque: its noise moves the model more than sensors of positions have noise
KNOWN = 5.0  # s, of a commanded torque, which has none
LONGEST = 1e4  # s


@dataclass(frozen=True)
class OutputError:
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
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(2001) * 0.005, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(2 * s) + np.sin(3 * s)], t)
    >>> log = dy.record(motion, sigma_q=2e-4, sigma_tau=1e-3, rng=rng).log
    >>> for estimator in (dy.LeastSquares(), dy.OutputError()):
    ...     found = dy.identify(arm, log, recipe=dy.Recipe(smoother=dy.Difference(), estimator=estimator)).estimate
    ...     print(f"J = {found.value[0]:.5f} +- {found.std[0]:.1e}")
    J = 0.02057 +- 8.0e-04
    J = 0.08250 +- 1.5e-06
    """

    loop: Loop = "auto"
    torque: Torque = "measured"
    segment: Annotated[float, Gt(0), Le(LONGEST)] | None = None
    iterations: Annotated[int, Ge(1), Le(MOST)] = 30

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        if self.loop not in get_args(Loop):
            raise ConfigError(f"loop = {self.loop!r}; {choices(self.loop, get_args(Loop))}")
        if self.torque not in get_args(Torque):
            raise ConfigError(f"torque = {self.torque!r}; {choices(self.torque, get_args(Torque))}")
        if self.segment is not None and not 0 < self.segment <= LONGEST:
            raise ConfigError(f"segment = {self.segment}; give a time (s) of at most {LONGEST:g}, or null.")
        if not 1 <= self.iterations <= MOST:
            raise ConfigError(f"iterations = {self.iterations}; give a whole number from 1 to {MOST}.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; a note says where the iteration did not converge."""
        return self._fitted(problem).estimate(problem)

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the value with its information, as rows that constraints can be put on."""
        return self._fitted(problem).linear

    def quick(self) -> LeastSquares:
        """Return least squares: a search needs no simulation."""
        return LeastSquares(weights="per_joint")

    def _fitted(self, problem: Problem) -> OutputFit:
        controllers = [controller_of(problem, k) for k in range(len(problem.motions))]
        if self.loop == "closed" and None in controllers:
            raise no_controller(problem.motions[controllers.index(None)], "the closed loop is", "leave `loop` at auto")
        closed = [] if self.loop == "open" else [one for one in controllers if one is not None]
        if len(closed) == len(problem.motions):
            shots = [closed_shots(problem, k, one) for k, one in enumerate(closed)]
        else:
            shots = [one for k in range(len(problem.motions)) for one in self._opened(problem, k)]
        return fitted(problem, tuple(shots), self.iterations)

    def _opened(self, problem: Problem, k: int) -> Iterator[Shots]:
        """Return the segments of the k-th recording, which its torque drives."""
        if self.torque == "measured":
            return open_shots(problem, k, self.segment or SEGMENT)
        log = log_of(problem, k)
        if log is None or log.command is None:
            raise MissingInputError(
                f"{problem.motions[k].source}: the commanded torque is to drive the model, and the recording does not "
                "have it (Log.command). Give it, or leave `torque` at measured."
            )
        return open_shots(problem, k, self.segment or KNOWN, log.command)
