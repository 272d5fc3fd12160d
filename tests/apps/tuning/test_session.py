"""What a session saves, and what it takes for saved."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("dash")

from dynident.apps.tuning import Bench
from dynident.apps.tuning import config as tuned_config
from dynident.apps.tuning.session import Session, WholeRuns
from dynident.runtime import DynidentError, budget_scope, memory_budget, set_budget


class File:
    """A file of one setting after the other."""

    def __init__(self, texts: tuple[object, ...] = (None,)) -> None:
        self.texts = texts

    def save(self, text: object) -> File:
        return self if text == self.texts[-1] else File((*self.texts, text))

    def undo(self) -> File:
        return File(self.texts[:-1])


@pytest.fixture
def session(validated_arm: Bench, monkeypatch: pytest.MonkeyPatch) -> Session:
    def changes(_project: Any, _bench: Bench, tuning: Any) -> dict[tuple[str], Any]:
        return {("degree",): tuning.degree}

    monkeypatch.setattr(tuned_config, "tuned_changes", changes)
    one = Session(Path("arm.yaml"), print)
    one.bench, one.project, one.files = validated_arm, object(), [(File(), validated_arm.start)]  # type: ignore[assignment,list-item]
    return one


def test_what_two_tabs_save_is_undone_once(session: Session, validated_arm: Bench) -> None:
    set_ = validated_arm.start.with_degree(1.0)
    assert session.save(set_) == ["degree"]
    assert session.save(set_) == []
    session.undo()
    assert session.saved_tuning == validated_arm.start
    assert len(session.files) == 1


def test_what_cannot_be_fitted_is_not_saved(session: Session, validated_arm: Bench) -> None:
    with pytest.raises(DynidentError, match="0 usable samples"):
        session.save(validated_arm.start.exclude(validated_arm.log_names[0], -1.0, 100.0))
    assert len(session.files) == 1


def test_the_threads_have_the_memory_of_the_run(monkeypatch: pytest.MonkeyPatch) -> None:
    seen, ended = list[int](), threading.Barrier(2, timeout=60)

    def look(*_: object) -> object:
        seen.append(memory_budget())
        ended.wait()
        return "done"

    monkeypatch.setattr(Session, "_load_bench", look)
    with budget_scope():
        set_budget(2.5)
        Session(Path("arm.yaml"), print).start()
        ended.wait()
        WholeRuns(look).request_run("page", "setting")  # type: ignore[arg-type]
        ended.wait()
    assert seen == [2_500_000_000, 2_500_000_000]
