"""What all pages of a configuration share: its bench, whole identifications in the background, the saved file."""

from __future__ import annotations

import os
import re
import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from dataclasses import dataclass, field
from itertools import chain, count
from pathlib import Path
from threading import Lock
from typing import TypeVar

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.config import tuned_text
from dynident.apps.tuning.tuning import Tuning
from dynident.files.opener import content
from dynident.files.results import write_text
from dynident.identification import Identification
from dynident.project.project import Project
from dynident.runtime import BudgetedFunction, DynidentError, Noun, Step, brief, progress_to

WorkResult = TypeVar("WorkResult")
MAX_KEPT_RUNS = 8  # results; one holds the signals of all logs
Identify = Callable[["Tuning"], "Identification"]


class Stale(Exception):  # noqa: N818 -- no error: a newer request has come
    """The request is no longer of interest: a newer one of the same asker has come."""


class Latest:
    """Does the work of each asker one by one; work that was overtaken while it waited is not done."""

    def __init__(self) -> None:
        self._lock, self._askers = Lock(), dict[Hashable, tuple[Lock, list[int]]]()

    def __call__(self, asker: Hashable, work: Callable[[], WorkResult]) -> WorkResult:
        """Return what the work returns; raise ``Stale`` where a newer request of the ``asker`` came before it began."""
        with self._lock:
            lock, newest = self._askers.setdefault(asker, (Lock(), [0]))
            newest[0] += 1
            number = newest[0]
        with lock:
            if number != newest[0]:
                raise Stale
            return work()


class _Overtaken(Exception):  # noqa: N818 -- no error: nobody waits for it any longer
    """No page waits for this setting."""


class RunOutcome(Noun):
    """Outcome of a whole identification: its ``result``, or why it ``failed``, in words."""

    result: Identification | None
    failed: str = ""


class WholeRuns:
    """Identifies by ``identify`` the settings that pages wait for, for each page its last.

    A run that no page waits for any longer is given up at the next step of its work.
    """

    def __init__(self, identify: Identify) -> None:
        self._identify = BudgetedFunction(identify)
        self._changed = threading.Condition()
        self._wanted = OrderedDict[str, "Tuning"]()  # by page, the oldest first
        self._ended = OrderedDict["Tuning", RunOutcome]()
        self._now: tuple[Tuning, Step] | None = None
        self._thread: threading.Thread | None = None

    def request_run(self, page: str, tuning: Tuning) -> None:
        """Let a page wait for a setting, and no longer for another."""
        with self._changed:
            self._wanted.pop(page, None)
            if tuning in self._ended:
                self._ended.move_to_end(tuning)
                return
            self._wanted[page] = tuning
            if self._thread is None:
                self._thread = threading.Thread(target=self._run, daemon=True)
                self._thread.start()
            self._changed.notify_all()

    def outcome(self, tuning: Tuning) -> RunOutcome | None:
        """Return the outcome of a setting; None while it is waited for."""
        with self._changed:
            return self._ended.get(tuning)

    def step(self, tuning: Tuning) -> Step:
        """Return the current step for a setting."""
        with self._changed:
            if self._now is None:
                return Step("about to begin")
            current, step = self._now
        return step if current == tuning else Step(f"waits for the fit of another setting, which is at: {step.words}")

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted)
                # the page that has waited longest comes first; its setting may change meanwhile
                tuning = next(iter(self._wanted.values()))
                self._now = tuning, Step("starting")
            try:
                outcome = self._identify_whole(tuning)
            except _Overtaken:
                continue
            with self._changed:
                self._ended[tuning] = outcome
                # all pages that wait for this setting are served by one run
                self._wanted = OrderedDict((page, wanted) for page, wanted in self._wanted.items() if wanted != tuning)
                while len(self._ended) > MAX_KEPT_RUNS:
                    self._ended.popitem(last=False)
                self._now = None
                self._changed.notify_all()

    def _identify_whole(self, tuning: Tuning) -> RunOutcome:
        def note_step(step: str) -> None:
            with self._changed:
                if tuning not in self._wanted.values():
                    raise _Overtaken
                self._now = tuning, Step.of(step)

        try:
            with progress_to(note_step):
                return RunOutcome(self._identify(tuning))
        except DynidentError as error:
            return RunOutcome(None, str(error))
        except _Overtaken:
            raise
        except Exception as error:  # a fault of dynident ends this setting, not the page
            return RunOutcome(None, f"This is a fault of dynident: {type(error).__name__}: {error}")


@dataclass(eq=False)
class Session:
    """A ``bench`` of a ``project`` that pages tune. ``fault`` is called with unexpected errors.

    ``saved`` are the files that tuned settings were saved to, by tab, each with its text.
    """

    project: Project
    bench: Bench
    fault: Callable[[str], None]
    saved: dict[str, tuple[Path, str]] = field(default_factory=dict)

    __repr__ = brief

    def __post_init__(self) -> None:
        self.latest, self.runs, self._saving = Latest(), WholeRuns(self.bench.identify), threading.Lock()

    def save(self, tuning: Tuning, tab: str = "") -> Path:
        """Write the configuration of a setting beside that of the session; return its path.

        The file of a former save of the ``tab`` is replaced while it is as it was written, another file never. Raises
        the errors of ``tuned_text`` and ``write_text``, and those of a setting that cannot be fitted.
        """
        # fails before anything is written, where the setting cannot be fitted
        self.bench.fit(tuning)
        with self._saving:
            path = next(path for path in tuned_paths(self.project.path) if self._is_free(path, tab))
            text = tuned_text(self.project, self.bench, tuning, path)
            self.saved[tab] = write_text(path, text), text
        return path

    def _is_free(self, path: Path, tab: str) -> bool:
        """Return whether a file may be written: there is none, or that of the former save of a tab."""
        if not os.path.lexists(path):
            return True
        saved_path, text = self.saved.get(tab, (None, ""))
        return saved_path == path and content(path, remember=False) == text.encode()


def tuned_paths(path: Path) -> Iterator[Path]:
    """Yield the names under which settings tuned from a configuration are saved: ``robot-tuned.yaml``, ``-tuned-2``."""
    stem = re.sub(r"-tuned(-\d+)?$", "", path.stem)
    return (path.with_name(f"{stem}-tuned{number}.yaml") for number in chain([""], (f"-{k}" for k in count(2))))
