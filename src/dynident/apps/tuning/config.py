"""A configuration that is tuned by hand: its bench, and the configuration of what was tuned."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynident.apps.tuning.bench import Bench, Columns
from dynident.apps.tuning.tuning import Tuning
from dynident.motion.log import Log
from dynident.project.explicit_config import fixed_settings, settings_text
from dynident.project.logs import read_recording, recording_of, turning_joints
from dynident.project.project import Project
from dynident.project.settings import RobotSettings
from dynident.project.signals import column_names, signals
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS


def bench_of(project: Project) -> Bench:
    """Return the bench of a project, and of its identification.

    Raises the errors of ``Project.identify``, and ConfigError where the recordings are too long for the memory.
    """
    if project.long:
        raise ConfigError(
            f"{project.path}: the recordings of `train` are too long for the memory, and fitted in pieces, which is "
            "too slow to tune by hand; give a shorter `window`, or raise the memory by --memory."
        )
    identification, (logs, _) = project.identify(), project.logs()
    kind = ESTIMATORS.kind_of(identification.recipe.estimator)
    kind = kind if kind in ESTIMATORS.kinds() else ""  # a class of the user goes by its name
    switchable = isinstance(project.config.model, RobotSettings)
    bench = Bench.of(project.model, logs, identification, switchable=switchable, estimator=kind)
    return replace(
        bench, multi_turn=turning_joints(project.config), read_others=lambda log: _other_columns(project, log)
    )


def _other_columns(project: Project, log: str) -> Columns:
    """Return the stamps (N, s) and the columns (N) that the configuration does not use, of the recording of a log."""
    config = project.config
    spec = recording_of(log, (*config.train, *config.validation))
    if spec is None:
        return np.zeros(0), {}
    recorded = signals(read_recording(spec), config, project.model.joints, measured=True)
    used = column_names(config, spec)
    columns = recorded.table.columns.items()
    return recorded.t, {name: x for name, x in columns if name not in used and len(x) == len(recorded.t)}


def tuned_text(project: Project, bench: Bench, tuning: Tuning, path: Path) -> str:
    """Return the text of a configuration, to lie at ``path``, that gives the numbers of ``bench.identify(tuning)``.

    It is that of the project with all written out that was tuned or chosen. Raises ConfigError for a tuning that does
    not fit, or a part that has no settings in a configuration.
    """
    bench.check(tuning)
    source = project.sources.configuration
    assert source is not None  # noqa: S101 -- a project is of a file
    settings = fixed_settings(source, bench.recipe(tuning), bench.model(tuning), path.parent)
    for role, specs in (("train", project.config.train), ("validation", project.config.validation)):
        for spec, entry in zip(specs, settings.get(role, ()), strict=True):
            logs = (log for name, log in bench.logs[role].items() if recording_of(name, specs) is spec)
            entry.pop("exclude", None)
            if windows := [list(window) for log in logs for window in _clip_windows(tuning, log)]:
                entry["exclude"] = windows
    return settings_text(settings, {"": [f"{project.path.name}, tuned by hand with `dynident tune`"]})


def _clip_windows(tuning: Tuning, log: Log) -> Iterator[tuple[float, float]]:
    """Yield the windows excluded of a log, not beyond its ends: a recording may have other logs there."""
    for start, stop in tuning.windows(log.source):
        if ((log.t >= start) & (log.t <= stop)).any():
            yield max(start, float(log.t[0])), min(stop, float(np.nextafter(log.t[-1], np.inf)))
