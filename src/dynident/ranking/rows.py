"""The rows of a comparison: what each smoother, and each combination with an estimator, has given."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.jobs import Status

__all__ = ["KEY", "NONE", "Outcome", "empty_row", "masks_of", "packed_masks", "schema"]

KEY = ("smoother", "estimator", "digest")
Mask = NDArray[np.bool_]


class Outcome(StrEnum):
    """What became of a combination: an estimate, one that did not converge, or none: since the log lacks what it needs,
    since the smoother leaves out too many samples, or since it raised an error, took too long or too much memory, or
    its process died."""

    OK = "ok"
    UNSETTLED = "unsettled"
    NOT_APPLICABLE = "not applicable"
    TOO_FEW = "too few samples"
    FAILED = Status.FAILED.value
    TIMED_OUT = Status.TIMED_OUT.value
    OUT_OF_MEMORY = Status.OUT_OF_MEMORY.value
    DIED = Status.DIED.value


NONE = (Outcome.FAILED, Outcome.TIMED_OUT, Outcome.OUT_OF_MEMORY, Outcome.DIED)  # another attempt may succeed


def schema() -> dict[str, Any]:
    """Return the columns of the table, and their types.

    ``smoother`` and ``estimator`` by name, the latter empty in the row of a smoother alone; ``digest`` of all that the
    row depends on; ``status`` (an ``Outcome``) and ``reason`` why there is no result; ``notes``: types of the notes.
    ``seconds`` of the smoothing of all logs or of the estimate, ``cv_seconds`` of the cross-validation, None without.
    Of a smoother: ``masks``, which samples it keeps, packed, the number in ``parts`` of the ``chosen`` one, and the
    time offset that was estimated, ``shift``: seconds, errors without and with it (%), its standard error, if known.
    Of a combination: sums of squares (N m, N)^2 of what is left of the torque on the ``held`` out logs (K n), on all of
    these by the motions of the configured smoother, ``alike`` (n), on the ``train``ing logs (n) and in the
    ``cross``-validation (K' n); ``condition``, smallest ``eigenvalue``; ``base`` (r) parameters and their standard
    errors ``std`` (r), where a truth is known.
    """
    import polars as pl

    floats = pl.List(pl.Float64)
    return {
        "smoother": pl.String, "estimator": pl.String, "digest": pl.String, "status": pl.String, "reason": pl.String,
        "notes": pl.List(pl.String), "seconds": pl.Float64, "cv_seconds": pl.Float64, "chosen": pl.Int64,
        "masks": pl.Binary, "shift": floats, "held": floats, "alike": floats, "train": floats, "cross": floats,
        "condition": pl.Float64, "eigenvalue": pl.Float64, "base": floats, "std": floats,
    }  # fmt: skip


def empty_row(key: tuple[str, str, str], status: Outcome, reason: str = "", seconds: float = 0.0) -> dict[str, Any]:
    """Return a row without a result."""
    names = ("notes", "shift", "held", "alike", "train", "cross", "base", "std")
    lists: dict[str, list[Any]] = {name: [] for name in names}
    none = dict.fromkeys(("cv_seconds", "chosen", "masks", "condition", "eigenvalue"))
    return {
        **dict(zip(KEY, key, strict=True)), "status": status.value, "reason": reason, "seconds": seconds, **lists,
        **none,
    }  # fmt: skip


def packed_masks(masks: Mapping[str, Mapping[str, Mask]]) -> bytes:
    """Return masks by role and log as bytes."""
    every = [mask for named in masks.values() for mask in named.values()]
    return zlib.compress(np.packbits(np.concatenate(every)).tobytes())


def masks_of(data: bytes, like: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Mask]]:
    """Return the masks of packed ones, of logs by role and name ``like`` those that they are of."""
    bits = np.unpackbits(np.frombuffer(zlib.decompress(data), dtype=np.uint8)).astype(bool)
    found: dict[str, dict[str, Mask]] = {}
    start = 0
    for role, named in like.items():
        found[role] = {}
        for name, log in named.items():
            found[role][name] = bits[start : start + len(log)]
            start += len(log)
    return found
