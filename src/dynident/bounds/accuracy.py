"""The accuracy that any unbiased method can reach with a robot, a motion and sensors, and with better ones."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dynident.bounds.normal_matrix import NormalMatrix, normal_matrices
from dynident.checks.channels import channels
from dynident.errors import ConfigError, InputError, brief, choices, listed
from dynident.estimators import quick
from dynident.identification import Identification, Recipe, identify
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import BaseParameters, Regression, base_parameters, rank_of_information
from dynident.smoothers.smoother import KnowsNoise
from dynident.splines import noise_sigma, steady_noise

if TYPE_CHECKING:
    import polars as pl

__all__ = ["CHANGES", "AccuracyBound", "Measure", "Noise", "Origin", "TorqueNoise", "accuracy_bound", "noise_of"]

Array = NDArray[np.float64]
TorqueNoise = Literal["residual", "sensor"]
# improvements: divisors of sigma_q and sigma_tau, and multiple of the length of the record
CHANGES: Mapping[str, tuple[float, float, float]] = {
    "now": (1.0, 1.0, 1.0),
    "bit": (2.0, 1.0, 1.0),
    "torque": (1.0, 10.0, 1.0),
    "twice": (1.0, 1.0, 2.0),
    "longer": (1.0, 1.0, 4.0),
}


class Measure(StrEnum):
    """How a noise level was estimated: from the residual of the fit, or the scatter between neighbouring samples."""

    RESIDUAL = "residual"
    SCATTER = "scatter"


@dataclass(frozen=True)
class Origin:
    """Source of a noise level: ``measured`` (None: for no joint), except for the joints in ``given``."""

    measured: Measure | None = Measure.SCATTER
    given: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Noise:
    """Standard deviations (n) of positions ``q`` (rad, m) and torques ``tau`` (N m, N), and their sources.

    ``sensor`` (n) is the torque's own noise, from differences of neighbouring samples.
    """

    q: Array
    tau: Array
    sensor: Array
    positions: Origin = Origin()
    torques: Origin = Origin()

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class AccuracyBound:
    """The Cramer-Rao bound of the r base parameters of a model, at the parameters of an identification.

    ``names`` of the base parameters as formulas in the ``parameters`` (p), ``alone`` (r) whether it is a single
    parameter, ``value`` (r) and ``units``; ``std`` maps "now" and each change of ``CHANGES`` to the least standard
    deviations (r), infinite for what the record does not excite. ``known`` (r) is the least one if all others were
    known; ``partner`` (r) is the index of the most correlated parameter, ``correlation`` (r) their correlation. ``fit``
    (r) are the standard errors of the identification, valid for correlated residuals where possible, nan where it has
    none.
    """

    identification: Identification
    names: tuple[str, ...]
    alone: NDArray[np.bool_]
    units: tuple[str, ...]
    value: Array
    std: Mapping[str, Array]
    known: Array
    partner: NDArray[np.intp]
    correlation: Array
    fit: Array
    noise: Noise
    samples: int

    def __repr__(self) -> str:
        hardest = [k for k in np.argsort(-self.relative) if np.isfinite(self.relative[k])]
        shown = listed((f"{self.leads[k]} {float(f'{self.relative[k]:.2g}'):g} %" for k in hardest), 3)
        return f"<AccuracyBound of {len(self.names)} base parameters from {self.samples} samples; least known: {shown}>"

    @property
    def leads(self) -> tuple[str, ...]:
        """The standard parameter (r) that each base parameter begins with."""
        return tuple(name.partition(" ")[0] for name in self.names)

    def frame(self) -> pl.DataFrame:
        """Return a table, one row per base parameter: parameter, unit, value, ``std`` of the fit, and the least
        standard deviation ``now`` and after each change of ``CHANGES``."""
        import polars as pl

        columns = {"parameter": self.names, "unit": self.units, "value": self.value, "std": self.fit}
        return pl.DataFrame({**columns, **self.std})

    @property
    def relative(self) -> Array:
        """Least standard deviation (r) in % of the value; infinite where that is zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.value == 0, np.inf, 100 * self.std["now"] / np.abs(self.value)))

    @property
    def position_share(self) -> Array:
        """Share (r) of the least variance that is due to the position noise; the rest is the torque's (nan: unknown).

        The variance is homogeneous of degree one in the two noise variances, so that the two shares add up to one.
        """
        with np.errstate(divide="ignore", invalid="ignore"):
            fall = np.log(self.std["now"] / self.std["bit"]) / np.log(CHANGES["bit"][0])
        return np.asarray(np.clip(fall, 0.0, 1.0))

    @property
    def inflation(self) -> Array:
        """Ratio (r) of the least standard deviation to that if all other parameters were known."""
        return self.std["now"] / self.known


