"""A remark on a log, a robot file or both: how grave it is, where, and in words what it is and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from dynident.errors import InputError

__all__ = ["Finding", "require"]


@dataclass(frozen=True)
class Finding:
    """One remark: ``severity``, the ``joint`` it concerns (None: all of them), and words with the cure.

    An error is what would give wrong numbers, a warning what to look at, an info what is good to know. ``topic`` is a
    short lasting name for programs and for gathering like remarks; ``source`` the log or file, ``link`` the link that
    it is about, each empty where it is about none.
    """

    severity: Literal["error", "warning", "info"]
    joint: str | None
    message: str
    topic: str = ""
    source: str = ""
    link: str = ""

    def __str__(self) -> str:
        return self.message if self.joint is None else f"joint {self.joint!r}: {self.message}"


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError with every finding that is an error, one a line; return where there is none."""
    errors = [str(finding) for finding in findings if finding.severity == "error"]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))
