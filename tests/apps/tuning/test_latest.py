"""What was overtaken while it waited is not done."""

from __future__ import annotations

import threading

import pytest

from dynident.apps.tuning.session import Latest, Stale


def test_the_newest_of_those_that_wait_is_done() -> None:
    latest, begun, go = Latest(), threading.Event(), threading.Event()
    done: list[str] = []

    def slow() -> None:
        begun.set()
        go.wait(10)
        done.append("first")

    def ask(name: str) -> None:
        try:
            latest("page", lambda: done.append(name))
        except Stale:
            done.append(f"not {name}")

    first = threading.Thread(target=lambda: latest("page", slow))
    first.start()
    begun.wait(10)
    second = threading.Thread(target=ask, args=("second",))
    second.start()
    while latest._askers["page"][1][0] < 2:
        pass
    third = threading.Thread(target=ask, args=("third",))
    third.start()
    while latest._askers["page"][1][0] < 3:
        pass
    assert latest("another page", lambda: "at once") == "at once"
    go.set()
    for one in (first, second, third):
        one.join(10)
    assert done[0] == "first"
    assert set(done[1:]) == {"not second", "third"}


def test_errors_are_passed_on_and_forgotten() -> None:
    latest = Latest()
    with pytest.raises(ZeroDivisionError):
        latest("page", lambda: 1 // 0)
    assert latest("page", lambda: 2) == 2
