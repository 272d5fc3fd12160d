"""Whether one combination predicts better than others by more than chance: a paired block bootstrap.

Errors of neighbouring samples are correlated, and all combinations are judged on the same samples. Therefore whole
blocks of time are resampled (circular block bootstrap; Politis and Romano, 1992), the same ones for all combinations;
their length follows from the correlation of the differences (Politis and White, 2004, corrected by Patton, Politis and
White, 2009). The best combination is chosen by the data, too: a combination is called worse only where it is worse than
any other by more than the maximum of all its differences is by chance (Hsu, 1981, "Simultaneous confidence intervals
for all distances from the best"). Those not called worse contain the truly best one with a probability of 95 %.

The error of a combination is the geometric mean over joints of their relative errors. Its logarithm is, up to a term
common to all, the negative log-likelihood of Gaussian residuals whose size is each joint's own: one percent less in any
joint counts the same, and neither units, gains nor the size of a joint's torque change the order. An arithmetic mean
would be dominated by the joints with hardly any torque, the error of all torques together by the strongest joint.

Few blocks understate the scatter: differences by chance are taken from Student's distribution instead of the
normal one, with N / 2 - 1 degrees of freedom for N blocks, as long blocks are not independent either, and
multiplied by sqrt(N / (N - 2)).
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, stdtrit

from dynident.files.opener import read_text, real_path
from dynident.files.xml_text import SUFFIXES
from dynident.files.yaml_text import load_yaml
from dynident.identification import Identifiability, Identification, StandardErrors, accuracy_bound
from dynident.models import RigidBodies
from dynident.motion.log import Log
from dynident.project.config import load_robot, nominal_values
from dynident.project.saved import result_values
from dynident.project.settings import RobotSettings
from dynident.regression import base_parameters
from dynident.runtime import ConfigError, ModelError, Noun, as_number, choices
from dynident.runtime.arrays import Array

MAX_BLOCKS = 400  # blocks of all logs together
DRAWS = 2000
SIGNIFICANCE_LEVEL = 0.05
MIN_BLOCKS = 12  # drawn blocks that the data must have: fewer do not show how they scatter
# combinations, of up to so many times the least error, that say how long a block must be
MAX_LEADING, MAX_LEADING_ERROR_RATIO = 10, 2.0
MIN_RELATIVE_ERROR = 1e-6  # relative error below which a joint counts as exact
MAX_QUIET_CORRELATION = 2.0  # times sqrt(log10 K / K): a smaller autocorrelation counts as none

MAX_UNKNOWN_SHARE = 1e-6  # share of a base parameter, in scaled columns, that an unknown parameter may have


class TimeBlocks(Noun):
    """K blocks of equal time: the number of the ``log`` (K) of each, and their length in ``seconds``.

    ``by_log`` has the block (N) of each sample by log.
    """

    log: NDArray[np.intp]
    seconds: float
    by_log: Mapping[str, NDArray[np.intp]]

    def __len__(self) -> int:
        return len(self.log)

    def sums(self, values: Mapping[str, Array]) -> Array:
        """Return the sums (K, n) of values (N, n) by log in each block; zero in blocks of logs that are not given."""
        n = next((log_values.shape[1] for log_values in values.values()), 0)
        totals = np.zeros((len(self), n))
        for name, log_values in values.items():
            for j in range(n):
                totals[:, j] += np.bincount(self.by_log[name], log_values[:, j], len(self))
        return totals


def time_blocks(logs: Mapping[str, Log]) -> TimeBlocks:
    """Return up to 400 blocks of equal time; none holds samples of two logs."""
    spans = {name: float(log.t[-1] - log.t[0]) for name, log in logs.items()}
    steps = [float(np.diff(log.t).mean()) for log in logs.values()]
    # blocks of equal time for all logs, of at least two samples
    seconds = max(sum(spans.values()) / MAX_BLOCKS, 2.0 * max(steps, default=1.0))
    block_numbers: dict[str, NDArray[np.intp]] = {}
    log_numbers: list[int] = []
    for k, (name, log) in enumerate(logs.items()):
        count = max(1, round(spans[name] / seconds))
        share = (log.t - log.t[0]) / max(spans[name], seconds * 1e-9)
        block_numbers[name] = len(log_numbers) + np.minimum((share * count).astype(np.intp), count - 1)
        log_numbers += [k] * count
    return TimeBlocks(np.array(log_numbers, dtype=np.intp), seconds, block_numbers)


class Differences(Noun):
    """Errors of R combinations: the ``error`` (R) in % (geometric mean over joints), and how far they differ.

    ``interval`` (R, 2) are the ends of the 95 % interval of the difference to the best (percentage points), ``p_value``
    (R) is that of being as good as any other. ``length`` is the number of blocks that are drawn together,
    ``drawn_blocks`` how many such there are in the data. With fewer than 12 of them interval and p-value are nan.
    """

    error: Array
    interval: Array
    p_value: Array
    length: int
    drawn_blocks: float

    @property
    def has_enough_blocks(self) -> bool:
        """Whether there are enough blocks to tell differences from chance."""
        return self.drawn_blocks >= MIN_BLOCKS


def joint_errors(squares: Array, torque: Array) -> Array:
    """Return relative errors (..., n) in % from sums of squares (..., n) of residual and torque; nan without torque."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(torque > 0, 100.0 * np.sqrt(squares / torque), np.nan))


