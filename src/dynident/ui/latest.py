"""One piece of work at a time for each asker, and of those that wait the newest alone."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from threading import Lock
from typing import TypeVar

__all__ = ["Latest", "Stale"]

Found = TypeVar("Found")
ASKERS = 64  # that are remembered


class Stale(Exception):  # noqa: N818 -- no error: a newer request has come
    """The request is no longer of interest: a newer one of the same asker has come."""


class Latest:
    """Does the work of each asker one by one; what was overtaken while it waited is not done."""

    def __init__(self) -> None:
        self._lock, self._askers = Lock(), OrderedDict[Hashable, tuple[Lock, list[int]]]()

    def __call__(self, asker: Hashable, work: Callable[[], Found]) -> Found:
        """Return what the work returns; raise ``Stale`` where a newer request of the ``asker`` came before it began."""
        with self._lock:
            own, newest = self._askers.setdefault(asker, (Lock(), [0]))
            self._askers.move_to_end(asker)
            newest[0] += 1
            mine = newest[0]
            while len(self._askers) > ASKERS:
                self._askers.popitem(last=False)
        with own:
            if mine != newest[0]:
                raise Stale
            return work()
