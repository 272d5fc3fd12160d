"""One log of a fleet: what a worker does with it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident._version import __version__
from dynident.apps.fleets.components import History
from dynident.apps.fleets.config import FleetLog
from dynident.apps.fleets.recipe import FleetRecipe
from dynident.estimators.least_squares import joint_weights, solve_least_squares, weight_joints
from dynident.files.opener import is_address, local_file, real_path, watch_inputs
from dynident.identification import Identification, SourceFile, has_gravity, judge, tilt_base
from dynident.models import Model
from dynident.project.explicit_config import relocate_settings, settings_text
from dynident.project.project import Project, parse_project
from dynident.project.settings import LogSpec
from dynident.regression import BaseParameters, Regression, base_parameters, structural_base_parameters
from dynident.runtime import DynidentError, InputError, ModelError, Noun, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import Status
from dynident.validation import robust_covariance

if TYPE_CHECKING:
    from datetime import datetime

    import polars as pl

ITERATIONS = 3  # of the weights of the joints
KEY = ("robot", "log", "recipe", "stamp")
DAY = 86_400.0  # s

CONFIG = "config.yaml"
NO_TILT, ANY_TILT = (0.0, 0.0), (0.3, 0.2)  # rad; no axis of a robot is likely to be parallel to this
COMPRESSION_LEVEL = 1  # of the levels of zlib: a report holds megabytes


def information_of(identification: Identification, basis: BaseParameters) -> tuple[Array, Array, Array]:
    """Return what the training logs of an identification alone tell: base parameters (b), information (b, b),
    residual.

    The base parameters are by least squares; the information on them is the inverse of their covariance, zero in
    directions that the logs do not show. The residual (n) is the root mean square of the torque (N m, N) that
    these parameters leave of each joint, with their degrees of freedom; nan where no row of a joint is in use.

    Nothing else than the logs counts: no prior, no constraint; joints are weighted by their residuals. With R the
    triangular factor of the columns in use, R = U S V', the errors of S V' beta are independent where residuals
    are white; their variances v, at least 1, are those of correlated residuals (``robust_covariance``), and the
    information is V S diag(1 / v) S V'. Raises ModelError where the motion shows too little to tell.
    """
    model, recipe = identification.model, identification.recipe
    motions = tuple(validation.motion for validation in identification.validations if validation.role == "train")
    residual = identification.estimate.residual
    unweighted = Regression(model, motions, recipe.selection(model.joints))
    regression = residual.weight_rows(unweighted)
    triangular, parameters = regression.triangular_factors, model.parameters
    # least squares on these logs alone, with the joints weighted by their residuals
    weights = joint_weights(triangular, "per_joint", ITERATIONS, parameters)
    value = solve_least_squares(*weight_joints(triangular, weights, parameters)).value
    shown_base = base_parameters(triangular.stack(weights), parameters)
    columns = list(shown_base.independent)
    covariance = robust_covariance(regression, value, weights, columns, residual.slopes)
    factor = np.linalg.qr(triangular.stack(weights)[:, columns], mode="r")
    # columns of unit norm, so that the axes do not depend on units
    scale = np.linalg.norm(factor, axis=0)
    _, size, axes = np.linalg.svd(factor / scale)
    to_axes = size[:, None] * axes * scale
    # a variance below one would claim more than white residuals tell
    variance = np.maximum(np.einsum("ij,jk,ik->i", to_axes, covariance, to_axes), 1.0)
    whitened = (to_axes / np.sqrt(variance)[:, None]) @ shown_base.combination[:, list(basis.independent)]
    # the residual is that of the torque itself, before rows were whitened
    plain = triangular if residual.whitening is None else unweighted.triangular_factors
    # the rank is spread over all rows
    share = max(1 - len(columns) / plain.total, 0.0)
    rows = np.where((plain.rows > 0) & (share > 0), share * plain.rows, np.nan)
    return basis.to_base(value), whitened.T @ whitened, np.sqrt(plain.residual(value) / rows)


def schema() -> dict[str, Any]:
    """Return the columns of the table, and their types.

    ``robot``, ``type``, ``log`` (its path or address as the fleet names it), ``date``; ``recipe``: digest of the
    recipe of that robot; ``stamp`` of the file, another one where it has changed; ``status`` (a ``Status`` of
    jobs), ``reason`` why there is no result; ``seconds`` it took, ``version`` of dynident; ``samples`` in use,
    ``verdict`` (a ``Use``; null where no log was held out); torque ``error`` (%) of all joints, ``errors`` (n) by
    joint, ``held_out`` (n) those on a log that was held out, empty without; ``value`` (b) and ``information`` (b
    (b + 1) / 2, by ``pack_triangle``) of the base parameters, and the ``residual`` (n) that they leave of the
    torque of each joint (N m, N; nan where the log does not tell it); ``folder`` of the run's result and report
    in that of the fleet, empty without.
    """
    import polars as pl

    floats = pl.List(pl.Float64)
    return {
        "robot": pl.String, "type": pl.String, "log": pl.String, "date": pl.Datetime("us"), "recipe": pl.String,
        "stamp": pl.String, "status": pl.String, "reason": pl.String, "seconds": pl.Float64,
        "version": pl.String, "samples": pl.Int64, "verdict": pl.String, "error": pl.Float64, "errors": floats,
        "held_out": floats, "value": floats, "information": floats, "residual": floats, "folder": pl.String,
    }  # fmt: skip


def pack_triangle(matrix: Array) -> list[float]:
    """Return the lower triangle of a symmetric matrix (b, b), row by row: b (b + 1) / 2 numbers."""
    return list(map(float, matrix[np.tril_indices(len(matrix))]))


def unpack_triangle(numbers: Array, size: int) -> Array:
    """Return the symmetric matrices (..., b, b) of packed triangles (..., b (b + 1) / 2)."""
    rows, columns = np.tril_indices(size)
    out = np.zeros((*np.shape(numbers)[:-1], size, size))
    out[..., rows, columns] = out[..., columns, rows] = numbers
    return out


def histories_of(rows: pl.DataFrame, start: datetime | None) -> Iterator[tuple[History, History]]:
    """Yield the history of each robot that has a result, from the table of one recipe; days count from ``start``.

    Beside it is what the model leaves of its torque: value (K, n) is the logarithm of residuals. Its information is
    that of white residuals, twice the samples; what more it scatters is found from the fleet.
    """
    import polars as pl

    good = rows.filter(pl.col("status") == Status.OK).sort("robot", "date", "log")
    for (robot,), logs in good.group_by("robot", maintain_order=True):
        value, triangles, residual = (
            np.array(logs[name].to_list(), dtype=float) for name in ("value", "information", "residual")
        )
        days = np.array([(date - start).total_seconds() / DAY for date in logs["date"]])
        is_valid = np.isfinite(residual) & (residual > 0)
        # the logarithm of the root mean square of N white samples has the variance 1 / (2 N)
        precision = 2.0 * logs["samples"].to_numpy()[:, None] * is_valid
        names = str(robot), tuple(logs["log"])
        yield (
            History(*names, days, value, unpack_triangle(triangles, value.shape[1])),
            History(
                *names,
                days,
                np.log(np.where(is_valid, residual, 1.0)),
                precision[:, :, None] * np.eye(residual.shape[1]),
            ),
        )


@dataclass(frozen=True)
class LogJob:
    """A log to identify: the digest of its ``recipe``, and the ``folder`` of the run in that of the fleet."""

    log: FleetLog
    recipe: str
    folder: str

    @property
    def key(self) -> tuple[str, str, str, str]:
        """The key of its row."""
        return self.log.robot, self.log.log, self.recipe, self.log.stamp


class LogResult(Noun):
    """The row of a log, and the ``files`` of its run by name, compressed by zlib."""

    row: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)


def empty_row(job: LogJob, status: Status = Status.FAILED, reason: str = "", seconds: float = 0.0) -> dict[str, Any]:
    """Return the row of a log without a result."""
    log = job.log
    key = dict(zip(KEY, job.key, strict=True))
    lists: dict[str, list[float]] = {name: [] for name in ("errors", "held_out", "value", "information", "residual")}
    outcome = {"status": status.value, "reason": reason, "seconds": seconds, "version": __version__, "folder": ""}
    return dict.fromkeys(schema()) | {**key, "type": log.type, "date": log.date, **outcome, **lists}


class LogIdentifier(Noun):
    """Identifies logs with the recipe of a fleet, whose configuration is in ``folder``.

    ``names`` are those of the base parameters, which all robots must have. ``files`` gives the texts of a run's files
    by name, None where none are kept.
    """

    recipe: FleetRecipe
    folder: Path
    names: tuple[str, ...]
    files: Callable[[Identification], Mapping[str, str]] | None = None

    def __call__(self, job: LogJob) -> LogResult:
        """Return the row of a log; an error that a user can cause is its reason."""
        with watch_inputs():
            try:
                return self._fit_log(job)
            except DynidentError as error:
                return LogResult(empty_row(job, reason=str(error)))

    def _fit_log(self, job: LogJob) -> LogResult:
        if job.log.fault:
            raise InputError(job.log.fault)
        project, basis = _robot_project(self.recipe, job.log.robot, job.recipe)
        # base parameters can only be compared where all robots have the same
        if basis.leading != self.names:
            differing_names = join_names(sorted(set(basis.leading) ^ set(self.names)))
            raise ModelError(
                f"robot {job.log.robot}: its model has not the base parameters of the recipe: {differing_names}."
            )
        identification = self._identify_log(job, project)
        value, information, residual = information_of(identification, basis)
        row = empty_row(job, Status.OK) | _quality_columns(identification)
        row |= {"value": value.tolist(), "information": pack_triangle(information), "residual": residual.tolist()}
        files = self._files(identification)
        return LogResult(row | {"folder": job.folder if files else ""}, files)

    def _identify_log(self, job: LogJob, project: Project) -> Identification:
        """Return what is found of a log, with a configuration for its folder."""
        log = job.log
        names = {role: name for role, name in (("train", log.log), ("validation", log.hold_out)) if name}
        place = self.recipe.folder / job.folder / CONFIG
        # the configuration in the result names files relative to its own folder, so that it can be run again
        specs = {
            role: [self.recipe.spec(name, name if is_address(name) else str(real_path(self.folder / name)))]
            for role, name in names.items()
        }
        text = settings_text(relocate_settings(self.recipe.of(log.robot) | specs, self.recipe.folder, place.parent), {})
        source = SourceFile(str(real_path(place)), sha256(text.encode()).hexdigest(), text)
        sources = replace(project.sources, configuration=source)
        # logs with an address are read from local copies
        with ExitStack() as stack:
            files = {
                role: real_path(stack.enter_context(local_file(name, self.folder))) for role, name in names.items()
            }
            read = {role: (LogSpec.model_validate(self.recipe.spec(names[role], str(file))),)
                    for role, file in files.items()}  # fmt: skip
            config = project.config.model_copy(update={"validation": (), **read})
            identification = replace(project, config=config, sources=sources).identify()
        # the result names the addresses instead of the temporary copies
        fetched = {str(files[role]): name for role, name in names.items() if is_address(name)}
        provenance = identification.provenance
        logs = tuple(replace(file, path=fetched.get(file.path, file.path)) for file in provenance.logs)
        return replace(identification, provenance=replace(provenance, logs=logs))

    def _files(self, identification: Identification) -> dict[str, bytes]:
        """Return the files of a run, with the configuration that repeats it."""
        source = identification.provenance.configuration
        if self.files is None or source is None:
            return {}
        files = {**self.files(identification), CONFIG: source.text}
        encoded = {name: text.encode("utf-8", "backslashreplace") for name, text in files.items()}
        return {name: zlib.compress(data, COMPRESSION_LEVEL) for name, data in encoded.items()}


def model_of(recipe: FleetRecipe) -> tuple[Model, BaseParameters]:
    """Return the model of a recipe, and its base parameters; raises ConfigError and ModelError."""
    project, basis = _robot_project(recipe, "", recipe.digest(""))
    return project.model, basis


def _robot_project(recipe: FleetRecipe, robot: str, digest: str) -> tuple[Project, BaseParameters]:
    """Return the project of a robot, whose logs are still to be named, and the base parameters of its model."""
    settings = recipe.of(robot) | {"train": [{"file": "-"}], "validation": []}
    source = f"the recipe of {robot}" if robot else "the recipe"
    # the base parameters are those of a level base only where every robot has one
    is_level = (
        len({_gravity_and_tilt(recipe, name) for name in ("", *recipe.changes)}) == 1
        and _gravity_and_tilt(recipe, "")[1] == NO_TILT
    )
    return _parse_recipe(settings_text(settings, {}), recipe.folder / CONFIG, source, digest, is_level)


def _gravity_and_tilt(recipe: FleetRecipe, robot: str) -> tuple[str, tuple[float, float]]:
    """Return what says how gravity acts on the base of a robot: its vector, and the tilt (rad)."""
    model = recipe.of(robot).get("model")
    model = model if isinstance(model, Mapping) else {}
    tilt = model.get("base_tilt")
    tilt = tilt if isinstance(tilt, Sequence) and not isinstance(tilt, str) else NO_TILT
    return str(model.get("gravity")), (tilt[0], tilt[1])


@lru_cache(maxsize=16)
def _parse_recipe(text: str, path: Path, source: str, digest: str, is_level: bool) -> tuple[Project, BaseParameters]:  # noqa: ARG001
    """Return the project of a recipe's text and its base parameters, cached; the digest tells files of one name
    apart.

    Unless ``is_level``, which says that all robots are, the base parameters are those of any direction of
    gravity: a tilt shows more.
    """
    project = parse_project(text, path, source)
    model = project.model if is_level or not has_gravity(project.model) else tilt_base(project.model, *ANY_TILT)
    return project, structural_base_parameters(model)


def _quality_columns(identification: Identification) -> dict[str, Any]:
    """Return the columns of a row that say how good a result is."""
    # of several pieces, those of the first
    validations = identification.validations
    errors = {validation.role: validation.errors for validation in reversed(validations)}
    held_out = errors.get("validation")
    return {
        "samples": sum(validation.errors.samples for validation in validations if validation.role == "train"),
        "verdict": None if held_out is None else judge(identification).use.value,  # without, none is good for anything
        "error": errors["train"].relative_error,
        "errors": list(errors["train"].per_joint.values()),
        "held_out": [] if held_out is None else list(held_out.per_joint.values()),
    }
