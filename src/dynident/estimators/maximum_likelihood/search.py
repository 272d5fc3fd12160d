"""From measured logs to the most likely parameters: knots, noise estimated in rounds, and Newton's search."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, Step
from dynident.estimators.constraints import Barrier
from dynident.estimators.maximum_likelihood.columns import Columns
from dynident.estimators.maximum_likelihood.equations import leverage, scores
from dynident.estimators.maximum_likelihood.friction import with_smooth_signs
from dynident.estimators.maximum_likelihood.likelihood import Likelihood
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings, maximise
from dynident.estimators.maximum_likelihood.plan import plan, whiteness
from dynident.estimators.maximum_likelihood.profile import crossing, swept
from dynident.estimators.maximum_likelihood.segment import Segment, Sigma, State
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.splines import median_sigma

__all__ = ["Recordings", "Search"]

Array = NDArray[np.float64]
SPACINGS = (80.0, 40.0, 20.0, 10.0, 5.0, 2.5, 1.25)  # of the knots, in samples
FEWEST = 4  # intervals of a recording: the residuals of fewer are too few to tell whether they are white
TELLING = 4.0  # spacing, in samples, below which a spline makes any residual look white
STILL = 1e-8  # usual acceleration (rad/s^2, m/s^2) of a joint that does not move
NO_SIGN = 1e3  # rad/s, m/s: width of a sign of velocity that is not there
SAME = 1.1  # ratio of two powers of the torque's residual that count as equal
CLOSE = 1e-9  # residual of a position, relative to its range, that counts as zero
LOOSE = 1e3  # factor of the usual accelerations, that leaves a spline free
MANY = 0.02  # share of the samples with an uncertain sign above which it is noted
WHITE = 1e-3  # probability below which residuals are not white
AFAR = 300.0  # factor of the tolerance where a parameter is held for its profile: the expected fall is taken off
TINY = 1e-6  # half the deviance that counts as none
CLUSTERS = 200  # parts of the recordings whose scores count as independent


@dataclass(frozen=True, eq=False)
class Recordings:
    """The measurements: logs, the steps of the torque (s) in each, which torques are ``used`` (N, n), the
    ``time_offset`` (s) of the positions, the ``usual_acceleration`` (n) of the joints, and the smoothed motions with
    what the model remembers of them.
    """

    logs: tuple[Log, ...]
    steps: tuple[tuple[float, ...], ...]
    used: tuple[NDArray[np.bool_] | None, ...]
    time_offset: float
    usual_acceleration: Array
    remembered: tuple[Motion, ...] = ()


@dataclass(frozen=True, eq=False)
class _Knots:
    """Segments of one spacing, the power (n) they leave of the positions, and whether that is ``converged``."""

    segments: tuple[Segment, ...]
    power: Array
    converged: bool


@dataclass(eq=False)
class Search:
    """The state of the search: theta (p), the ``directions`` (p, v) in which it may move, the noise ``sigma``, segments
    and their states."""

    model: Model
    given: Recordings
    barrier: Barrier
    settings: NewtonSettings
    directions: Array
    theta: Array
    sigma: Sigma
    segments: tuple[Segment, ...] = ()
    states: tuple[State, ...] = field(default=())
    progress: Callable[[str], None] = lambda _: None

    @property
    def likelihood(self) -> Likelihood:
        """The likelihood at the current settings."""
        return Likelihood(self.model, self.segments, self.sigma, self.barrier, self.directions, self._columns)

    @cached_property
    def _columns(self) -> Columns:
        """The independent columns of the model's regressor, which smooth signs leave as they are."""
        return Columns.independent(self.model)

    def choose_knots(self, spacing: float | None, *, rest: bool, condense: bool) -> None:
        """Choose the knots: ``spacing`` samples, or as wide as fits to the positions alone allow.

        Their residuals must be white. Where they never are, because real noise is not white, the narrowest knots are
        taken that predict the torque as well as any other.
        """
        if spacing:
            self.segments = self._planned(spacing, rest=rest)
        else:
            found = self._spaced(rest=rest)
            # the spline's misfit counts as noise
            self.segments = found.segments
            self.sigma = replace(self.sigma, q=np.maximum(self.sigma.q, np.sqrt(found.power)))
        self.states = tuple(one.start(self.sigma.q, self.given.usual_acceleration) for one in self.segments)
        if condense:
            pairs = zip(self.segments, self.states, strict=True)
            self.segments = tuple(one.condensed(self.model, state, self.theta, self.sigma.tau) for one, state in pairs)

    def _planned(self, spacing: float, *, rest: bool) -> tuple[Segment, ...]:
        late = self.given.time_offset
        remembered = self.given.remembered or (None,) * len(self.given.logs)
        given = zip(self.given.logs, self.given.steps, self.given.used, remembered, strict=True)
        return tuple(
            plan(log, times, spacing, self.sigma.tau, rest=rest, time_offset=late, used=used, remembered=one)
            for log, times, used, one in given
        )

    def _spaced(self, *, rest: bool) -> _Knots:
        """Return the widest knots that leave white residuals of the positions, else those chosen by the torque."""
        widest = max(map(len, self.given.logs)) / FEWEST
        tried = []
        for size in SPACINGS:
            if TELLING < size <= widest:
                tried.append(self._tried(size, rest=rest))
                if tried[-1].converged:
                    return tried[-1]
        return self._by_torque(tried, rest=rest)

    def _by_torque(self, tried: list[_Knots], *, rest: bool) -> _Knots:
        """Return the narrowest knots, tried or narrower, that predict the torque as well as any other."""
        missed = [self._missed(one.segments) for one in tried]
        for size in SPACINGS:
            if size < TELLING:
                if len(missed) > 1 and missed[-1] >= min(missed[:-1]) / SAME:
                    break  # the last halving gained nothing
                tried.append(self._tried(size, rest=rest))
                missed.append(self._missed(tried[-1].segments))
        return [one for one, x in zip(tried, missed, strict=True) if x <= SAME * min(missed)][-1]

    def _tried(self, size: float, *, rest: bool) -> _Knots:
        """Return the knots of a spacing, after a fit to the positions alone."""
        segments = self._planned(size, rest=rest)
        left = [one.offset(self._fitted(one)) for one in segments]
        power = sum(((x**2).sum(axis=0) for x in left), np.zeros(len(self.sigma.q))) / sum(map(len, left))
        exact = CLOSE * np.ptp(np.concatenate([log.q for log in self.given.logs]), axis=0)
        return _Knots(segments, power, self._white(left, segments) or bool((power < exact**2).all()))

    def _fitted(self, segment: Segment) -> State:
        """Return the motion fitted to a segment's positions alone."""
        return segment.start(self.sigma.q, LOOSE * self.given.usual_acceleration)

    def _missed(self, segments: Sequence[Segment]) -> float:
        """Return the power of the torque residual of fits to the positions alone."""
        left = [one.residuals(self.model, self._fitted(one), self.theta)[1] / self.sigma.tau for one in segments]
        return sum(float((((one.raw.weight > 0) * x) ** 2).sum()) for one, x in zip(segments, left, strict=True))

    def smooth_signs(self) -> tuple[float, ...]:
        """Smooth the sign over the uncertainty of the velocities; return the widths if many samples are affected."""
        known = [one.resolution(self.sigma.q, self.given.usual_acceleration) for one in self.segments]
        still = self.given.usual_acceleration < STILL
        width = np.where(still, NO_SIGN, np.max(known, axis=0))
        speed = [np.abs(one.motion(state)[1]) for one, state in zip(self.segments, self.states, strict=True)]
        self.model = with_smooth_signs(self.model, width)
        if float((np.concatenate(speed) < 2 * width).mean(axis=0)[~still].max(initial=0.0)) < MANY:
            return ()
        return tuple(width[~still].tolist())

    def _white(self, left: Sequence[Array], segments: Sequence[Segment]) -> bool:
        pairs = zip(left, segments, strict=True)
        return min(whiteness(x, one.trajectory.size) for x, one in pairs) > WHITE

    def run(self, hold: int = 0, loose: float = 1.0) -> LikelihoodFit:
        """Search from the current state, and move to the result."""
        return self.moved_to(self.searched(self.theta, self.states, hold, loose))

    def moved_to(self, fitted: LikelihoodFit) -> LikelihoodFit:
        """Move to the result of a search, and return it."""
        self.theta, self.states = fitted.theta, fitted.states
        return fitted

    def searched(
        self, theta: Array, states: tuple[State, ...], hold: int = 0, loose: float = 1.0, fixed: int | None = None
    ) -> LikelihoodFit:
        """Search from a theta and states, with one parameter fixed or none."""
        settings = replace(self.settings, tolerance=loose * self.settings.tolerance, hold=hold, fixed=fixed)

        def trace(step: int, *_: object) -> None:
            self.progress(Step("maximum likelihood, steps", step))

        return maximise(self.likelihood, states, theta, settings, trace)

    def with_free_start(self) -> Search:
        """Return the search with the velocities at the start unknown."""
        return replace(self, segments=tuple(replace(one, rest=False) for one in self.segments))

    def residuals(self) -> tuple[list[Array], list[Array]]:
        """Return the residuals of positions and torques by segment, in units of their deviations; zero where unused."""
        pairs = [
            one.residuals(self.model, state, self.theta) for one, state in zip(self.segments, self.states, strict=True)
        ]
        torques = zip(pairs, self.segments, strict=True)
        return [a / self.sigma.q for a, _ in pairs], [
            (one.raw.weight > 0) * b / self.sigma.tau for (_, b), one in torques
        ]

    def reweight(self, huber: float | None, fitted: LikelihoodFit) -> None:
        """Estimate the noise from the residuals and degrees of freedom of the fit moved to; with ``huber``, also the
        sample weights.
        """
        q, tau = self.residuals()
        known = [one.arrow for one in fitted.segments]
        found = zip(self.segments, self.states, known, strict=True)
        taken = np.sum([leverage(one, self.model, x, self.theta, self.sigma, band) for one, x, band in found], axis=0)
        there = np.array(
            [sum(map(len, q)) + 0 * self.sigma.q, sum((one.raw.weight > 0).sum(0) for one in self.segments)]
        )
        free = np.maximum(there - taken, 0.05 * there)
        if huber is not None:
            trust = [np.minimum(1.0, huber / np.maximum(np.abs(x), 1e-300)) for x in tau]
            self.segments = tuple(one.trusting(x) for one, x in zip(self.segments, trust, strict=True))
            scale = median_sigma(np.concatenate(tau)) * np.sqrt(there[1] / free[1])
        else:
            scale = np.sqrt(sum((x**2).sum(axis=0) for x in tau) / free[1])
        scale_q = np.sqrt(sum((x**2).sum(axis=0) for x in q) / free[0])
        self.sigma = Sigma(self.sigma.q * np.maximum(scale_q, 1e-6), self.sigma.tau * np.maximum(scale, 1e-6))

    def _held(self, last: LikelihoodFit, theta: Array, k: int, value: float) -> LikelihoodFit | None:
        """Return the best fit with parameter k at a value, from theta near the ``last``; None where there is none."""
        theta[k] = value
        if not self.barrier.inside(theta):
            theta = last.theta.copy()
            theta[k] = value
        if not self.barrier.inside(theta):
            return None
        try:
            return self.searched(theta, last.extrapolated(self.segments, theta), hold=1, loose=AFAR, fixed=k)
        except (ModelError, np.linalg.LinAlgError):  # too far away to be evaluated
            return None

    def profiled(self, fitted: LikelihoodFit, covariance: Array, k: int) -> Array:
        """Return 95 % intervals (p, 2) along the profile likelihood of parameter k.

        The parameter keeps its sign where it must not be zero. Where a physical constraint is reached first, the
        interval ends there.
        """
        value, std = float(fitted.theta[k]), float(np.sqrt(covariance[k, k]))
        along, zero = covariance[:, k] / std**2, fitted.theta.copy()
        zero[k] = 0.0
        keeps = not self.barrier.inside(zero)
        path: list[tuple[float, Array]] = []  # signed roots of the deviance, and the best fits there

        def end(side: int) -> float:
            """Return the end of the interval on one side, where the likelihood or physics ends it."""
            last, inward = fitted, keeps and side * value < 0
            # from one share to the next; not the parameter itself, which may be near zero or at a bound
            unit, way = (value, -1) if inward else (side * max(abs(value), std), 1)

            def root(share: float) -> tuple[float, float]:
                """Return the root of the deviance where the parameter is held at a share, and its slope."""
                nonlocal last
                aim = value + unit * (share - 1)
                found = self._held(last, last.theta + along * (aim - last.theta[k]), k, aim)
                if found is None:
                    return np.nan, np.nan
                last, fall = found, found.cost - fitted.cost
                r = float(np.sqrt(2 * max(fall, TINY)))
                path.append((side * r, found.theta))
                slope = found.gradient[k] + self.barrier.slopes(found.theta)[0][k]
                return way * r, float(slope) * unit / (way * r)

            return value + unit * (crossing(root, std / abs(unit), way) - 1)

        ends = [end(-1), end(1)]
        out = swept(fitted.theta, path, covariance, k)
        out[k] = ends
        return out

    def sandwich_std(self, fitted: LikelihoodFit, inverse: Array) -> tuple[Array, Array]:
        """Return the sandwich's standard deviations (p), and how many parts of the recordings contribute to each (p).

        ``inverse`` (p, p) is that of the information. The scores of stretches of the recordings are taken as
        independent; no assumption is made on the noise within them.
        """
        out = []
        for one, state, known in zip(self.segments, fitted.states, fitted.segments, strict=True):
            follow = known.follow @ fitted.columns.combination
            pulls = scores(one, self.model, state, fitted.theta, self.sigma, follow)
            middle = (one.trajectory.breaks[:-1] + one.trajectory.breaks[1:]) / 2
            part = max(int(CLUSTERS / len(self.segments)), 2)
            edges = np.searchsorted(
                middle, np.linspace(one.trajectory.breaks[0], one.trajectory.breaks[-1], part + 1)[:-1]
            )
            edges = np.unique(np.minimum(edges, len(middle) - 1))
            out.append(np.add.reduceat(pulls, edges))
        square = (np.concatenate(out) @ inverse) ** 2
        return np.sqrt(square.sum(axis=0)), square.sum(axis=0) ** 2 / np.maximum((square**2).sum(axis=0), 1e-300)
