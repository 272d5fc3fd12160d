"""Intervals by a block bootstrap: the fit, repeated with stretches of the training drawn anew.

Stretches of time are drawn with replacement, each as its triangular factors, so that a repetition costs a merge and a
fit however long the logs are. It holds for residuals that are correlated within a stretch, and for estimators whose
errors have no formula. References: Efron (1979); for blocks Kunsch (1989).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, Step, brief, called
from dynident.estimators import Estimate, Estimator, Problem
from dynident.identification.result import Identification
from dynident.jobs import Limits, Status, run_jobs
from dynident.models import Model, Parameter
from dynident.regression import (
    BaseParameters,
    Part,
    Regression,
    TriangularFactors,
    divided,
    factors_of_parts,
    merged,
    one_thread,
)

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Bootstrap", "bootstrap"]

Array = NDArray[np.float64]
Draw = tuple[int, tuple[int, ...]]  # the number of a repetition, and how often it has each stretch
FEWEST = 10  # stretches, below which what is drawn from them says little
LEAST = 20  # usable samples of a stretch


@dataclass(frozen=True, eq=False)
class Bootstrap:
    """An estimate with the repetitions of its fit on stretches of the training that were drawn anew.

    ``value`` (p) is the estimate, ``repeated`` (B, p) what the repetitions found, less what the fit to all stretches
    differs from the estimate by; ``determined`` (p) says which parameters the data determine by themselves, ``basis``
    the base parameters where these are not all. ``blocks`` stretches were drawn from; ``failed`` repetitions have no
    row.
    """

    parameters: tuple[Parameter, ...]
    value: Array
    repeated: Array
    determined: NDArray[np.bool_]
    basis: BaseParameters | None
    blocks: int
    failed: int = 0

    __repr__ = brief

    @property
    def std(self) -> Array:
        """Standard errors (p) of the parameters, infinite where the data do not determine one."""
        return np.where(self.determined, self.repeated.std(axis=0, ddof=1), np.inf)

    @property
    def base_std(self) -> Array:
        """Standard errors (r) of the base parameters; of all parameters where the data determine them."""
        return np.asarray(self._base(self.repeated).std(axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Return the ends (p, 2) of intervals that hold the true parameters with a probability of ``level``.

        They are infinite where the data do not determine a parameter. ConfigError for a level outside (0, 1).
        """
        return np.where(self.determined[:, None], _ends(self.repeated, level), [-np.inf, np.inf])

    def base_interval(self, level: float = 0.95) -> Array:
        """Return the same (r, 2) of the base parameters."""
        return _ends(self._base(self.repeated), level)

    def frame(self, level: float = 0.95) -> pl.DataFrame:
        """Return a table, one row per parameter: parameter, value, std, low, high, unit."""
        import polars as pl

        low, high = self.interval(level).T
        names, units = ([getattr(one, name) for one in self.parameters] for name in ("name", "unit"))
        columns = {"parameter": names, "value": self.value, "std": self.std, "low": low, "high": high, "unit": units}
        return pl.DataFrame(columns)

    def _base(self, theta: Array) -> Array:
        return theta if self.basis is None else theta @ self.basis.combination.T


