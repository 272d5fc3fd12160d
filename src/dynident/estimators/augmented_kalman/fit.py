"""Kalman filtering with the parameters as states: the textbooks' comparison, extended or with sigma points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, Note, Step, brief, changed, choices
from dynident.estimators.augmented_kalman.dynamics import Dynamics
from dynident.estimators.augmented_kalman.series import Series, grouping, series_of, smooth_model
from dynident.estimators.augmented_kalman.square_root import corrected, lower, points
from dynident.estimators.constraints import bodies_of
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.first_model import other_model
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.linear import LinearFit, estimate_of, of_information
from dynident.estimators.maximum_likelihood.measured import misfit
from dynident.estimators.notes import SmoothSigns, StartedElsewhere, StillMoving
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.regression import Rank
from dynident.simulation import Failure, Singular

__all__ = ["AugmentedKalman"]

Array = NDArray[np.float64]
Method = Literal["extended", "sigma_point"]
MOST = 1_000_000  # samples
SPREAD, PIECES = 2.0, 16  # standard errors of least squares, of so many pieces, that the filter starts with
START = (10.0, 0.1)  # deviation of a first position, in its noise, and of a first velocity, in the usual one
CLOSE = 0.1  # standard errors: a step of the parameters that ends the passes
EACH = 8  # steps between two at which the mass matrix is looked at
LIGHTER = 0.2  # of what moves: a longer step of the parameters is cut
SHORTEST = 1e-3  # share of a step of the parameters
LOST = 1e3  # standard deviations of an innovation: the filter has lost the motion
MANY = 0.2  # share of the samples with an uncertain sign above which it is noted
EXACT = 0.1  # of what the noise of the torque moves in a step: no position is taken as more exact
LEAST = 1e-4  # noise of a torque, relative to the largest
REPORTED = 25  # steps between two reports


@dataclass(frozen=True)
class AugmentedKalman:
    """A Kalman filter whose state is (q, dq, theta): driven by the measured torque, it measures the positions.

    ``method``: "extended" linearises the dynamics along the smoothed motion (along that of the noisy torque, as some
    do, it is sure of too much); "sigma_point" takes the 2 L points of the cubature rule through them, L = 2 n + rank.
    The state is what the motion differs from the smoothed one by, so that friction cannot make a prediction run away.
    Both in square-root form. The noise of the torque, that of the residual of least squares, enters through the inverse
    mass matrix; that of the positions is found in the logs. Each recording is taken in ``samples`` steps at most: of
    longer ones groups of samples make one step. Recordings are cut into pieces of 125 steps that run side by side, each
    with a start of its own; what each tells beyond the start's covariance is added. So nothing depends on the order of
    the logs, and least squares, where the filter starts, counts nothing. ``passes`` at most repeat it from what it
    found, until that moves by less than a tenth of a standard error. For parameters, which are constant, the smoothed
    (Rauch-Tung-Striebel) estimate is that of the last step, so that no backward pass is needed.

    A recording of 2000 samples takes about a second for one or two joints, by sigma points two; it grows with
    ``passes`` and with the size of the arm. It is no better than maximum likelihood, which has the same noise model
    without linearising step by step, and worse where the model lacks something: all that the torque does not explain
    is taken as white noise of the torque, and its covariance is too small where that is correlated. Coulomb friction
    is a smooth function of the velocity here, and its change over a reversal counts as noise, so that reversals tell
    little. Between passes the parameters are made consistent with physics where a body has mass no longer. Only
    directions that least squares determines are estimated. A filter of the recipe is not applied; torques that are not
    fitted count hardly.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.AugmentedKalman())
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0825 +- 0.00007
    h = 0.2499 +- 0.00021
    """

    method: Method = "extended"
    samples: Annotated[int, Ge(100), Le(MOST)] = 4000
    passes: Annotated[int, Ge(1), Le(20)] = 4

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise ConfigError(f"method = {self.method!r}; {choices(self.method, get_args(Method))}")
        if not 100 <= self.samples <= MOST or not 1 <= self.passes <= 20:
            raise ConfigError(
                f"samples = {self.samples} must be from 100 to {MOST}, passes = {self.passes} from 1 to 20."
            )

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
        run = self._begun(problem, start)
        at = theta = run.dynamics.theta
        moved, information = np.inf, np.zeros((0, 0))
        for k in range(self.passes):
            before = theta
            theta, information = run.passed(at, k)
            moved = float(np.sqrt((theta - before) @ information @ (theta - before) / max(run.directions.rank, 1)))
            if moved < CLOSE:
                break
            at = run.inside(at, theta, information)
        notes = (*run.notes, *([StillMoving(self.passes, moved)] if moved >= CLOSE else []))
        rank, total = run.directions, problem.regression.triangular_factors.total
        fit = of_information(theta, information, rank, total, notes)
        return estimate_of(problem, replace(fit, weights=start.residual.weights))

    def _begun(self, problem: Problem, start: Estimate) -> _Run:
        """Return the run from a start, or from another one where that has no mass matrix."""

        def tried(value: Array) -> _Run | Failure:
            try:
                return _Run.begin(self, problem, replace(start, value=value))
            except InputError:
                return Singular()

        try:
            return _Run.begin(self, problem, start)
        except InputError as error:
            other = other_model(problem, Singular(), tried)
            if isinstance(other, Failure):
                raise error from None
            _, run, kind = other
            return replace(run, notes=(StartedElsewhere(kind), *run.notes))

    def quick(self) -> LeastSquares:
        """Return least squares: a filter takes too long for a search."""
        return LeastSquares()


@dataclass(frozen=True, eq=False)
class _Found:
    """A linear ``fit`` that is known."""

    fit: LinearFit

    __repr__ = brief

    def __call__(self, problem: Problem) -> Estimate:
        """Return the estimate without constraints."""
        return estimate_of(problem, self.fit)

    def reduced(self, _: Problem) -> LinearFit:
        """Return the fit."""
        return self.fit


@dataclass(frozen=True, eq=False)
class _Run:
    """One estimation: the pieces, the smooth model with the directions that are estimated, what to note, and the
    ``means`` (B, K, n) of the torque that parameters (p) leave in each step."""

    settings: AugmentedKalman
    problem: Problem
    series: Series
    dynamics: Dynamics
    directions: Rank
    notes: tuple[Note, ...]
    means: Callable[[Array], Array]

    __repr__ = brief

    @classmethod
    def begin(cls, settings: AugmentedKalman, problem: Problem, start: Estimate) -> _Run:
        """Return the run from the estimate of least squares."""
        groups = [grouping(one, settings.samples) for one in problem.motions]
        step = max(g * float(np.diff(one.t).mean()) for g, one in zip(groups, problem.motions, strict=True))
        rank = start.determined.directions
        if rank is None:
            raise ModelError("the start of the filter does not say what the data determine.")
        sigma = np.maximum(misfit(problem, start.value), LEAST * _largest(problem))
        model, widths, uncertain = smooth_model(problem, start.value, step)
        given = problem, settings.samples, sigma, uncertain
        series = series_of(*given, _left(problem, start.value))
        found = start.residual
        own = (
            1.0 if found.weights is None else float(np.mean(np.square(found.weights * np.maximum(found.sigma, sigma))))
        )
        unit = rank.determined / rank.values[: rank.rank] * np.sqrt(own * len(series.off) / PIECES)
        within = float(np.sqrt((1.0 - 1.0 / max(groups) ** 2) / 12.0 + 1.0 / 288.0))  # of the samples, and of the slope
        dynamics = Dynamics(model, start.value, unit, within)
        _ = _mobile(dynamics, series, start.value)
        least = EXACT * step**2 / 2 * _mobility(dynamics, series) @ series.noise.mean(axis=(0, 1))
        series = replace(series, sigma=np.maximum(series.sigma, least))
        notes = (SmoothSigns(widths),) if widths and _many(uncertain, sigma) else ()

        def means(theta: Array) -> Array:
            return series_of(*given, _left(problem, theta)).mean

        return cls(settings, problem, series, dynamics, rank, notes, means)

    def inside(self, at: Array, theta: Array, information: Array) -> Array:
        """Return parameters (p) like theta whose mass matrix can be inverted: the consistent ones nearest to it where
        there are bodies, and on the way from ``at`` (p), where it can, as far as no joint becomes much lighter."""
        dynamics = replace(self.dynamics, theta=at)
        if _mobile(dynamics, self.series, theta):
            return theta
        if bodies_of(self.problem.model.parameters):
            total = self.problem.regression.triangular_factors.total
            own = _Found(of_information(theta, information, self.directions, total, ()))
            theta = PhysicallyConsistent(costs=False, fit=own)(self.problem).value
        share = 1.0
        while share > SHORTEST and not _mobile(dynamics, self.series, at + share * (theta - at)):
            share /= 2
        return np.asarray(at + share * (theta - at))

    def passed(self, theta: Array, number: int) -> tuple[Array, Array]:
        """Return theta (p) after a pass from there, and its information (p, p)."""
        dynamics, series = replace(self.dynamics, theta=theta), replace(self.series, mean=self.means(theta))
        n, r = dynamics.joints, dynamics.directions.shape[1]
        x, S = self._start(r)
        white, count = 0.0, 0
        predicted = _extended if self.settings.method == "extended" else _cubature
        for k in range(series.mean.shape[1]):
            if k % REPORTED == 0:
                text = f"Kalman filter, pass {number + 1} of {self.settings.passes} at most"
                self.problem.progress(Step(text, k, series.mean.shape[1]))
            on = series.used[:, k]
            at = series.step[on], series.motion[:, on, k], series.mean[on, k]
            try:
                with np.errstate(all="ignore"):
                    moved = predicted(dynamics, x[on], S[on], series.noise[on, k], *at)
                    x[on], S[on], e = corrected(*moved, series.off[on, k + 1], series.sigma)
            except (ModelError, np.linalg.LinAlgError):
                raise _diverged(k) from None
            if not (np.isfinite(x).all() and np.isfinite(S).all() and np.abs(e).max() < LOST):
                raise _diverged(k)
            white, count = white + float(np.square(e).sum()), count + e.size
        a, information = _added(x[:, 2 * n :], S[:, 2 * n :], max(white / count, 1.0))
        back = self.directions.scale[:, None] * self.directions.vectors[:, :r]
        turned = back @ np.linalg.pinv(back.T @ dynamics.directions).T
        return theta + dynamics.directions @ a, turned @ information @ turned.T

    def _start(self, r: int) -> tuple[Array, Array]:
        """Return the first states (B, L) and their S (B, L, L)."""
        series = self.series
        usual = np.sqrt(np.mean([np.square(one.dq[one.mask]).mean(axis=0) for one in self.problem.motions], axis=0))
        slow = np.maximum(usual, 10 * series.sigma / series.step.min())
        size = np.concatenate([START[0] * series.sigma, START[1] * slow, np.full(r, SPREAD)])
        x = np.zeros((len(series.off), len(size)))
        x, S, _ = corrected(x, np.tile(np.diag(size), (len(x), 1, 1)), series.off[:, 0], series.sigma)
        return x, S


def _left(problem: Problem, theta: Array) -> tuple[Array, ...]:
    """Return what theta (p) leaves of the torque (N, n) of each motion."""
    return tuple(one.tau - problem.model.torque(**one.states(), theta=theta) for one in problem.motions)


def _largest(problem: Problem) -> Array:
    return np.asarray(np.max([np.abs(one.tau[one.mask]).max(axis=0) for one in problem.motions], axis=0))


def _many(uncertain: tuple[Array, ...], sigma: Array) -> bool:
    """Whether the sign of a velocity is not known at many samples."""
    return float((np.concatenate(uncertain) > sigma).mean(axis=0).max()) > MANY


def _masses(dynamics: Dynamics, series: Series, theta: Array) -> Array:
    """Return the mass matrix at some of the steps, (B, n, n)."""
    some = slice(None, None, EACH)
    return dynamics.model.mass_matrix(series.motion[0][:, some][series.used[:, some]], theta)


def _mobile(dynamics: Dynamics, series: Series, theta: Array) -> bool:
    """Whether no direction of the joints is lighter with theta (p) than ``LIGHTER`` times what it is now."""
    now, then = (_masses(dynamics, series, one) for one in (dynamics.theta, theta))
    try:
        half = np.linalg.inv(np.linalg.cholesky(now))
    except np.linalg.LinAlgError:
        raise _diverged(None) from None
    return float(np.linalg.eigvalsh(half @ then @ np.swapaxes(half, 1, 2))[:, 0].min()) > LIGHTER


def _mobility(dynamics: Dynamics, series: Series) -> Array:
    """Return the mean size (n, n) of the inverse mass matrix."""
    return np.asarray(np.abs(np.linalg.inv(_masses(dynamics, series, dynamics.theta))).mean(axis=0))


def _extended(
    dynamics: Dynamics, x: Array, S: Array, noise: Array, step: Array, motion: Array, left: Array
) -> tuple[Array, Array]:
    """Return state and S after a step, linearised at the smoothed motion (3, B, n)."""
    F, G, c = dynamics.linear(step, motion, left)
    return (F @ x[..., None])[..., 0] + c, lower(np.concatenate([F @ S, G * np.tile(noise, 2)[:, None]], axis=2))


def _cubature(
    dynamics: Dynamics, x: Array, S: Array, noise: Array, step: Array, motion: Array, left: Array
) -> tuple[Array, Array]:
    """Return state and S after a step, by the points of the cubature rule."""
    moved = dynamics.moved(step, motion, left, points(x, S))
    after = moved.mean(axis=1)
    spread = np.swapaxes(moved - after[:, None], 1, 2) / np.sqrt(moved.shape[1])
    G = dynamics.linear(step, motion, left)[1]
    return after, lower(np.concatenate([spread, G * np.tile(noise, 2)[:, None]], axis=2))


def _added(a: Array, S: Array, scatter: float) -> tuple[Array, Array]:
    """Return a (r) with its information (r, r) from the last states (B, r) of all pieces and S (B, r, L): what each
    tells beyond what it started with. ``scatter`` is the variance of white innovations."""
    r = a.shape[1]
    inverse = np.linalg.inv(S @ np.swapaxes(S, 1, 2))
    information = (inverse - np.eye(r) / SPREAD**2).sum(axis=0)
    if not np.linalg.eigvalsh(information)[0] > 0:
        raise _diverged(None)
    found = np.linalg.solve(information, (inverse @ a[..., None]).sum(axis=0)[:, 0])
    return found, information / scatter


def _diverged(k: int | None) -> InputError:
    where = "" if k is None else f" at step {k + 1} of a piece"
    return InputError(
        f"the Kalman filter diverged{where}: a mass matrix of its parameters is singular, or its motion left the "
        "measured one. Give a model whose bodies have mass (terms, rotor inertias), more steps (samples), the method "
        "extended, or an estimator that needs no mass matrix, such as consistent."
    )
