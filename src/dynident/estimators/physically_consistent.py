"""The physically consistent fit: least squares with physical and user constraints, and a prior for the rest.

Settings become constraints and a prior here. Two convex programs follow, whose size does not depend on the length of
the logs: ``staged`` fits the data; ``prior`` moves only along the directions that the data do not determine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from dynident.estimators.estimator import (
    Consistency,
    DataRank,
    Estimate,
    Estimator,
    Problem,
    Provenance,
    check_parameters,
    prior_notes,
    prior_values,
    to_tuples,
)
from dynident.estimators.least_squares import LeastSquares, LinearEstimator, LinearFit
from dynident.estimators.notes import ConstraintsCostly, HeldByConstraints, PriorApproached, RankDeficient
from dynident.estimators.physical_constraints import (
    NONNEGATIVE_ROLES,
    BodyConstraint,
    Bounds,
    Constraints,
    Corners,
    centre_of_mass_limit,
    estimate_sizes,
    interval_limit,
    parameter_scales,
    sign_limits,
    total_mass_limit,
)
from dynident.estimators.programs import Information, add_prior, move_to_prior, nearest_to_prior, staged_fit
from dynident.models import Model, Parameter
from dynident.regression import base_parameters
from dynident.runtime import ConfigError, Note, Noun
from dynident.runtime.arrays import Array

MAX_GAP = 1e-6  # duality gap above which the prior was not reached
MIN_COST_SHARE, MIN_COST = 0.25, 0.5  # share of the error without constraints, and percentage points, that are said
MAX_SHIFT = 3.0  # standard errors: noise alone moves an estimate as far in 0.3 % of all cases
ACTIVE_DISTANCE = 1e-7  # how near a limit counts as at it, in units of the parameter's size


def provenance_of(
    theta: Array, information: Information, constraints: Constraints, prior: NDArray[np.bool_]
) -> tuple[Provenance, ...]:
    """Return what determines each parameter; ``prior`` (p) tells which ones have a prior."""
    free = information.directions.undetermined_mask
    at_limit = np.zeros(len(theta), dtype=bool)
    for body in constraints.bodies:
        # a body on the boundary of the feasible set is determined by it, as far as the data see its parameters
        if body.min_eigenvalue(theta) < 10 * constraints.margin:
            at_limit[body.columns[~free[body.columns]]] = True
    for limit in constraints.limits:
        value = limit.rows @ theta
        is_near = np.minimum(np.abs(value - limit.lower), np.abs(limit.upper - value)) < ACTIVE_DISTANCE
        single = (limit.rows != 0).sum(axis=1) == 1
        at_limit |= (limit.rows[is_near & single] != 0).any(axis=0)
    choice = np.select([at_limit, ~free, prior], [0, 1, 2], 3)
    order = (Provenance.BOUND, Provenance.DATA, Provenance.PRIOR, Provenance.UNIDENTIFIABLE)
    return tuple(order[k] for k in choice)


def costs_of(information: Information, constraints: Constraints, start: Array, excess: float) -> dict[str, float]:
    """Return the increase of the error, in percentage points, by each family of constraints alone and by "all"."""
    alone = {
        family: staged_fit(information, constraints.select_family(family), start)[1] for family in constraints.families
    }
    return {
        family: information.error(increase) - information.error(0.0)
        for family, increase in (alone | {"all": excess}).items()
    }


def cost_notes(information: Information, costs: Mapping[str, float]) -> tuple[ConstraintsCostly, ...]:
    """Return a note where the constraints raise the training error by a good part."""
    free, families = information.error(0.0), [name for name in costs if name != "all"]
    if not families or costs["all"] < max(MIN_COST_SHARE * free, MIN_COST):
        return ()
    return (ConstraintsCostly(max(families, key=lambda name: costs[name]), free + costs["all"], free),)


def shift_notes(
    information: Information, theta: Array, parameters: Sequence[Parameter]
) -> tuple[HeldByConstraints, ...]:
    """Return a note on the base parameters that the constraints moved far from where the data alone have them."""
    basis = base_parameters(information.directions, parameters)
    std = np.linalg.norm(basis.combination @ information.informed, axis=1)
    shift = np.abs(basis.to_base(theta - information.base)) / std
    shifted = tuple((basis.groupings[k], float(shift[k])) for k in np.argsort(-shift) if shift[k] > MAX_SHIFT)
    return (HeldByConstraints(shifted),) if shifted else ()


def rank_notes(information: Information, provenance: tuple[Provenance, ...], gap: float) -> tuple[Note, ...]:
    """Return notes on what the data do not determine, and on a prior that was not reached (duality ``gap``)."""
    return (
        *([RankDeficient(information.rank, len(provenance))] if information.rank < len(provenance) else []),
        *prior_notes(provenance),
        *([PriorApproached(gap)] if gap > MAX_GAP else []),
    )


Distance = Literal["entropic", "euclidean"]
NamedPrior = Literal["nominal", "none", "any"]
MAX_STRENGTH = 1e3
MAX_MASS, MAX_LIMIT = 1e6, 1e9  # kg; in size, of any limit


class _TorqueFit(Noun):
    """The fit of the torque under the ``constraints`` on ``bodies``: ``theta`` (p), and its ``excess`` |d|^2.

    ``information`` is that of the rows, ``posterior`` with the ``prior`` (p), and ``start`` its solution without
    constraints.
    """

    bodies: tuple[BodyConstraint, ...]
    information: Information
    constraints: Constraints
    prior: Array
    posterior: Information
    start: Array
    theta: Array
    excess: float


@dataclass(frozen=True)
class PhysicallyConsistent(Estimator):
    """Least squares with a positive definite pseudo-inertia for each body that has all ten inertial parameters.

    ``inertia``, ``viscous``, ``coulomb``, ``rotor`` switch the constraints on the bodies and on the signs of friction
    and rotor inertia. ``total_mass`` is a value or (lower, upper) in kg, ``bounds`` are (lower, upper) by parameter
    name, ``centre_of_mass`` gives per body the corners of a box in m in the joint frame; None leaves a side open.

    ``prior`` is "nominal" (the model's values), "none", "any" (values that the constraints allow, which are found
    fastest), or values by parameter name. It determines only what the data do not, by the rank (``rank_of``) of the
    noise-weighted regressor. The ``distance`` from it is "entropic" (log-det divergence of pseudo-inertias, invariant
    to frames and units; Euclidean for all other parameters) or "euclidean" (in units of each parameter's usual size).
    Undetermined parameters without a prior are made as small as the constraints allow. With a ``strength`` above 0, the
    prior of the bodies also counts against the data: where a parameter is one usual size away from it, by that share of
    the squared residual. "auto" is 0 here; ``identify`` chooses it by cross-validation.

    ``margin`` is the least eigenvalue of a pseudo-inertia relative to the body's usual mass and length (the model's
    values, else 1 kg and 0.1 m); the second program may use half of it. Rows are those of least squares weighted by
    joint, or those of ``fit``, an estimator that is linear in the parameters (``LinearEstimator``): each of them can be
    made consistent with physics. ``costs`` = False skips the extra fits that measure the cost of each constraint. A
    small penalty, far below the noise, keeps bodies finite that would fit slightly better the larger they are.

    Constraints that the true parameters violate, or effects missing from the model, bias the estimate: what they move
    the value by is included in the covariance, so that intervals hold wherever those without constraints do.

    Calling it with a ``Problem`` gives an ``Estimate``. Here the inertia of a pendulum is known to exceed 0.09 kg m^2:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> bounded = dy.PhysicallyConsistent(bounds={"J": (0.09, None)})
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=bounded)
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0900 +- 0.00756
    h = 0.2711 +- 0.02129
    """

    inertia: bool = True
    viscous: bool = True
    coulomb: bool = True
    rotor: bool = True
    total_mass: Annotated[float, Gt(0), Le(MAX_MASS)] | Bounds | None = None
    bounds: Mapping[str, Bounds] | tuple[tuple[str, Bounds], ...] = ()
    centre_of_mass: Mapping[str, Corners] | tuple[tuple[str, Corners], ...] = ()
    prior: NamedPrior | Mapping[str, float] | tuple[tuple[str, float], ...] = "nominal"
    distance: Distance = "entropic"
    strength: Annotated[float, Ge(0), Le(MAX_STRENGTH)] | Literal["auto"] = "auto"
    margin: Annotated[float, Gt(0), Lt(1)] = 1e-5
    costs: bool = True
    fit: Estimator | None = None

    by_parameter: ClassVar[tuple[str, ...]] = ("bounds", "prior")
    title = "physically consistent least squares"

    def __post_init__(self) -> None:
        super().__post_init__()
        for setting in ("total_mass", "centre_of_mass"):
            object.__setattr__(self, setting, to_tuples(getattr(self, setting)))
        self._check_settings()

    def _check_settings(self) -> None:
        if not isinstance(self.fit, LinearEstimator | None):
            raise ConfigError(f"fit = {self.fit!r}: is not linear in the parameters; give one such as LeastSquares().")
        self.check_prior()
        for name, sides in self._named_bounds().items():
            _check_bounds(name, *sides)
        for name, (lower, upper) in dict(self.centre_of_mass).items():
            for sides in zip(lower, upper, strict=True):
                _check_bounds(f"centre of mass of {name}", *sides)

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes tell what the data do not determine.

        Raises ConfigError where settings name parameters or bodies that the model does not have, or the constraints
        contradict each other, and ModelError where the program cannot be solved.
        """
        return self.constrain(problem, self.linear.rows(problem))

    @property
    def linear(self) -> LinearEstimator:
        """The estimator whose rows are taken: ``fit``, or least squares weighted by joint."""
        fit: Any = self.fit  # checked when it was set
        return LeastSquares(weights="per_joint") if fit is None else fit

    def torque_value(self, problem: Problem) -> Array:
        """Return parameters (p) with the torque of the estimate: without the move towards the prior along what the rows
        leave free, which takes as long as the fit. Raises as the call does."""
        return self._fit_torque(problem, self.linear.rows(problem)).theta

    def _fit_torque(self, problem: Problem, rows: LinearFit) -> _TorqueFit:
        """Fit the rows under the constraints; the prior counts only along informed directions."""
        model, triangular = problem.model, problem.regression.triangular_factors
        bodies = estimate_sizes(model.parameters, triangular)
        effect = np.linalg.norm(rows.factor, axis=0)
        scale = parameter_scales(model.parameters, bodies, effect[:-1], float(effect[-1]))
        information = Information.from_factor(rows.factor, scale, rows.directions, rows.total)
        constraints, prior = self._constraints(model, bodies, scale), prior_values(self.prior, model)
        strength = 0.0 if self.strength == "auto" else self.strength
        posterior = add_prior(information, self._body_prior(constraints, prior), strength)
        start = nearest_to_prior(posterior, posterior.base, np.where(np.isnan(prior), 0.0, prior))
        fit = staged_fit(posterior, constraints, start)
        return _TorqueFit(bodies, information, constraints, prior, posterior, start, *fit)

    def constrain(self, problem: Problem, rows: LinearFit) -> Estimate:
        """Return the consistent estimate of rows that are at hand; raises as the call does."""
        model, directions = problem.model, rows.directions
        fit = self._fit_torque(problem, rows)
        information, constraints, prior, posterior = fit.information, fit.constraints, fit.prior, fit.posterior
        # second program: move along directions that the data do not determine, towards the prior
        value, gap = fit.theta, 0.0
        if self.prior != "any":
            entropic = self._entropic_bodies(information, constraints, prior)
            target = np.where(np.isnan(prior), 0.0, prior)
            value, gap = move_to_prior(information, constraints, fit.theta, target, entropic)
        value = _clip_to_limits(value, constraints)
        provenance = provenance_of(value, information, constraints, ~np.isnan(prior))
        costs = costs_of(posterior, constraints, fit.start, fit.excess) if self.costs else {}
        free = information.base if rows.plain is None else rows.plain.solution.value
        # the shift by the constraints may be an error, and widens the covariance
        shift = np.where(directions.undetermined_mask, 0.0, value - free)
        return Estimate(
            parameters=model.parameters,
            value=value,
            covariance=rows.covariance + np.outer(shift, shift),
            determined=DataRank(information.rank, directions.condition, directions),
            residual=rows.residual(problem, value),
            notes=(
                *rows.notes,
                *rank_notes(information, provenance, gap),
                *cost_notes(information, costs),
                *shift_notes(information, value, model.parameters),
            ),
            provenance=provenance,
            consistency=Consistency({body.name: body.min_eigenvalue(value) for body in fit.bodies}, costs, free),
            information=rows.information,
        )

    def quick(self) -> PhysicallyConsistent:
        """Return a fit of the same torque, without the cost of each constraint and with any prior."""
        return replace(self, costs=False, prior="any", strength=0.0, fit=None)

    @property
    def needs_samples(self) -> bool:
        """Whether the fit whose rows are taken needs the samples."""
        return self.fit is not None and self.fit.needs_samples

    def _named_bounds(self) -> dict[str, Bounds]:
        mass = self.total_mass
        if mass is None:
            return dict(self.bounds)
        return {**dict(self.bounds), "total mass": mass if isinstance(mass, tuple) else (mass, mass)}

    def _constraints(self, model: Model, bodies: tuple[BodyConstraint, ...], scale: Array) -> Constraints:
        parameters = model.parameters
        limits = list(sign_limits(parameters, [role for role in NONNEGATIVE_ROLES if getattr(self, role)]))
        check_parameters(dict(self.bounds), model, "bounds")
        bounds = {model.names.index(name): sides for name, sides in dict(self.bounds).items()}
        limits.append(interval_limit("bounds", parameters, bounds))
        sides = self._named_bounds().get("total mass")
        if sides is not None:
            if not bodies:
                raise ConfigError(f"total mass {sides}: the model has no body with ten inertial parameters.")
            limits.append(total_mass_limit("total mass", bodies, len(parameters), sides))
        limits.append(centre_of_mass_limit("centre of mass", bodies, len(parameters), dict(self.centre_of_mass)))
        scaled_limits = tuple(limit.scale_rows(scale) for limit in limits if len(limit.rows))
        return Constraints(scaled_limits, bodies if self.inertia else (), self.margin)

    def _body_prior(self, constraints: Constraints, prior: Array) -> Array:
        """Return the prior (p) of the bodies that have a physically consistent one, nan for all other parameters."""
        out = np.full(len(prior), np.nan)
        for body in self._bodies_with_prior(constraints, prior):
            out[body.columns] = prior[body.columns]
        return out

    def _entropic_bodies(
        self, information: Information, constraints: Constraints, prior: Array
    ) -> list[BodyConstraint]:
        """Return the bodies with a log-det distance: undetermined ones whose prior is physically consistent."""
        if self.distance == "euclidean":
            return []
        undetermined = information.directions.undetermined_mask
        bodies = self._bodies_with_prior(constraints, prior)
        return [body for body in bodies if undetermined[body.columns].any()]

    def _bodies_with_prior(self, constraints: Constraints, prior: Array) -> list[BodyConstraint]:
        """Return the bodies with a prior (p) that is physically consistent."""
        bodies = [body for body in constraints.bodies if not np.isnan(prior[body.columns]).any()]
        return [body for body in bodies if body.min_eigenvalue(prior) > self.margin]


def _check_bounds(name: str, lower: float | None, upper: float | None) -> None:
    if any(side is not None and np.isnan(side) for side in (lower, upper)):
        raise ConfigError(f"{name}: the limits {lower} and {upper} must be numbers; leave a side open with None.")
    if any(side is not None and MAX_LIMIT < abs(side) < np.inf for side in (lower, upper)):
        raise ConfigError(
            f"{name}: the limits {lower} and {upper} must be {MAX_LIMIT:g} at most in size, or left open."
        )
    if lower is not None and upper is not None and lower > upper:
        raise ConfigError(f"{name}: the lower limit {lower} lies above the upper limit {upper}; exchange them.")


def _clip_to_limits(theta: Array, constraints: Constraints) -> Array:
    """Return theta with parameters moved to their limits where only the solver's rounding separates them."""
    theta = theta.copy()
    for limit in constraints.limits:
        for i in np.flatnonzero((limit.rows != 0).sum(axis=1) == 1):
            k = int(np.flatnonzero(limit.rows[i])[0])
            for side in (limit.lower[i], limit.upper[i]):
                if abs(limit.rows[i, k] * theta[k] - side) < ACTIVE_DISTANCE:
                    theta[k] = side / limit.rows[i, k]
    return theta
