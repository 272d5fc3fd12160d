"""Triangular factors in folds of time, of a model with all terms: any choice of them is some of their columns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from hashlib import blake2b
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.log import Log, Motion
from dynident.models import Model
from dynident.regression import Regression, TriangularFactors, factorise, merged

__all__ = ["FOLDS", "columns_in", "digest", "fold_factors", "of_columns", "opened", "without"]

Array = NDArray[np.float64]
FOLDS = 5  # as many as a smoother is chosen by


def fold_factors(regression: Regression, folds: int = FOLDS) -> tuple[TriangularFactors, ...]:
    """Return the factors of each of ``folds`` stretches of time: of each motion, equal shares of its usable samples.

    Rows are filtered as in the whole, so that all together give its factors.
    """
    found = []
    for k in range(folds):
        parts = []
        for i, motion in enumerate(regression.motions):
            start, stop = _edges(motion, folds)[k]
            parts.append(factorise(regression.entries(within=(i, slice(start, stop))), regression.model.structure))
        found.append(merged(parts))
    return tuple(found)


def _edges(motion: Motion, folds: int) -> list[tuple[int, int]]:
    """Return where folds start and stop."""
    used = np.flatnonzero(motion.mask)
    inner = [int(one[0]) if len(one) else len(motion) for one in np.array_split(used, folds)[1:]]
    return list(pairwise([0, *inner, len(motion)]))


def columns_in(whole: Model, model: Model) -> NDArray[np.intp] | None:
    """Return where the parameters of a model are among those of one with more terms; None where one is not."""
    places = {name: k for k, name in enumerate(whole.names)}
    if not set(model.names) <= places.keys():
        return None
    return np.array([places[name] for name in model.names], dtype=np.intp)


def of_columns(parts: Sequence[TriangularFactors], columns: NDArray[np.intp]) -> tuple[TriangularFactors, ...]:
    """Return the factors of some of the columns, with the torque."""
    some = np.append(columns, parts[0].factors.shape[2] - 1)
    return tuple(
        TriangularFactors(np.asarray(np.linalg.qr(one.factors[:, :, some], mode="r")), one.rows) for one in parts
    )


def opened(motion: Motion, unfitted: Sequence[str]) -> Motion:
    """Return a motion that keeps of joints that are not fitted what it keeps of all others: its factors serve any
    choice of joints, once ``without`` has left some out."""
    if motion.keep is None or not unfitted:
        return motion
    fitted = np.array([name not in unfitted for name in motion.joints])
    others: NDArray[np.bool_] = np.asarray(motion.keep[:, fitted].all(axis=1))
    keep: NDArray[np.bool_] = np.asarray(motion.keep | (others[:, None] & ~fitted))
    return replace(motion, keep=None if keep.all() else keep)


def without(parts: Sequence[TriangularFactors], joints: Sequence[int]) -> tuple[TriangularFactors, ...]:
    """Return the factors without the equations of some joints."""
    left = np.ones(len(parts[0].rows), dtype=int)
    left[list(joints)] = 0
    return tuple(TriangularFactors(one.factors * left[:, None, None], one.rows * left) for one in parts)


def digest(motions: Sequence[Motion], logs: Sequence[Log]) -> bytes:
    """Return a digest of which torque equations of the motions are fitted, and of torques that are not those of the
    logs."""
    found = blake2b(digest_size=16)
    for motion, log in zip(motions, logs, strict=True):
        found.update(b"all" if motion.keep is None else motion.keep.tobytes())
        found.update(b"" if motion.tau is log.tau else motion.tau.tobytes())
    return found.digest()
