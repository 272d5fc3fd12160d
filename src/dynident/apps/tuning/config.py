"""Settings that were tuned by hand, as changes of the configuration that they were tuned from, and saved there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextvars import Context
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.tuning import Tuning
from dynident.checks import with_findings
from dynident.files.opener import content, real_path
from dynident.files.results import CHANGED_MESSAGE, replace_text
from dynident.files.yaml_edit import REMOVED, Changes, KeyPath, edit_yaml
from dynident.files.yaml_text import load_yaml
from dynident.identification import Recipe, identify
from dynident.models import CoupledMotor, Joint, Model, RigidBodies, Term
from dynident.motion.log import Log
from dynident.motion.smoothers import strip_time_offset
from dynident.project.config import configured_terms, parse_config
from dynident.project.explicit_config import part_settings
from dynident.project.logs import recording_of, turning_joints
from dynident.project.project import Project, read_project
from dynident.project.settings import LogSpec, RobotSettings
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, Remark, brief
from dynident.runtime.families import ESTIMATORS, SMOOTHERS, TERMS

BOM = "\ufeff".encode()
Pairs = Iterator[tuple[KeyPath, Any]]


def read_bench(path: str | Path) -> tuple[Project, Bench]:
    """Read a configuration, identify what it describes, and return it with its bench.

    Raises the errors of ``read_project`` and ``Project.identify``, and ConfigError where the recordings are too long
    for the memory.
    """
    project = read_project(path)
    return project, bench_of(project)


def bench_of(project: Project) -> Bench:
    """Return the bench of a project: its recordings are read, and identified once. Raises as ``read_bench``."""
    if project.long:
        raise ConfigError(
            f"{project.path}: the recordings of `train` are too long for the memory, and fitted in pieces, which is "
            "too slow to tune by hand; give a shorter `window`, or raise the memory by --memory."
        )
    (logs, remarks), turning = project.logs(), turning_joints(project.config)
    model, recipe = project.model, project.recipe
    identification = identify(model, logs["train"], logs["validation"], recipe)
    identification = with_findings(identification, model, logs, recipe, multi_turn=turning)
    provenance = replace(
        identification.provenance, configuration=project.sources.configuration, model=project.sources.model
    )
    warnings = map(Remark, (*project.warnings, *model.notes, *remarks))
    identification = replace(identification, warnings=(*warnings, *identification.warnings), provenance=provenance)
    switchable = isinstance(project.config.model, RobotSettings)
    kind = ESTIMATORS.kind_of(identification.recipe.estimator)
    kind = kind if kind in ESTIMATORS.kinds() else ""  # a class of the user goes by its name
    bench = Bench.of(model, logs, identification, switchable=switchable, estimator=kind)
    return replace(bench, multi_turn=turning)


@dataclass(frozen=True)
class ConfigFile:
    """A configuration file that tuned settings are saved to: its ``path`` and its ``text`` as it is there.

    ``start`` is the text of which its project was made, and ``before`` what the file held before each change that was
    saved, the last one at the end. All with their own marks and line ends.
    """

    path: Path
    text: str
    start: str
    before: tuple[str, ...] = ()

    __repr__ = brief

    @classmethod
    def of(cls, project: Project) -> ConfigFile:
        """Return the file of a project; ConfigError where it is not as it was read any more."""
        data, source = content(project.path, ConfigError, remember=False), project.sources.configuration
        if source is None or data.removeprefix(BOM) != source.text.encode():
            raise ConfigError(f"{project.path}: {CHANGED_MESSAGE}")
        return cls(project.path, data.decode(), data.decode())

    def apply_changes(self, changes: Changes) -> str:
        """Return the text of the start with changes.

        Raises ConfigError where they are no configuration, or cannot be made in the text.
        """
        text = edit_yaml(self.start, changes, str(self.path))
        parse_config(text.removeprefix("\ufeff"), self.path.parent, str(self.path))
        return text

    def save(self, changes: Changes) -> ConfigFile:
        """Write the text of the start with changes and return the file as it is then; itself where nothing differs.

        The file is replaced as a whole, though this run has read it. Raises as ``apply_changes``, ConfigError where
        the file is not as it was any more, InputError where it cannot be written.
        """
        text = self.apply_changes(changes)
        return self if text == self.text else self._write_text(text, (*self.before, self.text))

    def undo(self) -> ConfigFile:
        """Write what was there before the last change, to the byte; raises as ``save``, and where nothing was saved."""
        if not self.before:
            raise ConfigError(f"{self.path}: nothing has been saved to it that could be undone.")
        return self._write_text(self.before[-1], self.before[:-1])

    def _write_text(self, text: str, before: tuple[str, ...]) -> ConfigFile:
        Context().run(replace_text, self.path, text, self.text)  # outside of the run, which may not replace its input
        return replace(self, text=text, before=before)


def tuned_changes(project: Project, bench: Bench, tuning: Tuning) -> dict[KeyPath, Any]:
    """Return what a tuning changes in the file of a project: only settings that differ from what the file says.

    What the file leaves to the data (terms, smoothing, time offset, tilt of the base) is written as it was used, so
    that the file gives the numbers of ``bench.whole(tuning)``; the tuning that the ``bench`` started with changes
    nothing.

    Raises ConfigError for a tuning that does not fit, or a part that has no settings in a configuration.
    """
    bench.check(tuning)
    if tuning == bench.start:
        return {}
    source = project.sources.configuration
    data = load_yaml("" if source is None else source.text, str(project.path))
    folder = real_path(project.path).parent
    changes = dict(_model_changes(project, bench, tuning, data["model"], folder))
    changes |= _recipe_changes(project.recipe, bench.recipe(tuning), bench.joints, folder)
    for role, specs in (("train", project.config.train), ("validation", project.config.validation)):
        changes |= _exclusion_changes(role, specs, bench, tuning)
    # a key that the file does not have need not be removed
    return {path: value for path, value in changes.items() if value is not REMOVED or path[0] in data}


def _recipe_changes(old_recipe: Recipe, new_recipe: Recipe, joints: tuple[str, ...], folder: Path) -> Pairs:
    """Yield the settings of a recipe that are not as they were."""
    if new_recipe.smoothers != old_recipe.smoothers:
        yield ("smoother",), part_settings(SMOOTHERS, strip_time_offset(new_recipe.smoothers[0]), folder)
    if new_recipe.estimator != old_recipe.estimator:
        yield ("estimator",), part_settings(ESTIMATORS, new_recipe.estimator, folder)
    if new_recipe.filter != old_recipe.filter:
        yield ("filter",), REMOVED if new_recipe.filter is None else _filter_settings(new_recipe.filter)
    if new_recipe.min_speeds(joints) != old_recipe.min_speeds(joints):
        yield ("min_speed",), REMOVED if new_recipe.min_speed is None else new_recipe.min_speed
    if new_recipe.time_offset != old_recipe.time_offset:
        yield ("time_offset",), new_recipe.time_offset
    if new_recipe.unfitted != old_recipe.unfitted:
        yield ("unfitted",), list(new_recipe.unfitted) or REMOVED
    yield from (
        ((key,), getattr(new_recipe, key))
        for key in ("outliers", "rests")
        if getattr(new_recipe, key) != getattr(old_recipe, key)
    )


def _filter_settings(parallel_filter: ParallelFilter) -> dict[str, Any]:
    """Return the settings of a filter that differ from their defaults."""
    return {
        field.name: value
        for field in fields(parallel_filter)
        if (value := getattr(parallel_filter, field.name)) != field.default
    }


def _model_changes(project: Project, bench: Bench, tuning: Tuning, model_entry: Any, folder: Path) -> Pairs:
    """Yield terms and tilt of the base where they are not as they were; a file name becomes a mapping for them."""
    settings = project.config.model
    if not isinstance(settings, RobotSettings):
        return
    tilt, changes = bench.recipe(tuning).base_tilt, dict[str, Any]()
    if tilt != project.recipe.base_tilt:
        changes["base_tilt"] = list(tilt) if isinstance(tilt, tuple) else "none"
    terms = _listed_terms(bench.model(tuning))
    # terms that the logs would choose are written out, so that the file gives the same model
    if settings.chooses_terms or terms != _listed_terms(project.model):
        changes["terms"] = list(_term_entries(terms, settings, project.model.joints, model_entry, folder))
    if changes and not isinstance(model_entry, Mapping):
        yield ("model",), {"file": model_entry, **changes}
    else:
        yield from ((("model", key), value) for key, value in changes.items())


def _listed_terms(model: Model) -> list[Term]:
    """Return the terms that a configuration lists."""
    return [term for term in model.terms if not isinstance(term, RigidBodies | CoupledMotor)]


def _term_entries(
    terms: Sequence[Term], settings: RobotSettings, joints: tuple[Joint, ...], model_entry: Any, folder: Path
) -> Iterator[Any]:
    """Yield terms as a configuration lists them: as the file has them, by the kind alone, or with their settings."""
    listed = model_entry.get("terms") if isinstance(model_entry, Mapping) else None
    pairs = list(zip(listed, configured_terms(settings, joints), strict=True)) if isinstance(listed, list) else []
    for term in terms:
        described = part_settings(TERMS, term, folder)
        # a term of all joints needs no list of them
        if described.get("on") == [joint.name for joint in joints]:
            del described["on"]
        kind = described["kind"]
        is_plain_kind = (
            len(described) == 1 and kind in TERMS.kinds() and not (kind == "coulomb" and settings.coulomb_width)
        )
        yield next((entry for entry, old_term in pairs if old_term == term), kind if is_plain_kind else described)


def _exclusion_changes(role: str, specs: Sequence[LogSpec], bench: Bench, tuning: Tuning) -> Pairs:
    """Yield the windows that are excluded of a recording, where they are not as they were."""
    for k, spec in enumerate(specs):
        logs = [name for name in bench.logs[role] if recording_of(name, specs) is spec]
        old_windows = [pair for name in logs for pair in bench.start.windows(name)]
        new_windows = [pair for name in logs for pair in tuning.windows(name)]
        if len(logs) > 1:  # the file excludes of the whole recording: not what is beyond the part that was meant
            new_windows = [
                window for name in logs for window in _clip_windows(tuning.windows(name), bench.logs[role][name])
            ]
        if new_windows != old_windows:
            windows = dict.fromkeys(
                _window_of_file(pair, spec) if pair in old_windows else pair for pair in new_windows
            )
            yield (role, k, "exclude"), [list(pair) for pair in windows] or REMOVED


def _clip_windows(windows: Sequence[tuple[float, float]], log: Log) -> Iterator[tuple[float, float]]:
    """Yield windows as far as they have samples of a log."""
    for start, stop in windows:
        inside = log.t[(log.t >= start) & (log.t <= stop)]
        if inside.size:
            # the end lies just behind the last sample, which is excluded, too
            yield max(start, float(inside[0])), min(stop, float(np.nextafter(inside[-1], np.inf)))


def _window_of_file(pair: tuple[float, float], spec: LogSpec) -> tuple[float | None, float | None]:
    """Return the window of the file that excludes the samples from one to another, else these."""
    matches = (window for window in spec.exclude if _is_within(pair, window))
    return next(matches, pair)


def _is_within(pair: tuple[float, float], window: tuple[float | None, float | None]) -> bool:
    start, stop = window
    return (start is None or start <= pair[0]) and (stop is None or pair[1] <= stop)
