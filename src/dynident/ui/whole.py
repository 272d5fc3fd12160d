"""Whole identifications in the background, one at a time: of each page the newest setting alone."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from dynident.errors import DynidentError, Step, brief

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.tuning import Tuning

__all__ = ["Ended", "WholeRuns"]

KEPT = 8  # results; one holds the signals of all logs
Identify = Callable[["Tuning", Callable[[str], None]], "Identification"]


class _Overtaken(Exception):  # noqa: N818 -- no error: nobody waits for it any longer
    """No page waits for this setting."""


@dataclass(frozen=True, eq=False)
class Ended:
    """What became of a whole identification: what it ``found``, or why it ``failed``, in words."""

    found: Identification | None
    failed: str = ""

    __repr__ = brief


class WholeRuns:
    """Identifies wholly, by ``identify``, the settings that pages wait for, each page for its last.

    What no page waits for any longer is given up at the next step of its work.
    """

    def __init__(self, identify: Identify) -> None:
        self._identify = identify
        self._changed = threading.Condition()
        self._wanted = OrderedDict[str, "Tuning"]()  # by page, the oldest first
        self._ended = OrderedDict["Tuning", Ended]()
        self._now: tuple[Tuning, Step] | None = None
        self._thread: threading.Thread | None = None

    def want(self, page: str, tuning: Tuning) -> None:
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

    def ended(self, tuning: Tuning) -> Ended | None:
        """Return what became of a setting; None while it is waited for."""
        with self._changed:
            return self._ended.get(tuning)

    def step(self, tuning: Tuning) -> Step:
        """Return what is being done for a setting."""
        with self._changed:
            if self._now is not None and self._now[0] == tuning:
                return self._now[1]
        return Step("waiting")

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted)
                tuning = next(iter(self._wanted.values()))
                self._now = tuning, Step("starting")
            try:
                ended = self._whole(tuning)
            except _Overtaken:
                continue
            with self._changed:
                self._ended[tuning] = ended
                self._wanted = OrderedDict((page, one) for page, one in self._wanted.items() if one != tuning)
                while len(self._ended) > KEPT:
                    self._ended.popitem(last=False)
                self._now = None
                self._changed.notify_all()

    def _whole(self, tuning: Tuning) -> Ended:
        def progress(step: str) -> None:
            with self._changed:
                if tuning not in self._wanted.values():
                    raise _Overtaken
                self._now = tuning, Step.of(step)

        try:
            return Ended(self._identify(tuning, progress))
        except DynidentError as error:
            return Ended(None, str(error))
        except _Overtaken:
            raise
        except Exception as error:  # a fault of dynident ends this setting, not the page
            return Ended(None, f"This is a fault of dynident: {type(error).__name__}: {error}")
