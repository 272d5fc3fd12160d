"""What a likelihood's end tells besides its values: remarks in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Verdict
from dynident.likelihood import Fitted, Search, whiteness

__all__ = ["remarks", "undetermined"]

Array = NDArray[np.float64]
APART = 1.3  # ratio of the sandwich's standard error to the likelihood's, from which on it is told
BORNE = 20.0  # parts of the recordings that must bear a parameter to tell its sandwich
SURE = 4.0  # standard deviations of the sandwich's own chance that make a difference one
EXACT = 1e-3  # residuals, relative to the largest torque, that are as good as none
COLOURED, UNLIKELY = 0.1, 1e-3  # correlation of neighbours, and its probability, that make residuals not white


def remarks(
    search: Search,
    fitted: Fitted,
    names: Sequence[str],
    inverse: Array,
    lost: NDArray[np.bool_],
    tau: Sequence[Array],
) -> list[str]:
    """Return what is to be said of the torque's residuals ``tau``, and of standard errors, by the pseudo-inverse."""
    words = []
    colour = _colour(tau)
    largest = np.abs(np.concatenate([log.tau for log in search.given.logs])).max(axis=0)
    if colour and (search.sigma_tau > EXACT * largest).any():
        words.append(
            f"the torque's residuals are not white (correlation of neighbours {colour:.2f}): the model leaves out "
            "more than noise, so compare with least squares on held-out motion"
        )
    sandwich, borne = search.spread(fitted, inverse)
    std = np.sqrt(np.diag(inverse))
    ratio = np.divide(sandwich, std, out=np.ones_like(std), where=(std > 0) & (borne > BORNE) & ~lost)
    ratio[ratio**2 - 1 < SURE / np.sqrt(np.maximum(borne, BORNE))] = 1.0
    worst = int(np.argmax(ratio))
    if ratio[worst] > APART:  # smaller ones come about by chance, where a few samples tell most
        words.append(
            f"standard errors take residuals for white noise; by their scatter along the recordings that of "
            f"{names[worst]} is {ratio[worst]:.2g} times as large"
        )
    return words


def undetermined(names: Sequence[str], lost: NDArray[np.bool_], rank: int, verdict: Sequence[Verdict]) -> list[str]:
    """Return what is to be said of parameters that the data leave free."""
    if not lost.any():
        return []
    if verdict:
        count = sum(word != "data" for word in verdict)
        return [f"rank {rank} of {len(lost)}; {count} parameters are not decided by the data alone"]
    gone = ", ".join(name for name, one in zip(names, lost, strict=True) if one)
    return [f"rank {rank} of {len(lost)}: not determined alone: {gone}"]


def _colour(tau: Sequence[Array]) -> float:
    """Return the largest correlation of neighbouring residuals of a joint, zero where they are as good as white."""
    if min(whiteness(x, 0) for x in tau) > UNLIKELY:
        return 0.0
    power = np.maximum(sum((x**2).sum(axis=0) for x in tau), 1e-300)
    found = float((sum((x[1:] * x[:-1]).sum(axis=0) for x in tau) / power).max())
    return found if found > COLOURED else 0.0
