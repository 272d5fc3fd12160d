"""A memory of results for several threads."""

from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event

import pytest

from dynident.runtime.cache import Cache


def test_what_two_ask_for_at_once_is_made_once() -> None:
    cache, made, both = Cache[int](2), list[int](), Barrier(2, timeout=10.0)
    asked = Event()

    def make() -> int:
        made.append(1)
        assert asked.wait(10.0)
        return 7

    def ask(last: bool) -> int:
        both.wait()
        if last:
            asked.set()
        return cache("key", make)

    with ThreadPoolExecutor(2) as threads:
        assert list(threads.map(ask, (False, True))) == [7, 7]
    assert made == [1]


def test_the_oldest_is_forgotten_and_an_error_not_kept() -> None:
    cache, made = Cache[str](2), list[str]()

    def ask(key: str) -> str:
        return cache(key, lambda: made.append(key) or key)

    for key in "abacb":
        assert ask(key) == key
    assert made == ["a", "b", "c", "b"]
    with pytest.raises(ZeroDivisionError):
        cache("d", lambda: str(1 // 0))
    assert cache("d", lambda: "d") == "d"