def accuracy_bound(
    model: Model,
    logs: Mapping[str, Log] | Sequence[Log],
    recipe: Recipe | None = None,
    *,
    sigma_q: Mapping[str, float] | float | None = None,
    sigma_tau: Mapping[str, float] | float | None = None,
    torque: TorqueNoise = "residual",
    progress: Callable[[str], None] | None = None,
) -> AccuracyBound:
    """Return the bound for a model and its training logs; the smoothed motion is taken for the true one.

    ``recipe`` smooths the logs and fits the parameters at which the bound is evaluated, with the fast substitute of its
    estimator where it has one. The standard deviations are those of ``noise_of``, except where ``sigma_q`` (rad, m;
    default: the ``sigma`` of the spline) and ``sigma_tau`` (N m, N) give them, by joint or as one number for all. Noise
    is taken as white, all usable samples count, and the initial state is unknown. Raises the errors of ``identify``,
    and ConfigError for a deviation that is not positive or for an unknown joint.

    >>> from dynident.models import record, simulate
    >>> from dynident.models.gallery import pendulum
    >>> model = pendulum()
    >>> motion = simulate(model, model.values, lambda t: [np.sin(3.0 * t)], np.linspace(0.0, 4.0, 801))
    >>> log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    >>> bound = accuracy_bound(model, [log], sigma_q=1e-4, sigma_tau=0.01)
    >>> bound.names, bool((bound.relative < 1.0).all())  # %
    (('J', 'h'), True)
    """
    recipe = recipe or Recipe()
    recipe = replace(recipe, estimator=quick(recipe.estimator))
    named = logs if isinstance(logs, Mapping) else {log.source: log for log in logs}
    plain = {name: replace(log, controller=None) for name, log in named.items()}
    found = identify(model, plain, (), replace(recipe, restart=None), progress=progress)
    joints = tuple(joint.name for joint in model.joints)
    if sigma_q is None:
        sigma_q = _spline_noise(recipe)
    sensors = noise_of(found, [log.select(joints) for log in plain.values()], torque, sigma_q, sigma_tau)
    if progress:
        progress("computing the bound")
    motions = tuple(one.motion for one in found.validations)
    directions = found.estimate.determined.directions
    shown = Regression(found.model, motions).triangular_factors.stacked() if directions is None else directions
    basis = base_parameters(shown, found.model.parameters)
    return _bounded(found, motions, basis, sensors, recipe.min_speeds(joints))


def _spline_noise(recipe: Recipe) -> Mapping[str, float] | float | None:
    """Return the position noise given to the smoother, None where it estimates it."""
    first = recipe.smoothers[0]
    return first.sigma if isinstance(first, KnowsNoise) else None


def _bounded(
    found: Identification,
    motions: Sequence[Motion],
    basis: BaseParameters,
    sensors: Noise,
    min_speed: tuple[float, ...] | None,
) -> AccuracyBound:
    theta, kept = found.estimate.value, list(basis.independent)
    sums = {name: np.zeros((len(kept), len(kept))) for name in CHANGES}
    samples = 0
    for motion in motions:
        samples += int(motion.mask.sum())
        for matrix in normal_matrices(found.model, theta, motion, sensors.q, sensors.tau, kept, min_speed):
            _add(sums, matrix)
    std, correlations = {}, np.eye(len(kept))
    for name, S in sums.items():
        covariance = rank_of_information(S).covariance()
        std[name] = np.sqrt(np.diag(covariance))
        if name == "now":
            with np.errstate(invalid="ignore"):  # infinite ones have none
                correlations = covariance / np.outer(std[name], std[name])
    known = 1.0 / np.sqrt(np.diag(sums["now"]))
    strong = np.nan_to_num(correlations) - np.eye(len(kept))
    partner = np.abs(strong).argmax(axis=1)
    return AccuracyBound(
        identification=found,
        names=basis.groupings,
        alone=(basis.combination != 0).sum(axis=1) == 1,
        units=tuple(found.estimate.units[k] for k in kept),
        value=basis.to_base(theta),
        std=std,
        known=known,
        partner=partner,
        correlation=np.take_along_axis(strong, partner[:, None], axis=1)[:, 0],
        fit=_fit_std(found, basis),
        noise=sensors,
        samples=samples,
    )