def mean_error(squares: Array, torque: Array) -> Array:
    """Return the geometric mean (...) of the relative errors (%) of the joints that have a torque.

    A relative error below 1e-6 counts as 1e-6: rounding should not decide between exact fits.
    """
    has_torque = np.broadcast_to(torque > 0, np.shape(squares))
    with np.errstate(divide="ignore", invalid="ignore"):
        logs = np.log(np.maximum(joint_errors(squares, torque), 100.0 * MIN_RELATIVE_ERROR))
        return np.asarray(np.exp(np.where(has_torque, logs, 0.0).sum(axis=-1) / has_torque.sum(axis=-1)))


def differences(
    squares: Array, torque: Array, log: Sequence[int] | NDArray[np.intp], rng: np.random.Generator
) -> Differences:
    """Return the differences of R combinations.

    ``squares`` (R, K, n) are the sums of squares of the residual in K blocks of time, those of the ``torque`` (K,
    n) the same for all; ``log`` (K) is the recording of each block.
    """
    error = mean_error(squares.sum(axis=1), torque.sum(axis=0))
    best, log_numbers = int(np.argmin(error)), np.asarray(log)
    length = _required_block_length(squares, torque, error, best)
    counts = np.unique(log_numbers, return_counts=True)[1]
    drawn_blocks = float(np.sum(counts / np.minimum(length, counts)))
    untested = Differences(error, np.full((len(error), 2), np.nan), np.full(len(error), np.nan), length, drawn_blocks)
    if not untested.has_enough_blocks:
        return untested
    drawn_errors = _draw_errors(squares, torque, log_numbers, length, rng)
    # widen the interval of the resampled differences about the estimate, as few blocks understate it
    normal, difference = ndtri(1 - SIGNIFICANCE_LEVEL / 2), (error - error[best])[:, None]
    factor = float(_student_quantiles(normal, drawn_blocks) / normal)
    levels = [SIGNIFICANCE_LEVEL / 2, 1 - SIGNIFICANCE_LEVEL / 2]
    ends = np.quantile(drawn_errors - drawn_errors[:, [best]], levels, axis=0).T
    p_values = _best_p_values(np.log(error), np.log(drawn_errors), drawn_blocks)
    return replace(untested, interval=difference + factor * (ends - difference), p_value=p_values)


def _required_block_length(squares: Array, torque: Array, error: Array, best: int) -> int:
    """Return how many blocks must be drawn together: the largest number that a leading combination requires."""
    # weigh joints as in the logarithm of the mean error of the best combination
    size = np.maximum(squares[best].sum(axis=0), MIN_RELATIVE_ERROR**2 * torque.sum(axis=0))
    has_torque = torque.sum(axis=0) > 0
    shares = squares[:, :, has_torque] / size[has_torque]
    order = np.argsort(error, kind="stable")[: MAX_LEADING + 1]
    leading = [k for k in order if k != best and error[k] <= MAX_LEADING_ERROR_RATIO * error[best]]
    return max((_block_length((shares[k] - shares[best]).sum(axis=1)) for k in leading), default=1)


