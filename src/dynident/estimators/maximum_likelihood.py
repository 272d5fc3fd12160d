"""Maximum likelihood of eq. (7): errors in positions and torques alike, on a spline trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, choices
from dynident.estimators.consistent import Consistent
from dynident.estimators.constraints import bodies_of
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import LeastSquares
from dynident.likelihood import (
    Barrier,
    Demand,
    Fitted,
    Segment,
    Settings,
    State,
    demands,
    maximise,
    noise,
    plan,
    steps_of,
    whiteness,
)
from dynident.log import Log

__all__ = ["MaximumLikelihood"]

Array = NDArray[np.float64]
Start = Literal["free", "rest", "test"]
MARGIN, DEEP = 0.3, 0.8  # room to the boundary that a first and a second start are given, relative to the usual size
WIDEST, NARROWEST = 80.0, 1.25  # spacings of the knots, in samples
CLOSE = 1e-9  # residual of a position, relative to its range, that is as good as none
LIMIT = 1.959964  # of a normal deviate, for 95 %
LONGEST = 6.0  # of the search for the end of an interval, in the parameter's logarithm
ROUGH = 100.0  # factor of the tolerance while the noise is only roughly known
LOOSE = 1e3  # factor of the usual accelerations, that leaves a spline free
WHITE = 1e-3  # probability below which residuals are not white
LEAST = {"q": 1e-7, "tau": 1e-4}  # least noise, relative to the largest value: the spline is hardly more exact
NULL = 1e-12  # relative information below which a direction counts as not excited


@dataclass(frozen=True)
class MaximumLikelihood:
    """The trajectory and theta that make measured positions and torques most likely: article, eq. (7).

    ``start``: "rest" where the recordings start from standstill, "test" to decide it by a likelihood ratio at the level
    of 1 %, "free" where they may start in motion. ``spacing`` (samples) of the knots far from steps of the torque; None
    halves 80 until the positions are fitted to white residuals, or 1.25 is reached. ``steps``: whether steps of the
    torque are looked for; None does so unless the model has Coulomb friction, whose reversals look like steps. A start
    from rest is one. ``huber`` (standard deviations, such as 1.345) bounds the pull of a torque sample. ``rounds`` of
    estimating the noise of each joint's position and torque. Parameters whose standard error exceeds the share
    ``profile`` of their value get intervals by profile likelihood; None leaves all symmetric.

    The start is a fit of least squares, or the consistent one for bodies, moved to where physics allows it; where the
    iteration fails it is returned, and the status says so. The barrier ``weight`` that keeps inertia and friction
    physical is in units of half a squared standard deviation.
    """

    start: Start = "free"
    spacing: float | None = None
    steps: bool | None = None
    huber: float | None = None
    rounds: int = 2
    profile: float | None = 0.15
    weight: float = 1e-3
    tolerance: float = 1e-3
    iterations: int = 60

    def __post_init__(self) -> None:
        if self.start not in get_args(Start):
            raise ConfigError(f"start = {self.start!r}; {choices(self.start, get_args(Start))}")
        for name in ("spacing", "huber", "profile"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"{name} = {value}; give a positive number, or leave it out.")
        for name in ("rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a whole number from 1.")
        for name in ("weight", "tolerance"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a number between 0 and 1, such as 1e-3.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; the status says how it went. Raises ConfigError, InputError and ModelError as the start does."""
        model = problem.model
        start = Consistent(costs=False)(problem) if bodies_of(model.parameters) else LeastSquares()(problem)
        fallback = start
        try:
            run = _Run.begin(self, problem, start)
            fallback = replace(start, value=run.theta)  # as near to it as physics allows
            return run.estimate()
        except (ModelError, InputError, np.linalg.LinAlgError) as error:
            return replace(fallback, status=f"maximum likelihood failed, this is the least-squares start: {error}")


