"""DIDIM: the torque that the controller asks for in the simulated loop is fitted to the measured one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Le

from dynident.errors import changed
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import MOST, LeastSquares, check_weights
from dynident.estimators.linear import LinearFit
from dynident.estimators.loops import controller_of, no_controller
from dynident.estimators.output_error.fit import OutputFit, fitted
from dynident.estimators.output_error.recordings import torque_shots

__all__ = ["Didim"]


@dataclass(frozen=True)
class Didim:
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
    >>> from dynident.models.gallery import slider
    >>> from dynident.simulation import PD, simulated
    >>> rail, t, one = slider(values=(5.0, 8.0, 3.0, 0.5)), np.arange(1000) * 0.005, np.ones(1)
    >>> path, zero = 0.2 * np.sin(3 * t[:, None]) + 0.1 * np.sin(7 * t[:, None]), np.zeros((1000, 1))
    >>> drive = PD(("slider",), t, path, 400 * one, 80 * one, one, np.inf * one, zero)
    >>> still = dy.Motion(t, zero, zero, zero, zero, ("slider",), np.ones(1000, dtype=bool))
    >>> run, rng = simulated(rail, rail.values, still, drive), np.random.default_rng(0)
    >>> q, tau = run.q + 1e-3 * rng.standard_normal(zero.shape), run.tau + 0.1 * rng.standard_normal(zero.shape)
    >>> log = dy.Log(t, q, tau, ("slider",), controller=drive)
    >>> for estimator in (dy.LeastSquares(), dy.Didim()):
    ...     recipe = dy.Recipe(smoother=dy.Difference(), estimator=estimator, time_offset=0.0025)
    ...     found = dy.identify(rail, log, recipe=recipe).estimate
    ...     print(f"M = {found.value[0]:.3f} +- {found.std[0]:.3f}")
    M = 0.053 +- 0.010
    M = 4.999 +- 0.001
    """

    iterations: Annotated[int, Ge(1), Le(MOST)] = 30

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        check_weights("per_joint", self.iterations)

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
        shots = []
        for k, motion in enumerate(problem.motions):
            controller = controller_of(problem, k)
            if controller is None:
                raise no_controller(motion, "the closed loop is", "use an estimator that simulates nothing")
            shots.append(torque_shots(problem, k, controller))
        return fitted(problem, tuple(shots), self.iterations)
