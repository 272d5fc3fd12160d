"""Ridge regression: least squares drawn towards a prior, in units of each parameter's usual size (Tikhonov)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, changed, choices
from dynident.estimators.constraints import bodies_of, scales, sized
from dynident.estimators.estimator import Consistency, Estimate, Problem, Provenance
from dynident.estimators.least_squares import joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of
from dynident.estimators.notes import DecidedByPrior, DrawnToPrior, NotIdentifiable
from dynident.estimators.physically_consistent.prior import drawn, nearest
from dynident.estimators.physically_consistent.staged import Information, read
from dynident.models import Model
from dynident.regression import Regression, TriangularFactors, divided, factors_of_parts, merged, rank_of

__all__ = ["Ridge"]

Array = NDArray[np.float64]
NamedPrior = Literal["nominal", "none"]
STRONGEST, LARGEST = 1e9, 1e9
STRENGTHS = tuple(10.0 ** (0.5 * k) for k in range(-10, 5))  # that are tried
FOLDS = 10
ROWS = 3  # times the parameters: with fewer there is nothing to predict
LEAST = 1.0  # % of the squared cross-validated error that a strength must remove


@dataclass(frozen=True)
class Ridge:
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
    >>> from dynident.models.gallery import pendulum
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
    strength: Annotated[float, Ge(0), Le(STRONGEST)] | Literal["auto"] = "auto"
    tolerance: Annotated[float, Gt(0), Le(0.01)] | None = None

    __repr__ = changed

    def __post_init__(self) -> None:
        if isinstance(self.prior, Mapping):
            object.__setattr__(self, "prior", tuple(self.prior.items()))
        if isinstance(self.prior, str) and self.prior not in get_args(NamedPrior):
            raise ConfigError(f"prior = {self.prior!r}; {choices(self.prior, get_args(NamedPrior))}")
        for name, value in self._given.items():
            if not abs(value) <= LARGEST:
                raise ConfigError(f"prior of {name} is {value}; give a number of at most {LARGEST:g} in size.")
        if self.strength != "auto" and not 0 <= self.strength <= STRONGEST:
            raise ConfigError(f"strength = {self.strength}; give a number from 0 to {STRONGEST:g}, or 'auto'.")

    @property
    def named(self) -> tuple[str, ...]:
        """The parameters that the prior names."""
        return tuple(self._given)

    def among(self, names: Collection[str]) -> Ridge:
        """Return the estimator without the prior of other parameters than these."""
        if isinstance(self.prior, str):
            return self
        return replace(self, prior=tuple(one for one in self._given.items() if one[0] in names))

    def quick(self) -> Ridge:
        """Return the fit without a search for the strength."""
        return replace(self, strength=0.0) if self.strength == "auto" else self

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say what the data do not determine, and how strong the prior is where "auto" chose it.

        Raises ConfigError where the prior names parameters that the model does not have.
        """
        known, leaning, fit = self._fitted(problem)
        prior = self._prior(problem.model)
        free = known.directions.undetermined
        value = nearest(leaning, leaning.base, np.where(np.isnan(prior), 0.0, prior))
        moved = np.where(free, 0.0, value - known.base)
        found = estimate_of(problem, fit)
        provenance = _provenance(free, ~np.isnan(prior))
        return replace(
            found,
            value=value,
            covariance=found.covariance + np.outer(moved, moved),
            residual=fit.residual(problem, value),
            notes=(*found.notes, *_undetermined(provenance)),
            provenance=provenance,
            consistency=Consistency(unconstrained=known.base),
        )

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with those of the penalty, as far as it acts on what the data determine."""
        return self._fitted(problem)[2]

    def _fitted(self, problem: Problem) -> tuple[Information, Information, LinearFit]:
        """Return what the data tell, the same with the prior, and its rows."""
        parameters, triangular = problem.model.parameters, problem.regression.triangular_factors
        weights = joint_weights(triangular, "per_joint", 3, parameters, self.tolerance)
        prior = self._prior(problem.model)
        scale = _sizes(problem.model, triangular, weights)
        known = _known(triangular, weights, scale, problem.model, self.tolerance)
        strength = self.strength
        notes: tuple[Note, ...] = ()
        if strength == "auto":
            strength = _chosen(problem, prior, weights, scale, self.tolerance)
            notes = (DrawnToPrior(strength),) if strength else ()
        leaning = drawn(known, prior, strength)
        plain = _rows(known, problem, triangular.total, weights)
        rows = _rows(leaning, problem, triangular.total, weights)
        return known, leaning, replace(rows, notes=notes, plain=plain)

    def _prior(self, model: Model) -> Array:
        """Return the prior (p), nan where a parameter has none."""
        if self.prior == "none":
            return np.zeros(len(model.names))
        if self.prior == "nominal":
            return np.array([np.nan if one.value is None else one.value for one in model.parameters])
        for name in self._given:
            if name not in model.names:
                raise ConfigError(f"prior: {model.name} has no parameter {name!r}; {choices(name, model.names)}")
        return np.array([self._given.get(name, np.nan) for name in model.names])

    @property
    def _given(self) -> dict[str, float]:
        return {} if isinstance(self.prior, str) else dict(self.prior)


def _sizes(model: Model, triangular: TriangularFactors, weights: Array) -> Array:
    """Return the usual size (p) of each parameter."""
    bodies = sized(bodies_of(model.parameters), model.parameters, triangular)
    effect = np.linalg.norm(triangular.stacked(weights), axis=0)
    return scales(model.parameters, bodies, effect[:-1], float(effect[-1]))


def _known(
    triangular: TriangularFactors, weights: Array, scale: Array, model: Model, tolerance: float | None
) -> Information:
    """Return what the rows tell with these weights (n)."""
    factor, rank = weighted(triangular, weights, model.parameters, tolerance)
    return read(factor, scale, rank, triangular.total)


def _rows(leaning: Information, problem: Problem, total: int, weights: Array) -> LinearFit:
    """Return rows of which the solution is the base and the covariance that of the informed directions."""
    p, k = len(leaning.base), leaning.rank
    turned = np.linalg.inv(np.concatenate([leaning.informed, leaning.free], axis=1) / leaning.scale[:, None])
    factor = np.zeros((p + 1, p + 1))
    factor[:k, :p] = turned[:k] / leaning.scale
    factor[:k, p] = factor[:k, :p] @ leaning.base
    factor[p, p] = np.sqrt(max(total - k, 1))  # the variance of a row is one
    rank = rank_of(factor, problem.model.parameters, None, leaning.directions)
    return LinearFit(factor, rank, total, weights)


def _chosen(problem: Problem, prior: Array, weights: Array, scale: Array, tolerance: float | None) -> float:
    """Return the strength that predicts blocks of the data best from the others, 0 where none is clearly better."""
    parts = _blocks(problem.regression)
    if len(parts) < 3 or sum(one.total for one in parts) < ROWS * len(scale):
        return 0.0
    problem.progress("choosing the strength of the prior")
    errors = np.stack(
        [
            _predicted(
                one, _known(merged([*parts[:k], *parts[k + 1 :]]), weights, scale, problem.model, tolerance), prior
            )
            for k, one in enumerate(parts)
        ]
    )  # (folds, strengths, n)
    plain = errors[:, 0]
    size = np.where(plain.sum(axis=0) > 0, plain.sum(axis=0), np.inf)
    gains = 100.0 * ((plain[:, None] - errors) / size).mean(axis=2)
    total, std = gains.sum(axis=0), np.sqrt(len(gains)) * gains.std(axis=0, ddof=1)
    best = int(total.argmax())
    return (0.0, *STRENGTHS)[best] if total[best] > max(LEAST, std[best]) else 0.0


def _blocks(regression: Regression) -> list[TriangularFactors]:
    """Return the factors of about ``FOLDS`` blocks of time."""
    samples = sum(int(one.mask.sum()) for one in regression.motions)
    parts = divided(regression, max(samples // FOLDS, 1))
    found = factors_of_parts(regression, parts)
    size = max(-(-len(found) // FOLDS), 1)
    return [merged(found[k : k + size]) for k in range(0, len(found), size)]


def _predicted(part: TriangularFactors, others: Information, prior: Array) -> Array:
    """Return the squared errors (strengths, n) of a part, without a prior and with each strength."""
    aim = np.where(np.isnan(prior), 0.0, prior)
    found = []
    for strength in (0.0, *STRENGTHS):
        leaning = drawn(others, prior, strength)
        found.append(part.residual(nearest(leaning, leaning.base, aim)))
    return np.stack(found)


def _provenance(free: NDArray[np.bool_], prior: NDArray[np.bool_]) -> tuple[Provenance, ...]:
    order = (Provenance.DATA, Provenance.PRIOR, Provenance.UNIDENTIFIABLE)
    return tuple(order[k] for k in np.select([~free, prior], [0, 1], 2))


def _undetermined(provenance: Sequence[Provenance]) -> tuple[Note, ...]:
    kinds = ((Provenance.PRIOR, DecidedByPrior), (Provenance.UNIDENTIFIABLE, NotIdentifiable))
    return tuple(kind(provenance.count(which)) for which, kind in kinds if which in provenance)
