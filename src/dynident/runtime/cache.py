"""Results that are computed once: facts that a noun keeps about itself, and a cache for several threads."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from threading import Lock
from typing import Any, Generic, TypeVar

T = TypeVar("T")
F = TypeVar("F")


class KeepsFacts:
    """A base of immutable nouns that keep what was computed from them alone, for as long as they live.

    A changed copy and a pickle start without facts.
    """

    def fact(self, name: Hashable, compute: Callable[[], F]) -> F:
        """Return the fact of that name, computed where it is first asked for, or each time where that has no hash."""
        try:
            hash(name)
        except TypeError:
            return compute()
        facts: dict[Hashable, Any] = self.__dict__.setdefault("_facts", {})
        if name not in facts:
            facts[name] = compute()
        value: F = facts[name]
        return value

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_facts"}


class Cache(Generic[T]):
    """Keeps the last ``size`` results by key; an error is raised in all threads that wait for it, and not kept."""

    def __init__(self, size: int) -> None:
        self._size, self._lock = size, Lock()
        self._known: OrderedDict[Hashable, Future[T]] = OrderedDict()

    def __call__(self, key: Hashable, make: Callable[[], T]) -> T:
        """Return the cached result for the key, else that of ``make``."""
        with self._lock:
            future, is_new = self._known.get(key), False
            if future is None:
                future, is_new = Future(), True
                # The lock is held only to register the future; the result is computed without it.
                self._known[key] = future
                while len(self._known) > self._size:
                    self._known.popitem(last=False)
            self._known.move_to_end(key)
        if is_new:
            self._fill(key, future, make)
        return future.result()

    def _fill(self, key: Hashable, future: Future[T], make: Callable[[], T]) -> None:
        try:
            future.set_result(make())
        except BaseException as error:  # those who wait must not wait for ever
            with self._lock:
                if self._known.get(key) is future:
                    del self._known[key]
            future.set_exception(error)

    def __repr__(self) -> str:
        return f"<Cache of {len(self._known)} results>"
