"""A configuration and what it names: the model, the recipe, the recordings; and the runs that are made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from datetime import UTC, datetime
from hashlib import sha256
from itertools import chain
from pathlib import Path

from dynident.checks import CheckResult, run_checks, with_findings
from dynident.files.lerobot import episode_files
from dynident.files.opener import real_path
from dynident.files.results import as_path
from dynident.files.tables import is_episode, recording_parts
from dynident.files.xml_text import SUFFIXES
from dynident.identification import (
    AccuracyBound,
    Identification,
    Recipe,
    SourceFile,
    Sources,
    TorqueNoise,
    accuracy_bound,
    identify,
    identify_from_pieces,
    plan_pieces,
)
from dynident.models import Model
from dynident.motion.log import Log
from dynident.project.config import (
    config_text,
    config_warnings,
    fingerprint,
    load_model,
    model_file,
    parse_config,
    robot_text,
)
from dynident.project.drive_settings import TorqueInputSettings
from dynident.project.logs import read_roles, read_with_findings, turning_joints
from dynident.project.long_recordings import is_long, long_logs, pieces_name, reduce_pieces, saves_memory
from dynident.project.parts import build_part
from dynident.project.settings import Config, RobotSettings
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, ConfigRemark, Finding, Noun, Remark, report_progress
from dynident.runtime.jobs import Limits


def build_recipe(config: Config) -> Recipe:
    """Return smoother, estimator and parallel filter as configured; ConfigError where their values do not fit."""
    parallel_filter = None if config.filter is None else ParallelFilter(**dict(config.filter))
    robot = config.model if isinstance(config.model, RobotSettings) else None
    restart = config.simulation.restart if isinstance(config.simulation, TorqueInputSettings) else None
    smoother, estimator = build_part(config.smoother), build_part(config.estimator)
    # a model of Python code has all its terms, a robot file may leave them to the training logs
    return Recipe(
        smoother,
        estimator,
        parallel_filter,
        config.min_speed,
        config.time_offset,
        None if robot is None or robot.base_tilt == "none" else robot.base_tilt,
        restart,
        config.outliers,
        config.rests,
        "auto" if robot is not None and robot.chooses_terms else None,
        () if robot is None else robot.proposed,
        config.unfitted,
    )


class Project(Noun):
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

    def logs(self) -> tuple[dict[str, dict[str, Log]], tuple[str, ...]]:
        """Read all recordings: their logs by role ("train", "validation") and name, and warnings.

        Raises ConfigError and InputError as ``read_roles`` does.
        """
        return read_roles(self.config, self.model.joints)

    @property
    def long(self) -> bool:
        """Whether the training is too long for the memory, so that it is fitted in pieces."""
        return is_long(self.config)

    @property
    def in_pieces(self) -> bool:
        """Whether the training is fitted in pieces: it is too ``long``, or takes much less memory so."""
        return self.long or (saves_memory(self.config) and not self.recipe.estimator.needs_samples)

    def identify(
        self, *, executor: Executor | None = None, limits: Limits | None = None, folder: Path | None = None
    ) -> Identification:
        """Identify the parameters from the recordings, with all warnings, the findings of the checks, and the hashes of
        all files that were read.

        A long training is fitted ``in_pieces``, over the ``executor``; those that were done are kept in the ``folder``,
        if there is one, for the next run. Of another the smoothers are tried there. Raises the errors of reading and
        of ``dynident.identification.identify``.
        """
        try:
            if not self.in_pieces:
                identification, logs, remarks = self._identify_at_once(executor)
            else:
                identification, logs, remarks = self._identify_in_pieces(executor, limits, folder)
        except ConfigError:
            # some smoothers and estimators need all samples, which the memory may hold
            if self.long or not self.in_pieces:
                raise
            identification, logs, remarks = self._identify_at_once(executor)
        report_progress("reading the logs once more, for their hashes")
        files = log_files(self.config)
        turning = turning_joints(self.config)
        identification = with_findings(identification, self.model, logs, self.recipe, multi_turn=turning)
        # what reading has warned of may be among the findings as well, which tell of all joints and logs at once
        finding_texts = set(map(str, identification.findings))
        notes = (*self.model.notes, *(remark for remark in remarks if remark not in finding_texts))
        return self._with_provenance(identification, notes, files)

    def _identify_at_once(
        self, executor: Executor | None
    ) -> tuple[Identification, dict[str, dict[str, Log]], tuple[str, ...]]:
        """Return the identification with all samples in memory, all logs, and what to remark."""
        logs, remarks = self.logs()
        return identify(self.model, logs["train"], logs["validation"], self.recipe, executor=executor), logs, remarks

    def _identify_in_pieces(
        self, executor: Executor | None, limits: Limits | None, folder: Path | None
    ) -> tuple[Identification, dict[str, dict[str, Log]], tuple[str, ...]]:
        """Return the identification of long recordings, their excerpts with the held-out logs, and what to remark."""
        validation_config = self.config.model_copy(update={"train": ()})
        logs, remarks = read_roles(validation_config, self.model.joints)
        recordings = long_logs(self.config, self.model.joints)
        preparation = plan_pieces(self.model, recordings, self.recipe)
        table = None if folder is None else folder / pieces_name(preparation, recordings)
        pieces = reduce_pieces(preparation, table, executor, limits)
        identification = identify_from_pieces(preparation, pieces, logs["validation"])
        notes = [note for recording in recordings for note in recording.notes]
        if preparation.lost_samples:
            notes.append(f"{preparation.lost_samples} samples between gaps are too few to be smoothed, and left out.")
        return identification, {"train": dict(preparation.logs), "validation": logs["validation"]}, (*notes, *remarks)

    def bound(
        self,
        sigma_q: Mapping[str, float] | float | None = None,
        sigma_tau: Mapping[str, float] | float | None = None,
        torque: TorqueNoise = "residual",
    ) -> AccuracyBound:
        """Return the accuracy that any method could reach with the training logs; arguments as in
        ``accuracy_bound``."""
        logs, remarks = self.logs()
        accuracy = accuracy_bound(
            self.model, logs["train"], self.recipe, sigma_q=sigma_q, sigma_tau=sigma_tau, torque=torque
        )
        return replace(accuracy, identification=self._with_provenance(accuracy.identification, remarks))

    def examine(self) -> CheckResult:
        """Examine the robot file and all recordings; one that cannot be read is an error among the findings."""
        logs, reading_findings = read_with_findings(self.config, self.model.joints)
        config_findings = tuple(Finding(ConfigRemark(text), source=self.path.name) for text in self.warnings)
        turning = turning_joints(self.config)
        return run_checks(
            self.model, logs, self.recipe, multi_turn=turning, initial_findings=(*config_findings, *reading_findings)
        )

    def _with_provenance(
        self, identification: Identification, remarks: Sequence[str], files: tuple[SourceFile, ...] = ()
    ) -> Identification:
        """Return an identification that says what it was made from, and all that is to be warned of."""
        warnings = (*map(Remark, (*self.warnings, *remarks)), *identification.warnings)
        sources = replace(identification.provenance, configuration=self.sources.configuration, model=self.sources.model)
        sources = replace(sources, logs=files, identified=stamp())
        return replace(identification, warnings=warnings, provenance=sources)


def read_project(path: str | Path) -> Project:
    """Read a configuration (YAML) and build its model and recipe; relative file names start at its folder.

    Raises ConfigError where it is wrong, ModelError where its model cannot be built.
    """
    path = as_path(path)
    return parse_project(config_text(path), path)


def parse_project(text: str, path: Path, source: str | None = None, *, allow_code: bool = True) -> Project:
    """Return the project of a YAML text that belongs at ``path``; ``source`` is its name in messages.

    Files of Python are refused unless ``allow_code``. Raises the errors of ``read_project``.
    """
    config = parse_config(text, path.parent, source or str(path), allow_code=allow_code)
    report_progress("building the model")
    model = load_model(config.model, path.parent, allow_code=allow_code)
    file = model_file(config.model, path.parent)
    robot = None if file is None else model_source(file)
    sources = Sources(SourceFile(str(real_path(path)), sha256(text.encode()).hexdigest(), text), robot)
    return Project(path, config, model, build_recipe(config), config_warnings(config), sources)


def model_source(file: Path) -> SourceFile:
    """Return what a result keeps of the file of a model: of a robot file its text, too."""
    text = robot_text(file) if file.suffix.lower() in SUFFIXES else ""
    return SourceFile(str(real_path(file)), fingerprint(file), text)


def run(path: str | Path, *, executor: Executor | None = None) -> Identification:
    """Identify what a configuration describes, as the command ``dynident identify`` does.

    Recordings too long for the memory are fitted in pieces, over the ``executor``. Raises ConfigError, ModelError,
    InputError.

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
    return read_project(path).identify(executor=executor)


def log_files(config: Config) -> tuple[SourceFile, ...]:
    """Return every file of the recordings with its SHA-256; each is read once more."""
    paths = (path for spec in (*config.train, *config.validation) for path in spec.file.values())
    parts = chain.from_iterable(episode_files(path) if is_episode(path) else recording_parts(path) for path in paths)
    files = dict.fromkeys(map(real_path, parts))
    return tuple(SourceFile(str(file), fingerprint(file), modified=stamp(file)) for file in files)


def stamp(file: Path | None = None) -> str:
    """Return when a file was last modified, or the time now, as ISO 8601 in UTC; "" where that is not known."""
    try:
        when = datetime.now(UTC) if file is None else datetime.fromtimestamp(file.stat().st_mtime, UTC)
    except (OSError, OverflowError, ValueError):
        return ""
    return when.isoformat(timespec="seconds")
