"""A step of long work, as it is passed to ``progress``."""

from __future__ import annotations

__all__ = ["Step"]


class Step(str):
    """What is being done in a few words, and how much of it is ``done``, of a ``total`` where that is known.

    >>> Step("smoothing", 2, 5)
    'smoothing (2 of 5)'
    """

    words: str
    done: int
    total: int | None

    def __new__(cls, words: str, done: int = 0, total: int | None = None) -> Step:
        """Make the text of all three."""
        count = "" if total is None and not done else f" ({done})" if total is None else f" ({done} of {total})"
        step = super().__new__(cls, words + count)
        step.words, step.done, step.total = words, done, total
        return step

    @classmethod
    def of(cls, step: str) -> Step:
        """Return a step of which only the words are known as one."""
        return step if isinstance(step, Step) else cls(step)
