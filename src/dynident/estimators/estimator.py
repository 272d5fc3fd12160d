"""What an estimator takes, gives and is: Problem -> Estimate."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import field, replace
from enum import StrEnum
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.notes import DecidedByPrior, NotIdentifiable, Unsettled
from dynident.models import Model, Parameter
from dynident.motion.log import Controller, Log, Motion
from dynident.regression import Rank, Regression, TriangularFactors, Whitening
from dynident.runtime import (
    OMITTED,
    Axes,
    ConfigError,
    KeepsFacts,
    Note,
    Noun,
    Part,
    check_settings,
    choices,
    join_names,
    settings_repr,
    settings_text,
)
from dynident.runtime.arrays import Array

MAX_PRIOR = 1e9  # in size


class Provenance(StrEnum):
    """What determines a parameter: the data, the prior, an active bound, or nothing."""

    DATA = "data"
    PRIOR = "prior"
    BOUND = "bound"
    UNIDENTIFIABLE = "unidentifiable"


class Problem(KeepsFacts, Noun):
    """The input of an estimator: the model, the motions to fit, their linear problem, and the logs as measured.

    ``logs`` may be empty: the positions of the motions are then used as the measured ones. The positions of the logs
    are stamped ``time_offset`` (s) later than the torque; the motions are corrected for it, the logs are not.
    """

    model: Model
    motions: tuple[Motion, ...]
    regression: Regression
    logs: tuple[Log, ...] = ()
    time_offset: float = 0.0

    def log(self, k: int) -> Log | None:
        """Return the log behind the k-th motion, None where there is none."""
        if len(self.logs) != len(self.motions) or len(self.logs[k]) != len(self.motions[k]):
            return None
        return self.logs[k]

    def controller(self, k: int) -> Controller | None:
        """Return the controller of the k-th recording, None where it has none."""
        log = self.log(k)
        return None if log is None else log.controller


class DataRank(Noun):
    """How much the data determine: the ``rank``, and the ``condition`` of the column-scaled regressor.

    ``directions`` are the determined directions of the parameters, as many as the rank, where the estimator gives
    them.
    """

    rank: int
    condition: float = math.nan
    directions: Annotated[Rank | None, OMITTED] = None

    @property
    def determined_condition(self) -> float:
        """The condition within the directions that the data determine, where these are known."""
        if self.directions is None or not self.directions.rank:
            return self.condition
        return float(self.directions.values[0] / self.directions.values[self.directions.rank - 1])


class Pieces(Noun):
    """The residual torque in each of K pieces of long recordings, to see whether a fit is equally good all the time.

    ``recording`` (K) names the recording, ``begins`` and ``ends`` (K) are in s; ``rows`` (K, n) is how many
    torques of each joint were fitted, ``torque`` and ``residual`` (K, n) are their rms values (N m or N), zero
    where there are none.
    """

    recording: tuple[str, ...]
    begins: Annotated[Array, Axes("K")]
    ends: Annotated[Array, Axes("K")]
    rows: Annotated[NDArray[np.int_], Axes("K", "n")]
    torque: Annotated[Array, Axes("K", "n")]
    residual: Annotated[Array, Axes("K", "n")]

    @property
    def relative_error(self) -> Array:
        """The residual (n) of all pieces relative to the torque, in %; nan where a joint has no torque."""
        residual, torque = (np.sqrt((self.rows * rms**2).sum(axis=0)) for rms in (self.residual, self.torque))
        return np.asarray(100.0 * np.divide(residual, torque, out=np.full_like(torque, np.nan), where=torque > 0))


class Residual(Noun):
    """The residual torque of a fit: standard deviation ``sigma`` (n) of each joint (N m or N), of ``samples``.

    The weighting of the rows: ``weights`` (n) multiplied the rows of each joint, None where all count the same;
    ``sample_weights`` multiplied the rows (N, n) of each motion in addition, empty where all count the same;
    ``slopes`` (N, n) are the derivatives of w^2 e by the residual e where the weights w depend on it (empty:
    w^2); ``whitening`` was applied to the rows of all joints before, None for none. ``pieces`` are the residuals
    piece by piece, of recordings that were fitted in pieces. Where the residual is ``correlated``, the errors of
    the estimate account for its correlation in time.
    """

    sigma: Annotated[Array, Axes("n")]
    samples: int
    weights: Annotated[Array, Axes("n")] | None = None
    sample_weights: Annotated[tuple[Array, ...], OMITTED] = ()
    slopes: Annotated[tuple[Array, ...], OMITTED] = ()
    pieces: Pieces | None = None
    whitening: Whitening | None = None
    correlated: bool = False

    def weight_rows(self, regression: Regression) -> Regression:
        """Return a regression of these motions, with the whitening and the sample weights of the fit."""
        if not self.sample_weights and self.whitening is None:
            return regression
        return replace(regression, weights=self.sample_weights, whitening=self.whitening)

    def weight_by_slopes(self, regression: Regression) -> Regression:
        """Return a regression whose rows are weighted by the slopes, which tell how strongly the fit responds to
        them."""
        return (
            replace(regression, weights=tuple(np.sqrt(slope) for slope in self.slopes)) if self.slopes else regression
        )

    def row_deviation(self, triangular: TriangularFactors, value: Array) -> Array:
        """Return the standard deviation (n) of the weighted rows at ``value``.

        It differs from ``sigma`` where the rows were whitened (about one) or weighted by sample; with ``slopes``,
        ``sigma`` is the deviation that counts.
        """
        if self.slopes or not (self.sample_weights or self.whitening):
            return self.sigma
        return np.asarray(np.sqrt(triangular.residual(value) / np.maximum(triangular.rows - 1, 1)))

    @property
    def joint_weights(self) -> Array | None:
        """The weights (n) of the joints for a fit without whitening: where there was whitening, one over ``sigma``."""
        if self.whitening is None:
            return self.weights
        return 1.0 / np.maximum(self.sigma, 1e-7 * (self.sigma.max(initial=0.0) or 1.0))


class Consistency(Noun):
    """How an estimate agrees with physics.

    ``eigenvalues`` is the smallest eigenvalue of each body's pseudo-inertia, relative to the body's typical mass
    (kg) and length (m); ``costs`` is what each family of constraints alone, and "all" of them, add to the
    weighted relative error of the training data (percentage points of the torque); ``unconstrained`` (p) is a
    solution of the same fit without constraints, None where it has none. A change of a value by the constraints
    may be its error, and counts as such in the covariance.
    """

    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    unconstrained: Annotated[Array, Axes("p")] | None = None


class Estimate(Noun):
    """Parameters with their uncertainty.

    ``value`` (p) of the model's ``parameters``, in their units; ``covariance`` (p, p), with infinite variance
    where the data do not determine a parameter; ``notes`` tell what was not as it should be, none where all is
    well.

    Where the estimator can tell: ``provenance`` (p) is what determines each parameter (else empty);
    ``consistency`` is the agreement with physics; ``interval`` (p, 2) are the ends of 95 % intervals that need
    not be symmetric; ``information`` (p, p) is the Fisher information of all data, where the errors of the motion
    count, too.
    """

    parameters: Annotated[tuple[Parameter, ...], OMITTED]
    value: Annotated[Array, OMITTED]
    covariance: Annotated[Array, Axes("p", "p")]
    determined: DataRank
    residual: Residual
    notes: tuple[Note, ...] = ()
    provenance: Annotated[tuple[Provenance, ...], OMITTED] = ()
    consistency: Consistency | None = None
    interval: Annotated[Array, Axes("p", 2)] | None = None
    information: Annotated[Array, Axes("p", "p")] | None = None

    def __repr__(self) -> str:
        rows = zip(self.parameters, self.value, self.std, strict=True)
        summary = join_names(
            (f"{parameter.name} = {value:.4g} +- {std:.2g} {parameter.unit}" for parameter, value, std in rows), 3
        )
        return f"<Estimate of {len(self.value)} parameters, rank {self.determined.rank}: {summary}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters (p)."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def units(self) -> tuple[str, ...]:
        """Units of the parameters (p)."""
        return tuple(parameter.unit for parameter in self.parameters)

    @property
    def std(self) -> Array:
        """Standard errors (p)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def converged(self) -> bool:
        """Whether the iteration, if there was one, converged."""
        return not any(isinstance(note, Unsettled) for note in self.notes)

    @property
    def needs_samples(self) -> bool:
        """Whether the estimate needs the samples, and not only triangular factors.

        It does where samples had weights, rows were whitened, or errors of the motion count.
        """
        residual = self.residual
        return self.information is not None or bool(residual.sample_weights) or residual.whitening is not None

    @property
    def unwhitened_rank(self) -> Rank | None:
        """The rank of the rows before whitening, where those of the fit are whitened; else None."""
        directions = self.determined.directions
        return None if self.residual.whitening is None or directions is None else directions.unweighted or directions


