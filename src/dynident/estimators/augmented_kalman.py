"""Extended Kalman filtering with the parameters as states: the textbooks' comparison."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar

import numpy as np
from annotated_types import Ge, Le

from dynident.estimators.augmented_kalman_steps import (
    Dynamics,
    FilterSeries,
    correct_state,
    group_size,
    predict_state,
    series_of,
    smooth_model,
)
from dynident.estimators.estimator import Estimate, Estimator, Problem
from dynident.estimators.least_squares import LeastSquares, LinearFit
from dynident.estimators.maximum_likelihood.plan import misfit
from dynident.estimators.notes import SmoothSigns, StartedElsewhere, StillMoving
from dynident.estimators.physical_constraints import bodies_of
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.estimators.simulated_recordings import find_first_model
from dynident.models.simulation import Failure, Singular
from dynident.regression import Rank
from dynident.runtime import ConfigError, InputError, ModelError, Note, Noun, Step, report_progress
from dynident.runtime.arrays import Array

MAX_SAMPLES = 1_000_000  # samples
PRIOR_STD, PRIOR_PIECES = 2.0, 16  # standard errors of least squares, of so many pieces, that the filter starts with
INITIAL_DEVIATIONS = 10.0, 0.1  # of a first position, in its noise, and of a first velocity, in the usual one
CONVERGED_STEP = 0.1  # standard errors: a step of the parameters that ends the passes
MASS_CHECK_INTERVAL = 8  # steps between two at which the mass matrix is looked at
MIN_MASS_SHARE = 0.2  # of what moves: a longer step of the parameters is cut
MIN_STEP_SHARE = 1e-3  # share of a step of the parameters
MAX_INNOVATION = 1e3  # standard deviations of an innovation: the filter has lost the motion
MAX_UNCERTAIN_SHARE = 0.2  # share of the samples with an uncertain sign above which it is noted
MIN_POSITION_NOISE = 0.1  # of what the noise of the torque moves in a step: no position is taken as more exact
MIN_TORQUE_NOISE = 1e-4  # noise of a torque, relative to the largest
PROGRESS_INTERVAL = 25  # steps between two reports


@dataclass(frozen=True)
class AugmentedKalman(Estimator):
    """A Kalman filter whose state is (q, dq, theta): driven by the measured torque, it measures the positions.

    The dynamics are linearised along the smoothed motion (along that of the noisy torque, as some do, it is sure of too
    much). The state is what the motion differs from the smoothed one by, so that friction cannot make a prediction run
    away; its covariance is kept as a square root. The noise of the torque, that of the residual of least squares, acts
    through the inverse mass matrix; that of the positions is found in the logs. Each recording is taken in ``samples``
    steps at most: of longer ones groups of samples make one step. Recordings are cut into pieces of 125 steps that run
    side by side, each with a start of its own; what each tells beyond the start's covariance is added. So nothing
    depends on the order of the logs, and least squares, where the filter starts, counts nothing. ``passes`` at most
    repeat it from what it found, until that moves by less than a tenth of a standard error. For parameters, which are
    constant, the smoothed (Rauch-Tung-Striebel) estimate is that of the last step, so that no backward pass is needed.

    A recording of 2000 samples takes about a second for one or two joints; it grows with ``passes`` and with the
    size of the arm. It is no better than maximum likelihood, which has the same noise model
    without linearising step by step, and worse where the model lacks something: all that the torque does not explain
    is taken as white noise of the torque, and its covariance is too small where that is correlated. Coulomb friction
    is a smooth function of the velocity here, and its change over a reversal counts as noise, so that reversals tell
    little. Between passes the parameters are made consistent with physics where a body has mass no longer. Only
    directions that least squares determines are estimated. A filter of the recipe is not applied; torques that are not
    fitted count hardly.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.AugmentedKalman())
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0825 +- 0.00007
    h = 0.2499 +- 0.00021
    """

    samples: Annotated[int, Ge(100), Le(MAX_SAMPLES)] = 4000
    passes: Annotated[int, Ge(1), Le(20)] = 4

    needs_samples: ClassVar[bool] = True
    title = "extended Kalman filter of motion and parameters"

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate, with notes on what was averaged and smoothed.

        Raises InputError where the filter loses the motion or recordings are too short, and ConfigError for a model
        that remembers.
        """
        if problem.model.memory:
            raise ConfigError(
                "estimator: augmented_kalman cannot use terms that remember, such as dahl; leave them out, or use "
                "least_squares or consistent."
            )
        start = LeastSquares(weights="per_joint")(problem)
        if bodies_of(problem.model.parameters):  # those of least squares may have no mass matrix
            start = replace(start, value=PhysicallyConsistent(costs=False)(problem).value)
        run = self._begin_run(problem, start)
        origin = theta = run.dynamics.theta
        step_size, information = np.inf, np.zeros((0, 0))
        # each pass linearises at the estimate of the previous one, until a step is small against its standard error
        for k in range(self.passes):
            previous = theta
            theta, information = run.filter_pass(origin, k)
            step_size = float(
                np.sqrt((theta - previous) @ information @ (theta - previous) / max(run.directions.rank, 1))
            )
            if step_size < CONVERGED_STEP:
                break
            # a step that makes the mass matrix singular is shortened before the next pass
            origin = run.with_invertible_mass(origin, theta, information)
        notes = (*run.notes, *([StillMoving(self.passes, step_size)] if step_size >= CONVERGED_STEP else []))
        rank, total = run.directions, problem.regression.triangular_factors.total
        fit = LinearFit.from_information(theta, information, rank, total, notes)
        return replace(fit, weights=start.residual.weights).estimate(problem)

    def _begin_run(self, problem: Problem, start: Estimate) -> _KalmanRun:
        """Return the run from a start, or from an alternative first model where the start has no mass matrix."""

        def try_start(value: Array) -> _KalmanRun | Failure:
            try:
                return _KalmanRun.begin(self, problem, replace(start, value=value))
            except InputError:
                return Singular()

        try:
            return _KalmanRun.begin(self, problem, start)
        except InputError as error:
            alternative = find_first_model(problem, Singular(), try_start)
            if isinstance(alternative, Failure):
                raise error from None
            _, run, kind = alternative
            return replace(run, notes=(StartedElsewhere(kind), *run.notes))

    def quick(self) -> LeastSquares:
        """Return least squares: a filter takes too long for a search."""
        return LeastSquares()


