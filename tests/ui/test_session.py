"""What a session saves, and what it takes for saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("dash")

from dynident.errors import DynidentError
from dynident.io import tuned_config
from dynident.tuning import Bench
from dynident.ui.session import Session


class File:
    """A file of one setting after the other."""

    def __init__(self, texts: tuple[object, ...] = (None,)) -> None:
        self.texts = texts

    def save(self, text: object) -> File:
        return self if text == self.texts[-1] else File((*self.texts, text))

    def undo(self) -> File:
        return File(self.texts[:-1])


@pytest.fixture
def session(arm: Bench, monkeypatch: pytest.MonkeyPatch) -> Session:
    def changes(_project: Any, _bench: Bench, tuning: Any) -> dict[tuple[str], Any]:
        return {("degree",): tuning.degree}

    monkeypatch.setattr(tuned_config, "tuned_changes", changes)
    one = Session(Path("arm.yaml"), print)
    one.bench, one.project, one.files = arm, object(), [(File(), arm.start)]  # type: ignore[assignment,list-item]
    return one


def test_what_two_tabs_save_is_undone_once(session: Session, arm: Bench) -> None:
    set_ = arm.start.with_degree(1.0)
    assert session.save(set_) == ["degree"]
    assert session.save(set_) == []
    session.undo()
    assert session.saved == arm.start
    assert len(session.files) == 1


def test_what_cannot_be_fitted_is_not_saved(session: Session, arm: Bench) -> None:
    with pytest.raises(DynidentError, match="0 usable samples"):
        session.save(arm.start.excluding(arm.log_names[0], -1.0, 100.0))
    assert len(session.files) == 1
