"""Ridge regression: least squares shrunk towards a prior, in units of each parameter's typical size (Tikhonov)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Le

from dynident.estimators.estimator import Consistency, Estimate, Problem, Provenance, prior_notes, prior_values
from dynident.estimators.least_squares import LeastSquares, LinearEstimator, LinearFit, joint_weights, weight_joints
from dynident.estimators.notes import DrawnToPrior
from dynident.estimators.physical_constraints import estimate_sizes, parameter_scales
from dynident.estimators.programs import Information, add_prior, nearest_to_prior
from dynident.models import Model
from dynident.regression import TriangularFactors, divide_regression, factors_of_parts, merge_factors, rank_of
from dynident.runtime import Note, report_progress
from dynident.runtime.arrays import Array

NamedPrior = Literal["nominal", "none"]
MAX_STRENGTH = 1e9
STRENGTHS = tuple(10.0 ** (0.5 * k) for k in range(-10, 5))  # that are tried
FOLDS = 10
MIN_ROWS_PER_PARAMETER = 3  # times the parameters: with fewer there is nothing to predict
MIN_GAIN = 1.0  # % of the squared cross-validated error that a strength must remove


@dataclass(frozen=True)
class Ridge(LinearEstimator):
    """Least squares with a penalty on the distance from a prior: min |X theta - y|^2 + k |(theta - prior) / size|^2.

    ``prior`` is "nominal" (the model's values; a parameter without one is not drawn), "none" (all towards zero), or
    values by parameter name, which alone are drawn then. The ``size`` is the usual one of each parameter: by mass and
    length of a body, else the nominal value, or the one at which the parameter alone makes the whole torque. k is
    ``strength`` times the squared residual of least squares: the penalty is this share of it where one parameter is
    one usual size away. "auto" takes the strength with the least error on stretches of the data that are predicted from
    the others (ten blocks), and 0 unless that gains more than one standard error and 1 %. Joints are weighted by
    their residuals. What the data do not determine is at the prior, whatever the strength.

    A penalty biases the estimate, towards the prior. The covariance is that of least squares, and the square of what
    the prior moves a value by, which may be an error: intervals hold wherever those of least squares do, whatever the
    prior, and are too wide where it is right. What the data hardly determine gains; what they determine well cannot.
    A. E. Hoerl and R. W. Kennard (1970), "Ridge regression: biased estimation for nonorthogonal problems".

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> drawn = dy.Ridge(prior={"J": 0.09}, strength=1000)
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=drawn)
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0855 +- 0.00308
    h = 0.2585 +- 0.00867
    """

    prior: NamedPrior | Mapping[str, float] | tuple[tuple[str, float], ...] = "nominal"
    strength: Annotated[float, Ge(0), Le(MAX_STRENGTH)] | Literal["auto"] = "auto"

    by_parameter: ClassVar[tuple[str, ...]] = ("prior",)
    title = "ridge regression"

    def __post_init__(self) -> None:
        super().__post_init__()
        self.check_prior()

    def quick(self) -> Ridge | LeastSquares:
        """Return least squares where the strength is to be searched: with a strength of zero, ridge is that."""
        return LeastSquares(weights="per_joint") if self.strength == "auto" else self

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say what the data do not determine, and how strong the prior is where "auto" chose it.

        Raises ConfigError where the prior names parameters that the model does not have.
        """
        information, posterior, fit = self._fit(problem)
        prior = self._prior(problem.model)
        undetermined = information.directions.undetermined_mask
        value = nearest_to_prior(posterior, posterior.base, np.where(np.isnan(prior), 0.0, prior))
        # the shift by the prior may be an error, and widens the covariance; where the prior alone decides it is none
        shift = np.where(undetermined, 0.0, value - information.base)
        estimate = fit.estimate(problem)
        order = (Provenance.DATA, Provenance.PRIOR, Provenance.UNIDENTIFIABLE)
        provenance = tuple(order[k] for k in np.select([~undetermined, ~np.isnan(prior)], [0, 1], 2))
        return replace(
            estimate,
            value=value,
            covariance=estimate.covariance + np.outer(shift, shift),
            residual=fit.residual(problem, value),
            notes=(*estimate.notes, *prior_notes(provenance)),
            provenance=provenance,
            consistency=Consistency(unconstrained=information.base),
        )

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with those of the penalty, as far as it acts on what the data determine."""
        return self._fit(problem)[2]

    def _fit(self, problem: Problem) -> tuple[Information, Information, LinearFit]:
        """Return the information of the data, the same with the prior, and its rows; computed once for each problem."""
        return problem.fact((Ridge, self), lambda: self._penalised_fit(problem))

    def _penalised_fit(self, problem: Problem) -> tuple[Information, Information, LinearFit]:
        parameters, triangular = problem.model.parameters, problem.regression.triangular_factors
        weights = joint_weights(triangular, "per_joint", 3, parameters)
        prior = self._prior(problem.model)
        scale = _usual_sizes(problem.model, triangular, weights)
        information = _information(triangular, weights, scale, problem.model)
        strength = self.strength
        notes: tuple[Note, ...] = ()
        if strength == "auto":
            strength = _choose_strength(problem, prior, weights, scale)
            notes = (DrawnToPrior(strength),) if strength else ()
        posterior = add_prior(information, prior, strength)
        plain = _rows_from_information(information, problem, triangular.total, weights)
        rows = _rows_from_information(posterior, problem, triangular.total, weights)
        return information, posterior, replace(rows, notes=notes, plain=plain)

    def _prior(self, model: Model) -> Array:
        """Return the prior (p), nan where a parameter has none."""
        return np.zeros(len(model.names)) if self.prior == "none" else prior_values(self.prior, model)


def _usual_sizes(model: Model, triangular: TriangularFactors, weights: Array) -> Array:
    """Return the typical size (p) of each parameter."""
    bodies = estimate_sizes(model.parameters, triangular)
    effect = np.linalg.norm(triangular.stack(weights), axis=0)
    return parameter_scales(model.parameters, bodies, effect[:-1], float(effect[-1]))


def _information(triangular: TriangularFactors, weights: Array, scale: Array, model: Model) -> Information:
    """Return the information of the rows with these weights (n)."""
    factor, rank = weight_joints(triangular, weights, model.parameters)
    return Information.from_factor(factor, scale, rank, triangular.total)


def _rows_from_information(information: Information, problem: Problem, total: int, weights: Array) -> LinearFit:
    """Return rows whose solution is the base and whose covariance is that of the informed directions."""
    p, k = len(information.base), information.rank
    # rows that give the coordinates along the informed directions, of which the errors are independent
    inverse = np.linalg.inv(
        np.concatenate([information.informed, information.free], axis=1) / information.scale[:, None]
    )
    factor = np.zeros((p + 1, p + 1))
    factor[:k, :p] = inverse[:k] / information.scale
    factor[:k, p] = factor[:k, :p] @ information.base
    factor[p, p] = np.sqrt(max(total - k, 1))  # the variance of a row is one
    rank = rank_of(factor, problem.model.parameters, None, information.directions)
    return LinearFit(factor, rank, total, weights)


def _choose_strength(problem: Problem, prior: Array, weights: Array, scale: Array) -> float:
    """Return the strength that best predicts blocks of the data from the others, 0 where none is clearly better."""
    regression = problem.regression
    samples = sum(int(motion.mask.sum()) for motion in regression.motions)
    factors = factors_of_parts(regression, divide_regression(regression, max(samples // FOLDS, 1)))
    count = max(-(-len(factors) // FOLDS), 1)
    parts = [merge_factors(factors[k : k + count]) for k in range(0, len(factors), count)]
    if len(parts) < 3 or sum(part.total for part in parts) < MIN_ROWS_PER_PARAMETER * len(scale):
        return 0.0
    report_progress("choosing the strength of the prior")
    # predict each block of time from all others, with each strength
    errors = np.stack(
        [
            _prediction_errors(
                part,
                _information(merge_factors([*parts[:k], *parts[k + 1 :]]), weights, scale, problem.model),
                prior,
            )
            for k, part in enumerate(parts)
        ]
    )  # (folds, strengths, n)
    plain = errors[:, 0]
    size = np.where(plain.sum(axis=0) > 0, plain.sum(axis=0), np.inf)
    gains = 100.0 * ((plain[:, None] - errors) / size).mean(axis=2)
    # a gain within one standard error of the folds is chance: then least squares stays as it is
    total, std = gains.sum(axis=0), np.sqrt(len(gains)) * gains.std(axis=0, ddof=1)
    best = int(total.argmax())
    return (0.0, *STRENGTHS)[best] if total[best] > max(MIN_GAIN, std[best]) else 0.0


def _prediction_errors(part: TriangularFactors, information: Information, prior: Array) -> Array:
    """Return the squared prediction errors (strengths, n) of a part, without a prior and with each strength."""
    aim = np.where(np.isnan(prior), 0.0, prior)
    errors = []
    for strength in (0.0, *STRENGTHS):
        posterior = add_prior(information, prior, strength)
        errors.append(part.residual(nearest_to_prior(posterior, posterior.base, aim)))
    return np.stack(errors)
