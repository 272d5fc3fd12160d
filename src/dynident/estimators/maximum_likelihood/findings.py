"""The notes of a maximum-likelihood estimate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note
from dynident.estimators.estimator import Provenance
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit
from dynident.estimators.maximum_likelihood.plan import whiteness
from dynident.estimators.maximum_likelihood.search import Search
from dynident.estimators.notes import NotAlone, NotByData, NotWhite, RankDeficient, ScatterLarger

__all__ = ["residual_notes", "undetermined_notes"]

Array = NDArray[np.float64]
APART = 1.3  # ratio of the sandwich's standard error to the likelihood's above which it is noted
BORNE = 20.0  # parts of the recordings that must contribute to a parameter for its sandwich to be reliable
SURE = 4.0  # standard deviations of the sandwich's own sampling error that make a difference significant
EXACT = 1e-3  # residuals, relative to the largest torque, that count as zero
COLOURED, UNLIKELY = 0.1, 1e-3  # correlation of neighbours, and its probability, that make residuals not white


def residual_notes(
    search: Search,
    fitted: LikelihoodFit,
    names: Sequence[str],
    inverse: Array,
    undetermined: NDArray[np.bool_],
    tau: Sequence[Array],
) -> list[Note]:
    """Return the notes on the torque's residuals ``tau`` and on standard errors, by the pseudo-inverse."""
    found: list[Note] = []
    colour = _colour(tau)
    largest = np.abs(np.concatenate([log.tau for log in search.given.logs])).max(axis=0)
    if colour and (search.sigma.tau > EXACT * largest).any():
        found.append(NotWhite(colour))
    sandwich, borne = search.sandwich_std(fitted, inverse)
    std = np.sqrt(np.diag(inverse))
    ratio = np.divide(sandwich, std, out=np.ones_like(std), where=(std > 0) & (borne > BORNE) & ~undetermined)
    ratio[ratio**2 - 1 < SURE / np.sqrt(np.maximum(borne, BORNE))] = 1.0
    worst = int(np.argmax(ratio))
    if ratio[worst] > APART:  # smaller ones occur by chance where a few samples dominate
        found.append(ScatterLarger(names[worst], float(ratio[worst])))
    return found


def undetermined_notes(
    names: Sequence[str], undetermined: NDArray[np.bool_], rank: int, provenance: Sequence[Provenance]
) -> list[Note]:
    """Return the notes on parameters that the data do not determine."""
    if not undetermined.any():
        return []
    if provenance:
        return [
            RankDeficient(rank, len(undetermined)),
            NotByData(sum(one is not Provenance.DATA for one in provenance)),
        ]
    gone = tuple(name for name, one in zip(names, undetermined, strict=True) if one)
    return [RankDeficient(rank, len(undetermined)), NotAlone(gone)]


def _colour(tau: Sequence[Array]) -> float:
    """Return the largest correlation of neighbouring residuals of a joint, zero where they are nearly white."""
    if min(whiteness(x, 0) for x in tau) > UNLIKELY:
        return 0.0
    power = np.maximum(sum((x**2).sum(axis=0) for x in tau), 1e-300)
    found = float((sum((x[1:] * x[:-1]).sum(axis=0) for x in tau) / power).max())
    return found if found > COLOURED else 0.0
