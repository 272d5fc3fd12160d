"""Instrumental variables (IDIM-IV): theta = (W' X)^-1 W' y, where the noise of W is not that of X and y."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le

from dynident.estimators.estimator import Problem
from dynident.estimators.instrument_moments import Moments, moments_of, score_information
from dynident.estimators.instruments import (
    InstrumentKind,
    Instruments,
    InstrumentsUsed,
    NotSimulated,
    WeakInstruments,
    lagged_instruments,
    pair_rows,
    repeated_instruments,
    simulated_instruments,
)
from dynident.estimators.least_squares import MAX_ITERATIONS, LinearFit, SampledEstimator, rows_by_joint
from dynident.estimators.notes import StartedElsewhere, StillMoving
from dynident.estimators.simulated_recordings import find_first_model, no_controller_error, not_simulated_error
from dynident.models.simulation import Failure
from dynident.motion.log import Motion
from dynident.regression import Regression
from dynident.runtime import MissingInputError, Note, Step, report_progress
from dynident.runtime.arrays import Array

InstrumentSource = Literal["auto", "simulated", "repeated", "lagged"]
# share of the samples that another pass must have, unless it is asked for; of the speed
MIN_SHARED_SAMPLES, MAX_SPEED_DIFFERENCE = 0.5, 0.3
CONVERGED_STEP = 0.01  # standard errors
MIN_TORQUE_CHANGE = 1e-10  # relative change of the torque
MIN_F_STATISTIC = 10.0  # F of the first stage below which instruments are weak (Staiger and Stock, 1997)


@dataclass(eq=False)
class InstrumentalRun:
    """One estimation in progress, with its ``settings``, which begins with ``plain`` least squares."""

    settings: InstrumentalVariables
    problem: Problem
    plain: LinearFit
    notes: list[Note] = field(default_factory=list)

    @property
    def source(self) -> InstrumentSource:
        """Which instruments are asked for."""
        return self.settings.instruments

    @cached_property
    def start(self) -> Array:
        """The value (p) of least squares."""
        return self.plain.solution.value

    def fit(self) -> LinearFit:
        """Return the fit; simulated instruments are those of the value before last, which is about the last."""
        value, step_size = self.start, np.inf
        instruments = self.first_instruments([self.choose_instruments(k) for k in range(len(self.problem.motions))])
        loops = [k for k, instrument in enumerate(instruments) if instrument.kind is InstrumentKind.SIMULATED]
        # simulated instruments depend on the value: solve and simulate in turn until it stays
        for iteration in range(1, self.settings.iterations + 1):
            rows, instrument_rows, moments = self.form_moments(instruments)
            # the change of the torque ends the iteration for exact data, where standard errors are rounding
            step_size, relative_change = moments.distance(moments.value, value), moments.change(moments.value, value)
            value = moments.value
            if not loops or step_size < CONVERGED_STEP or relative_change < MIN_TORQUE_CHANGE:
                break
            if iteration == self.settings.iterations:
                self.notes.append(StillMoving(iteration, step_size))
                break
            report_progress(Step("simulating instruments", iteration, self.settings.iterations))
            simulations = self.simulate_instruments(value, loops)
            if isinstance(simulations, Failure):
                self.notes.append(StillMoving(iteration, step_size, str(simulations)))
                break
            instruments = [simulations.get(k, instrument) for k, instrument in enumerate(instruments)]
        return self.finish_fit(instruments, (rows, instrument_rows), moments)

    def choose_instruments(self, k: int) -> Instruments | None:
        """Return the instruments of the k-th recording, None where they are to be simulated."""
        problem, motion = self.problem, self.problem.motions[k]
        if self.source in ("auto", "simulated") and problem.controller(k) is not None:
            return None
        if self.source == "simulated":
            raise no_controller_error(motion, "instruments are", "leave `instruments` at auto")
        return self.measured_instruments(k)

    def measured_instruments(self, k: int) -> Instruments:
        """Return instruments of the k-th recording that are made from measurements."""
        problem, motion = self.problem, self.problem.motions[k]
        repetition = None if self.source == "lagged" else repeated_instruments(problem, k)
        if repetition is not None and (self.source == "repeated" or _is_repetition(repetition, motion)):
            return repetition
        if self.source == "repeated":
            message = (
                f"{motion.source}: instruments `repeated` need another recording of the same motion in the training, "
                "or a motion that repeats itself, and there is none. Record it twice, or leave `instruments` at auto."
            )
            raise MissingInputError(message)
        return lagged_instruments(problem.model, motion, problem.log(k), problem.regression.filter, self.settings.lag)

    def first_instruments(self, instruments: Sequence[Instruments | None]) -> list[Instruments]:
        """Return the first instruments of all recordings.

        Where the model of least squares fails in a loop, they are simulated with another one; where all fail, they
        are measured ones. Raises InputError if they must be simulated.
        """
        loops = [k for k, instrument in enumerate(instruments) if instrument is None]
        simulations: dict[int, Instruments] | Failure = {}
        if loops:
            report_progress("simulating instruments")
            simulations = self.simulate_instruments(self.start, loops)
        if isinstance(simulations, Failure):
            simulations = self.simulate_alternative(simulations, loops)
        return [simulations[k] if instrument is None else instrument for k, instrument in enumerate(instruments)]

    def simulate_alternative(self, failure: Failure, loops: Sequence[int]) -> dict[int, Instruments]:
        """Return the instruments of these recordings where those of least squares cannot be simulated."""
        alternative = find_first_model(self.problem, failure, lambda value: self.simulate_instruments(value, loops))
        if not isinstance(alternative, Failure):
            _, simulations, kind = alternative
            self.notes.append(StartedElsewhere(kind))
            return simulations
        if self.source == "simulated":
            others = "instruments `repeated` or `lagged`"
            raise not_simulated_error(self.problem.motions[loops[0] : loops[0] + 1], alternative, others)
        self.notes.append(NotSimulated(str(alternative)))
        return {k: self.measured_instruments(k) for k in loops}

    def simulate_instruments(self, theta: Array, loops: Sequence[int]) -> dict[int, Instruments] | Failure:
        """Return the simulated instruments of these recordings, or the first failure."""
        simulations = {}
        for k in loops:
            simulation = simulated_instruments(self.problem, k, theta)
            if isinstance(simulation, Failure):
                return simulation
            simulations[k] = simulation
        return simulations

    def form_moments(self, instruments: Sequence[Instruments]) -> tuple[Regression, Regression, Moments]:
        """Return the rows, those of the instruments, and their moments."""
        rows, instrument_rows = pair_rows(self.problem, instruments)
        return rows, instrument_rows, moments_of(rows, instrument_rows, self.plain)

    def finish_fit(
        self, instruments: Sequence[Instruments], regressions: tuple[Regression, Regression], moments: Moments
    ) -> LinearFit:
        """Return the fit with its information and notes."""
        information, independent = score_information(moments, *regressions, instruments, self.plain.directions)
        fit = LinearFit.from_information(moments.value, information, self.plain.directions, int(moments.rows.sum()), ())
        weakest, names = moments.strength(independent), self.problem.model.names
        # name the parameter with the largest part in the weakest direction
        if weakest.statistic < MIN_F_STATISTIC:
            largest = int(np.argmax(np.abs(weakest.direction * self.plain.directions.scale)))
            self.notes.append(WeakInstruments(names[largest], weakest.correlation, weakest.statistic))
        if self.problem.logs:  # else the motions are taken as measured
            std = np.sqrt(np.diag(fit.directions.covariance()))
            shift = np.abs(moments.value - self.start) / std
            lags = [instrument.lag for instrument in instruments if instrument.lag is not None]
            kinds = tuple(dict.fromkeys(instrument.kind for instrument in instruments))
            k = int(np.argmax(shift))
            name = names[k] if np.isfinite(std[k]) else None
            note = InstrumentsUsed(kinds, weakest.correlation, max(lags, default=None), name, float(shift[k]))
            self.notes.insert(0, note)
        return replace(fit, weights=self.plain.weights, notes=tuple(self.notes), correlated=True)


def _is_repetition(instruments: Instruments, motion: Motion) -> bool:
    """Return whether another pass has most samples of a motion, and each joint about the same speeds there."""
    common = instruments.motion.mask & motion.mask
    # the same positions at another speed are no repetition: the noise of the speeds would differ
    size, difference = (np.linalg.norm(x[common], axis=0) for x in (motion.dq, motion.dq - instruments.motion.dq))
    return bool(
        common.sum() > MIN_SHARED_SAMPLES * motion.mask.sum() and (difference <= MAX_SPEED_DIFFERENCE * size).all()
    )


MAX_LAG = 1e3  # s


@dataclass(frozen=True)
class InstrumentalVariables(SampledEstimator):
    """Instrumental variables, theta = (W' D^2 X)^-1 W' D^2 y, consistent although noise is in the regressor X.

    W is the regressor of a motion whose errors are not those of X, D weights each joint by its residual. Which motion
    is said by ``instruments``: "simulated" is what the model makes under the same reference in the loop of the recorded
    controller, begun with least squares and repeated until theta stays (at most ``iterations``): it is consistent also
    where the loop feeds noise and disturbances back. "repeated" is another pass of the same motion, in another training
    recording or later in the same: consistent where the noise of the two is independent. "lagged" is interpolated from
    the motion a time ``lag`` (s) before and after: consistent where noise of the positions is not correlated over the
    lag, which by default is as long as smoother and filter spread white noise. Disturbances that move the joints remain
    a bias of the last two, and coloured noise one of the last. "auto" takes for each recording the first that it has;
    another pass must then share half of its samples, with the same speeds to 30 %.

    Where the model of least squares fails in the loop, the simulation begins with another one, and a note says with
    which. The covariance allows for residuals that are correlated in time and between joints, and counts the errors of
    the motion. A note says which instruments were used and how much they explain of the regressor.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises MissingInputError where a recording lacks what the
    instruments need, InputError where the model fails in the loop, ConfigError for bad settings. Reference: Janot,
    Vandanjon and Gautier (2014).

    Of positions with much noise, least squares with difference quotients finds too small an inertia:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(2 * s) + np.sin(3 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-3, sigma_tau=0.01, rng=rng).log
    >>> for estimator in (dy.LeastSquares(), dy.InstrumentalVariables()):
    ...     found = dy.identify(arm, log, recipe=dy.Recipe(smoother=dy.Difference(), estimator=estimator)).estimate
    ...     print(f"J = {found.value[0]:.3f} +- {found.std[0]:.3f}, is {arm.values[0]:.3f}")
    J = 0.015 +- 0.001, is 0.083
    J = 0.084 +- 0.009, is 0.083
    """

    instruments: InstrumentSource = "auto"
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 10
    lag: Annotated[float, Gt(0), Le(MAX_LAG)] | None = None

    title = "instrumental variables"

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the value with its information, as rows to which constraints can be added."""
        plain = rows_by_joint(problem)
        return InstrumentalRun(self, problem, plain).fit() if plain.directions.rank else plain