def _block_length(series: Array) -> int:
    """Return the block length for a series (K) after Politis and White (2004), with the flat-top lag window."""
    count, x = len(series), series - series.mean()
    power = float(x @ x)
    if count < 8 or power <= 0:
        return 1
    lags = min(count - 1, int(np.ceil(np.sqrt(count))) + max(5, int(np.sqrt(np.log10(count)))))
    R = np.array([x[: count - k] @ x[k:] for k in range(lags + 1)]) / count
    # the correlation has ended where several lags in a row are insignificant; twice that lag is the window
    quiet = np.abs(R[1:]) < MAX_QUIET_CORRELATION * np.sqrt(np.log10(count) / count) * R[0]
    run = max(5, int(np.sqrt(np.log10(count))))
    last = next((k for k in range(len(quiet) - run + 1) if quiet[k : k + run].all()), len(quiet))
    reach = min(2 * max(last, 1), lags)
    k = np.arange(-reach, reach + 1)
    window = np.clip(2.0 * (1.0 - np.abs(k) / reach), 0.0, 1.0)
    windowed = window * R[np.abs(k)]
    spectrum, slope = windowed.sum(), (np.abs(k) * windowed).sum()
    if spectrum <= 0:
        return 1
    # the length with the least mean squared error of the variance, for the circular bootstrap
    length = (2.0 * slope**2 / (4.0 / 3.0 * spectrum**2)) ** (1 / 3) * count ** (1 / 3)
    return int(np.clip(np.ceil(length), 1, np.ceil(min(3 * np.sqrt(count), count / 3))))


