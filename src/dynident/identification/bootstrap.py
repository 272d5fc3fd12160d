"""Confidence intervals by a block bootstrap over stretches of the training motion.

Stretches of time are drawn with replacement, each as its triangular factors, so that a repetition costs a
merge and a fit however long the logs are. It holds for residuals that are correlated within a stretch, and
for estimators whose errors have no formula. References: Efron (1979); for blocks Kunsch (1989).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Estimate, Estimator, Problem
from dynident.identification.result import Identification
from dynident.models import Model, Parameter
from dynident.regression import (
    BaseParameters,
    Regression,
    RegressionPart,
    TriangularFactors,
    divide_regression,
    factors_of_parts,
    merge_factors,
    one_thread,
)
from dynident.runtime import ConfigError, InputError, Noun, Step, call_part, report_progress
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import Limits, Status, run_jobs

if TYPE_CHECKING:
    import polars as pl

Draw = tuple[int, tuple[int, ...]]  # the number of a repetition, and how often it has each stretch
MIN_STRETCHES = 10  # stretches, below which what is drawn from them says little
MIN_STRETCH_SAMPLES = 20  # usable samples of a stretch


class Bootstrap(Noun):
    """An estimate with the repetitions of its fit on stretches of the training drawn with replacement.

    ``value`` (p) is the estimate. ``repetitions`` (B, p) are the values of the repeated fits, shifted by the
    difference between the estimate and the fit to all stretches. ``determined`` (p) says which parameters the
    data determine by themselves, ``basis`` are the base parameters where these are not all. ``blocks`` is the
    number of stretches drawn from; the ``failed`` repetitions have no row.
    """

    parameters: tuple[Parameter, ...]
    value: Array
    repetitions: Array
    determined: NDArray[np.bool_]
    basis: BaseParameters | None
    blocks: int
    failed: int = 0

    @property
    def std(self) -> Array:
        """Standard errors (p) of the parameters, infinite where the data do not determine one."""
        return np.where(self.determined, self.repetitions.std(axis=0, ddof=1), np.inf)

    @property
    def base_std(self) -> Array:
        """Standard errors (r) of the base parameters; of all parameters where the data determine them."""
        return np.asarray(self._base(self.repetitions).std(axis=0, ddof=1))

    def interval(self, level: float = 0.95) -> Array:
        """Return the ends (p, 2) of confidence intervals of the parameters at a ``level``.

        They are infinite where the data do not determine a parameter. Raises ConfigError for a level outside (0, 1).
        """
        return np.where(self.determined[:, None], _percentiles(self.repetitions, level), [-np.inf, np.inf])

    def base_interval(self, level: float = 0.95) -> Array:
        """Return the ends (r, 2) of confidence intervals of the base parameters at a ``level``."""
        return _percentiles(self._base(self.repetitions), level)

    def frame(self, level: float = 0.95) -> pl.DataFrame:
        """Return a table, one row per parameter: parameter, value, std, low, high, unit."""
        import polars as pl

        low, high = self.interval(level).T
        names, units = ([getattr(parameter, name) for parameter in self.parameters] for name in ("name", "unit"))
        columns = {"parameter": names, "value": self.value, "std": self.std, "low": low, "high": high, "unit": units}
        return pl.DataFrame(columns)

    def _base(self, theta: Array) -> Array:
        return theta if self.basis is None else theta @ self.basis.combination.T


def bootstrap(
    identification: Identification,
    runs: int,
    rng: np.random.Generator,
    *,
    blocks: int = 100,
    executor: Executor | None = None,
    limits: Limits | None = None,
) -> Bootstrap:
    """Repeat the fit of an identification ``runs`` times, each time to stretches of its training drawn with ``rng``.

    The training is cut into about ``blocks`` stretches: many enough to draw from, and each longer than residuals
    correlate. Smoother, terms and time offset stay as they are. The repetitions run on ``executor``, by default in this
    process, with the same result.

    Raises ConfigError where the estimator needs more than triangular factors (maximum likelihood has intervals of its
    own), or for settings that are too small; InputError where the training is too short, its signals are not there
    (a result that was loaded), or where no repetition succeeds.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
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
    _check_request(identification, runs, blocks)
    model, recipe = identification.model, identification.recipe
    regression = Regression(model, identification.training_motions, recipe.selection(model.joints))
    with one_thread():
        # Factors of each stretch are computed once; a repetition only merges and solves.
        stretches = factors_of_parts(regression, _stretches(regression, blocks), executor)
        fit = _Fit(model, recipe.estimator, stretches)
        full_fit = fit((0, (1,) * len(stretches)))
        # all come from the generator before any fit, so that the result does not depend on the executor
        counts = rng.multinomial(len(stretches), np.full(len(stretches), 1.0 / len(stretches)), size=runs)
        draws: Iterator[Draw] = ((k, tuple(row.tolist())) for k, row in enumerate(counts))
        values, failed, reason = dict[int, Array](), 0, ""
        for outcome in run_jobs(fit, draws, executor, limits=limits):
            if outcome.status is Status.OK and outcome.value is not None:
                values[outcome.job[0]] = outcome.value
            else:
                failed, reason = failed + 1, outcome.reason
            report_progress(Step("drawing stretches anew", len(values) + failed, runs))
    if len(values) < 2:
        raise InputError(f"{failed} of {runs} repetitions of the fit failed, the last by: {reason}")
    estimate, basis = identification.estimate, identification.base.on_data
    # Centre on the estimate: the fit from factors may differ from it where the estimator iterates on samples.
    repetitions = np.stack([values[k] for k in sorted(values)]) - full_fit + estimate.value
    determined = np.isfinite(identification.errors.std)
    return Bootstrap(estimate.parameters, estimate.value, repetitions, determined, basis, len(stretches), failed)


