"""All that reading a log raises or warns of has words below ``report``."""

from __future__ import annotations

from dynident.checks import notes, reading_words


def test_every_note_on_reading_has_words_and_no_other_does() -> None:
    said = {kind for kind in reading_words.registry if kind is not object}
    assert said == set(notes.ReadingNote.__subclasses__())
