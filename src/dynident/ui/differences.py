"""What differs between two settings, and between what they give, in words."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from dynident.report.page import number
from dynident.report.part_words import part_words
from dynident.report.words import percent

if TYPE_CHECKING:
    from dynident.tuning import Tuning

__all__ = ["Change", "changes", "degree_words", "error_words", "estimator_words"]

Change = tuple[str, str, str]  # what, before, now


def changes(before: Tuning, now: Tuning, joints: Sequence[str]) -> list[Change]:
    """Return what differs between two settings: what it is, and how it was and is; the same of all joints once."""
    found = [
        *_by_joint("smoothing", before.degree, now.degree, joints, degree_words),
        *_by_joint("minimum speed", before.min_speed, now.min_speed, joints, lambda value: number(value, 3)),
        *_by_joint("terms", before.terms, now.terms, joints, lambda kinds: ", ".join(kinds) or "none"),
    ]
    for what, words in WHOLE.items():
        if (was := words(before)) != (is_now := words(now)):
            found.append((what, was, is_now))
    return [*found, *_windows(before, now)]


def degree_words(degree: float) -> str:
    """Word a degree of smoothing by S/n."""
    return f"S/n = {number(10.0**degree, 3)}"


def estimator_words(kind: str) -> str:
    """Word a kind of estimator, one of the user by its name."""
    return {"consistent": "physically consistent"}.get(kind, kind.replace("_", " "))


def error_words(value: float | None) -> str:
    """Word an error in per cent."""
    return "-" if value is None or value != value else percent(value)


WHOLE: Mapping[str, Callable[[Tuning], str]] = {
    "joints not fitted": lambda one: ", ".join(one.unfitted) or "none",
    "parallel filter": lambda one: "none" if one.filter is None else part_words(one.filter),
    "estimator": lambda one: estimator_words(one.estimator),
    "time offset": lambda one: f"{number(1e3 * one.time_offset, 4)} ms",
}


def _by_joint(
    what: str, before: Sequence[Any], now: Sequence[Any], joints: Sequence[str], words: Any
) -> Iterator[Change]:
    differ = [k for k in range(len(joints)) if before[k] != now[k]]
    pairs = {(words(before[k]), words(now[k])) for k in differ}
    if len(pairs) == 1 and len(differ) == len(joints) > 1:
        yield (f"{what} of all joints", *pairs.pop())
        return
    for k in differ:
        yield f"{what} of {joints[k]}", words(before[k]), words(now[k])


def _windows(before: Tuning, now: Tuning) -> Iterator[Change]:
    for one in before.excluded:
        if one not in now.excluded:
            yield f"samples of {one[0]}", f"without {number(one[1], 4)} to {number(one[2], 4)} s", "used again"
    for one in now.excluded:
        if one not in before.excluded:
            yield f"samples of {one[0]}", "used", f"without {number(one[1], 4)} to {number(one[2], 4)} s"