class _KalmanRun(Noun):
    """One estimation: the pieces, the smooth model with the estimated directions, and the notes.

    ``mean_residuals`` maps parameters (p) to the mean torque (B, K, n) that they leave unexplained in each step.
    """

    settings: AugmentedKalman
    problem: Problem
    series: FilterSeries
    dynamics: Dynamics
    directions: Rank
    notes: tuple[Note, ...]
    mean_residuals: Callable[[Array], Array]

    @classmethod
    def begin(cls, settings: AugmentedKalman, problem: Problem, start: Estimate) -> _KalmanRun:
        """Return the run from the estimate of least squares."""
        groups = [group_size(motion, settings.samples) for motion in problem.motions]
        step = max(
            group * float(np.diff(motion.t).mean()) for group, motion in zip(groups, problem.motions, strict=True)
        )
        rank = start.determined.directions
        if rank is None:
            raise ModelError("the start of the filter does not say what the data determine.")
        largest_torque = np.max([np.abs(motion.tau[motion.mask]).max(axis=0) for motion in problem.motions], axis=0)
        sigma = np.maximum(misfit(problem, start.value), MIN_TORQUE_NOISE * largest_torque)
        model, widths, uncertain = smooth_model(problem, start.value, step)
        series_arguments = problem, settings.samples, sigma, uncertain
        series = series_of(*series_arguments, _torque_residuals(problem, start.value))
        residual = start.residual
        row_variance = (
            1.0
            if residual.weights is None
            else float(np.mean(np.square(residual.weights * np.maximum(residual.sigma, sigma))))
        )
        # unit steps are the standard errors of least squares if it had seen only a share of the pieces
        unit_directions = (
            rank.determined_directions
            / rank.values[: rank.rank]
            * np.sqrt(row_variance * len(series.offset) / PRIOR_PIECES)
        )
        moment_noise = float(
            np.sqrt((1.0 - 1.0 / max(groups) ** 2) / 12.0 + 1.0 / 288.0)
        )  # of the samples, and of the slope
        dynamics = Dynamics(model, start.value, unit_directions, moment_noise)
        # raises here, and not within the filter, where the start has no positive definite mass matrix
        _ = _is_mobile(dynamics, series, start.value)
        # the torque noise moves the joints within a step: positions must not count as more exact than that
        mobility = np.abs(np.linalg.inv(_mass_matrices(dynamics, series, dynamics.theta))).mean(axis=0)
        min_sigma = MIN_POSITION_NOISE * step**2 / 2 * mobility @ series.noise.mean(axis=(0, 1))
        series = replace(series, sigma=np.maximum(series.sigma, min_sigma))
        uncertain_share = (np.concatenate(uncertain) > sigma).mean(axis=0).max()  # of the samples, in the sign
        notes = (SmoothSigns(widths),) if widths and uncertain_share > MAX_UNCERTAIN_SHARE else ()

        def mean_residuals(theta: Array) -> Array:
            return series_of(*series_arguments, _torque_residuals(problem, theta)).mean

        return cls(settings, problem, series, dynamics, rank, notes, mean_residuals)

    def with_invertible_mass(self, origin: Array, theta: Array, information: Array) -> Array:
        """Return parameters (p) close to theta whose mass matrix is invertible.

        Where there are bodies, these are the nearest physically consistent ones. From ``origin`` (p), the step is
        shortened until no joint becomes much lighter.
        """
        dynamics = replace(self.dynamics, theta=origin)
        if _is_mobile(dynamics, self.series, theta):
            return theta
        if bodies_of(self.problem.model.parameters):
            total = self.problem.regression.triangular_factors.total
            rows = LinearFit.from_information(theta, information, self.directions, total, ())
            theta = PhysicallyConsistent(costs=False).constrain(self.problem, rows).value
        # halve the step until no direction of motion becomes much lighter than at the origin
        share = 1.0
        while share > MIN_STEP_SHARE and not _is_mobile(dynamics, self.series, origin + share * (theta - origin)):
            share /= 2
        return np.asarray(origin + share * (theta - origin))

    def filter_pass(self, theta: Array, number: int) -> tuple[Array, Array]:
        """Return theta (p) after one pass of the filter linearised at theta, and its information (p, p)."""
        dynamics, series = replace(self.dynamics, theta=theta), replace(self.series, mean=self.mean_residuals(theta))
        n, r = dynamics.joint_count, dynamics.directions.shape[1]
        x, S = self._initial_state(r)
        innovation_square, count = 0.0, 0
        for k in range(series.mean.shape[1]):
            if k % PROGRESS_INTERVAL == 0:
                text = f"Kalman filter, pass {number + 1} of {self.settings.passes} at most"
                report_progress(Step(text, k, series.mean.shape[1]))
            # pieces that have ended keep their last state
            on = series.active[:, k]
            try:
                with np.errstate(all="ignore"):
                    prediction = predict_state(dynamics, series.filter_step(k), x[on], S[on])
                    x[on], S[on], innovation = correct_state(*prediction, series.offset[on, k + 1], series.sigma)
            except (ModelError, np.linalg.LinAlgError):
                raise _divergence_error(k) from None
            if not (np.isfinite(x).all() and np.isfinite(S).all() and np.abs(innovation).max() < MAX_INNOVATION):
                raise _divergence_error(k)
            innovation_square, count = innovation_square + float(np.square(innovation).sum()), count + innovation.size
        # larger innovations than predicted scale the covariance up, smaller ones do not scale it down
        a, information = _combine_pieces(x[:, 2 * n :], S[:, 2 * n :], max(innovation_square / count, 1.0))
        basis = self.directions.scale[:, None] * self.directions.vectors[:, :r]
        transform = basis @ np.linalg.pinv(basis.T @ dynamics.directions).T
        return theta + dynamics.directions @ a, transform @ information @ transform.T

    def _initial_state(self, r: int) -> tuple[Array, Array]:
        """Return the initial states (B, L) and the square roots S (B, L, L) of their covariance."""
        series = self.series
        rms_speed = np.sqrt(
            np.mean([np.square(motion.dq[motion.mask]).mean(axis=0) for motion in self.problem.motions], axis=0)
        )
        initial_speed = np.maximum(rms_speed, 10 * series.sigma / series.step.min())
        deviation = np.concatenate(
            [INITIAL_DEVIATIONS[0] * series.sigma, INITIAL_DEVIATIONS[1] * initial_speed, np.full(r, PRIOR_STD)]
        )
        x = np.zeros((len(series.offset), len(deviation)))
        x, S, _ = correct_state(x, np.tile(np.diag(deviation), (len(x), 1, 1)), series.offset[:, 0], series.sigma)
        return x, S