def _draw_errors(
    squares: Array, torque: Array, log_numbers: NDArray[np.intp], length: int, rng: np.random.Generator
) -> Array:
    """Return the errors (D, R) of resampled recordings, with as many blocks from each log as it has."""
    counts = np.zeros((DRAWS, len(log_numbers)))
    for log in np.unique(log_numbers):
        places = np.flatnonzero(log_numbers == log)
        block = min(length, len(places))
        # blocks begin anywhere and wrap around the end of the log, so that all parts are drawn equally often
        starts = rng.integers(len(places), size=(DRAWS, -(-len(places) // block)))
        picks = (starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[:, : len(places)] % len(places)
        rows = np.repeat(np.arange(DRAWS), len(places))
        np.add.at(counts, (rows, places[picks.ravel()]), 1.0)
    # the same drawn blocks for all combinations: the comparison is paired
    drawn_torque = counts @ torque
    R, K, n = squares.shape
    drawn_squares = (counts @ squares.transpose(1, 0, 2).reshape(K, R * n)).reshape(DRAWS, R, n)
    return mean_error(drawn_squares, drawn_torque[:, None, :])


def _student_quantiles(normal: Array | float, blocks: float) -> Array:
    """Return the values of Student's distribution with the same tail probability as normal values."""
    tail = np.asarray(stdtrit(blocks / 2 - 1, np.minimum(ndtr(normal), 1 - 1e-12)))
    return np.asarray(tail * np.sqrt(blocks / (blocks - 2)))


def _best_p_values(error: Array, drawn_errors: Array, blocks: float) -> Array:
    """Return for each combination the p-value of being as good as any other.

    That is how likely chance makes it as much worse than some other as it is, from the logarithms of the errors
    (R) and of those of drawn blocks (D, R).
    """
    p_values = np.ones(len(error))
    for k in range(len(error)):
        difference, drawn_difference = error[k] - error, drawn_errors[:, [k]] - drawn_errors
        std = drawn_difference.std(axis=0, ddof=1)
        is_comparable = (std > 1e-9) & (np.arange(len(error)) != k)
        # the largest of all standardised differences is compared, so that the level holds for all of them together
        if is_comparable.any():
            scatter = (drawn_difference - difference)[:, is_comparable] / std[is_comparable]
            by_chance = _student_quantiles(scatter.max(axis=1), blocks)
            largest = (difference[is_comparable] / std[is_comparable]).max()
            p_values[k] = (1 + np.sum(by_chance >= largest)) / (1 + len(by_chance))
    return p_values


class TrueParameters(Noun):
    """True base parameters ``value`` (r), nan where not known, with their ``names`` and ``units``.

    ``combination`` (r, p) maps the parameters of the model to them; ``bound`` (r) are the least standard
    deviations that any unbiased method can reach with these logs.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    combination: Array
    value: Array
    bound: Array

    def base(self, value: Array) -> Array:
        """Return the base parameters (r) of parameters (p)."""
        return self.combination @ value

    def std(self, errors: StandardErrors, base: Identifiability) -> Array:
        """Return the standard errors (r) of an estimate for these base parameters, nan for those that it does not
        have."""
        basis = base.on_data
        if basis is None and len(errors.std) == len(self.names):
            return errors.std
        # another fit may group its base parameters differently: match them by name
        std_by_name: dict[str, float] = {}
        if basis is not None and errors.base_std is not None:
            std_by_name = dict(zip(basis.groupings, errors.base_std.tolist(), strict=True))
        return np.array([std_by_name.get(name, np.nan) for name in self.names])


def read_truth(source: str | Path | Mapping[str, float], folder: Path, spec: str | RobotSettings) -> dict[str, float]:
    """Return true values by the names of parameters, from a mapping or a file in the ``folder``.

    The file is YAML of values by name, the ``parameters.yaml`` or ``result.json`` of an identification, or a robot file
    with the true values, read with the settings of the model, in which zeros are no truth of friction, rotor inertia
    and offset. Raises ConfigError and InputError for any other.
    """
    if isinstance(source, Mapping):
        return {str(name): float(value) for name, value in source.items()}
    path = real_path(folder / source)
    if path.suffix.lower() in SUFFIXES:
        return _values_of_robot(path, spec)
    if path.suffix.lower() == ".json":
        return _values_of_rows(result_values(path).get("parameters"), path)
    data = load_yaml(read_text(path, ConfigError, (".yaml", ".yml")), str(path))
    if isinstance(data, dict) and isinstance(data.get("parameters"), list):
        return _values_of_rows(data["parameters"], path)
    if not isinstance(data, dict) or not all(np.isfinite(as_number(value)) for value in data.values()):
        raise ConfigError(f"{path}: is no list of true values; write lines such as `Fv_elbow: 6.0`.")
    return {str(name): float(value) for name, value in data.items()}


def _values_of_rows(rows: Any, path: Path) -> dict[str, float]:
    entries = rows if isinstance(rows, list) else [None]
    if not all(isinstance(row, dict) and np.isfinite(as_number(row.get("value"))) for row in entries):
        raise ConfigError(f"{path}: its `parameters` are no list of names with values.")
    return {str(row.get("name")): float(row["value"]) for row in rows}


def _values_of_robot(path: Path, spec: str | RobotSettings) -> dict[str, float]:
    if not isinstance(spec, RobotSettings):
        raise ConfigError(f"truth: {path} is a robot file, and the model is none; give values by name.")
    model = load_robot(spec.model_copy(update={"file": {str(path): path}}))
    values = dict(zip(model.names, nominal_values(model).tolist(), strict=True))
    for term in (term for term in model.terms if isinstance(term, RigidBodies)):
        for prefix, by_joint in (("Fv", term.damping), ("Fc", term.friction), ("Ia", term.armature)):
            values |= {f"{prefix}_{joint}": float(value) for joint, value in by_joint.items()}
    # zeros of friction, rotors and offsets are what a file writes, or leaves out, where nobody knows them
    bodies = {parameter.name for parameter in model.parameters if parameter.body}
    return {name: value for name, value in values.items() if value or name in bodies}


def compute_truth(
    values: Mapping[str, float], identification: Identification, logs: Mapping[str, Log]
) -> TrueParameters:
    """Return the true base parameters of an identification, and the accuracy bound at its parameters.

    Raises ConfigError where no value is of a parameter of the model, and the errors of ``accuracy_bound``.
    """
    names = identification.estimate.names
    if not set(values) & set(names):
        first_name = next(iter(values), "")
        raise ConfigError(f"truth: none of its values is of a parameter of the model; {choices(first_name, names)}")
    directions = identification.estimate.determined.directions
    if directions is None:
        raise ModelError("truth: the first fit does not say what the data determine.")
    basis = base_parameters(directions, identification.estimate.parameters)
    is_known = np.array([name in values for name in names])
    # a base parameter is known where all parameters that count in it are: compare them in scaled columns
    share = np.abs(basis.combination) * basis.scale[list(basis.independent), None] / basis.scale
    is_unknown = (share > MAX_UNKNOWN_SHARE)[:, ~is_known].any(axis=1)
    # values that are not known enter as zero; the base parameters that they matter to are set to nan
    value = basis.to_base(np.array([values.get(name, 0.0) for name in names]))
    bound = accuracy_bound(identification.model, logs, replace(identification.recipe, restart=None))
    bound_by_name = dict(zip(bound.names, bound.std["now"].tolist(), strict=True))
    units = tuple(identification.estimate.units[k] for k in basis.independent)
    bounds = np.array([bound_by_name.get(name, np.nan) for name in basis.groupings])
    return TrueParameters(basis.groupings, units, basis.combination, np.where(is_unknown, np.nan, value), bounds)


def truth_text(truth: TrueParameters | None) -> str:
    """Return a text that identifies the true parameters, for digests."""
    if truth is None:
        return ""
    return json.dumps([truth.names, np.round(truth.value, 12).tolist(), truth.combination.tolist()])
