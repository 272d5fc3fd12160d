"""The torque of one joint that is stamped late against that of the others: a delay of each joint, all sought at once.

Rigid bodies move slowly, so that a few ms show mainly where friction reverses, in the torque as measured. Friction that
builds up gradually looks alike there: the low-passed torque, without the reversals, must agree.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case, as_measured
from dynident.checks.cost import cost, mean_square
from dynident.checks.finding import Finding, Topic
from dynident.checks.misfit import Misfit, misfit
from dynident.checks.missing import torque_rate
from dynident.checks.robot_notes import MissingTerm, TermKind
from dynident.checks.suspect import CERTAIN
from dynident.errors import Severity
from dynident.log import Motion, subsample
from dynident.models import Model
from dynident.regression.long_run import long_run

__all__ = ["delay_findings"]

Array = NDArray[np.float64]
SAMPLES = 2000  # of all motions, up to twice as many
LONGEST = 0.05  # s; a later torque is another fault
WIDE = 5e-3  # s, least half width of the differences by time
NARROW, WIDER = 0.8, 1.5  # a delay of more than so much of the half width needs one of so many times the delay
LIKELY = 2.5  # standard errors of the low-passed torque
WORTH = 0.1  # share of the joint's squared residual, as measured, that its delay must explain
SHORTEST = 1e-3  # s


def delay_findings(
    fit: Misfit, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None
) -> Iterator[Finding]:
    """Yield the joints whose torque comes later or earlier than it should, beyond the time offset of all.

    ``fit`` is that of the low-passed torque.
    """
    slow, std, _ = _delays(fit, torque_rate(fit, fit.case))
    likely = (np.abs(slow) > LIKELY * std) & (np.abs(slow) < LONGEST)
    rows = subsample(motions, SAMPLES, LONGEST)
    if not likely.any() or all(len(kept) < 2 for kept in rows):
        return
    model = fit.case.model
    value, error, share, size = _as_measured(model, motions, rows, min_speed)
    likely &= (np.sign(value) == np.sign(slow)) & (np.abs(value) > np.maximum(CERTAIN * error, SHORTEST))
    for j in np.flatnonzero(likely & (share > WORTH)):
        rate = _of_joint(-torque_rate(fit, fit.case), int(j))
        set_right = misfit(replace(fit.case, extra=(rate,), beyond=(np.zeros_like(rate),)), fit.weight.max(axis=0))
        figures = float(value[j]), float(error[j]), float(share[j])
        name, removed = model.joints[j].name, float(share[j] * size[j])
        note = MissingTerm(TermKind.DELAY, *figures, cost=cost(fit, set_right).all, removed=((name, removed),))
        yield Finding(Severity.WARNING, name, note, Topic.MISSING_TERM)


def _as_measured(
    model: Model, motions: Sequence[Motion], rows: Sequence[NDArray[np.intp]], min_speed: tuple[float, ...] | None
) -> tuple[Array, Array, Array, Array]:
    """Return the delays (n) in the torque as measured, their standard errors, what each explains of its joint, and the
    mean squared residual (n).

    The differences by time are narrow at first, and wider for the value of a delay that explains something then:
    slow errors of a model look like delays over long times, too.
    """
    step = max(float(np.median(np.diff(one.t))) for one in motions)
    fit = misfit(_at(model, motions, rows, min_speed, 0.0))
    wide, needed = 0.0, max(WIDE, step)
    shares: list[Array] = []
    while wide < needed:
        wide = needed
        late, early = (_at(model, motions, rows, min_speed, side * wide).torque(fit.theta) for side in (1.0, -1.0))
        found = _delays(fit, (late - early) / (2 * wide))
        shares.append(found[2])
        longest = float(np.abs(found[0][shares[0] > WORTH]).max(initial=0.0))
        needed = min(WIDER * longest, LONGEST) if longest > NARROW * wide else wide
    return found[0], found[1], shares[0], mean_square(fit)


def _at(
    model: Model,
    motions: Sequence[Motion],
    rows: Sequence[NDArray[np.intp]],
    min_speed: tuple[float, ...] | None,
    late: float,
) -> Case:
    """Return the case of the motions, not low-passed, so much later (s) than their torque."""
    moved = [one.shifted(late, kept) for one, kept in zip(motions, rows, strict=True) if len(kept) > 1]
    return as_measured(model, moved, min_speed)


def _delays(fit: Misfit, rate: Array) -> tuple[Array, Array, Array]:
    """Return the delays (n) of all joints together, their standard errors, robust to correlation, and the share that
    each explains of its joint's squared residual; ``rate`` (M, n) is the torque's."""
    n = rate.shape[1]
    Z = np.moveaxis(fit.beside(np.stack([_of_joint(-rate, j) for j in range(n)])), 0, 2)
    inverse = np.linalg.pinv(np.einsum("mni,mnj->ij", Z, Z), hermitian=True)
    value = inverse @ np.einsum("mni,mn->i", Z, fit.residual)
    left = fit.residual - Z @ value
    scores = np.split(np.einsum("mni,mn->mi", Z, left), np.cumsum(fit.case.lengths)[:-1])
    std = np.sqrt(np.diag(inverse @ long_run(scores) @ inverse))
    before = np.square(fit.residual).sum(axis=0)
    return value, std, 1.0 - np.square(left).sum(axis=0) / np.where(before > 0, before, 1.0)


def _of_joint(x: Array, j: int) -> Array:
    """Return the columns (M, n) with those of the other joints zero."""
    return np.where(np.arange(x.shape[1]) == j, x, 0.0)
