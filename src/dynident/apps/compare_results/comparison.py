"""Comparison of two results of one robot: which parameters differ beyond their errors, and whether one is worse."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr

from dynident.regression import rank_of_information
from dynident.runtime import Noun, Use, brief
from dynident.runtime.arrays import Array
from dynident.validation import TorqueErrors

MAX_UNSPANNED_SHARE = 1e-4  # of a combination of parameters, in scaled units, that another's may leave of it
MIN_RELATIVE_DIFFERENCE = 1e-11  # of the sizes of all that is summed: a smaller difference is none
NEGLIGIBLE_SHARE = 1e-12  # a direction with less of the largest variance has no error of its own
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


class ComparedResult(Noun):
    """What a comparison needs of a result: parameters (p), determined base parameters (r), logs, use and exports.

    ``combination`` (r, p) maps parameters to base parameters, ``scale`` (p) are the sizes of the columns.
    ``covariance`` (r, r) is that of the base parameters; unless ``together``, only its diagonal is known.
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


@dataclass(frozen=True)
class BaseDifference:
    """The difference of a base parameter between two results, with its standard errors.

    ``z`` is the second value less the first, divided by the standard error of this difference. ``p_value`` is
    corrected for the number of parameters (Holm, 1979).
    """

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
    """A log of the same name and role in two results.

    ``is_same_recording`` is None where it is not known whether both are the same recording.
    """

    name: str
    role: str
    first: TorqueErrors
    second: TorqueErrors
    is_same_recording: bool | None

    __repr__ = brief

    @property
    def growth(self) -> float:
        """Relative growth (%) of the error from the first result to the second."""
        return 100.0 * (self.second.relative_error / self.first.relative_error - 1.0)


@dataclass(frozen=True)
class ResultComparison:
    """Comparison of a result, ``second``, with a reference, ``first``.

    ``base`` are the base parameters of the first that the second determines too, ordered by significance; ``alone`` are
    the names of its others. ``chi_squared`` and ``p_value`` test all of them together, None where a covariance is not
    known. ``level`` is that of both tests, ``tolerance`` (%) the accepted growth of the torque error.
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
        return tuple(difference for difference in self.base if difference.p_value < self.level)

    @property
    def differs(self) -> bool:
        """Whether the parameters differ significantly: some of them, or all together."""
        return bool(self.significant) or (self.p_value is not None and self.p_value < self.level)

    @cached_property
    def compared_logs(self) -> tuple[LogDifference, ...]:
        """The logs by which the results are compared: not known to be different recordings, held out if possible."""
        logs = [log for log in self.logs if log.is_same_recording is not False]
        held_out = [log for log in logs if log.role == "validation"]
        return tuple(held_out or logs)

    @property
    def comparable(self) -> bool:
        """Whether there is a parameter, or an error on the same recording, to be compared."""
        return bool(self.base or self.compared_logs)

    @property
    def worse_logs(self) -> tuple[LogDifference, ...]:
        """The compared logs on which the second result is worse."""
        return tuple(log for log in self.compared_logs if log.growth > self.tolerance)

    @property
    def worse_use(self) -> bool:
        """Whether the second result is good for less."""
        first_use, second_use = self.first.use, self.second.use
        return first_use is not None and second_use is not None and USES.index(second_use) < USES.index(first_use)

    @property
    def lost_exports(self) -> tuple[str, ...]:
        """Files that were proven with the first result and are not with the second."""
        proven = {export.file for export in self.second.exports if export.proven}
        return tuple(export.file for export in self.first.exports if export.proven and export.file not in proven)

    @property
    def worse(self) -> bool:
        """Whether the second is worse in anything."""
        return bool(self.worse_logs) or self.worse_use or bool(self.second.exports and self.lost_exports)

    @property
    def shared_training(self) -> tuple[str, ...]:
        """Training logs of the second that the first was fitted to as well: their errors are not independent."""
        recordings = {log.recording for log in self.first.logs if log.role == "train" and log.recording}
        return tuple(log.name for log in self.second.logs if log.role == "train" and log.recording in recordings)


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
    rows, change = _common_base_parameters(first, second)
    first_value, second_value = first.combination[rows] @ first.value, change @ (second.combination @ second.value)
    size = np.abs(first.combination[rows]) @ np.abs(first.value)
    size += np.abs(change @ second.combination) @ np.abs(second.value)
    # Differences at rounding level are exactly zero: their z would otherwise be noise over a tiny standard error.
    d = second_value - first_value
    d = np.where(np.abs(d) > MIN_RELATIVE_DIFFERENCE * size, d, 0.0)
    first_covariance = first.covariance[np.ix_(rows, rows)]
    second_covariance = _transform_covariance(second.covariance, change)
    stds = [np.sqrt(np.diag(part).clip(min=0.0)) for part in (first_covariance, second_covariance)]
    std = np.hypot(*stds)
    finite = np.isfinite(std)
    with np.errstate(divide="ignore", invalid="ignore"):
        z = np.where(d == 0.0, 0.0, d / std)
    p_value = _holm_correction(2.0 * ndtr(-np.abs(z[finite])))
    columns = np.column_stack([first_value, stds[0], second_value, stds[1], z])[finite]
    rows_known = np.column_stack([columns, p_value]).tolist()
    labels = [(first.base_names[k], first.base_units[k]) for k in rows[finite]]
    base = [BaseDifference(*names, *row) for names, row in zip(labels, rows_known, strict=True)]
    together = first.together and second.together and finite.any()
    covariance = (first_covariance + second_covariance)[np.ix_(finite, finite)]
    squared, freedom = _chi_squared(d[finite], covariance) if together else (None, 0)
    compared = {name for name, _ in labels}
    return ResultComparison(
        first,
        second,
        tuple(sorted(base, key=lambda row: -abs(row.z))),
        tuple(name for name in first.base_names if name not in compared),
        squared,
        freedom,
        None if squared is None else float(chdtrc(freedom, squared)),
        tuple(_log_differences(first, second)),
        level,
        tolerance,
    )


def _transform_covariance(covariance: Array, change: Array) -> Array:
    """Return L C L'; nan in the rows that depend on a value without a finite error."""
    finite = np.isfinite(np.diag(covariance))
    transformed = change[:, finite] @ covariance[np.ix_(finite, finite)] @ change[:, finite].T
    lost = np.any(np.abs(change[:, ~finite]) > NEGLIGIBLE_SHARE, axis=1)
    transformed[lost, :] = transformed[:, lost] = np.nan
    return np.asarray(transformed)


