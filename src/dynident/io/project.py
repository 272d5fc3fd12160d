"""A configuration and what it names: the model, the recipe, the recordings; and the runs that are made of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path

from dynident.bounds import AccuracyBound, TorqueNoise, accuracy_bound
from dynident.checks import CheckResult, Finding, notes, reading_line, run_checks, with_findings
from dynident.errors import Remark, Severity, brief
from dynident.identification import Identification, Recipe, SourceFile, Sources, finished, identify, prepared
from dynident.io.config import config_text, config_warnings, load_model, parse_config
from dynident.io.logs import read_found, read_roles, turning_joints
from dynident.io.long_log import is_long, long_logs
from dynident.io.long_run import pieces_name, reduced
from dynident.io.opener import real
from dynident.io.recipe import build_recipe
from dynident.io.recording_parts import recording_parts
from dynident.io.results import as_path
from dynident.io.robot import SUFFIXES, fingerprint, model_file, robot_text
from dynident.io.settings import Config
from dynident.jobs import Limits
from dynident.log import Log
from dynident.models import Model

__all__ = ["Project", "log_files", "model_source", "parse_project", "read_project", "run", "stamp"]

Progress = Callable[[str], None]


def _silent(_: str) -> None:
    """Show no progress."""


@dataclass(frozen=True, eq=False)
class Project:
    """What a configuration names: ``config`` as written in the file ``path``, and the model and recipe made of it.

    ``warnings`` are on the configuration itself; ``sources`` are its file and that of the model. Recordings are read
    by the methods, each time that one is called.
    """

    path: Path
    config: Config
    model: Model
    recipe: Recipe
    warnings: tuple[str, ...]
    sources: Sources

    __repr__ = brief

    def logs(self, progress: Progress = _silent) -> tuple[dict[str, dict[str, Log]], tuple[str, ...]]:
        """Read all recordings: their logs by role ("train", "validation") and name, and warnings.

        Raises ConfigError and InputError as ``read_roles`` does.
        """
        return read_roles(self.config, self.model.joints, progress)

    @property
    def long(self) -> bool:
        """Whether the training is too long for the memory, so that it is fitted in pieces."""
        return is_long(self.config)

    def identify(
        self,
        progress: Progress = _silent,
        *,
        executor: Executor | None = None,
        limits: Limits | None = None,
        folder: Path | None = None,
    ) -> Identification:
        """Identify the parameters from the recordings, with all warnings, the findings of the checks, and the hashes of
        all files that were read.

        A training too ``long`` for the memory is fitted in pieces, over the ``executor``; those that were done are kept
        in the ``folder``, if there is one, for the next run. Of another the smoothers are tried there. Raises the
        errors of reading and of ``dynident.identification.identify``.
        """
        if self.long:
            found, logs, remarks = self._in_pieces(progress, executor, limits, folder)
        else:
            logs, remarks = self.logs(progress)
            read = logs["train"], logs["validation"]
            found = identify(self.model, *read, self.recipe, executor=executor, progress=progress)
        progress("reading the logs once more, for their hashes")
        files = log_files(self.config)
        turning = turning_joints(self.config)
        found = with_findings(found, self.model, logs, self.recipe, multi_turn=turning, progress=progress)
        findings, remarks = _once(found.findings, remarks)
        return self._signed(replace(found, warnings=(*found.notes, *findings)), (*self.model.notes, *remarks), files)

    def _in_pieces(
        self, progress: Progress, executor: Executor | None, limits: Limits | None, folder: Path | None
    ) -> tuple[Identification, dict[str, dict[str, Log]], tuple[str, ...]]:
        """Return the identification of long recordings, their excerpts with the held-out logs, and what to remark."""
        held = self.config.model_copy(update={"train": ()})
        logs, remarks = read_roles(held, self.model.joints, progress)
        recordings = long_logs(self.config, self.model.joints, progress)
        ready = prepared(self.model, recordings, self.recipe, progress=progress)
        table = None if folder is None else folder / pieces_name(ready, recordings)
        pieces = reduced(ready, table, executor, limits, progress)
        found = finished(ready, pieces, logs["validation"], progress)
        notes = [note for one in recordings for note in one.notes]
        if ready.lost:
            notes.append(f"{ready.lost} samples between gaps are too few to be smoothed, and left out.")
        return found, {"train": dict(ready.logs), "validation": logs["validation"]}, (*notes, *remarks)

    def bound(
        self,
        sigma_q: Mapping[str, float] | float | None = None,
        sigma_tau: Mapping[str, float] | float | None = None,
        torque: TorqueNoise = "residual",
        progress: Progress = _silent,
    ) -> AccuracyBound:
        """Return the accuracy that any method could reach with the training logs; arguments as in
        ``accuracy_bound``."""
        logs, remarks = self.logs(progress)
        found = accuracy_bound(
            self.model,
            logs["train"],
            self.recipe,
            sigma_q=sigma_q,
            sigma_tau=sigma_tau,
            torque=torque,
            progress=progress,
        )
        return replace(found, identification=self._signed(found.identification, remarks))

    def examine(self, progress: Progress = _silent) -> CheckResult:
        """Examine the robot file and all recordings; one that cannot be read is an error among the findings."""
        logs, found = read_found(self.config, self.model.joints, progress)
        own = tuple(Finding(Severity.WARNING, None, words, source=self.path.name) for words in self.warnings)
        turning = turning_joints(self.config)
        return run_checks(self.model, logs, self.recipe, multi_turn=turning, found=(*own, *found), progress=progress)

    def _signed(
        self, found: Identification, remarks: Sequence[str], files: tuple[SourceFile, ...] = ()
    ) -> Identification:
        """Return an identification that says what it was made from, and all that is to be warned of."""
        warnings = (*map(Remark, (*self.warnings, *remarks)), *found.warnings)
        sources = replace(found.provenance, configuration=self.sources.configuration, model=self.sources.model)
        sources = replace(sources, logs=files, identified=stamp())
        return replace(found, warnings=warnings, provenance=sources)


def read_project(path: str | Path, progress: Progress = _silent) -> Project:
    """Read a configuration (YAML) and build its model and recipe; relative file names start at its folder.

    Raises ConfigError where it is wrong, ModelError where its model cannot be built.
    """
    path = as_path(path)
    text = config_text(path)
    return _built(parse_config(text, path.parent, str(path)), path, text, progress)


def parse_project(text: str, path: Path, source: str | None = None) -> Project:
    """Return the project of a YAML text that belongs at ``path``; ``source`` is its name in messages.

    Raises the errors of ``read_project``.
    """
    return _built(parse_config(text, path.parent, source or str(path)), path, text, _silent)


def _built(config: Config, path: Path, text: str, progress: Progress) -> Project:
    progress("building the model")
    model = load_model(config.model, path.parent)
    file = model_file(config.model, path.parent)
    robot = None if file is None else model_source(file)
    sources = Sources(SourceFile(str(real(path)), sha256(text.encode()).hexdigest(), text), robot)
    return Project(path, config, model, build_recipe(config), config_warnings(config), sources)


def model_source(file: Path) -> SourceFile:
    """Return what a result keeps of the file of a model: of a robot file its text, too."""
    text = robot_text(file) if file.suffix.lower() in SUFFIXES else ""
    return SourceFile(str(real(file)), fingerprint(file), text)


def run(path: str | Path, *, progress: Progress | None = None, executor: Executor | None = None) -> Identification:
    """Identify what a configuration describes, as the command ``dynident identify`` does.

    Recordings too long for the memory are fitted in pieces, over the ``executor``. ``progress`` is called with a few
    words before each step. Raises ConfigError, ModelError, InputError.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t = np.arange(1001) * 0.01
    >>> table = np.column_stack([t, np.sin(3 * t), -45 * np.sin(3 * t) + 24 * np.cos(3 * t)])  # 5 kg, 8 N s/m
    >>> text = '''
    ... model: gallery:slider
    ... time: { column: t, unit: s }
    ... position: { slider: { column: x, unit: m } }
    ... torque: { slider: { column: f, unit: N } }
    ... train: [{ file: log.csv }]
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     np.savetxt(Path(folder, "log.csv"), table, delimiter=",", header="t,x,f", comments="")
    ...     _ = Path(folder, "robot.yaml").write_text(text)
    ...     found = dy.run(Path(folder, "robot.yaml"))
    >>> print(found.estimate.names[0], round(found.estimate.value[0], 2))
    M 5.0
    """
    progress = progress or _silent
    return read_project(path, progress).identify(progress, executor=executor)


def _once(findings: Sequence[Finding], remarks: Sequence[str]) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Return findings and remarks of reading without what both say: the finding stays where it forbids a use."""
    said = {f"{one.source}: {reading_line(one)}": one for one in findings if isinstance(one.message, notes.ReadingNote)}
    twice = [said[one] for one in remarks if one in said and said[one].forbids is None]
    kept = tuple(one for one in remarks if one not in said or said[one].forbids is None)
    return tuple(one for one in findings if one not in twice), kept


def log_files(config: Config) -> tuple[SourceFile, ...]:
    """Return every file of the recordings with its SHA-256; each is read once more."""
    paths = (path for spec in (*config.train, *config.validation) for path in spec.file.values())
    files = {real(file): None for path in paths for file in recording_parts(path)}
    return tuple(SourceFile(str(file), fingerprint(file), modified=stamp(file)) for file in files)


def stamp(file: Path | None = None) -> str:
    """Return when a file was last modified, or the time now, as ISO 8601 in UTC; "" where that is not known."""
    try:
        when = datetime.now(UTC) if file is None else datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except (OSError, OverflowError, ValueError):
        return ""
    return when.isoformat(timespec="seconds")
