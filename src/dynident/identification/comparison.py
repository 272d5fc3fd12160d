"""Two results of one robot side by side: which parameters differ beyond their errors, and whether one is worse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from dynident.errors import Use, brief
from dynident.validation import TorqueErrors

__all__ = [
    "BaseDifference",
    "ComparedLog",
    "ComparedResult",
    "ExportRecord",
    "LogDifference",
    "ResultComparison",
    "compare_results",
]

Array = NDArray[np.float64]
SPAN = 1e-4  # of a combination of parameters, in scaled units, that another's may leave of it
ROUNDING = 1e-11  # of the sizes of all that is summed: a smaller difference is none
SHOWN = 1e-12  # a direction with less of the largest variance has no error of its own
USES = (Use.DO_NOT_USE, Use.CONTROL, Use.SIMULATION)  # from the least to the most


@dataclass(frozen=True)
class ComparedLog:
    """A log that a result was fitted to or judged on: its errors, and what identifies the recording (hashes of its
    files, window), empty where that is not known."""

    name: str
    role: str
    errors: TorqueErrors
    recording: str = ""

    __repr__ = brief


@dataclass(frozen=True)
class ExportRecord:
    """A file of the model that was written beside a result: its format and hash, whether it was ``proven`` by loading
    it again, how far its torque is from the model's (relative), and whether it is there as it was (None: not looked).
    """

    file: str
    format: str
    sha256: str
    proven: bool
    agreement: float | None
    there: bool | None = None


@dataclass(frozen=True, eq=False)
class ComparedResult:
    """What comparing needs of a result: parameters (p), base parameters (r) that its data determine, logs, use, files.

    ``combination`` (r, p) makes base parameters of parameters, ``scale`` (p) are the sizes of the columns;
    ``covariance`` (r, r) is of the base parameters, of which only the diagonal is known unless ``together``.
    """

    name: str
    joints: tuple[str, ...]
    names: tuple[str, ...]
    value: Array
    base_names: tuple[str, ...]
    base_units: tuple[str, ...]
    combination: Array
    scale: Array
    covariance: Array
    together: bool = True
    logs: tuple[ComparedLog, ...] = ()
    use: Use | None = None
    exports: tuple[ExportRecord, ...] = ()

    __repr__ = brief


@dataclass(frozen=True)
class BaseDifference:
    """A base parameter of two results, with its standard errors: ``z`` is second less first over the standard error of
    that, ``p_value`` how likely chance makes the largest of all so large (Holm, 1979)."""

    name: str
    unit: str
    first: float
    first_std: float
    second: float
    second_std: float
    z: float
    p_value: float


@dataclass(frozen=True)
class LogDifference:
    """A log of the same name and role in two results; ``same``: whether the recording is, None where not known."""

    name: str
    role: str
    first: TorqueErrors
    second: TorqueErrors
    same: bool | None

    __repr__ = brief

    @property
    def growth(self) -> float:
        """By how much (%) the error of the second is above that of the first."""
        return 100.0 * (self.second.relative_error / self.first.relative_error - 1.0)


@dataclass(frozen=True)
class ResultComparison:
    """A result, the ``second``, beside a reference, the ``first``.

    ``base`` are the base parameters of the first that the second determines, too, those that differ most at the front;
    ``alone`` the names of its others. ``chi_squared`` and ``p_value`` are of all together, None where errors are not
    known together. ``level`` is that of both tests, ``tolerance`` (%) what the torque error may grow by.
    """

    first: ComparedResult
    second: ComparedResult
    base: tuple[BaseDifference, ...]
    alone: tuple[str, ...]
    chi_squared: float | None
    freedom: int
    p_value: float | None
    logs: tuple[LogDifference, ...]
    level: float
    tolerance: float

    __repr__ = brief

    @cached_property
    def significant(self) -> tuple[BaseDifference, ...]:
        """The base parameters that differ significantly, each for itself."""
        return tuple(one for one in self.base if one.p_value < self.level)

    @property
    def differs(self) -> bool:
        """Whether the parameters differ significantly: some of them, or all together."""
        return bool(self.significant) or (self.p_value is not None and self.p_value < self.level)

    @cached_property
    def judged(self) -> tuple[LogDifference, ...]:
        """The logs that tell which is better: of the same recording, held out where any is."""
        logs = [one for one in self.logs if one.same is not False]
        held = [one for one in logs if one.role == "validation"]
        return tuple(held or logs)

    @property
    def comparable(self) -> bool:
        """Whether there is a parameter, or an error on the same recording, to be compared."""
        return bool(self.base or self.judged)

    @property
    def worse_logs(self) -> tuple[LogDifference, ...]:
        """Those of them on which the second is worse."""
        return tuple(one for one in self.judged if one.growth > self.tolerance)

    @property
    def worse_use(self) -> bool:
        """Whether the second is good for less."""
        first, second = self.first.use, self.second.use
        return first is not None and second is not None and USES.index(second) < USES.index(first)

    @property
    def lost_exports(self) -> tuple[str, ...]:
        """Files that were proven with the first, and are not with the second."""
        proven = {one.file for one in self.second.exports if one.proven}
        return tuple(one.file for one in self.first.exports if one.proven and one.file not in proven)

    @property
    def worse(self) -> bool:
        """Whether the second is worse in anything."""
        return bool(self.worse_logs) or self.worse_use or bool(self.second.exports and self.lost_exports)

    @property
    def shared(self) -> tuple[str, ...]:
        """Training logs of the second that the first was fitted to as well: their errors are not independent."""
        known = {one.recording for one in self.first.logs if one.role == "train" and one.recording}
        return tuple(one.name for one in self.second.logs if one.role == "train" and one.recording in known)


def compare_results(
    first: ComparedResult, second: ComparedResult, level: float = 0.01, tolerance: float = 5.0
) -> ResultComparison:
    """Compare a result with a reference, the ``first``.

    With base parameters b = B x and covariances C of both, those of the first whose combinations the second determines
    are compared: d = B_1 x_2 - B_1 x_1 has the covariance C_1 + L C_2 L', where B_1 = L B_2. Each is tested by
    z = d / std(d), corrected for their number after Holm, all together by chi^2 = d' (C_1 + L C_2 L')^-1 d.

    The errors of results that were fitted to the same recordings are not independent: the difference is then smaller
    than tested, so that what is found significant is, and more may be.
    """
    rows, change = _common(first, second)
    own, others = first.combination[rows] @ first.value, change @ (second.combination @ second.value)
    sizes = (
        np.abs(first.combination[rows]) @ np.abs(first.value),
        np.abs(change @ second.combination) @ abs(second.value),
    )
    d = np.where(np.abs(others - own) > ROUNDING * (sizes[0] + sizes[1]), others - own, 0.0)
    one = first.covariance[np.ix_(rows, rows)]
    other = _moved(second.covariance, change)
    stds = [np.sqrt(np.diag(part).clip(min=0.0)) for part in (one, other)]
    whole = np.hypot(*stds)
    known = np.isfinite(whole)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(d == 0.0, 0.0, d / whole)
    p_value = _holm(2.0 * ndtr(-np.abs(z[known])))
    columns = np.column_stack([own, stds[0], others, stds[1], z])[known]
    rows_known = np.column_stack([columns, p_value]).tolist()
    named = [(first.base_names[k], first.base_units[k]) for k in rows[known]]
    base = [BaseDifference(*names, *row) for names, row in zip(named, rows_known, strict=True)]
    together = first.together and second.together and known.any()
    squared, freedom = _chi_squared(d[known], (one + other)[np.ix_(known, known)]) if together else (None, 0)
    compared = {name for name, _ in named}
    return ResultComparison(
        first,
        second,
        tuple(sorted(base, key=lambda row: -abs(row.z))),
        tuple(name for name in first.base_names if name not in compared),
        squared,
        freedom,
        None if squared is None else float(chdtrc(freedom, squared)),
        tuple(_logs(first, second)),
        level,
        tolerance,
    )


def _moved(covariance: Array, change: Array) -> Array:
    """Return L C L'; nan in the rows that are made of something whose error is not finite."""
    known = np.isfinite(np.diag(covariance))
    found = change[:, known] @ covariance[np.ix_(known, known)] @ change[:, known].T
    lost = np.any(np.abs(change[:, ~known]) > SHOWN, axis=1)
    found[lost, :] = found[:, lost] = np.nan
    return np.asarray(found)