class Estimator(Part, ABC):
    """Base of the estimators: a frozen dataclass of settings, which maps a problem to an estimate.

    All but the call has a default, which an estimator overrides where it differs. Settings outside the limits of their
    types raise ConfigError. Those ``by_parameter`` are values by parameter name, or a text; they are kept as pairs.
    As text it is its ``title``, or the name of its class, with the settings that differ from their defaults.
    """

    by_parameter: ClassVar[tuple[str, ...]] = ()
    title: ClassVar[str] = ""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.__repr__ = settings_repr  # type: ignore[method-assign]  # dataclass would make another

    def __post_init__(self) -> None:
        check_settings(self)
        for setting in self.by_parameter:
            object.__setattr__(self, setting, to_tuples(getattr(self, setting)))

    @abstractmethod
    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""

    def quick(self) -> Estimator:
        """Return an estimator that minimises a similar error as fast as least squares, for searches: here itself."""
        return self

    @property
    def needs_samples(self) -> bool:
        """Whether the samples of the motions are needed, and not only the triangular factors of their rows."""
        return False

    @property
    def named(self) -> tuple[str, ...]:
        """The parameters that the settings name."""
        return tuple(dict.fromkeys(name for setting in self.by_parameter for name in self.values_of(setting)))

    def __str__(self) -> str:
        return settings_text(self.title or type(self).__name__, self)

    def among(self, names: Collection[str]) -> Self:
        """Return the estimator without its settings for parameters other than ``names``."""
        kept = {
            setting: tuple((name, value) for name, value in self.values_of(setting).items() if name in names)
            for setting in self.by_parameter
            if not isinstance(getattr(self, setting), str)
        }
        return replace(self, **kept) if kept else self  # type: ignore[type-var]

    def values_of(self, setting: str) -> dict[str, Any]:
        """Return the values of a setting by parameter name; none where it is a text."""
        values = getattr(self, setting)
        return {} if isinstance(values, str) else dict(values)

    def check_prior(self) -> None:
        """Raise ConfigError for a setting ``prior`` with what is no number, or a huge one."""
        for name, value in self.values_of("prior").items():
            if not abs(value) <= MAX_PRIOR:
                raise ConfigError(f"prior of {name} is {value}; give a number of at most {MAX_PRIOR:g} in size.")


