"""What torque and motion must agree on before a fit: the delay between them, and how the base stands.

Both are nonlinear in the torque and few; the parameters of the model are eliminated at every trial value (variable
projection; Golub and Pereyra 1973), so that only one to three unknowns are searched.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError
from dynident.estimators import Consistent, Estimator, LeastSquares, Problem
from dynident.log import Log, Motion
from dynident.model import Model
from dynident.regression import Regression, compress
from dynident.selection import choose_smoother, excerpts
from dynident.smoothers import Delayed, Smoother

__all__ = ["Delay", "Lean", "find_delay", "find_lean", "mounted", "pair"]

Array = NDArray[np.float64]
ENTRIES = 200_000  # samples of all logs together times parameters: one or two unknowns need no more
FEWEST = 200  # samples below which no delay is sought
TRIALS = (0.0, 0.001, 0.003, 0.01, 0.032)  # s, of either sign; the search refines the best
FINE = 2e-5  # s
GAIN = 0.005  # share of the error that a delay must take away to be believed
STEEPEST = 0.2  # rad: a base that leans more was mounted so on purpose
START = 1e-3  # rad: at zero lean the links' masses that only a lean shows have no effect yet


@dataclass(frozen=True)
class Delay:
    """By how much the positions lag the torque, ``seconds``, and the training error (%) without and with it."""

    seconds: float
    before: float
    after: float

    @property
    def words(self) -> str:
        """The finding in words."""
        if not self.seconds:
            return f"none that lowers the training error ({self.before:.3g} %)"
        late, early = ("positions", "torques") if self.seconds > 0 else ("torques", "positions")
        return (
            f"{late} come {1e3 * abs(self.seconds):.2g} ms later than {early}; taken into account, the training error "
            f"is {self.after:.3g} % instead of {self.before:.3g} %"
        )


@dataclass(frozen=True)
class Lean:
    """How the base leans: rotations about the root link's x and y axes, in rad, with standard errors and errors (%)."""

    x: float
    y: float
    std: tuple[float, float]
    before: float
    after: float

    @property
    def words(self) -> str:
        """The finding in words."""
        return (
            f"the base leans by {np.rad2deg(self.x):.2f} deg about x and {np.rad2deg(self.y):.2f} deg about y "
            f"(+- {np.rad2deg(self.std[0]):.2f} and {np.rad2deg(self.std[1]):.2f}); taken into account, the training "
            f"error is {self.after:.3g} % instead of {self.before:.3g} %"
        )


def mounted(model: Model, x: float, y: float) -> Model:
    """Return the model on a base that leans by x and y (rad) about the axes of its root link.

    Raises ConfigError where no term of the model knows of gravity.
    """
    from scipy.spatial.transform import Rotation

    back = Rotation.from_rotvec((-x, -y, 0.0))
    terms: list[Any] = []
    for term in model.terms:
        gravity = getattr(term, "gravity", None)
        terms.append(term if gravity is None else replace(term, gravity=tuple(back.apply(gravity).tolist())))  # type: ignore[type-var]
    if all(new is old for new, old in zip(terms, model.terms, strict=True)):
        raise ConfigError(f"{model.name}: no term has a gravity that could be turned; only robot files have one.")
    return replace(model, terms=tuple(terms))


def pair(
    model: Model,
    logs: Sequence[Log],
    smoothers: Sequence[Smoother],
    delay: float | Literal["estimate"],
    estimator: Estimator,
    slow: tuple[float, ...] | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Smoother, dict[str, str]]:
    """Return the smoother, chosen among ``smoothers`` and delayed, that pairs torque and motion; and words by topic.

    Of several smoothers ``choose_smoother`` takes one, before the delay is known and again with it.
    """
    told: dict[str, str] = {}

    def chosen(candidates: Sequence[Smoother]) -> Smoother:
        if len(candidates) == 1:
            return candidates[0]
        choice = choose_smoother(model, logs, candidates, progress=progress)
        told["smoother"] = choice.words
        return choice.smoother

    if delay != "estimate":
        return chosen([Delayed(one, delay) for one in smoothers] if delay else smoothers), told
    best = chosen(smoothers)
    progress("finding the delay")
    found = find_delay(model, [best(log) for log in excerpts(logs)], estimator, slow)
    told["delay"] = found.words
    return chosen([Delayed(one, found.seconds) for one in smoothers]) if found.seconds else best, told