@dataclass(frozen=True, eq=False)
class _Fit:
    """The fit to drawn stretches, each repeated as often as it was drawn: picklable, and sent to a worker once."""

    model: Model
    estimator: Estimator
    stretches: tuple[TriangularFactors, ...]

    def __call__(self, draw: Draw) -> Array:
        """Return the parameters (p)."""
        # A stretch drawn count times weighs its squared errors by count, its rows by the square root.
        drawn = ((stretch, count) for stretch, count in zip(self.stretches, draw[1], strict=True) if count)
        factors = merge_factors(
            TriangularFactors(stretch.factors * np.sqrt(count), stretch.rows * count) for stretch, count in drawn
        )
        regression = Regression(self.model, ()).with_factors(factors)
        return call_part(self.estimator, Problem(self.model, (), regression), Estimate).value


def _stretches(regression: Regression, blocks: int) -> Sequence[RegressionPart]:
    """Return the stretches that are drawn from; InputError where there are too few samples."""
    samples = regression.usable_samples
    stretches = divide_regression(regression, max(samples // blocks, MIN_STRETCH_SAMPLES))
    if len(stretches) < MIN_STRETCHES:
        raise InputError(
            f"{samples} samples of training are {len(stretches)} stretches of at least {MIN_STRETCH_SAMPLES} "
            f"to draw from; {MIN_STRETCHES} are needed: record longer."
        )
    return stretches


def _check_request(identification: Identification, runs: int, blocks: int) -> None:
    if identification.estimate.needs_samples:
        raise ConfigError(
            "the bootstrap draws from triangular factors, and "
            f"{type(identification.recipe.estimator).__name__} needs all "
            "samples (maximum likelihood has its intervals in `estimate.interval`). Identify with least squares, or "
            "with physical consistency."
        )
    if runs < 2 or blocks < MIN_STRETCHES:
        raise ConfigError(f"runs = {runs} and blocks = {blocks} of the bootstrap; give at least 2 and {MIN_STRETCHES}.")


def _percentiles(repetitions: Array, level: float) -> Array:
    """Return percentiles (p, 2) of the repetitions, which stay within the bounds of the fit."""
    if not 0 < level < 1:
        raise ConfigError(f"level = {level} of an interval; give a number between 0 and 1, such as 0.95.")
    return np.quantile(repetitions, [(1 - level) / 2, (1 + level) / 2], axis=0).T