def _common_base_parameters(first: ComparedResult, second: ComparedResult) -> tuple[NDArray[np.intp], Array]:
    """Return the base parameters of the first that the second determines, and the map (k, r2) to them."""
    # Both combinations in the union of the parameter names; a result lacks columns for terms that it does not have.
    index = {name: k for k, name in enumerate(dict.fromkeys((*first.names, *second.names)))}
    scale, combinations = np.ones(len(index)), list[Array]()
    for result in (second, first):
        columns = [index[name] for name in result.names]
        scale[columns] = np.where(result.scale > 0, result.scale, 1.0)
        combinations.append(np.zeros((len(result.combination), len(index))))
        combinations[-1][:, columns] = result.combination
    second_rows, first_rows = combinations
    if not second_rows.size or not first_rows.size:
        return np.zeros(0, dtype=np.intp), np.zeros((0, len(second_rows)))
    # In scaled units the residual of the projection does not depend on the units of the parameters.
    first_rows, second_rows = first_rows / scale, second_rows / scale
    change = first_rows @ np.linalg.pinv(second_rows)
    residual_norm = np.linalg.norm(first_rows - change @ second_rows, axis=1)
    rows = np.flatnonzero(residual_norm <= MAX_UNSPANNED_SHARE * np.linalg.norm(first_rows, axis=1))
    return rows, change[rows]


def _holm_correction(p_values: Array) -> Array:
    """Return p-values corrected for their number, step by step from the smallest."""
    order, count = np.argsort(p_values), len(p_values)
    corrected = np.empty(count)
    # Step-down: the k-th smallest p-value is multiplied by the number of hypotheses left, and must not decrease.
    corrected[order] = np.maximum.accumulate(np.minimum(p_values[order] * (count - np.arange(count)), 1.0))
    return corrected


def _chi_squared(d: Array, covariance: Array) -> tuple[float, int]:
    """Return d' C^-1 d and its degrees of freedom, in the directions that have an error of their own."""
    rank = rank_of_information(covariance, tolerance=NEGLIGIBLE_SHARE)
    along = d @ (rank.determined_directions / rank.values[: rank.rank])
    return float(along @ along), rank.rank


def _log_differences(first: ComparedResult, second: ComparedResult) -> Sequence[LogDifference]:
    first_logs: Mapping[tuple[str, str], ComparedLog] = {(log.name, log.role): log for log in first.logs}
    pairs = [(first_logs[log.name, log.role], log) for log in second.logs if (log.name, log.role) in first_logs]
    return [
        LogDifference(
            b.name, b.role, a.errors, b.errors, a.recording == b.recording if a.recording and b.recording else None
        )
        for a, b in pairs
    ]