def _fit_std(found: Identification, basis: BaseParameters) -> Array:
    """Return the standard errors (r) of the identification for the base parameters that it knows by the same name."""
    errors, own = found.errors, found.base.on_data
    alone = errors.std if errors.std_hac is None else errors.std_hac
    std, names = (alone, found.estimate.names) if own is None else (errors.best_base, own.groupings)
    known = {} if std is None else dict(zip(names, std.tolist(), strict=True))
    return np.array([known.get(name, np.nan) for name in basis.groupings])


def _add(sums: dict[str, Array], matrix: NormalMatrix) -> None:
    """Add one stretch's information to that of each change; a longer record multiplies it."""
    once: dict[tuple[float, float], Array] = {}
    for name, (finer_q, finer_tau, times) in CHANGES.items():
        if (finer_q, finer_tau) not in once:
            once[finer_q, finer_tau] = matrix.information(finer_q, finer_tau)
        sums[name] += times * once[finer_q, finer_tau]


def noise_of(
    found: Identification,
    logs: Sequence[Log],
    torque: TorqueNoise = "residual",
    sigma_q: Mapping[str, float] | float | None = None,
    sigma_tau: Mapping[str, float] | float | None = None,
) -> Noise:
    """Return the noise of the sensors on the training logs, estimated where it is not given.

    Positions: the scatter between neighbouring samples. Torques: the residual of the fit, which includes the misfit of
    the model, or with ``torque`` "sensor" the scatter between neighbouring samples. The scatter is at least that of
    quantisation, step / sqrt(12). Raises ConfigError for an unknown joint.
    """
    if not isinstance(torque, str) or torque not in get_args(TorqueNoise):
        raise ConfigError(f"torque is {torque!r}. {choices(torque, get_args(TorqueNoise))}")
    joints = found.validations[0].motion.joints
    position = _mean([_position(log) for log in logs], logs)
    sensor = _mean([_scatter(log) for log in logs], logs)
    residual = _mean([np.array([one.errors.rmse[name] for name in joints]) for one in found.validations], logs)
    residual = np.where(np.isnan(residual), sensor, residual)  # never recorded: it counts for nothing
    by = Measure.RESIDUAL if torque == "residual" else Measure.SCATTER
    q, positions = _given("sigma_q", sigma_q, joints, position, Measure.SCATTER)
    tau, torques = _given("sigma_tau", sigma_tau, joints, residual if by is Measure.RESIDUAL else sensor, by)
    return Noise(q, tau, sensor, positions, torques)


def _given(
    name: str, wanted: Mapping[str, float] | float | None, joints: tuple[str, ...], sizes: Array, by: Measure
) -> tuple[Array, Origin]:
    """Return the deviations (n), measured ``sizes`` except where given, and their source."""
    if wanted is None:
        return sizes, Origin(by)
    values: dict[str, Any] = dict(wanted) if isinstance(wanted, Mapping) else dict.fromkeys(joints, wanted)
    for joint, value in values.items():
        if joint not in joints:
            raise ConfigError(f"{name}: there is no joint {joint!r}; {choices(joint, joints)}")
        if not isinstance(value, int | float | np.number) or not 0 < value < np.inf:
            raise ConfigError(f"{name} of {joint} is {value!r}; give a positive number, in SI units.")
    origin = Origin(None if len(values) == len(joints) else by, tuple(values))
    return np.array([values.get(joint, size) for joint, size in zip(joints, sizes, strict=True)]), origin


def _position(log: Log) -> Array:
    steps = np.array([channel.resolution for channel in channels(log)])
    try:
        found = noise_sigma(log.t, log.q)
    except InputError as error:
        raise InputError(f"{log.source}: {error}") from error
    return _rounded(found, steps)


def _scatter(log: Log) -> Array:
    """Return the torque's noise (n) by the median of differences, which is robust to jumps of Coulomb friction."""
    steps = np.array([channel.torque_resolution for channel in channels(log)])
    return _rounded(steady_noise(log.tau, 1e-12), steps)


def _rounded(noise: Array, steps: Array) -> Array:
    """Return the noise (n), at least that of quantisation in steps (n); nan for no quantisation."""
    return np.asarray(np.maximum(noise, np.nan_to_num(steps) / np.sqrt(12)))


def _mean(sizes: Sequence[Array], logs: Sequence[Log]) -> Array:
    """Return the root mean square over the logs, by their samples, nan where none is known; never zero."""
    known = ~np.isnan(sizes)
    weights = known * np.array([len(log) for log in logs])[:, None]
    squares = np.sum(weights * np.square(np.nan_to_num(sizes)), axis=0) / np.maximum(weights.sum(axis=0), 1)
    return np.where(known.any(axis=0), np.sqrt(np.maximum(squares, 1e-200)), np.nan)
