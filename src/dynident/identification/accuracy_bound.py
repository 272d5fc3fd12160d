"""The accuracy that any unbiased method can reach with a robot, a motion and sensors, and with better ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cache
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from dynident.identification.cramer_rao import normal_matrices
from dynident.identification.dataset import Logs, logs_by_name
from dynident.identification.identify import identify
from dynident.identification.recipe import Recipe
from dynident.identification.result import Identification
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.splines import grid_step, noise_sigma, steady_noise
from dynident.regression import BaseParameters, Regression, Selection, base_parameters, rank_of_information
from dynident.runtime import ConfigError, InputError, Noun, choices, join_names, report_progress
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import polars as pl

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
    """Source of a noise level: ``measured`` (None: for no joint), except for the joints in ``given_joints``."""

    measured: Measure | None = Measure.SCATTER
    given_joints: tuple[str, ...] = ()

    def __str__(self) -> str:
        kinds = {Measure.RESIDUAL: "residual of the fit", Measure.SCATTER: "scatter between neighbouring samples"}
        if self.measured is None:
            return "as given"
        measured = kinds[self.measured]
        return f"as given for {', '.join(self.given_joints)}; else {measured}" if self.given_joints else measured


class Noise(Noun):
    """Standard deviations (n) of positions ``q`` (rad, m) and torques ``tau`` (N m, N), and their sources.

    ``sensor`` (n) is the torque's own noise, from differences of neighbouring samples.
    """

    q: Array
    tau: Array
    sensor: Array
    positions: Origin = Origin()
    torques: Origin = Origin()


@dataclass(frozen=True, eq=False)
class AccuracyBound:
    """The Cramer-Rao bound of the r base parameters of a model, at the parameters of an identification.

    ``names`` of the base parameters as formulas in the ``parameters`` (p), ``independent`` (r) the index of the
    parameter that each begins with, ``alone`` (r) whether it is that one alone, ``value`` (r) and ``units``; ``std``
    maps "now" and each change of ``CHANGES`` to the least standard deviations (r), infinite for what the record does
    not excite. ``conditional_std`` (r) is the least one if all others were known; ``partner`` (r) is the index of the
    most correlated parameter, ``correlation`` (r) their correlation. ``fit`` (r) are the standard errors of the
    identification, valid for correlated residuals where possible, nan where it has none.
    """

    identification: Identification
    names: tuple[str, ...]
    independent: tuple[int, ...]
    alone: NDArray[np.bool_]
    units: tuple[str, ...]
    value: Array
    std: Mapping[str, Array]
    conditional_std: Array
    partner: NDArray[np.intp]
    correlation: Array
    fit: Array
    noise: Noise
    samples: int

    def __repr__(self) -> str:
        least_certain = [k for k in np.argsort(-self.relative) if np.isfinite(self.relative[k])]
        least_known = join_names((f"{self.leads[k]} {float(f'{self.relative[k]:.2g}'):g} %" for k in least_certain), 3)
        size = f"{len(self.names)} base parameters from {self.samples} samples"
        return f"<AccuracyBound of {size}; least known: {least_known}>"

    @property
    def leads(self) -> tuple[str, ...]:
        """The standard parameter (r) that each base parameter begins with."""
        return tuple(self.identification.model.names[k] for k in self.independent)

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
            # the local power of the variance in sigma_q^2, from a bound with half of sigma_q
            share = np.log(self.std["now"] / self.std["bit"]) / np.log(CHANGES["bit"][0])
        return np.asarray(np.clip(share, 0.0, 1.0))

    @property
    def inflation(self) -> Array:
        """Ratio (r) of the least standard deviation to that if all other parameters were known."""
        return self.std["now"] / self.conditional_std


def accuracy_bound(
    model: Model,
    logs: Logs,
    recipe: Recipe | None = None,
    *,
    sigma_q: Mapping[str, float] | float | None = None,
    sigma_tau: Mapping[str, float] | float | None = None,
    torque: TorqueNoise = "residual",
) -> AccuracyBound:
    """Return the bound for a model and its training logs; the smoothed motion is taken for the true one.

    ``recipe`` smooths the logs and fits the parameters at which the bound is evaluated, with the fast substitute of its
    estimator where it has one. The standard deviations are those of ``noise_of``, except where ``sigma_q`` (rad, m;
    default: the ``sigma`` of the spline) and ``sigma_tau`` (N m, N) give them, by joint or as one number for all. Noise
    is taken as white, all usable samples count, and the initial state is unknown. Raises the errors of ``identify``,
    and ConfigError for a deviation that is not positive or for an unknown joint.

    >>> from dynident.models.simulation import record, simulate
    >>> from dynident.models.lagrangian import pendulum
    >>> model = pendulum()
    >>> motion = simulate(model, model.values, lambda t: [np.sin(3.0 * t)], np.linspace(0.0, 4.0, 801))
    >>> log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    >>> bound = accuracy_bound(model, [log], sigma_q=1e-4, sigma_tau=0.01)
    >>> bound.names, bool((bound.relative < 1.0).all())  # %
    (('J', 'h'), True)
    """
    recipe = recipe or Recipe()
    recipe = replace(recipe, estimator=recipe.estimator.quick())
    # without controllers, so that no estimator simulates their loop
    open_logs = {name: replace(log, controller=None) for name, log in logs_by_name(logs, "logs").items()}
    identification = identify(model, open_logs, (), replace(recipe, restart=None))
    joints = tuple(joint.name for joint in model.joints)
    if sigma_q is None:
        sigma_q = recipe.smoothers[0].sigma  # None where the smoother estimates it
    sensors = noise_of(identification, [log.select(joints) for log in open_logs.values()], torque, sigma_q, sigma_tau)
    report_progress("computing the bound")
    motions = tuple(validation.motion for validation in identification.validations)
    directions = identification.estimate.determined.directions
    # base parameters of what these data determine, not of the model's structure
    rows = Regression(identification.model, motions).triangular_factors.stack() if directions is None else directions
    basis = base_parameters(rows, identification.model.parameters)
    return _compute_bound(identification, motions, basis, sensors, recipe.selection(identification.model.joints))


def _compute_bound(
    identification: Identification,
    motions: Sequence[Motion],
    basis: BaseParameters,
    sensors: Noise,
    selection: Selection,
) -> AccuracyBound:
    theta, columns = identification.estimate.value, list(basis.independent)
    sums = {name: np.zeros((len(columns), len(columns))) for name in CHANGES}
    samples = 0
    # informations of motions add; each change has its own sum
    for motion in motions:
        samples += int(motion.mask.sum())
        for matrix in normal_matrices(identification.model, theta, motion, sensors.q, sensors.tau, columns, selection):
            information = cache(matrix.information)  # of changes that differ in the length of the record alone
            for name, (finer_q, finer_tau, repeats) in CHANGES.items():
                sums[name] += repeats * information(finer_q, finer_tau)
    std, correlations = {}, np.eye(len(columns))
    for name, S in sums.items():
        covariance = rank_of_information(S).covariance()
        std[name] = np.sqrt(np.diag(covariance))
        if name == "now":
            with np.errstate(invalid="ignore"):  # infinite ones have none
                correlations = covariance / np.outer(std[name], std[name])
    # with all others known, the variance is the inverse of the diagonal of the information
    least_std = 1.0 / np.sqrt(np.diag(sums["now"]))
    strong = np.nan_to_num(correlations) - np.eye(len(columns))
    partner = np.abs(strong).argmax(axis=1)
    return AccuracyBound(
        identification=identification,
        names=basis.groupings,
        independent=tuple(columns),
        alone=(basis.combination != 0).sum(axis=1) == 1,
        units=tuple(identification.estimate.units[k] for k in columns),
        value=basis.to_base(theta),
        std=std,
        conditional_std=least_std,
        partner=partner,
        correlation=np.take_along_axis(strong, partner[:, None], axis=1)[:, 0],
        fit=_fit_std(identification, basis),
        noise=sensors,
        samples=samples,
    )


def _fit_std(identification: Identification, basis: BaseParameters) -> Array:
    """Return the standard errors (r) of the identification for the base parameters that it knows by the same name."""
    errors, data_base = identification.errors, identification.base.on_data
    std, names = (
        (errors.std, identification.estimate.names) if data_base is None else (errors.base_std, data_base.groupings)
    )
    std_by_name = {} if std is None else dict(zip(names, std.tolist(), strict=True))
    return np.array([std_by_name.get(name, np.nan) for name in basis.groupings])


def noise_of(
    identification: Identification,
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
    joints = identification.validations[0].motion.joints
    position = _mean_noise([_position_noise(log) for log in logs], logs)
    # the median of differences, which is robust to jumps of Coulomb friction
    sensor = _mean_noise([_limit_by_quantisation(steady_noise(log.tau, 1e-12), log.tau) for log in logs], logs)
    residual = _mean_noise(
        [np.array([validation.errors.rmse[name] for name in joints]) for validation in identification.validations], logs
    )
    residual = np.where(np.isnan(residual), sensor, residual)  # never recorded: it counts for nothing
    by = Measure.RESIDUAL if torque == "residual" else Measure.SCATTER
    q, positions = _override_noise("sigma_q", sigma_q, joints, position, Measure.SCATTER)
    tau, torques = _override_noise("sigma_tau", sigma_tau, joints, residual if by is Measure.RESIDUAL else sensor, by)
    return Noise(q, tau, sensor, positions, torques)


def _override_noise(
    name: str, sigma: Mapping[str, float] | float | None, joints: tuple[str, ...], sizes: Array, by: Measure
) -> tuple[Array, Origin]:
    """Return the deviations (n), measured as ``sizes`` (n) except for those that are given, and their source."""
    if sigma is None:
        return sizes, Origin(by)
    values: dict[str, Any] = dict(sigma) if isinstance(sigma, Mapping) else dict.fromkeys(joints, sigma)
    for joint, value in values.items():
        if joint not in joints:
            raise ConfigError(f"{name}: there is no joint {joint!r}; {choices(joint, joints)}")
        if not isinstance(value, int | float | np.number) or not 0 < value < np.inf:
            raise ConfigError(f"{name} of {joint} is {value!r}; give a positive number, in SI units.")
    origin = Origin(None if len(values) == len(joints) else by, tuple(values))
    return np.array([values.get(joint, size) for joint, size in zip(joints, sizes, strict=True)]), origin


def _position_noise(log: Log) -> Array:
    try:
        noise = noise_sigma(log.t, log.q)
    except InputError as error:
        raise InputError(f"{log.source}: {error}") from error
    return _limit_by_quantisation(noise, log.q)


def _limit_by_quantisation(noise: Array, x: Array) -> Array:
    """Return the noise (n) of what was recorded as x (N, n), at least that of its quantisation, if there is one."""
    steps = np.array([grid_step(column) for column in x.T])
    return np.asarray(np.maximum(noise, np.nan_to_num(steps) / np.sqrt(12)))


def _mean_noise(sizes: Sequence[Array], logs: Sequence[Log]) -> Array:
    """Return the root mean square over the logs, by their samples, nan where none is known; never zero."""
    is_known = ~np.isnan(sizes)
    weights = is_known * np.array([len(log) for log in logs])[:, None]
    squares = np.sum(weights * np.square(np.nan_to_num(sizes)), axis=0) / np.maximum(weights.sum(axis=0), 1)
    # never zero, which would mean infinite information
    return np.where(is_known.any(axis=0), np.sqrt(np.maximum(squares, 1e-200)), np.nan)
