"""Signatures of classes that their base makes dataclasses: griffe reads the source, and knows decorators alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import griffe

BASES = ("dynident.runtime.errors.Noun", "dynident.runtime.notes.Statement")
DATACLASS = griffe.ExprName("dataclasses.dataclass")


class FrozenData(griffe.Extension):
    """Gives each class derived from such a base the decorator that the base applies."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Look through all classes of a package, before griffe makes their signatures."""
        for kind in _classes(pkg):
            if any(base.canonical_path in BASES for base in kind.mro()):
                kind.decorators.append(griffe.Decorator(DATACLASS, lineno=None, endlineno=None))


def _classes(parent: griffe.Module | griffe.Class) -> Iterator[griffe.Class]:
    for member in parent.members.values():
        if isinstance(member, griffe.Module | griffe.Class):
            yield from _classes(member)
            if isinstance(member, griffe.Class):
                yield member
