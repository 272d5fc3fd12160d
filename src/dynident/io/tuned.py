"""A configuration on the bench, to be tuned by hand."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from dynident.checks import with_findings
from dynident.errors import ConfigError, Remark
from dynident.identification import identify
from dynident.io.families import ESTIMATORS
from dynident.io.logs import turning_joints
from dynident.io.project import Project, read_project
from dynident.io.settings import RobotSettings
from dynident.tuning import Bench

__all__ = ["bench_of", "read_bench"]


def read_bench(path: str | Path, progress: Callable[[str], None] = lambda _: None) -> tuple[Project, Bench]:
    """Read a configuration, identify what it describes, and return it with its bench.

    Raises the errors of ``read_project`` and ``Project.identify``, and ConfigError where the recordings are too long
    for the memory.
    """
    project = read_project(path, progress)
    return project, bench_of(project, progress)


def bench_of(project: Project, progress: Callable[[str], None] = lambda _: None) -> Bench:
    """Return the bench of a project: its recordings are read, and identified once. Raises as ``read_bench``."""
    if project.long:
        raise ConfigError(
            f"{project.path}: the recordings of `train` are too long for the memory, and fitted in pieces, which is "
            "too slow to tune by hand; give a shorter `window`, or raise the memory by --memory."
        )
    (logs, remarks), turning = project.logs(progress), turning_joints(project.config)
    model, recipe = project.model, project.recipe
    found = identify(model, logs["train"], logs["validation"], recipe, progress=progress)
    found = with_findings(found, model, logs, recipe, multi_turn=turning, progress=progress)
    known = replace(found.provenance, configuration=project.sources.configuration, model=project.sources.model)
    said = map(Remark, (*project.warnings, *model.notes, *remarks))
    found = replace(found, warnings=(*said, *found.warnings), provenance=known)
    switchable = isinstance(project.config.model, RobotSettings)
    kind = ESTIMATORS.kind_of(found.recipe.estimator)
    kind = kind if kind in ESTIMATORS.kinds() else ""  # a class of the user goes by its name
    return Bench.of(model, logs, found, switchable=switchable, multi_turn=turning, estimator=kind)