def _common(first: ComparedResult, second: ComparedResult) -> tuple[NDArray[np.intp], Array]:
    """Return the base parameters of the first that the second determines, and how (k, r2) they are made of its own."""
    index = {name: k for k, name in enumerate(dict.fromkeys((*first.names, *second.names)))}
    mine, own = np.zeros((len(first.combination), len(index))), np.zeros((len(second.combination), len(index)))
    mine[:, [index[name] for name in first.names]] = first.combination
    own[:, [index[name] for name in second.names]] = second.combination
    scale = np.ones(len(index))
    for one in (second, first):
        scale[[index[name] for name in one.names]] = np.where(one.scale > 0, one.scale, 1.0)
    if not own.size or not mine.size:
        return np.zeros(0, dtype=np.intp), np.zeros((0, len(own)))
    mine, own = mine / scale, own / scale
    change = mine @ np.linalg.pinv(own)
    left = np.linalg.norm(mine - change @ own, axis=1)
    rows = np.flatnonzero(left <= SPAN * np.linalg.norm(mine, axis=1))
    return rows, change[rows]


def _holm(p_values: Array) -> Array:
    """Return p-values corrected for their number, step by step from the smallest."""
    order, count = np.argsort(p_values), len(p_values)
    corrected = np.empty(count)
    corrected[order] = np.maximum.accumulate(np.minimum(p_values[order] * (count - np.arange(count)), 1.0))
    return corrected


def _chi_squared(d: Array, covariance: Array) -> tuple[float, int]:
    """Return d' C^-1 d and its degrees of freedom, in the directions that have an error of their own."""
    size = np.sqrt(np.diag(covariance))
    size = np.where(size > 0, size, 1.0)
    roots, axes = np.linalg.eigh(covariance / np.outer(size, size))
    kept = roots > SHOWN * roots[-1]
    along = axes[:, kept].T @ (d / size)
    return float(np.sum(along**2 / roots[kept])), int(np.count_nonzero(kept))


def _logs(first: ComparedResult, second: ComparedResult) -> Sequence[LogDifference]:
    known: Mapping[tuple[str, str], ComparedLog] = {(one.name, one.role): one for one in first.logs}
    pairs = [(known[one.name, one.role], one) for one in second.logs if (one.name, one.role) in known]
    return [LogDifference(b.name, b.role, a.errors, b.errors, _same(a.recording, b.recording)) for a, b in pairs]


def _same(one: str, other: str) -> bool | None:
    return one == other if one and other else None
