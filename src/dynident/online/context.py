"""A part of a motion that grows: its samples are delivered once those after them that matter are there, too."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.log import Motion

__all__ = ["Context", "cut", "joined"]

Array = NDArray[np.float64]
SIGNALS = ("t", "q", "dq", "ddq", "tau", "mask", "memory")
FEWEST = 2  # samples of a motion


class Context:
    """Holds ``before`` samples of a motion that were delivered, and those that wait for ``after`` further ones.

    ``multiple``: the first sample held is a multiple of so many samples after the first usable one, as a decimation of
    all that is usable needs it.
    """

    def __init__(self, before: int = 0, after: int = 0, multiple: int = 1) -> None:
        self.before, self.after, self.multiple = before, after, multiple
        self.held: Motion | None = None
        self._done = 0  # samples of these that were delivered

    def push(self, motion: Motion | None, *, ended: bool = False) -> tuple[Motion, slice] | None:
        """Take what follows; return all that is held, and which samples of it are delivered now; None for none.

        They are all that are left where a stretch has ``ended``; what follows then begins another.
        """
        held = motion if self.held is None else self.held if motion is None else joined(self.held, motion)
        if held is None:
            return None
        stop = len(held) if ended else len(held) - self.after
        new = slice(self._done, stop if stop >= self._done + FEWEST else self._done)
        first = self._first(held, new.stop)
        self.held, self._done = cut(held, slice(first, None)), new.stop - first
        if ended:
            self.clear()
        return (held, new) if new.start < new.stop else None

    def clear(self) -> None:
        """Begin anew."""
        self.held, self._done = None, 0

    @property
    def state(self) -> dict[str, Array]:
        """What it holds, as arrays; nothing where it is empty."""
        if self.held is None:
            return {}
        given = {name: getattr(self.held, name) for name in SIGNALS}
        return {"done": np.array(float(self._done))} | {
            name: np.array(x, dtype=float) for name, x in given.items() if x is not None
        }

    def restore(self, state: Mapping[str, Array], like: Motion) -> None:
        """Continue from a saved state; ``like`` is any motion of the same joints and source."""
        self.clear()
        if "t" in state:
            given: dict[str, Any] = {name: state.get(name) for name in SIGNALS}
            given["mask"] = np.asarray(state["mask"]) > 0
            self.held, self._done = replace(like, **given), int(state["done"])

    def _first(self, held: Motion, done: int) -> int:
        """Return the first sample to be kept, where so many were delivered."""
        first = min(max(done - self.before, 0), len(held) - FEWEST)
        usable = int(np.argmax(held.mask))
        return usable + (first - usable) // self.multiple * self.multiple if first > usable else first


def cut(motion: Motion, rows: slice) -> Motion:
    """Return some samples of a motion, with its memory; at least two."""
    pairs = ((name, getattr(motion, name)) for name in SIGNALS)
    part: dict[str, Any] = {name: None if x is None else x[rows] for name, x in pairs}
    return replace(motion, **part)


def joined(first: Motion, then: Motion) -> Motion:
    """Return two motions that follow each other as one, without the memory where one has none."""
    pairs = ((name, getattr(first, name), getattr(then, name)) for name in SIGNALS)
    whole: dict[str, Any] = {name: None if a is None or b is None else np.concatenate([a, b]) for name, a, b in pairs}
    return replace(then, **whole)
