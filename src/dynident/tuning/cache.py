"""A memory of results for several threads: each is computed once, also where two ask for it at the same time."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from threading import Lock
from typing import Generic, TypeVar

__all__ = ["Cache"]

T = TypeVar("T")


class Cache(Generic[T]):
    """Keeps the last ``size`` results by key; an error is raised in all threads that wait for it, and not kept."""

    def __init__(self, size: int) -> None:
        self._size, self._lock = size, Lock()
        self._known: OrderedDict[Hashable, Future[T]] = OrderedDict()

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return what is known by the key, else what ``make`` returns."""
        with self._lock:
            found, mine = self._known.get(key), False
            if found is None:
                found, mine = Future(), True
                self._known[key] = found
                while len(self._known) > self._size:
                    self._known.popitem(last=False)
            self._known.move_to_end(key)
        if mine:
            self._fill(key, found, make)
        return found.result()

    def _fill(self, key: Hashable, found: Future[T], make: Callable[[], T]) -> None:
        try:
            found.set_result(make())
        except BaseException as error:  # those who wait must not wait for ever
            with self._lock:
                if self._known.get(key) is found:
                    del self._known[key]
            found.set_exception(error)

    def __repr__(self) -> str:
        return f"<Cache of {len(self._known)} results>"
