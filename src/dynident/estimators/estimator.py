"""The protocol of an estimator: Problem -> Estimate."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, brief, listed
from dynident.estimators.notes import Unsettled
from dynident.log import Log, Motion
from dynident.models import Model, Parameter
from dynident.regression import Rank, Regression, TriangularFactors, Whitening

__all__ = [
    "Consistency",
    "Determined",
    "Estimate",
    "Estimator",
    "HasQuick",
    "NeedsSamples",
    "Problem",
    "Provenance",
    "Residual",
    "needs_samples",
    "quick",
]

Array = NDArray[np.float64]


class Provenance(StrEnum):
    """What determines a parameter: the data, the prior, an active bound, or nothing."""

    DATA = "data"
    PRIOR = "prior"
    BOUND = "bound"
    UNIDENTIFIABLE = "unidentifiable"


@dataclass(frozen=True, eq=False)
class Problem:
    """The input of an estimator: the model, the motions to fit, their linear problem, and the logs as measured.

    ``logs`` may be empty: the positions of the motions are then used as the measured ones. The positions of the logs
    are stamped ``time_offset`` (s) later than the torque; the motions are corrected for it, the logs are not.
    ``progress`` is called with each `Step` of long work.
    """

    model: Model
    motions: tuple[Motion, ...]
    regression: Regression
    logs: tuple[Log, ...] = ()
    time_offset: float = 0.0
    progress: Callable[[str], None] = field(default=lambda _: None, repr=False)

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Determined:
    """What the data determine: the ``rank``, and the ``condition`` of the column-scaled regressor.

    ``directions`` are those of the parameters of which the rank is the number, where the estimator says them.
    """

    rank: int
    condition: float = math.nan
    directions: Rank | None = None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Pieces:
    """What a fit in pieces leaves of the torque, in each of K pieces of long recordings: is it the same all the time?

    ``recording`` (K) names it; ``begins`` and ``ends`` (K) in s; ``rows`` (K, n) is how many torques of each joint were
    fitted, ``torque`` and ``residual`` (K, n) their rms (N m or N), zero where there are none.
    """

    recording: tuple[str, ...]
    begins: Array
    ends: Array
    rows: NDArray[np.int_]
    torque: Array
    residual: Array

    __repr__ = brief

    @property
    def relative_error(self) -> Array:
        """The residual (n) of all pieces relative to the torque, in %; nan where a joint has no torque."""
        left, whole = (np.sqrt((self.rows * one**2).sum(axis=0)) for one in (self.residual, self.torque))
        return np.asarray(100.0 * np.divide(left, whole, out=np.full_like(whole, np.nan), where=whole > 0))


@dataclass(frozen=True, eq=False)
class Residual:
    """What the fit leaves of the torque: standard deviation ``sigma`` (n) of each joint (N m or N), of ``samples``.

    How rows were weighted: ``weights`` (n) are what each joint's rows were multiplied with, None where all count the
    same; ``sample_weights`` holds for each motion of the regression what its rows (N, n) were multiplied with besides,
    empty where all count the same, and ``slopes`` (N, n) the derivative of w^2 e by the residual e where the weights w
    depend on it (empty: w^2); ``whitening`` is what the rows of all joints went through before that, None where it is
    nothing. ``pieces`` is what is left in each piece of recordings that were fitted in pieces. Where it is
    ``correlated``, the errors of the estimate allow for its correlation in time.
    """

    sigma: Array
    samples: int
    weights: Array | None = None
    sample_weights: tuple[Array, ...] = ()
    slopes: tuple[Array, ...] = ()
    pieces: Pieces | None = None
    whitening: Whitening | None = None
    correlated: bool = False

    __repr__ = brief

    def weighted(self, plain: Regression) -> Regression:
        """Return a regression of these motions whose rows are whitened and weighted by sample as those of the fit."""
        if not self.sample_weights and self.whitening is None:
            return plain
        return replace(plain, weights=self.sample_weights, whitening=self.whitening)

    def responding(self, weighted: Regression) -> Regression:
        """Return a regression whose rows are those of the fit, weighted by how much it follows them: by the slopes."""
        return replace(weighted, weights=tuple(np.sqrt(one) for one in self.slopes)) if self.slopes else weighted

    def row_deviation(self, triangular: TriangularFactors, value: Array) -> Array:
        """Return the deviation (n) of what ``value`` leaves of the rows of the fit, where that is not ``sigma``: where
        they were whitened (about one), or weighted by sample. With ``slopes``, ``sigma`` is the one that counts."""
        if self.slopes or not (self.sample_weights or self.whitening):
            return self.sigma
        return np.asarray(np.sqrt(triangular.residual(value) / np.maximum(triangular.rows - 1, 1)))

    @property
    def joint_weights(self) -> Array | None:
        """The weights (n) of the joints for a fit without whitening: where there was some, one over ``sigma``."""
        if self.whitening is None:
            return self.weights
        return 1.0 / np.maximum(self.sigma, 1e-7 * (self.sigma.max(initial=0.0) or 1.0))


@dataclass(frozen=True, eq=False)
class Consistency:
    """How an estimate stands to physics: ``eigenvalues`` is the smallest one of each body's pseudo-inertia, relative
    to the body's usual mass (kg) and length (m); ``costs`` is what each family of constraints alone, and "all" of them,
    add to the weighted relative error of the training data (percentage points of the torque); ``unconstrained`` (p) is
    a solution of the same fit without constraints, None where it has none. What constraints move a value by may be its
    error, and counts as such in the covariance.
    """

    eigenvalues: Mapping[str, float] = field(default_factory=dict)
    costs: Mapping[str, float] = field(default_factory=dict)
    unconstrained: Array | None = None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Estimate:
    """Parameters with their uncertainty.

    ``value`` (p) of the model's ``parameters``, in their units; ``covariance`` (p, p), infinite variance where the data
    do not determine a parameter; ``notes`` say what was not as it should be, none where all is well.

    Where the estimator can tell: ``provenance`` (p) says what each parameter was determined by (else empty);
    ``consistency`` how it stands to physics; ``interval`` (p, 2) are the ends of 95 % intervals that need not be
    symmetric; ``information`` (p, p) is Fisher's of all, where the errors of the motion count, too.
    """

    parameters: tuple[Parameter, ...]
    value: Array
    covariance: Array
    determined: Determined
    residual: Residual
    notes: tuple[Note, ...] = ()
    provenance: tuple[Provenance, ...] = ()
    consistency: Consistency | None = None
    interval: Array | None = None
    information: Array | None = None

    def __repr__(self) -> str:
        rows = zip(self.parameters, self.value, self.std, strict=True)
        few = listed((f"{one.name} = {value:.4g} +- {std:.2g} {one.unit}" for one, value, std in rows), 3)
        return f"<Estimate of {len(self.value)} parameters, rank {self.determined.rank}: {few}>"

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
        """Whether triangular factors alone do not give it: samples had weights, or errors of the motion count, or rows
        were whitened."""
        residual = self.residual
        return self.information is not None or bool(residual.sample_weights) or residual.whitening is not None

    @property
    def shown(self) -> Rank | None:
        """What the motion shows by rows that are not whitened, where those of the fit are."""
        directions = self.determined.directions
        return None if self.residual.whitening is None or directions is None else directions.unweighted or directions


class Estimator(Protocol):
    """A frozen dataclass of settings; calling it with the data gives the estimate."""

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate the parameters of the problem's model."""


