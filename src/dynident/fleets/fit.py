"""One log of a fleet: what a worker does with it."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import lru_cache
from hashlib import sha256
from pathlib import Path
from typing import Any

from dynident import __version__
from dynident.errors import DynidentError, InputError, ModelError, brief, listed
from dynident.fleets.information import information_of
from dynident.fleets.listing import FleetLog
from dynident.fleets.recipe import FleetRecipe
from dynident.fleets.rows import packed
from dynident.identification import Identification, SourceFile, has_gravity, judge, mounted
from dynident.io.explicit_config import relocated, settings_text
from dynident.io.opener import real, watched
from dynident.io.places import is_address, local_file
from dynident.io.project import Project, parse_project
from dynident.io.settings import LogSpec
from dynident.jobs import Status
from dynident.models import Model
from dynident.regression import BaseParameters, structural_base_parameters

__all__ = ["Fitted", "LogFit", "LogJob", "empty_row", "model_of"]

CONFIG = "config.yaml"
LEVEL, ANY_TILT = (0.0, 0.0), (0.3, 0.2)  # rad; no axis of a robot is likely to be parallel to this
FAST = 1  # of the levels of zlib: a report holds megabytes


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


@dataclass(frozen=True, eq=False)
class Fitted:
    """The row of a log, and the ``files`` of its run by name, compressed by zlib."""

    row: Mapping[str, Any]
    files: Mapping[str, bytes] = field(default_factory=dict)

    __repr__ = brief


def empty_row(job: LogJob, status: Status = Status.FAILED, reason: str = "", seconds: float = 0.0) -> dict[str, Any]:
    """Return the row of a log without a result."""
    log = job.log
    key = {"robot": log.robot, "log": log.log, "recipe": job.recipe, "stamp": log.stamp}
    lists: dict[str, list[float]] = {name: [] for name in ("errors", "held_out", "value", "information", "residual")}
    found = {"status": status.value, "reason": reason, "seconds": seconds, "version": __version__}
    none = {"samples": None, "verdict": None, "error": None, "folder": ""}
    return {**key, "type": log.type, "date": log.date, **found, **none, **lists}


@dataclass(frozen=True, eq=False)
class LogFit:
    """Identifies logs with the recipe of a fleet, whose configuration is in ``folder``.

    ``names`` are those of the base parameters, which all robots must have. ``files`` gives the texts of a run's files
    by name, None where none are kept.
    """

    recipe: FleetRecipe
    folder: Path
    names: tuple[str, ...]
    files: Callable[[Identification], Mapping[str, str]] | None = None

    __repr__ = brief

    def __call__(self, job: LogJob) -> Fitted:
        """Return the row of a log; an error that a user can cause is its reason."""
        with watched():
            try:
                return self._fitted(job)
            except DynidentError as error:
                return Fitted(empty_row(job, reason=str(error)))

    def _fitted(self, job: LogJob) -> Fitted:
        if job.log.fault:
            raise InputError(job.log.fault)
        project, basis = _built(self.recipe, job.log.robot, job.recipe)
        if basis.leading != self.names:
            other = listed(sorted(set(basis.leading) ^ set(self.names)))
            raise ModelError(f"robot {job.log.robot}: its model has not the base parameters of the recipe: {other}.")
        found = self._identified(job, project)
        value, information, residual = information_of(found, basis)
        row = empty_row(job, Status.OK) | _figures(found)
        row |= {"value": value.tolist(), "information": packed(information), "residual": residual.tolist()}
        files = self._files(found)
        return Fitted(row | {"folder": job.folder if files else ""}, files)

    def _identified(self, job: LogJob, project: Project) -> Identification:
        """Return what is found of a log, with a configuration for its folder."""
        log = job.log
        names = {role: name for role, name in (("train", log.log), ("validation", log.hold_out)) if name}
        place = self.recipe.folder / job.folder / CONFIG
        specs = {role: [self.recipe.spec(name, _path(name, self.folder))] for role, name in names.items()}
        text = settings_text(relocated(self.recipe.of(log.robot) | specs, self.recipe.folder, place.parent), {})
        sources = replace(
            project.sources, configuration=SourceFile(str(real(place)), sha256(text.encode()).hexdigest(), text)
        )
        with ExitStack() as stack:
            files = {role: real(stack.enter_context(local_file(name, self.folder))) for role, name in names.items()}
            read = {role: (LogSpec.model_validate(self.recipe.spec(names[role], str(file))),)
                    for role, file in files.items()}  # fmt: skip
            config = project.config.model_copy(update={"validation": (), **read})
            found = replace(project, config=config, sources=sources).identify()
        fetched = {str(files[role]): name for role, name in names.items() if is_address(name)}
        logs = tuple(replace(one, path=fetched.get(one.path, one.path)) for one in found.provenance.logs)
        return replace(found, provenance=replace(found.provenance, logs=logs))

    def _files(self, found: Identification) -> dict[str, bytes]:
        """Return the files of a run, with the configuration that repeats it."""
        source = found.provenance.configuration
        if self.files is None or source is None:
            return {}
        files = {**self.files(found), CONFIG: source.text}
        return {name: zlib.compress(text.encode("utf-8", "backslashreplace"), FAST) for name, text in files.items()}


def model_of(recipe: FleetRecipe) -> tuple[Model, BaseParameters]:
    """Return the model of a recipe, and its base parameters; raises ConfigError and ModelError."""
    project, basis = _built(recipe, "", recipe.digest(""))
    return project.model, basis


def _built(recipe: FleetRecipe, robot: str, digest: str) -> tuple[Project, BaseParameters]:
    """Return the project of a robot, whose logs are still to be named, and the base parameters of its model."""
    settings = recipe.of(robot) | {"train": [{"file": "-"}], "validation": []}
    source = f"the recipe of {robot}" if robot else "the recipe"
    level = len({_gravity(recipe, one) for one in ("", *recipe.changes)}) == 1 and _gravity(recipe, "")[1] == LEVEL
    return _known(settings_text(settings, {}), recipe.folder / CONFIG, source, digest, level)


def _gravity(recipe: FleetRecipe, robot: str) -> tuple[str, tuple[float, float]]:
    """Return what says how gravity acts on the base of a robot: its vector, and the tilt (rad)."""
    model = recipe.of(robot).get("model")
    model = model if isinstance(model, Mapping) else {}
    tilt = model.get("base_tilt")
    return str(model.get("gravity")), (tilt[0], tilt[1]) if isinstance(tilt, Sequence) and not isinstance(
        tilt, str
    ) else LEVEL


@lru_cache(maxsize=16)
def _known(text: str, path: Path, source: str, digest: str, level: bool) -> tuple[Project, BaseParameters]:  # noqa: ARG001
    """Return the same; the digest tells files of one name apart.

    Unless all robots are ``level``, the base parameters are those of any direction of gravity: a tilt shows more.
    """
    project = parse_project(text, path, source)
    model = project.model if level or not has_gravity(project.model) else mounted(project.model, *ANY_TILT)
    return project, structural_base_parameters(model)


def _path(name: str, folder: Path) -> str:
    return name if is_address(name) else str(real(folder / name))


def _figures(found: Identification) -> dict[str, Any]:
    """Return the columns of a row that say how good a result is."""
    errors = {one.role: one.errors for one in reversed(found.validations)}  # of several pieces, those of the first
    held_out = errors.get("validation")
    return {
        "samples": sum(one.errors.samples for one in found.validations if one.role == "train"),
        "verdict": None if held_out is None else judge(found).use.value,  # without, none is good for anything
        "error": errors["train"].relative_error,
        "errors": list(errors["train"].per_joint.values()),
        "held_out": [] if held_out is None else list(held_out.per_joint.values()),
    }