def find_delay(
    model: Model, motions: Sequence[Motion], estimator: Estimator, slow: tuple[float, ...] | None = None
) -> Delay:
    """Return the delay, within 32 ms, at which the estimator explains the unfiltered torque of the motions best.

    It is zero where that takes away less than 0.5 % of the error, and where the best value lies at the end of the
    range: that is no delay but another fault. ``slow`` (n) is that of the fit. Raises the errors of ``Regression``
    and the estimator.
    """
    from scipy.optimize import minimize_scalar

    rows = _thinned(model, motions, TRIALS[-1])
    if sum(map(len, rows)) < FEWEST:
        return Delay(0.0, np.nan, np.nan)
    quick = _quick(estimator)

    def error(delay: float) -> float:
        return _error(Regression(model, _shifted(motions, rows, delay), slow=slow), quick)

    grid = sorted({sign * trial for trial in TRIALS for sign in (-1.0, 1.0)})
    errors = [error(delay) for delay in grid]
    k, before = int(np.argmin(errors)), errors[grid.index(0.0)]
    if k in (0, len(grid) - 1):
        return Delay(0.0, before, before)
    found = minimize_scalar(error, bounds=(grid[k - 1], grid[k + 1]), method="bounded", options={"xatol": FINE})
    after, best = min((float(found.fun), float(found.x)), (errors[k], grid[k]))
    return Delay(best, before, after) if after < (1.0 - GAIN) * before else Delay(0.0, before, before)


def find_lean(
    model: Model, motions: Sequence[Motion], estimator: Estimator, slow: tuple[float, ...] | None = None
) -> Lean:
    """Return the lean of the base at which the estimator explains the torque of the motions best.

    Gauss-Newton steps on the residual, in which the estimator has eliminated all other parameters. Raises ConfigError
    where the best lean exceeds 0.2 rad, and the errors of ``mounted``, ``Regression`` and the estimator.
    """
    from scipy.optimize import least_squares

    thin = _shifted(motions, _thinned(model, motions, 0.0), 0.0)
    quick = _quick(estimator)

    def residual(lean: Array) -> Array:
        turned = mounted(model, *lean)
        regression = Regression(turned, thin, slow=slow)
        blocks = list(regression.blocks())  # few rows, needed twice: for the factors and for the residual
        regression.__dict__["compressed"] = compress(iter(blocks), len(model.joints), len(model.parameters))
        value = quick(Problem(turned, thin, regression)).value
        parts = [(one.tau - one.Y @ value) * (1.0 if one.keep is None else one.keep) for one in blocks]
        return np.concatenate(parts).ravel()

    level = residual(np.zeros(2))
    torque = np.sqrt(sum(float(np.sum(one.tau[one.mask] ** 2)) for one in thin))
    found = least_squares(residual, np.full(2, START), diff_step=0.1, x_scale=0.01, xtol=1e-3, ftol=1e-4, max_nfev=20)
    spread = np.sqrt(np.diag(np.linalg.pinv(found.jac.T @ found.jac)) * 2.0 * found.cost / max(level.size - 2, 1))
    seen = np.abs(found.x) > 2.0 * spread  # what the motion does not show is left level
    x, y = (float(v) for v in found.x * seen)
    if max(abs(x), abs(y)) > STEEPEST:
        raise ConfigError(
            f"the base would lean by {np.rad2deg(x):.3g} deg about x and {np.rad2deg(y):.3g} deg about y, more than "
            "any mounting error; give `gravity` as it is, and look whether the joints' zeros and axes are right."
        )
    before, after = (100.0 * float(np.linalg.norm(r)) / torque for r in (level, residual(np.array([x, y]))))
    return Lean(x, y, (float(spread[0]), float(spread[1])), before, after)


def _quick(estimator: Estimator) -> Estimator:
    """Return what stands for the estimator at the trial values: least squares, under its constraints if it has any."""
    if isinstance(estimator, Consistent):
        return replace(estimator, costs=False)
    return estimator if isinstance(estimator, LeastSquares) else LeastSquares()


def _shifted(motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], delay: float) -> tuple[Motion, ...]:
    return tuple(one.delayed(delay, keep) for one, keep in zip(motions, rows, strict=True) if len(keep) > 1)


def _error(regression: Regression, estimator: Estimator) -> float:
    """Return the relative error (%) of the fit to the regression's own rows."""
    compressed = regression.compressed
    value = estimator(Problem(regression.model, regression.motions, regression)).value
    torque = float(np.square(compressed.factors[:, :, -1]).sum())
    return 100.0 * float(np.sqrt(compressed.residual(value).sum() / torque)) if torque > 0 else 0.0


def _thinned(model: Model, motions: Sequence[Motion], margin: float) -> list[NDArray[np.intp]]:
    """Return the indices of usable samples of all motions, evenly spread, at least ``margin`` (s) from their ends."""
    wanted = ENTRIES // max(len(model.parameters), 10)
    every = max(1, sum(int(motion.mask.sum()) for motion in motions) // wanted)
    inside = [one.mask & (one.t >= one.t[0] + margin) & (one.t <= one.t[-1] - margin) for one in motions]
    return [np.flatnonzero(mask)[::every] for mask in inside]