def to_tuples(value: Any) -> Any:
    """Return lists, arrays and mappings as tuples, so that settings can be hashed; anything else as it is."""
    if isinstance(value, Mapping):
        return tuple((key, to_tuples(entry)) for key, entry in value.items())
    return tuple(map(to_tuples, value)) if isinstance(value, (list, tuple, np.ndarray)) else value


def check_parameters(names: Collection[str], model: Model, where: str) -> None:
    """Raise ConfigError where a setting, ``where``, names parameters that the model does not have."""
    for name in names:
        if name not in model.names:
            raise ConfigError(f"{where}: {model.name} has no parameter {name!r}; {choices(name, model.names)}")


def prior_values(prior: str | Mapping[str, float] | Iterable[tuple[str, float]], model: Model) -> Array:
    """Return a prior (p), "nominal" or values by name, nan where a parameter has none."""
    if prior == "nominal":
        return np.array([np.nan if parameter.value is None else parameter.value for parameter in model.parameters])
    values = {} if isinstance(prior, str) else dict(prior)
    check_parameters(values, model, "prior")
    return np.array([values.get(name, np.nan) for name in model.names])


def prior_notes(provenance: Sequence[Provenance]) -> tuple[Note, ...]:
    """Return the notes on how many parameters a prior determines, and nothing does."""
    kinds = ((Provenance.PRIOR, DecidedByPrior), (Provenance.UNIDENTIFIABLE, NotIdentifiable))
    return tuple(kind(provenance.count(which)) for which, kind in kinds if which in provenance)
