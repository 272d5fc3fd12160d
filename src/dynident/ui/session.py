"""A configuration that is tuned: its logs are read and identified first, in the background; then its pages are answered."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.errors import ConfigError, DynidentError, Step
from dynident.ui.latest import Latest
from dynident.ui.whole import WholeRuns

if TYPE_CHECKING:
    from pathlib import Path

    from dynident.io.project import Project
    from dynident.tuning import Bench, Tuning

__all__ = ["Session"]

Report = Callable[[str], None]


@dataclass
class Session:
    """The configuration at ``path``, and what becomes of it: where its logs cannot be used, ``failed`` says why; else
    there is a ``bench``. ``fault`` is told of errors that nobody foresaw."""

    path: Path
    fault: Report
    step: Step = Step("starting")  # noqa: RUF009 -- a text
    failed: str = ""
    bench: Bench | None = None
    runs: WholeRuns | None = None
    project: Project | None = None

    def __post_init__(self) -> None:
        self.latest = Latest()

    def start(self) -> None:
        """Begin to read the logs, and to identify them, in the background; again where this failed."""
        self.failed, self.step = "", Step("starting")
        threading.Thread(target=self._load, daemon=True).start()

    def _load(self) -> None:
        try:
            self._loaded()
        except DynidentError as error:
            self.failed = str(error)
        except Exception as error:
            self.failed = f"This is a fault of dynident: {type(error).__name__}: {error}"
            self.fault("".join(traceback.format_exception(error)))

    def _loaded(self) -> None:
        from dynident.io.project import read_project

        project = read_project(self.path, self._say)
        bench = bench_of(project, self._say)
        self.runs = WholeRuns(bench.whole)
        self.bench = bench

    def _say(self, step: str) -> None:
        self.step = Step.of(step)


def bench_of(project: Project, progress: Report) -> Bench:
    """Return the bench of a configuration; ConfigError and InputError where its logs cannot be used."""
    from dynident.identification import identify
    from dynident.tuning import Bench

    if project.long:
        raise ConfigError(
            f"{project.path.name}: the training is too long to be tuned by hand, and is fitted in pieces; name a window of "
            "it in a configuration of its own."
        )
    logs, _ = project.logs(progress)
    found = identify(project.model, logs["train"], logs["validation"], project.recipe, progress=progress)
    return Bench.of(project.model, logs, found, switchable=robot_is_file(project))


def robot_is_file(project: Project) -> bool:
    """Tell whether the model is of a robot file, so that the configuration lists its terms."""
    from dynident.io.robot import SUFFIXES, model_file

    file = model_file(project.config.model, project.path.parent)
    return file is not None and file.suffix.lower() in SUFFIXES
