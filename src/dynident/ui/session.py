"""A configuration that is tuned: its logs are read and identified in the background, then its pages are answered."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from dynident.errors import DynidentError, Step
from dynident.ui.latest import Latest
from dynident.ui.whole import WholeRuns

if TYPE_CHECKING:
    from pathlib import Path

    from dynident.io.project import Project
    from dynident.io.tuned_config import ConfigFile
    from dynident.tuning import Bench, Tuning

__all__ = ["Session"]

Report = Callable[[str], None]


@dataclass
class Session:
    """The configuration at ``path``, and what becomes of it: where its logs cannot be used, ``failed`` says why; else
    there is a ``bench``. ``files`` are the file as it was read and after each save, with the setting that it has.
    ``fault`` is told of errors that nobody foresaw.
    """

    path: Path
    fault: Report
    step: Step = Step("starting")  # noqa: RUF009 -- a text
    failed: str = ""
    bench: Bench | None = None
    runs: WholeRuns | None = None
    project: Project | None = None
    files: list[tuple[ConfigFile, Tuning]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.latest, self._saving = Latest(), threading.Lock()

    def start(self) -> None:
        """Begin to read the logs, and to identify them, in the background; again where this failed."""
        self.failed, self.step = "", Step("starting")
        threading.Thread(target=self._load, daemon=True).start()

    @property
    def saved(self) -> Tuning:
        """The setting that the file has."""
        return self.files[-1][1]

    def save(self, tuning: Tuning) -> list[str]:
        """Write a setting into the file; return where in it something else stands then.

        Raises the errors of ``ConfigFile.save``, and those of a setting that cannot be fitted: the file would be one
        that cannot be identified.
        """
        from dynident.io.tuned_config import tuned_changes
        from dynident.io.yaml_edit import place_words

        assert self.project is not None  # noqa: S101 -- there is a bench
        assert self.bench is not None  # noqa: S101
        self.bench.fitted(tuning)
        with self._saving:
            changes, last = tuned_changes(self.project, self.bench, tuning), self.files[-1][0]
            saved = last.save(changes)
            if saved is last:  # another tab was faster
                return []
            self.files.append((saved, tuning))
        return [place_words(path) for path in changes]

    def undo(self) -> None:
        """Write what was in the file before the last save. Raises the errors of ``ConfigFile.undo``."""
        with self._saving:
            before = self.files[-1][0].undo()
            self.files[:] = [*self.files[:-2], (before, self.files[-2][1])]

    def _load(self) -> None:
        try:
            self._loaded()
        except DynidentError as error:
            self.failed = str(error)
        except Exception as error:
            self.failed = f"This is a fault of dynident: {type(error).__name__}: {error}"
            self.fault("".join(traceback.format_exception(error)))

    def _loaded(self) -> None:
        from dynident.io.tuned import read_bench
        from dynident.io.tuned_config import ConfigFile

        project, bench = read_bench(self.path, self._say)
        self.files = [(ConfigFile.of(project), bench.start)]
        self.runs, self.project = WholeRuns(bench.whole), project
        self.bench = bench

    def _say(self, step: str) -> None:
        self.step = Step.of(step)
