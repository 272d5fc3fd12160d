"""A configuration that is tuned: its logs are read and identified first, in the background; then its pages are answered."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.errors import DynidentError, Step
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
    saved: Tuning | None = None

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
        from dynident.io.tuned import read_bench

        self.project, bench = read_bench(self.path, self._say)
        self.runs = WholeRuns(bench.whole)
        self.bench = bench

    def _say(self, step: str) -> None:
        self.step = Step.of(step)
