"""Settings that were tuned by hand, as changes of the configuration that they were tuned from, and saved there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextvars import Context
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from dynident.errors import ConfigError, brief
from dynident.identification import Recipe
from dynident.io.config import parse_config
from dynident.io.explicit_config import part_settings
from dynident.io.families import ESTIMATORS, SMOOTHERS, TERMS
from dynident.io.named_log import recording_of
from dynident.io.opener import content, real
from dynident.io.project import Project
from dynident.io.results import CHANGED, replace_text
from dynident.io.robot import configured_terms
from dynident.io.settings import LogSpec, RobotSettings
from dynident.io.yaml_edit import REMOVED, Changes, KeyPath, edited
from dynident.io.yaml_text import load_yaml
from dynident.log import Log
from dynident.models import CoupledMotor, Joint, Model, RigidBodies, Term
from dynident.regression import ParallelFilter
from dynident.smoothers import unshifted
from dynident.tuning import Bench, Tuning

__all__ = ["ConfigFile", "tuned_changes"]

BOM = "\ufeff".encode()
Pairs = Iterator[tuple[KeyPath, Any]]


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
            raise ConfigError(f"{project.path}: {CHANGED}")
        return cls(project.path, data.decode(), data.decode())

    def changed(self, changes: Changes) -> str:
        """Return the text of the start with changes.

        Raises ConfigError where they are no configuration, or cannot be made in the text.
        """
        text = edited(self.start, changes, str(self.path))
        parse_config(text.removeprefix("\ufeff"), self.path.parent, str(self.path))
        return text

    def save(self, changes: Changes) -> ConfigFile:
        """Write the text of the start with changes and return the file as it is then; itself where it is so already.

        The file is replaced as a whole, though this run has read it. Raises as ``changed``, ConfigError where it is not
        as it was any more, InputError where it cannot be written.
        """
        text = self.changed(changes)
        return self if text == self.text else self._written(text, (*self.before, self.text))

    def undo(self) -> ConfigFile:
        """Write what was there before the last change, to the byte; raises as ``save``, and where nothing was saved."""
        if not self.before:
            raise ConfigError(f"{self.path}: nothing has been saved to it that could be undone.")
        return self._written(self.before[-1], self.before[:-1])

    def _written(self, text: str, before: tuple[str, ...]) -> ConfigFile:
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
    folder = real(project.path).parent
    found = dict(_model(project, bench, tuning, data["model"], folder))
    found |= _recipe(project.recipe, bench.recipe(tuning), bench.joints, folder)
    for role, specs in (("train", project.config.train), ("validation", project.config.validation)):
        found |= _excluded(role, specs, bench, tuning)
    return {path: value for path, value in found.items() if value is not REMOVED or path[0] in data}


def _recipe(was: Recipe, now: Recipe, joints: tuple[str, ...], folder: Path) -> Pairs:
    """Yield the settings of a recipe that are not as they were."""
    if now.smoothers != was.smoothers:
        yield ("smoother",), part_settings(SMOOTHERS, unshifted(now.smoothers[0]), folder)
    if now.estimator != was.estimator:
        yield ("estimator",), part_settings(ESTIMATORS, now.estimator, folder)
    if now.filter != was.filter:
        yield ("filter",), REMOVED if now.filter is None else _filter(now.filter)
    if now.min_speeds(joints) != was.min_speeds(joints):
        yield ("min_speed",), REMOVED if now.min_speed is None else now.min_speed
    if now.time_offset != was.time_offset:
        yield ("delay",), now.time_offset
    if now.unfitted != was.unfitted:
        yield ("unfitted",), list(now.unfitted) or REMOVED
    yield from (((key,), getattr(now, key)) for key in ("outliers", "rests") if getattr(now, key) != getattr(was, key))


def _filter(given: ParallelFilter) -> dict[str, Any]:
    """Return the settings of a filter that are not as they are by default, of which there is one."""
    return {one.name: value for one in fields(given) if (value := getattr(given, one.name)) != one.default}


def _model(project: Project, bench: Bench, tuning: Tuning, given: Any, folder: Path) -> Pairs:
    """Yield terms and tilt of the base where they are not as they were; a file name becomes a mapping for them."""
    settings = project.config.model
    if not isinstance(settings, RobotSettings):
        return
    tilt, changes = bench.recipe(tuning).base_tilt, dict[str, Any]()
    if tilt != project.recipe.base_tilt:
        changes["base_tilt"] = list(tilt) if isinstance(tilt, tuple) else "none"
    terms = _own(bench.model(tuning))
    if settings.chooses_terms or terms != _own(project.model):
        changes["terms"] = list(_terms(terms, settings, project.model.joints, given, folder))
    if changes and not isinstance(given, Mapping):
        yield ("model",), {"file": given, **changes}
    else:
        yield from ((("model", key), value) for key, value in changes.items())


def _own(model: Model) -> list[Term]:
    """Return the terms that a configuration lists."""
    return [one for one in model.terms if not isinstance(one, RigidBodies | CoupledMotor)]


def _terms(
    terms: Sequence[Term], settings: RobotSettings, joints: tuple[Joint, ...], given: Any, folder: Path
) -> Iterator[Any]:
    """Yield terms as a configuration lists them: as the file has them, by the kind alone, or with their settings."""
    listed = given.get("terms") if isinstance(given, Mapping) else None
    pairs = list(zip(listed, configured_terms(settings, joints), strict=True)) if isinstance(listed, list) else []
    for term in terms:
        described = part_settings(TERMS, term, folder)
        if described.get("on") == [joint.name for joint in joints]:
            del described["on"]
        kind = described["kind"]
        alone = len(described) == 1 and kind in TERMS.kinds() and not (kind == "coulomb" and settings.coulomb_width)
        yield next((words for words, one in pairs if one == term), kind if alone else described)


def _excluded(role: str, specs: Sequence[LogSpec], bench: Bench, tuning: Tuning) -> Pairs:
    """Yield the windows that are excluded of a recording, where they are not as they were."""
    for k, spec in enumerate(specs):
        logs = [name for name in bench.logs[role] if recording_of(name, specs) is spec]
        was = [pair for name in logs for pair in bench.start.windows(name)]
        now = [pair for name in logs for pair in tuning.windows(name)]
        if len(logs) > 1:  # the file excludes of the whole recording: not what is beyond the part that was meant
            now = [one for name in logs for one in _inside(tuning.windows(name), bench.logs[role][name])]
        if now != was:
            windows = dict.fromkeys(_as_given(pair, spec) if pair in was else pair for pair in now)
            yield (role, k, "exclude"), [list(pair) for pair in windows] or REMOVED


def _inside(windows: Sequence[tuple[float, float]], log: Log) -> Iterator[tuple[float, float]]:
    """Yield windows as far as they have samples of a log."""
    for start, stop in windows:
        inside = log.t[(log.t >= start) & (log.t <= stop)]
        if inside.size:
            yield max(start, float(inside[0])), min(stop, float(np.nextafter(inside[-1], np.inf)))


def _as_given(pair: tuple[float, float], spec: LogSpec) -> tuple[float | None, float | None]:
    """Return the window of the file that excludes the samples from one to another, else these."""
    given = (one for one in spec.exclude if _within(pair, one))
    return next(given, pair)


def _within(pair: tuple[float, float], window: tuple[float | None, float | None]) -> bool:
    start, stop = window
    return (start is None or start <= pair[0]) and (stop is None or pair[1] <= stop)