@dataclass(eq=False)
class _Run:
    """One estimation on its way."""

    settings: MaximumLikelihood
    problem: Problem
    start: Estimate
    logs: tuple[Log, ...]
    barrier: Barrier
    theta: Array
    sigma_q: Array
    sigma_tau: Array
    segments: tuple[Segment, ...] = ()
    states: tuple[State, ...] = ()

    @classmethod
    def begin(cls, settings: MaximumLikelihood, problem: Problem, start: Estimate) -> _Run:
        logs = problem.logs or _logs(problem)
        sizes = [len(log) for log in logs]
        q, tau = ([noise(getattr(log, name), least) for log in logs] for name, least in LEAST.items())
        sigma_q, sigma_tau = (np.sqrt(np.average(np.square(x), axis=0, weights=sizes)) for x in (q, tau))
        wanted = demands(problem.model, logs, start.value)
        barrier = Barrier(wanted, settings.weight)
        theta = _feasible(start.value, problem, wanted)
        sigma_tau = np.maximum(sigma_tau, _misfit(problem, theta))  # what the model cannot explain counts as noise
        return cls(settings, problem, start, logs, barrier, theta, sigma_q, sigma_tau)

    def estimate(self) -> Estimate:
        notes: list[str] = []
        fitted = self.fitted(rest=self.settings.start != "free")
        if not fitted.converged or _inverted(fitted.information)[3].any():
            fitted = self.again(fitted)
        if self.settings.start == "test":
            fitted, word = self.tested(fitted)
            notes += word
        if not fitted.converged:
            notes.append(f"not converged after {fitted.iterations} steps (expected fall {fitted.decrement:.1e})")
        return self.told(fitted, notes)

    def fitted(self, *, rest: bool) -> Fitted:
        """Lay out the segments, and fit with the noise known better each round."""
        look = self.settings.steps
        if look is None:
            look = all(parameter.role != "coulomb" for parameter in self.problem.model.parameters)
        found = tuple(steps_of(log, self.sigma_tau) if look else () for log in self.logs)
        self.lay_out(found, rest=rest)
        fitted = self.maximised(hold=2, loose=ROUGH if self.settings.rounds > 1 else 1.0)
        for _ in range(self.settings.rounds - 1):
            self.reweighted()
            fitted = self.maximised()
        return fitted

    def again(self, fitted: Fitted) -> Fitted:
        """Search once more from well inside of what physics allows, and keep the more likely end."""
        deep = _feasible(self.start.value, self.problem, self.barrier.demands, DEEP)
        other = self.searched(deep, self.states, hold=3)
        better = other if other.converged and (other.cost < fitted.cost or not fitted.converged) else fitted
        self.theta, self.states = better.theta, better.states
        return better

    def lay_out(self, steps: Sequence[Sequence[float]], *, rest: bool) -> None:
        """Choose the knots' spacing by fits to the positions alone, whose residuals must be white."""
        bend = np.max([10 * motion.ddq.std(axis=0) + 1e-9 for motion in self.problem.motions], axis=0)
        spacing = self.settings.spacing or WIDEST
        while True:
            pairs = zip(self.logs, steps, strict=True)
            self.segments = tuple(plan(log, times, spacing, self.sigma_tau, rest=rest) for log, times in pairs)
            if self.settings.spacing or spacing <= NARROWEST:
                break
            left = [one.offset(one.start(self.sigma_q, LOOSE * bend)) for one in self.segments]
            power = sum((x**2).sum(axis=0) for x in left) / sum(map(len, left))
            close = (power < (CLOSE * np.ptp(np.concatenate([log.q for log in self.logs]), axis=0)) ** 2).all()
            if close or self.white(left):
                # what the spline cannot follow counts as noise
                self.sigma_q = np.maximum(self.sigma_q, np.sqrt(power))
                break
            spacing /= 2
        self.states = tuple(one.start(self.sigma_q, bend) for one in self.segments)
        if self.settings.huber is None:
            pairs = zip(self.segments, self.states, strict=True)
            self.segments = tuple(
                one.condensed(self.problem.model, state, self.theta, self.sigma_tau) for one, state in pairs
            )

    def white(self, left: Sequence[Array]) -> bool:
        """Return whether the residuals of all positions are as good as white."""
        pairs = zip(left, self.segments, strict=True)
        return min(whiteness(x, one.trajectory.size) for x, one in pairs) > WHITE

    def maximised(self, hold: int = 0, loose: float = 1.0) -> Fitted:
        """Search from where the run stands, and move there."""
        fitted = self.searched(self.theta, self.states, hold, loose)
        self.theta, self.states = fitted.theta, fitted.states
        return fitted

    def searched(
        self, theta: Array, states: tuple[State, ...], hold: int = 0, loose: float = 1.0, fixed: int | None = None
    ) -> Fitted:
        """Search from a theta and states, with one parameter fixed or none."""
        bodies = any(parameter.body for parameter in self.problem.model.parameters)
        settings = Settings(loose * self.settings.tolerance, self.settings.iterations, newton=not bodies)
        model, noise = self.problem.model, (self.sigma_q, self.sigma_tau)
        return maximise(model, self.segments, states, theta, *noise, self.barrier, settings, hold, fixed)

    def intervals(self, fitted: Fitted, covariance: Array) -> Array:
        """Return 95 % intervals (p, 2): by profile likelihood where the standard error is large, else symmetric."""
        std = np.sqrt(np.diag(covariance))
        out = fitted.theta[:, None] + LIMIT * std[:, None] * np.array([-1.0, 1.0])
        share = self.settings.profile
        if share is not None and np.isfinite(std).all():
            for k in np.flatnonzero(std > share * np.abs(fitted.theta)):
                out[k] = [self.crossing(fitted, covariance, int(k), sign) for sign in (-1, 1)]
        return np.asarray(out)

    def crossing(self, fitted: Fitted, covariance: Array, k: int, sign: int) -> float:
        """Return where the profile likelihood of parameter k falls to its 95 % limit, on one side.

        The root of the deviance is nearly linear in the logarithm of the parameter: regula falsi finds the crossing.
        A value at which the deviance stays low to the last is returned as it is.
        """
        value, std = float(fitted.theta[k]), float(np.sqrt(covariance[k, k]))
        along = covariance[:, k] / covariance[k, k]
        size = std / abs(value)
        known, x, theta, states = [(0.0, 0.0)], LIMIT * size, fitted.theta, fitted.states
        for _ in range(6):
            aim = value * float(np.exp(sign * np.sign(value) * x))
            start = theta + along * (aim - theta[k])
            start[k] = aim
            if not self.barrier.inside(start):
                start = theta.copy()
                start[k] = aim
            if not self.barrier.inside(start):
                x = (x + known[-1][0]) / 2
                continue
            found = self.searched(start, states, hold=1, loose=10.0, fixed=k)
            theta, states = found.theta, found.states
            known.append((x, float(np.sqrt(2 * max(found.cost - fitted.cost, 0.0)))))
            if abs(known[-1][1] - LIMIT) < 0.03 or x > LONGEST:
                break
            low = max((pair for pair in known if pair[1] < LIMIT), default=known[0])
            high = min((pair for pair in known if pair[1] >= LIMIT), default=None)
            if high is None:
                x = low[0] * min(LIMIT / max(low[1], 0.5), 2.0) if low[0] else 2 * x
            else:
                x = low[0] + (high[0] - low[0]) * (LIMIT - low[1]) / (high[1] - low[1])
        return value * float(np.exp(sign * np.sign(value) * x))

    def left(self) -> tuple[list[Array], list[Array]]:
        """Return the residuals of positions and torques (N, n) by segment, in units of their deviations."""
        pairs = [
            one.residuals(self.problem.model, state, self.theta)
            for one, state in zip(self.segments, self.states, strict=True)
        ]
        q = [a / self.sigma_q for a, _ in pairs]
        return q, [b / self.sigma_tau for _, b in pairs]

    def reweighted(self) -> None:
        """Estimate the noise from the residuals and the degrees of freedom left; with Huber, the trust too."""
        q, tau = self.left()
        taken = sum(
            one.leverage(self.problem.model, state, self.theta, self.sigma_q, self.sigma_tau)
            for one, state in zip(self.segments, self.states, strict=True)
        )
        N = sum(map(len, self.logs))
        free = np.maximum(N - np.asarray(taken), 0.05 * N)
        if self.settings.huber is not None:
            c = self.settings.huber
            trust = [np.minimum(1.0, c / np.maximum(np.abs(x), 1e-300)) for x in tau]
            self.segments = tuple(one.trusting(x) for one, x in zip(self.segments, trust, strict=True))
            scale = 1.4826 * np.median(np.abs(np.concatenate(tau)), axis=0) * np.sqrt(N / free[1])
        else:
            scale = np.sqrt(sum((x**2).sum(axis=0) for x in tau) / free[1])
        self.sigma_tau = self.sigma_tau * np.maximum(scale, 1e-6)
        self.sigma_q = self.sigma_q * np.maximum(np.sqrt(sum((x**2).sum(axis=0) for x in q) / free[0]), 1e-6)

    def tested(self, fitted: Fitted) -> tuple[Fitted, list[str]]:
        """Free the initial velocity, and keep it free where the likelihood ratio says so."""
        from scipy.stats import chi2

        held = (self.segments, self.states, self.theta)
        self.segments = tuple(replace(one, rest=False) for one in self.segments)
        free = self.maximised()
        gain, degrees = 2 * (fitted.cost - free.cost), len(self.logs) * len(self.sigma_q)
        chance = float(chi2.sf(max(gain, 0.0), degrees))
        if chance < 0.01:
            return free, [f"the recordings do not start from rest (likelihood ratio, p = {chance:.1e})"]
        self.segments, self.states, self.theta = held
        return fitted, []

    def told(self, fitted: Fitted, notes: Sequence[str]) -> Estimate:
        model, tau = self.problem.model, self.left()[1]
        covariance, rank, condition, lost = _inverted(fitted.information)
        words = list(notes)
        if lost.any():
            names = [name for name, gone in zip(model.names, lost, strict=True) if gone]
            words.append(f"rank {rank} of {len(lost)}: not determined alone: {', '.join(names)}")
        deviation = np.sqrt(np.mean(np.concatenate(tau) ** 2, axis=0)) * self.sigma_tau
        return Estimate(
            value=fitted.theta,
            covariance=covariance,
            names=model.names,
            units=tuple(parameter.unit for parameter in model.parameters),
            sigma=deviation,
            rank=rank,
            condition=condition,
            samples=sum(map(len, self.logs)),
            status="; ".join(words) or "ok",
            interval=self.intervals(fitted, covariance) if fitted.converged else np.zeros((0, 2)),
        )