@runtime_checkable
class HasQuick(Protocol):
    """An estimator with a fast substitute for searches over many trial values, such as that of the time offset."""

    def quick(self) -> Estimator:
        """Return an estimator that minimises a similar error, as fast as least squares."""


@runtime_checkable
class NeedsSamples(Protocol):
    """An estimator that may need the samples of the motions, and not only the triangular factors of their rows."""

    @property
    def needs_samples(self) -> bool:
        """Whether it does."""


@runtime_checkable
class NamesParameters(Protocol):
    """An estimator whose settings name parameters."""

    @property
    def named(self) -> tuple[str, ...]:
        """The parameters that are named."""

    def among(self, names: Collection[str]) -> Estimator:
        """Return the estimator without what it says of other parameters than these."""


def among(estimator: Estimator, names: Collection[str]) -> Estimator:
    """Return an estimator without what its settings say of other parameters than these."""
    return estimator.among(names) if isinstance(estimator, NamesParameters) else estimator


def needs_samples(estimator: Estimator) -> bool:
    """Return whether an estimator needs more of the samples than the triangular factors of their rows."""
    return isinstance(estimator, NeedsSamples) and estimator.needs_samples


def quick(estimator: Estimator) -> Estimator:
    """Return the fast substitute of an estimator for searches, or itself where it has none."""
    return estimator.quick() if isinstance(estimator, HasQuick) else estimator
