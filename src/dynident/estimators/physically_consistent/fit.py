"""The physically consistent fit: least squares with physical and user constraints, and a prior for the rest.

Settings become constraints and a prior here. Two convex programs follow, whose size does not depend on the length of
the logs: ``staged`` fits the data; ``prior`` moves only along the directions that the data do not determine.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from dynident.errors import ConfigError, called, changed, choices
from dynident.estimators.constraints import (
    SIGNED,
    BodyConstraint,
    Bounds,
    Constraints,
    Corners,
    bodies_of,
    box,
    interval,
    scales,
    signs,
    sized,
    total,
)
from dynident.estimators.estimator import Consistency, Determined, Estimate, Estimator, Problem, needs_samples
from dynident.estimators.least_squares import COARSEST, MOST, Weights, check_weights, joint_weights, weighted
from dynident.estimators.linear import IsLinear, LinearFit
from dynident.estimators.physically_consistent.findings import (
    CLOSE,
    costly,
    costs_of,
    eigenvalues,
    held,
    notes_of,
    provenance_of,
)
from dynident.estimators.physically_consistent.prior import drawn, move_to_prior, nearest
from dynident.estimators.physically_consistent.staged import Information, read, staged_fit
from dynident.models import Model

__all__ = ["PhysicallyConsistent"]

Array = NDArray[np.float64]
Distance = Literal["entropic", "euclidean"]
NamedPrior = Literal["nominal", "none", "any"]
STRONGEST = 1e3
HEAVIEST, LARGEST = 1e6, 1e9  # kg; in size, of any limit


@dataclass(frozen=True)
class PhysicallyConsistent:
    """Least squares with a positive definite pseudo-inertia for each body that has all ten inertial parameters.

    ``inertia``, ``viscous``, ``coulomb``, ``rotor`` switch the constraints on the bodies and on the signs of friction
    and rotor inertia. ``total_mass`` is a value or (lower, upper) in kg, ``bounds`` are (lower, upper) by parameter
    name, ``centre_of_mass`` gives per body the corners of a box in m in the joint frame; None leaves a side open.

    ``prior`` is "nominal" (the model's values), "none", "any" (values that the constraints allow, which are found
    fastest), or values by parameter name. It determines only what the data do not, by the rank (``rank_of``) of the
    noise-weighted regressor; ``threshold`` is its tolerance (None: the precision of the model). The ``distance`` from
    it is "entropic" (log-det divergence of pseudo-inertias, invariant to frames and units; Euclidean for all other
    parameters) or "euclidean" (in units of each parameter's usual size). Undetermined parameters without a prior are
    made as small as the constraints allow. With a ``strength`` above 0, the prior of the bodies also counts against the
    data: where a parameter is one usual size away from it, by that share of the squared residual. "auto" is 0 here;
    ``identify`` chooses it by cross-validation.

    ``margin`` is the least eigenvalue of a pseudo-inertia relative to the body's usual mass and length (the model's
    values, else 1 kg and 0.1 m); the second program may use half of it. ``weights`` and ``iterations`` are those of
    ``joint_weights``. Where ``fit`` is an estimator that is linear in the parameters (``IsLinear``), its weighted rows
    are fitted instead: each of them can be made consistent with physics. ``costs`` = False skips the extra fits that
    measure the cost of each constraint. A small penalty,
    far below the noise, keeps bodies finite that would fit slightly better the larger they are.

    Constraints that the true parameters violate, or effects missing from the model, bias the estimate: what they move
    the value by is included in the covariance, so that intervals hold wherever those without constraints do.

    Calling it with a ``Problem`` gives an ``Estimate``. Here the inertia of a pendulum is known to exceed 0.09 kg m^2:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
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
    total_mass: Annotated[float, Gt(0), Le(HEAVIEST)] | Bounds | None = None
    bounds: Mapping[str, Bounds] | tuple[tuple[str, Bounds], ...] = ()
    centre_of_mass: Mapping[str, Corners] | tuple[tuple[str, Corners], ...] = ()
    prior: NamedPrior | Mapping[str, float] | tuple[tuple[str, float], ...] = "nominal"
    distance: Distance = "entropic"
    strength: Annotated[float, Ge(0), Le(STRONGEST)] | Literal["auto"] = "auto"
    threshold: Annotated[float, Gt(0), Le(COARSEST)] | None = None
    margin: Annotated[float, Gt(0), Lt(1)] = 1e-5
    weights: Weights = "per_joint"
    iterations: Annotated[int, Ge(1), Le(MOST)] = 3
    costs: bool = True
    fit: Estimator | None = None

    __repr__ = changed

    def __post_init__(self) -> None:
        check_weights(self.weights, self.iterations)
        object.__setattr__(self, "total_mass", _tupled(self.total_mass))
        for name in ("bounds", "centre_of_mass", "prior"):
            given = getattr(self, name)
            if isinstance(given, Mapping):
                object.__setattr__(self, name, tuple((key, _tupled(value)) for key, value in given.items()))
        self._check_settings()

    def _check_settings(self) -> None:
        if not isinstance(self.fit, IsLinear | None):
            raise ConfigError(f"fit = {self.fit!r}: is not linear in the parameters; give one such as LeastSquares().")
        if self.distance not in get_args(Distance):
            raise ConfigError(f"distance = {self.distance!r}; {choices(self.distance, get_args(Distance))}")
        if isinstance(self.prior, str) and self.prior not in get_args(NamedPrior):
            raise ConfigError(f"prior = {self.prior!r}; {choices(self.prior, get_args(NamedPrior))}")
        if self.strength != "auto" and not 0 <= self.strength <= STRONGEST:
            raise ConfigError(f"strength = {self.strength}; give a number from 0 to {STRONGEST:g}, or 'auto'.")
        for name, most in (("threshold", COARSEST), ("margin", 1.0)):
            value = getattr(self, name)
            if value is not None and not 0 < value <= most:
                raise ConfigError(f"{name} = {value}; give a number between 0 and {most:g}, such as 1e-6.")
        for name, value in () if isinstance(self.prior, str) else dict(self.prior).items():
            if not abs(value) <= LARGEST:
                raise ConfigError(f"prior of {name} is {value}; give a number of at most {LARGEST:g} in size.")
        for name, sides in self._intervals().items():
            _check_sides(name, *sides)
        for name, (lower, upper) in dict(self.centre_of_mass).items():
            for sides in zip(lower, upper, strict=True):
                _check_sides(f"centre of mass of {name}", *sides)

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say what the data do not determine.

        Raises ConfigError where settings name parameters or bodies that the model does not have, or the constraints
        contradict each other, and ModelError where the program cannot be solved.
        """
        model, triangular = problem.model, problem.regression.triangular_factors
        rows = self._rows(problem)
        factor, directions = rows.factor, rows.directions
        bodies = sized(bodies_of(model.parameters), model.parameters, triangular)
        effect = np.linalg.norm(factor, axis=0)
        scale = scales(model.parameters, bodies, effect[:-1], float(effect[-1]))
        known = read(factor, scale, directions, rows.total)
        constraints, prior = self._constraints(model, bodies, scale), self._prior(model)
        aim = np.where(np.isnan(prior), 0.0, prior)
        strength = 0.0 if self.strength == "auto" else self.strength
        leaning = drawn(known, self._of_bodies(constraints, prior), strength)
        start = nearest(leaning, leaning.base, aim)
        theta, excess = staged_fit(leaning, constraints, start)
        entropic = self._entropic(known, constraints, prior)
        value, gap = theta, 0.0
        if self.prior != "any":
            value, gap = move_to_prior(known, constraints, theta, aim, entropic)
        value = _clipped_to_limits(value, constraints)
        provenance = provenance_of(value, known, constraints, ~np.isnan(prior))
        costs = costs_of(leaning, constraints, start, excess) if self.costs else {}
        free = known.base if rows.plain is None else rows.plain.solution.value
        moved = np.where(directions.undetermined, 0.0, value - free)
        return Estimate(
            parameters=model.parameters,
            value=value,
            covariance=rows.covariance + np.outer(moved, moved),
            determined=Determined(known.rank, directions.condition, directions),
            residual=rows.residual(problem, value),
            notes=(
                *rows.notes,
                *notes_of(known, provenance, gap),
                *costly(known, costs),
                *held(known, value, model.parameters),
            ),
            provenance=provenance,
            consistency=Consistency(eigenvalues(bodies, value), costs, free),
            information=rows.information,
        )

    def _rows(self, problem: Problem) -> LinearFit:
        """Return the weighted rows that are fitted: those of ``fit``, where it is given."""
        linear: Any = self.fit  # checked when it was set
        if linear is not None:
            return called(linear.reduced, problem, LinearFit)
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, self.weights, self.iterations, parameters, self.threshold)
        factor, directions = weighted(triangular, weights, parameters, self.threshold)
        return LinearFit(factor, directions, triangular.total, None if self.weights == "equal" else weights)

    def quick(self) -> PhysicallyConsistent:
        """Return a fit of the same torque, without the cost of each constraint and with any prior."""
        return replace(self, costs=False, prior="any", strength=0.0, fit=None)

    @property
    def needs_samples(self) -> bool:
        """Whether the fit of which it takes the rows does."""
        return self.fit is not None and needs_samples(self.fit)

    @property
    def named(self) -> tuple[str, ...]:
        """The parameters that bounds and prior name."""
        prior = () if isinstance(self.prior, str) else dict(self.prior)
        return tuple(dict.fromkeys((*dict(self.bounds), *prior)))

    def among(self, names: Collection[str]) -> PhysicallyConsistent:
        """Return the fit without the bounds and the prior of other parameters than these."""

        def kept(given: Any) -> tuple[tuple[str, Any], ...]:
            return tuple((name, value) for name, value in dict(given).items() if name in names)

        prior = self.prior if isinstance(self.prior, str) else kept(self.prior)
        return replace(self, bounds=kept(self.bounds), prior=prior)

    def _intervals(self) -> dict[str, Bounds]:
        mass = self.total_mass
        if mass is None:
            return dict(self.bounds)
        return {**dict(self.bounds), "total mass": mass if isinstance(mass, tuple) else (mass, mass)}

    def _constraints(self, model: Model, bodies: tuple[BodyConstraint, ...], scale: Array) -> Constraints:
        parameters = model.parameters
        limits = list(signs(parameters, [role for role in SIGNED if getattr(self, role)]))
        bounds = {_index(name, model, "bounds"): sides for name, sides in dict(self.bounds).items()}
        limits.append(interval("bounds", parameters, bounds))
        sides = self._intervals().get("total mass")
        if sides is not None:
            if not bodies:
                raise ConfigError(f"total mass {sides}: the model has no body with ten inertial parameters.")
            limits.append(total("total mass", bodies, len(parameters), sides))
        limits.append(box("centre of mass", bodies, len(parameters), dict(self.centre_of_mass)))
        used = tuple(limit.scaled(scale) for limit in limits if len(limit.rows))
        return Constraints(used, bodies if self.inertia else (), self.margin)

    def _prior(self, model: Model) -> Array:
        """Return the prior (p), nan where there is none."""
        if self.prior == "nominal":
            return np.array([np.nan if x.value is None else x.value for x in model.parameters])
        values = {} if isinstance(self.prior, str) else dict(self.prior)
        given = {_index(name, model, "prior"): value for name, value in values.items()}
        return np.array([given.get(k, np.nan) for k in range(len(model.names))])

    def _of_bodies(self, constraints: Constraints, prior: Array) -> Array:
        """Return the prior (p) of the bodies that have a physically consistent one, nan for all else."""
        out = np.full(len(prior), np.nan)
        for body in constraints.bodies:
            own = prior[body.columns]
            if not np.isnan(own).any() and np.linalg.eigvalsh(body.scaled(prior))[0] > self.margin:
                out[body.columns] = own
        return out

    def _entropic(self, known: Information, constraints: Constraints, prior: Array) -> list[BodyConstraint]:
        """Return the bodies with a log-det distance: undetermined ones whose prior is physically consistent."""
        if self.distance == "euclidean":
            return []
        free = [body for body in constraints.bodies if known.directions.undetermined[body.columns].any()]
        known_bodies = [body for body in free if not np.isnan(prior[body.columns]).any()]
        return [body for body in known_bodies if np.linalg.eigvalsh(body.scaled(prior))[0] > self.margin]


def _tupled(value: Any) -> Any:
    """Make settings hashable."""
    return tuple(map(_tupled, value)) if isinstance(value, (list, tuple, np.ndarray)) else value


def _check_sides(name: str, lower: float | None, upper: float | None) -> None:
    if any(side is not None and np.isnan(side) for side in (lower, upper)):
        raise ConfigError(f"{name}: the limits {lower} and {upper} must be numbers; leave a side open with None.")
    if any(side is not None and LARGEST < abs(side) < np.inf for side in (lower, upper)):
        raise ConfigError(f"{name}: the limits {lower} and {upper} must be {LARGEST:g} at most in size, or left open.")
    if lower is not None and upper is not None and lower > upper:
        raise ConfigError(f"{name}: the lower limit {lower} lies above the upper limit {upper}; exchange them.")


def _index(name: str, model: Model, where: str) -> int:
    if name not in model.names:
        raise ConfigError(f"{where}: {model.name} has no parameter {name!r}; {choices(name, model.names)}")
    return model.names.index(name)


def _clipped_to_limits(theta: Array, constraints: Constraints) -> Array:
    """Return theta with parameters moved to their limits where only the solver's rounding separates them."""
    theta = theta.copy()
    for limit in constraints.limits:
        for i in np.flatnonzero((limit.rows != 0).sum(axis=1) == 1):
            k = int(np.flatnonzero(limit.rows[i])[0])
            for side in (limit.lower[i], limit.upper[i]):
                if abs(limit.rows[i, k] * theta[k] - side) < CLOSE:
                    theta[k] = side / limit.rows[i, k]
    return theta