def _logs(problem: Problem) -> tuple[Log, ...]:
    """Return the runs of usable samples of the motions as logs: where no measured logs are given."""
    out = []
    for motion in problem.motions:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], motion.mask.astype(int), [0]])))
        for lo, hi in zip(edges[::2], edges[1::2], strict=True):
            if hi - lo >= 20:
                part = slice(lo, hi)
                out.append(Log(motion.t[part], motion.q[part], motion.tau[part], motion.joints, motion.source))
    if not out:
        raise InputError("maximum likelihood needs a run of at least 20 usable samples.")
    return tuple(out)


def _misfit(problem: Problem, theta: Array) -> Array:
    """Return the usual size (n) of what theta leaves of the torques on the smoothed motions: it does not see transients."""
    left = [
        (one.tau - problem.model.torque(one.q, one.dq, one.ddq, theta))[one.mask] for one in problem.motions
    ]
    return np.asarray(1.4826 * np.median(np.abs(np.concatenate(left)), axis=0))


def _feasible(theta: Array, problem: Problem, wanted: tuple[Demand, ...], margin: float = MARGIN) -> Array:
    """Return theta (p) moved into the demands by the least change of the torque, with some room to their boundary."""
    from dynident.estimators.cone import positive

    compressed = problem.regression.compressed
    factor = compressed.stacked(
        1.0 / np.maximum(np.sqrt(compressed.residual(theta) / np.maximum(compressed.rows, 1)), 1e-12)
    )
    hessian = factor[:, :-1].T @ factor[:, :-1]
    matrices, room = [], []
    for one in wanted:
        usual = np.abs(np.diagonal(one.slopes @ theta, axis1=1, axis2=2)).max(axis=0)
        usual = np.maximum(usual, 1e-6 * max(float(usual.max()), 1e-12))
        scale = 1.0 / np.sqrt(usual)
        matrices.append(one.slopes * np.multiply.outer(scale, scale)[None, :, :, None])
        room.append(margin if one.centre is None else 1e-9)
    inside = all(np.linalg.eigvalsh(M @ theta)[..., 0].min() >= least for M, least in zip(matrices, room, strict=True))
    return theta if inside else positive(theta, hessian, matrices, room)


def _inverted(information: Array) -> tuple[Array, int, float, NDArray[np.bool_]]:
    """Return covariance, rank, condition, and which parameters are not determined (their variance is infinite)."""
    scale = np.sqrt(np.maximum(np.diag(information), 0.0))
    empty = scale <= 1e-15 * scale.max()
    scale[empty] = 1.0
    values, vectors = np.linalg.eigh(np.where(empty | empty[:, None], 0.0, information / np.outer(scale, scale)))
    kept = values > NULL * values[-1]
    half = vectors[:, kept] / np.sqrt(values[kept]) / scale[:, None]
    covariance = half @ half.T
    lost = (vectors[:, ~kept] ** 2).sum(axis=1) > 1e-6
    covariance[lost, :] = covariance[:, lost] = 0.0
    covariance[lost, lost] = np.inf
    condition = float(np.sqrt(values[-1] / values[0])) if values[0] > 0 else np.inf
    return (covariance + covariance.T) / 2, int(kept.sum()), condition, lost
