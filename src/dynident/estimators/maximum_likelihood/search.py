"""From measured logs to the most likely parameters: knots, noise estimated in rounds, and Newton's search."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from dynident.estimators.barrier import Barrier
from dynident.estimators.maximum_likelihood.equations import Hypothesis, Likelihood, RegressorColumns, leverage, scores
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings, maximise
from dynident.estimators.maximum_likelihood.plan import (
    Recordings,
    crossing,
    has_sign,
    plan_segment,
    sweep_intervals,
    whiteness_probability,
    with_smooth_signs,
)
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.models import Model
from dynident.motion.splines import median_sigma
from dynident.runtime import ModelError, Noun, Step, report_progress
from dynident.runtime.arrays import Array

SPACINGS = (80.0, 40.0, 20.0, 10.0, 5.0, 2.5, 1.25)  # of the knots, in samples
MIN_INTERVALS = 4  # intervals of a recording: the residuals of fewer are too few to tell whether they are white
MIN_WHITENESS_SPACING = 4.0  # spacing, in samples, below which a spline makes any residual look white
MIN_ACCELERATION = 1e-8  # usual acceleration (rad/s^2, m/s^2) of a joint that does not move
UNUSED_SIGN_WIDTH = 1e3  # rad/s, m/s: width of a sign of velocity that is not there
EQUAL_POWER_RATIO = 1.1  # ratio of two powers of the torque's residual that count as equal
EXACT_RESIDUAL = 1e-9  # residual of a position, relative to its range, that counts as zero
FREE_SPLINE_FACTOR = 1e3  # factor of the usual accelerations, that leaves a spline free
MAX_UNCERTAIN_SHARE = 0.02  # share of the samples with an uncertain sign above which it is noted
MIN_WHITENESS = 1e-3  # probability below which residuals are not white
# factor of the tolerance where a parameter is held for its profile: the expected fall is taken off
PROFILE_TOLERANCE_FACTOR = 300.0
MIN_DEVIANCE = 1e-6  # half the deviance that counts as none
MIN_FREE_SHARE = 0.05  # least share of residuals that count as degrees of freedom
SCORE_CLUSTERS = 200  # parts of the recordings whose scores count as independent


class _Knots(Noun):
    """Segments of one spacing, the power (n) of the position residuals, and whether that is ``converged``."""

    segments: tuple[Segment, ...]
    power: Array
    converged: bool


def free_degrees(counts: ArrayLike, taken: ArrayLike) -> Array:
    """Return the degrees of freedom of residuals: their counts less those that a fit takes, but at least some."""
    return np.asarray(np.maximum(np.subtract(counts, taken), MIN_FREE_SHARE * np.asarray(counts)))


@dataclass(eq=False)
class LikelihoodSearch:
    """The state of the search.

    theta (p), the ``directions`` (p, v) in which it may move, the noise ``sigma``, the segments and their states,
    and the degrees of freedom (n) of the torques, where they were needed for the noise.
    """

    model: Model
    recordings: Recordings
    barrier: Barrier
    settings: NewtonSettings
    directions: Array
    theta: Array
    sigma: Sigma
    segments: tuple[Segment, ...] = ()
    states: tuple[State, ...] = ()
    torque_degrees: Array | None = None

    @property
    def likelihood(self) -> Likelihood:
        """The likelihood at the current settings."""
        return Likelihood(self.model, self.segments, self.sigma, self.barrier, self.directions, self._columns)

    @cached_property
    def _columns(self) -> RegressorColumns:
        """The independent columns of the model's regressor, which smooth signs leave as they are."""
        return RegressorColumns.independent(self.model)

    def choose_knots(self, spacing: float | None, *, from_rest: bool, condense: bool) -> None:
        """Choose the knots: ``spacing`` samples, or as wide as fits to the positions alone allow.

        Their residuals must be white. Where they never are, because real noise is not white, the narrowest knots are
        taken that predict the torque as well as any other.
        """
        if spacing:
            self.segments = self._plan_segments(spacing, from_rest=from_rest)
        else:
            knots = self._choose_spacing(from_rest=from_rest)
            # the spline's misfit counts as noise; differences of few samples a period take the motion for noise
            self.segments = knots.segments
            self.sigma = replace(self.sigma, q=np.maximum(self.recordings.min_sigma_q, np.sqrt(knots.power)))
        self.states = tuple(
            segment.initial_state(self.sigma.q, self.recordings.usual_acceleration) for segment in self.segments
        )
        if condense:
            pairs = zip(self.segments, self.states, strict=True)
            self.segments = tuple(
                segment.condense(self.model, state, self.theta, self.sigma.tau) for segment, state in pairs
            )

    def _plan_segments(self, spacing: float, *, from_rest: bool) -> tuple[Segment, ...]:
        time_offset, sigma_tau = self.recordings.time_offset, self.sigma.tau
        remembered = self.recordings.remembered or (None,) * len(self.recordings.logs)
        inputs = zip(self.recordings.logs, self.recordings.steps, self.recordings.used_torques, remembered, strict=True)
        return tuple(
            plan_segment(log, times, spacing, sigma_tau, time_offset, used, motion, from_rest=from_rest)
            for log, times, used, motion in inputs
        )

    def _choose_spacing(self, *, from_rest: bool) -> _Knots:
        """Return the widest knots with white residuals of the positions, else those chosen by the torque."""
        widest = max(map(len, self.recordings.logs)) / MIN_INTERVALS
        candidates = []
        # halve the spacing of the knots until the residuals of the positions are white
        for size in SPACINGS:
            if MIN_WHITENESS_SPACING < size <= widest:
                candidates.append(self._try_spacing(size, from_rest=from_rest))
                if candidates[-1].converged:
                    return candidates[-1]
        return self._choose_by_torque(candidates, from_rest=from_rest)

    def _choose_by_torque(self, candidates: list[_Knots], *, from_rest: bool) -> _Knots:
        """Return the narrowest knots, tried or narrower, that predict the torque as well as any other."""
        residual_power = [self._torque_residual_power(knots.segments) for knots in candidates]
        # then halve it further, as long as the torque gains from it
        for size in SPACINGS:
            if size < MIN_WHITENESS_SPACING:
                if len(residual_power) > 1 and residual_power[-1] >= min(residual_power[:-1]) / EQUAL_POWER_RATIO:
                    break  # the last halving gained nothing
                candidates.append(self._try_spacing(size, from_rest=from_rest))
                residual_power.append(self._torque_residual_power(candidates[-1].segments))
        return candidates[int(np.flatnonzero(residual_power <= EQUAL_POWER_RATIO * np.min(residual_power))[-1])]

    def _try_spacing(self, size: float, *, from_rest: bool) -> _Knots:
        """Return the knots of a spacing, after a fit to the positions alone."""
        segments = self._plan_segments(size, from_rest=from_rest)
        residuals = [segment.offset(self._fit_positions(segment)) for segment in segments]
        degrees = free_degrees(sum(map(len, residuals)), sum(segment.trajectory.size for segment in segments))
        power = sum(((x**2).sum(axis=0) for x in residuals), np.zeros(len(self.sigma.q))) / degrees
        exact = EXACT_RESIDUAL * np.ptp(np.concatenate([log.q for log in self.recordings.logs]), axis=0)
        pairs = zip(residuals, segments, strict=True)
        whiteness = min(whiteness_probability(x, segment.trajectory.size) for x, segment in pairs)
        return _Knots(segments, power, whiteness > MIN_WHITENESS or bool((power < exact**2).all()))

    def _fit_positions(self, segment: Segment) -> State:
        """Return the motion fitted to a segment's positions alone."""
        return segment.initial_state(self.sigma.q, FREE_SPLINE_FACTOR * self.recordings.usual_acceleration)

    def _torque_residual_power(self, segments: Sequence[Segment]) -> float:
        """Return the power of the torque residual of fits to the positions alone."""
        residuals = [segment.residuals(self.model, self._fit_positions(segment), self.theta)[1] for segment in segments]
        pairs = zip(segments, residuals, strict=True)
        # torques that are not fitted count for nothing
        return sum(float((((segment.raw.weight > 0) * x / self.sigma.tau) ** 2).sum()) for segment, x in pairs)

    def smooth_signs(self) -> tuple[float, ...]:
        """Smooth the sign over the uncertainty of the velocities; return the widths if many samples are affected."""
        if not has_sign(self.model):
            return ()
        resolutions = [
            segment.resolution(self.sigma.q, self.recordings.usual_acceleration) for segment in self.segments
        ]
        is_still = self.recordings.usual_acceleration < MIN_ACCELERATION
        width = np.where(is_still, UNUSED_SIGN_WIDTH, np.max(resolutions, axis=0))
        speed = [np.abs(segment.motion(state)[1]) for segment, state in zip(self.segments, self.states, strict=True)]
        self.model = with_smooth_signs(self.model, width)
        # few samples near a reversal: the smoothed sign needs no note
        if float((np.concatenate(speed) < 2 * width).mean(axis=0)[~is_still].max(initial=0.0)) < MAX_UNCERTAIN_SHARE:
            return ()
        return tuple(width[~is_still].tolist())

    def run(self, hold: int = 0, loose: float = 1.0) -> LikelihoodFit:
        """Search from the current state, and move to the result."""
        return self.move_to(self.search_from(self.theta, self.states, hold, loose))

    def move_to(self, fit: LikelihoodFit) -> LikelihoodFit:
        """Move to the result of a search, and return it."""
        self.theta, self.states = fit.theta, fit.states
        return fit

    def search_from(
        self, theta: Array, states: tuple[State, ...], hold: int = 0, loose: float = 1.0, fixed: int | None = None
    ) -> LikelihoodFit:
        """Search from a theta and states, with one parameter fixed or none."""
        settings = replace(self.settings, tolerance=loose * self.settings.tolerance, hold=hold, fixed=fixed)

        def trace(step: int, *_: object) -> None:
            report_progress(Step("maximum likelihood, steps", step))

        return maximise(self.likelihood, states, theta, settings, trace)

    def with_free_start(self) -> LikelihoodSearch:
        """Return the search with the velocities at the start unknown."""
        return replace(self, segments=tuple(replace(segment, from_rest=False) for segment in self.segments))

    def residuals(self) -> tuple[list[Array], list[Array]]:
        """Return the residuals of positions and torques by segment, in units of their deviations; zero where unused."""
        q, tau = [], []
        for segment, state in zip(self.segments, self.states, strict=True):
            positions, torques = segment.residuals(self.model, state, self.theta)
            q.append(positions / self.sigma.q)
            tau.append((segment.raw.weight > 0) * torques / self.sigma.tau)
        return q, tau

    def reweight(self, huber: float | None, fit: LikelihoodFit) -> None:
        """Estimate the noise from the residuals and degrees of freedom of the current fit.

        With ``huber``, the sample weights are estimated, too.
        """
        q, tau = self.residuals()
        arrows = [segment.arrow for segment in fit.segments]
        inputs = zip(self.segments, self.states, arrows, strict=True)
        hypothesis = Hypothesis(self.model, self.theta, self.sigma)
        leverages = np.sum([leverage(segment, hypothesis, state, arrow) for segment, state, arrow in inputs], axis=0)
        counts = np.array(
            [sum(map(len, q)) + 0 * self.sigma.q, sum((segment.raw.weight > 0).sum(0) for segment in self.segments)]
        )
        unused, counts = counts == 0, np.maximum(counts, 1)  # of a joint whose torque was not recorded nothing is used
        # the fit takes degrees of freedom from each joint's positions and torques: without them noise is underestimated
        degrees_of_freedom = free_degrees(counts, leverages)
        self.torque_degrees = degrees_of_freedom[1]
        if huber is not None:
            trust = [np.minimum(1.0, huber / np.maximum(np.abs(x), 1e-300)) for x in tau]
            self.segments = tuple(segment.weight_torques(x) for segment, x in zip(self.segments, trust, strict=True))
            scale = median_sigma(np.concatenate(tau)) * np.sqrt(counts[1] / degrees_of_freedom[1])
        else:
            scale = np.sqrt(sum((x**2).sum(axis=0) for x in tau) / degrees_of_freedom[1])
        scale_q = np.sqrt(sum((x**2).sum(axis=0) for x in q) / degrees_of_freedom[0])
        self.sigma = Sigma(
            np.maximum(self.sigma.q * scale_q, self.recordings.min_sigma_q),
            self.sigma.tau * np.maximum(scale, 1e-6) ** ~unused[1],
        )

    def _fit_with_fixed(self, last: LikelihoodFit, theta: Array, k: int, value: float) -> LikelihoodFit | None:
        """Return the best fit with parameter k at a value, from theta near the ``last`` fit; None where there is
        none."""
        # a step along the covariance may leave the feasible set: then only the parameter itself is moved
        theta[k] = value
        if not self.barrier.is_inside(theta):
            theta = last.theta.copy()
            theta[k] = value
        if not self.barrier.is_inside(theta):
            return None
        try:
            return self.search_from(
                theta, last.extrapolate(self.segments, theta), hold=1, loose=PROFILE_TOLERANCE_FACTOR, fixed=k
            )
        except (ModelError, np.linalg.LinAlgError):  # too far away to be evaluated
            return None

    def profile_intervals(self, fit: LikelihoodFit, covariance: Array, k: int) -> Array:
        """Return 95 % intervals (p, 2) along the profile likelihood of parameter k.

        The parameter keeps its sign where it must not be zero. Where a physical constraint is reached first, the
        interval ends there.
        """
        value, std = float(fit.theta[k]), float(np.sqrt(covariance[k, k]))
        along, zero = covariance[:, k] / std**2, fit.theta.copy()
        zero[k] = 0.0
        keeps_sign = not self.barrier.is_inside(zero)
        path: list[tuple[float, Array]] = []  # signed roots of the deviance, and the best fits there

        def end(side: int) -> float:
            """Return the end of the interval on one side, where the likelihood or physics ends it."""
            last, inward = fit, keeps_sign and side * value < 0
            # from one share to the next; not the parameter itself, which may be near zero or at a bound
            scale, direction = (value, -1) if inward else (side * max(abs(value), std), 1)

            def root(share: float) -> tuple[float, float]:
                """Return the root of the deviance where the parameter is held at a share, and its slope."""
                nonlocal last
                aim = value + scale * (share - 1)
                fixed_fit = self._fit_with_fixed(last, last.theta + along * (aim - last.theta[k]), k, aim)
                if fixed_fit is None:
                    return np.nan, np.nan
                last, increase = fixed_fit, fixed_fit.cost - fit.cost
                r = float(np.sqrt(2 * max(increase, MIN_DEVIANCE)))
                path.append((side * r, fixed_fit.theta))
                slope = fixed_fit.gradient[k] + self.barrier.derivatives(fixed_fit.theta)[0][k]
                return direction * r, float(slope) * scale / (direction * r)

            return value + scale * (crossing(root, std / abs(scale), direction) - 1)

        # each end starts from the estimate, and continues from the last fit on its side
        ends = [end(-1), end(1)]
        out = sweep_intervals(fit.theta, path, covariance, k)
        out[k] = ends
        return out

    def sandwich_std(self, fit: LikelihoodFit, inverse: Array) -> tuple[Array, Array]:
        """Return the sandwich standard deviations (p), and how many parts of the recordings contribute to each (p).

        ``inverse`` (p, p) is that of the information. The scores of stretches of the recordings are taken as
        independent; nothing is assumed about the noise within them.
        """
        out = []
        for segment, state, elimination in zip(self.segments, fit.states, fit.segments, strict=True):
            follow = elimination.sensitivity @ fit.columns.combination
            # the scores of neighbouring samples depend on each other: sum them over stretches
            pulls = scores(segment, Hypothesis(self.model, fit.theta, self.sigma), state, follow)
            breaks, part_count = segment.trajectory.breaks, max(int(SCORE_CLUSTERS / len(self.segments)), 2)
            middle = (breaks[:-1] + breaks[1:]) / 2
            edges = np.searchsorted(middle, np.linspace(breaks[0], breaks[-1], part_count + 1)[:-1])
            edges = np.unique(np.minimum(edges, len(middle) - 1))
            out.append(np.add.reduceat(pulls, edges))
        square = (np.concatenate(out) @ inverse) ** 2
        return np.sqrt(square.sum(axis=0)), square.sum(axis=0) ** 2 / np.maximum((square**2).sum(axis=0), 1e-300)
