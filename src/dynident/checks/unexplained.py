"""What remains of the torque when no cause of it was found: at the reversals of a joint, and in all."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import as_measured, steady
from dynident.checks.finding import Finding, Topic
from dynident.checks.misfit import FOLDS, Misfit, misfit
from dynident.checks.robot_notes import SIMULATION, LeftAtReversals, Unexplained
from dynident.errors import Severity
from dynident.log import Motion, subsample, thinned
from dynident.models import Model

__all__ = ["reversal_findings", "unexplained"]

Array = NDArray[np.float64]
SAMPLES = 1000  # of all motions, up to twice as many
NEAR = 0.05  # s, from a reversal
MOSTLY = 0.4  # share of a joint's squared residual, as for effects that are warned of
FELT = 0.5  # %, of a joint's torque, as there
LASTING = 0.2  # share of it that must be outside the fifth of the data with the most: more than a single event


def unexplained(fit: Misfit) -> Iterator[Finding]:
    """Yield that much of the low-passed torque is left which is no white noise, naming the joint with the most of it.

    Reversals do not count, as everywhere in the low-passed torque.
    """
    case, counted = fit.case, fit.case.keep
    left = np.where(counted, case.tau - fit.predicted, 0.0)
    power = np.maximum(np.square(left).sum(axis=0) - counted.sum(axis=0) * case.noise, 0.0)
    torque = np.square(np.where(counted, case.tau, 0.0)).sum(axis=0)
    share = 100.0 * float(np.sqrt(power.sum() / (torque.sum() or np.inf)))
    if share > SIMULATION:
        j = int(np.argmax(power))
        note = Unexplained(share, 100.0 * float(np.sqrt(power[j] / torque[j])))
        yield Finding(Severity.WARNING, case.model.joints[j].name, note, Topic.UNEXPLAINED)


def reversal_findings(
    model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None
) -> Iterator[Finding]:
    """Yield the joints of whose torque, as measured, most is left at their reversals."""
    used = [(one, kept) for one, kept in zip(motions, subsample(motions, SAMPLES), strict=True) if len(kept) > 1]
    if not used:
        return
    fit = misfit(as_measured(model, thinned(motions, SAMPLES), min_speed))
    near = np.concatenate([~steady(one, NEAR)[kept] for one, kept in used])
    for j, joint in enumerate(model.joints):
        share = _share_near(np.square(fit.residual[:, j]), near[:, j], fit.weight[:, j] > 0)
        left = 100.0 * share**0.5 * float(fit.error[j])
        if share > MOSTLY and left > FELT:
            yield Finding(Severity.WARNING, joint.name, LeftAtReversals(left, share), Topic.UNEXPLAINED)


def _share_near(squared: Array, near: NDArray[np.bool_], counted: NDArray[np.bool_]) -> float:
    """Return the share of squared residuals (M) that those near reversals have more than the others; zero where
    most of it may be a single event."""
    at, away = near & counted, ~near & counted
    if not at.any() or not away.any():
        return 0.0
    excess = np.where(at, squared - float(squared[away].mean()), 0.0)
    parts = np.array([one.sum() for one in np.array_split(excess, FOLDS)])
    lasting = parts.sum() - parts.max() > LASTING * parts.sum()
    return float(parts.sum()) / float(squared[counted].sum()) if lasting else 0.0
