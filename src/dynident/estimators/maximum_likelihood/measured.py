"""The input of maximum likelihood: logs as measured, their noise, and a feasible start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, Note
from dynident.estimators.constraints import PsdConstraint
from dynident.estimators.constraints.cone import nearest_feasible
from dynident.estimators.estimator import Problem
from dynident.estimators.maximum_likelihood.plan import steps_of
from dynident.estimators.maximum_likelihood.search import Recordings
from dynident.estimators.notes import Averaged
from dynident.log import Log, Motion
from dynident.regression import fitted_rows, stretches
from dynident.splines import median_sigma, steady_noise

__all__ = ["feasible", "misfit", "recordings", "usual_noise"]

Array = NDArray[np.float64]
MARGIN = 0.3  # slack of the start, relative to the usual size
THIN = 1e-3  # the same for bodies, which are often nearly rods or plates
LEAST = {"q": 1e-7, "tau": 1e-4}  # least noise, relative to the largest value: the spline is hardly more exact
SHORTEST = 20  # samples of a recording


def recordings(problem: Problem, rate: float | None, *, steps: bool) -> tuple[Recordings, list[Note]]:
    """Return the logs as measured, averaged down to about ``rate`` (Hz), and notes on this.

    Where the problem has no logs, the runs of usable samples of the motions are used.
    """
    notes: list[Note] = []
    remembered = problem.motions
    if problem.logs:
        logs = tuple(map(_bridged, problem.logs))
    else:
        logs, remembered = zip(*_runs(problem), strict=True)
    used = _used(problem, len(logs))
    group = _grouping(logs, rate)
    if group > 1:
        logs = tuple(_thinned(log, group) for log in logs)
        used = [None if one is None else _means(one.astype(float), group) == 1 for one in used]
        notes.append(Averaged(group))
    sigma_tau = usual_noise(logs)[1]
    found = tuple(steps_of(log, sigma_tau) if steps else () for log in logs)
    acceleration = np.stack([10 * motion.ddq.std(axis=0) + 1e-9 for motion in problem.motions]).max(axis=0)
    return Recordings(tuple(logs), found, tuple(used), problem.time_offset, acceleration, remembered), notes


def _bridged(log: Log) -> Log:
    """Return a log with straight torques over excluded samples: their steps and noise must not count, either."""
    if log.excluded is None or log.excluded.all():
        return log
    known = ~log.excluded
    columns = [np.interp(log.t, log.t[known], column[known]) for column in log.tau.T]
    return replace(log, tau=np.stack(columns, axis=1))


def _used(problem: Problem, logs: int) -> list[NDArray[np.bool_] | None]:
    """Return which torques (N, n) of each log are used, None for all."""
    min_speed = problem.regression.min_speed
    if logs != len(problem.motions):
        return [None] * logs
    return [fitted_rows(one, min_speed) for one in problem.motions]


def _grouping(logs: Sequence[Log], rate: float | None) -> int:
    """Return how many neighbouring samples to average; 1 where a log would become too short."""
    most = max((len(log) - 1) / float(np.ptp(log.t)) for log in logs)
    group = 1 if rate is None else int(np.ceil(most / rate))
    return group if min(map(len, logs)) >= SHORTEST * group else 1


def usual_noise(logs: Sequence[Log]) -> tuple[Array, Array]:
    """Return the standard deviations (n) of white noise in the positions and torques."""
    sizes = [len(log) for log in logs]
    found = ([steady_noise(getattr(log, name), least) for log in logs] for name, least in LEAST.items())
    q, tau = (np.sqrt(np.average(np.square(x), axis=0, weights=sizes)) for x in found)
    return q, tau


def misfit(problem: Problem, theta: Array) -> Array:
    """Return the usual size (n) of the torque residuals of theta on the smoothed motions, without transients."""
    left = [(one.tau - problem.model.torque(**one.states(), theta=theta))[one.mask] for one in problem.motions]
    return median_sigma(np.concatenate(left))


def feasible(theta: Array, problem: Problem, wanted: Sequence[PsdConstraint], margin: float = MARGIN) -> Array:
    """Return theta (p) moved into the constraints by the least change of the torque, with some slack.

    theta is returned unchanged where the solver finds no such point.
    """
    triangular = problem.regression.triangular_factors
    factor = triangular.stacked(
        1.0 / np.maximum(np.sqrt(triangular.residual(theta) / np.maximum(triangular.rows, 1)), 1e-12)
    )
    hessian = factor[:, :-1].T @ factor[:, :-1]
    matrices, slack = [], []
    for one in wanted:
        usual = np.abs(np.diagonal(one.slopes @ theta, axis1=1, axis2=2)).max(axis=0)
        usual = np.maximum(usual, 1e-6 * max(float(usual.max()), 1e-12))
        scale = 1.0 / np.sqrt(usual)
        matrices.append(one.slopes * np.multiply.outer(scale, scale)[None, :, :, None])
        slack.append(margin if one.centre is None else THIN)
    if _has_slack(theta, matrices, slack):
        return theta
    point = nearest_feasible(theta, hessian, matrices, slack)
    # an inaccurate solution is not used where the start is feasible
    return point if _has_slack(point, matrices, [0.5 * least for least in slack]) else theta


def _has_slack(theta: Array, matrices: Sequence[Array], slack: Sequence[float]) -> bool:
    return all(np.linalg.eigvalsh(M @ theta)[..., 0].min() >= least for M, least in zip(matrices, slack, strict=True))


def _runs(problem: Problem) -> list[tuple[Log, Motion]]:
    out = []
    for motion in problem.motions:
        for part in stretches(motion.mask):
            if part.stop - part.start >= SHORTEST:
                log = Log(motion.t[part], motion.q[part], motion.tau[part], motion.joints, motion.source)
                out.append((log, motion))
    if not out:
        raise InputError(f"maximum likelihood needs a run of at least {SHORTEST} usable samples.")
    return out


def _thinned(log: Log, group: int) -> Log:
    t, q, tau = (_means(x, group) for x in (log.t, log.q, log.tau))
    return Log(t, q, tau, log.joints, log.source)


def _means(x: Array, group: int) -> Array:
    """Return the means of ``group`` neighbours of x (N, ...); the remainder at the end is dropped."""
    whole = len(x) // group * group
    return np.asarray(x[:whole].reshape(-1, group, *x.shape[1:]).mean(axis=1))