def bootstrap(
    found: Identification,
    runs: int,
    rng: np.random.Generator,
    *,
    blocks: int = 100,
    executor: Executor | None = None,
    limits: Limits | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Bootstrap:
    """Repeat the fit of an identification ``runs`` times, each time to stretches of its training drawn with ``rng``.

    The training is cut into about ``blocks`` stretches: many enough to draw from, and each longer than residuals
    correlate. Smoother, terms and time offset stay as they are. The repetitions run on ``executor``, by default in this
    process, with the same result. ``progress`` is called after each.

    Raises ConfigError where the estimator needs more than triangular factors (maximum likelihood has intervals of its
    own), or for settings that are too small; InputError where the training is too short, its signals are not there
    (a result that was loaded), or where no repetition succeeds.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4))
    >>> repeated = dy.bootstrap(found, 200, rng, blocks=20)
    >>> for name, (low, high) in zip(arm.names, repeated.interval()):
    ...     print(f"{name}: {low:.4f} to {high:.4f}")
    J: 0.0824 to 0.0825
    h: 0.2496 to 0.2501
    """
    _check(found, runs, blocks)
    regression = _regression(found)
    with one_thread():
        each = factors_of_parts(regression, _stretches(regression, blocks), executor)
        fit = _Fit(found.model, found.recipe.estimator, each)
        whole = fit((0, (1,) * len(each)))
        values, failed, reason = dict[int, Array](), 0, ""
        for done in run_jobs(fit, _draws(rng, runs, len(each)), executor, limits=limits):
            if done.status is Status.OK and done.value is not None:
                values[done.job[0]] = done.value
            else:
                failed, reason = failed + 1, done.reason
            progress(Step("drawing stretches anew", len(values) + failed, runs))
    if len(values) < 2:
        raise InputError(f"{failed} of {runs} repetitions of the fit failed, the last by: {reason}")
    estimate, basis = found.estimate, found.base.on_data
    repeated = np.stack([values[k] for k in sorted(values)]) - whole + estimate.value
    sure = np.isfinite(found.errors.std)
    return Bootstrap(estimate.parameters, estimate.value, repeated, sure, basis, len(each), failed)


@dataclass(frozen=True, eq=False)
class _Fit:
    """The fit to stretches, each as often as a draw has it: picklable, and sent to a worker once."""

    model: Model
    estimator: Estimator
    each: tuple[TriangularFactors, ...]

    def __call__(self, draw: Draw) -> Array:
        """Return the parameters (p)."""
        drawn = ((one, count) for one, count in zip(self.each, draw[1], strict=True) if count)
        factors = merged(TriangularFactors(one.factors * np.sqrt(count), one.rows * count) for one, count in drawn)
        regression = Regression(self.model, ()).with_factors(factors)
        return called(self.estimator, Problem(self.model, (), regression), Estimate).value


def _draws(rng: np.random.Generator, runs: int, blocks: int) -> Iterator[Draw]:
    """Yield the draws, which depend on the generator alone."""
    counts = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), size=runs)
    return ((k, tuple(row.tolist())) for k, row in enumerate(counts))


def _stretches(regression: Regression, blocks: int) -> Sequence[Part]:
    """Return the stretches that are drawn from; InputError where there are too few samples."""
    samples = sum(int(motion.mask.sum()) for motion in regression.motions)
    found = divided(regression, max(samples // blocks, LEAST))
    if len(found) < FEWEST:
        raise InputError(
            f"{samples} samples of training are {len(found)} stretches of at least {LEAST} to draw from; {FEWEST} are "
            "needed: record longer."
        )
    return found


def _regression(found: Identification) -> Regression:
    """Return the linear problem of an identification."""
    motions = tuple(one.motion for one in found.validations if one.role == "train")
    speeds = found.recipe.min_speeds([joint.name for joint in found.model.joints])
    return Regression(found.model, motions, found.recipe.filter, speeds)


def _check(found: Identification, runs: int, blocks: int) -> None:
    if found.estimate.needs_samples:
        raise ConfigError(
            f"the bootstrap draws from triangular factors, and {type(found.recipe.estimator).__name__} needs all "
            "samples (maximum likelihood has its intervals in `estimate.interval`). Identify with least squares, or "
            "with physical consistency."
        )
    if runs < 2 or blocks < FEWEST:
        raise ConfigError(f"runs = {runs} and blocks = {blocks} of the bootstrap; give at least 2 and {FEWEST}.")


def _ends(repeated: Array, level: float) -> Array:
    """Return percentiles (p, 2) of the repetitions, which stay within the bounds of the fit."""
    if not 0 < level < 1:
        raise ConfigError(f"level = {level} of an interval; give a number between 0 and 1, such as 0.95.")
    return np.quantile(repeated, [(1 - level) / 2, (1 + level) / 2], axis=0).T