def _torque_residuals(problem: Problem, theta: Array) -> tuple[Array, ...]:
    """Return the torque residuals (N, n) of theta (p) for each motion."""
    return tuple(motion.tau - problem.model.torque(**motion.states(), theta=theta) for motion in problem.motions)


def _mass_matrices(dynamics: Dynamics, series: FilterSeries, theta: Array) -> Array:
    """Return the mass matrices at every few steps, (B, n, n)."""
    stride = slice(None, None, MASS_CHECK_INTERVAL)
    return dynamics.model.mass_matrix(series.motion[0][:, stride][series.active[:, stride]], theta)


def _is_mobile(dynamics: Dynamics, series: FilterSeries, theta: Array) -> bool:
    """Return whether theta (p) keeps at least ``MIN_MASS_SHARE`` of the current mass in every direction of motion."""
    # the smallest eigenvalue of the proposed mass matrix relative to the current one, over all directions
    current, proposed = (_mass_matrices(dynamics, series, parameters) for parameters in (dynamics.theta, theta))
    try:
        inverse_root = np.linalg.inv(np.linalg.cholesky(current))
    except np.linalg.LinAlgError:
        raise _divergence_error(None) from None
    return (
        float(np.linalg.eigvalsh(inverse_root @ proposed @ np.swapaxes(inverse_root, 1, 2))[:, 0].min())
        > MIN_MASS_SHARE
    )


def _combine_pieces(a: Array, S: Array, scatter: float) -> tuple[Array, Array]:
    """Combine the last states of all pieces into a (r) and its information (r, r).

    ``a`` (B, r) and ``S`` (B, r, L) are the last estimates and their square roots; the information of the common
    prior is subtracted from each. ``scatter`` is the variance of the innovations, one where the filter is right.
    """
    r = a.shape[1]
    inverse = np.linalg.inv(S @ np.swapaxes(S, 1, 2))
    # every piece starts from the same artificial prior: subtract it, so that only the data count
    information = (inverse - np.eye(r) / PRIOR_STD**2).sum(axis=0)
    if not np.linalg.eigvalsh(information)[0] > 0:
        raise _divergence_error(None)
    estimate = np.linalg.solve(information, (inverse @ a[..., None]).sum(axis=0)[:, 0])
    return estimate, information / scatter


def _divergence_error(k: int | None) -> InputError:
    where = "" if k is None else f" at step {k + 1} of a piece"
    return InputError(
        f"the Kalman filter diverged{where}: a mass matrix of its parameters is singular, or its motion left the "
        "measured one. Give a model whose bodies have mass (terms, rotor inertias), more steps (samples), "
        "or an estimator that needs no mass matrix, such as consistent."
    )
