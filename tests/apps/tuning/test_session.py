"""Where a session saves; work that nobody waits for any longer is not done."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("dash")

from dynident.apps.tuning import Bench, Tuning
from dynident.apps.tuning import session as session_module
from dynident.apps.tuning.session import Latest, Session, Stale, WholeRuns
from dynident.runtime import (
    DynidentError,
    InputError,
    Step,
    budget_scope,
    memory_budget,
    report_progress,
    set_budget,
)


@pytest.fixture
def session(validated_arm: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setattr(session_module, "tuned_text", lambda _project, _bench, tuning, path: f"{path.name} {tuning}")
    return session_of(tmp_path / "arm.yaml", validated_arm)


def session_of(path: Path, bench: Bench) -> Session:
    return Session(SimpleNamespace(path=path), bench, print)  # type: ignore[arg-type]


def test_a_file_that_the_session_did_not_write_stays(session: Session, validated_arm: Bench) -> None:
    path, start, tuned = session.project.path, validated_arm.start, validated_arm.start.with_degree(1.0)
    path.write_text("mine")
    assert session.save(start) == path.with_name("arm-tuned.yaml")
    assert session.save(tuned) == path.with_name("arm-tuned.yaml")  # its own is replaced
    assert path.with_name("arm-tuned.yaml").read_text() == f"arm-tuned.yaml {tuned}"
    path.with_name("arm-tuned.yaml").write_text("edited by hand")
    assert session.save(start) == path.with_name("arm-tuned-2.yaml")
    other = session_of(path.with_name("arm-tuned-2.yaml"), validated_arm)
    assert other.save(start) == path.with_name("arm-tuned-3.yaml")
    texts = [file.read_text() for file in sorted(path.parent.iterdir())]
    assert texts == [f"arm-tuned-{k}.yaml {start}" for k in (2, 3)] + ["edited by hand", "mine"]


def test_what_cannot_be_fitted_is_not_saved(session: Session, validated_arm: Bench) -> None:
    with pytest.raises(DynidentError, match="0 usable samples"):
        session.save(validated_arm.start.exclude(validated_arm.log_names[0], -1.0, 100.0))
    assert not list(session.project.path.parent.iterdir())


def test_the_thread_has_the_memory_of_the_run() -> None:
    with budget_scope():
        set_budget(2.5)
        runs = WholeRuns(lambda _: memory_budget())  # type: ignore[arg-type,return-value]
        runs.request_run("page", ONE)
    assert wait_for(runs, ONE).result == 2_500_000_000


ONE, TWO, THREE, WRONG = (Tuning((float(k),), ((),), (0.0,), "least_squares") for k in (1, 2, 3, 4))


def wait_for(runs: WholeRuns, tuning: Tuning):
    with runs._changed:
        assert runs._changed.wait_for(lambda: tuning in runs._ended, 10)
    return runs.outcome(tuning)


def test_a_whole_run_that_nobody_waits_for_any_longer_is_given_up():
    begun, go, requests = threading.Event(), threading.Event(), []

    def identify(tuning):
        requests.append(tuning)
        report_progress(Step("smoothing", 1, 4))
        begun.set()
        go.wait(10)
        report_progress("fitting")
        if tuning == THREE:
            raise InputError("nothing is left.")
        if tuning == WRONG:
            raise RuntimeError("no")
        return SimpleNamespace(of=tuning)

    runs = WholeRuns(identify)
    runs.request_run("page", ONE)
    assert begun.wait(10)
    assert runs.step(ONE) == "smoothing (1 of 4)"
    assert runs.step(TWO) == "waiting"
    runs.request_run("page", TWO)
    go.set()
    runs.request_run("other page", THREE)
    assert wait_for(runs, TWO).result.of == TWO
    assert wait_for(runs, THREE).failed == "nothing is left."
    assert runs.outcome(ONE) is None
    runs.request_run("page", TWO)  # has ended
    runs.request_run("page", WRONG)  # a fault ends a setting and not the runs
    assert "fault of dynident: RuntimeError: no" in wait_for(runs, WRONG).failed
    assert requests == [ONE, TWO, THREE, WRONG]


def test_the_newest_of_the_answers_that_wait_is_made() -> None:
    latest, begun, go = Latest(), threading.Event(), threading.Event()
    done: list[str] = []

    def work() -> None:
        begun.set()
        go.wait(10)
        done.append("first")

    def ask(name: str) -> None:
        try:
            latest("page", lambda: done.append(name))
        except Stale:
            done.append(f"not {name}")

    threads = [threading.Thread(target=lambda: latest("page", work))]
    threads[0].start()
    begun.wait(10)
    for number, name in ((2, "second"), (3, "third")):
        threads.append(threading.Thread(target=ask, args=(name,)))
        threads[-1].start()
        while latest._askers["page"][1][0] < number:
            pass
    assert latest("another page", lambda: "at once") == "at once"
    go.set()
    for thread in threads:
        thread.join(10)
    assert done[0] == "first"
    assert set(done[1:]) == {"not second", "third"}
    with pytest.raises(ZeroDivisionError):
        latest("page", lambda: 1 // 0)
    assert latest("page", lambda: 2) == 2
