"""The cross-validated torque error over the degree of smoothing: how much to smooth, as the torque sees it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.identification.smoother_choice import TIE, cross_validated_error
from dynident.log import Log, Motion, thinned
from dynident.models import Model
from dynident.smoothers import Smoother, Spline, motion_of
from dynident.smoothers.spline import FACTORS
from dynident.splines import GCV, REML
from dynident.tuning.smoothed import degree_of

__all__ = [
    "DEGREES",
    "GCV_MARK",
    "NOISE_MARK",
    "REML_MARK",
    "TORQUE_MARK",
    "DegreeCurve",
    "degree_curve",
    "rule_degrees",
]

Array = NDArray[np.float64]
DEGREES = (-2.0, -1.2, -0.6, -0.3, *(2.0 * np.log10(one) for one in FACTORS), 3.4)
ROWS = 6000  # samples of the regression on which the curve rests
LEFT = 0.5  # share of the samples that a degree must leave usable to be on the curve
NOISE_MARK, GCV_MARK, REML_MARK, TORQUE_MARK = "S = n", "GCV", "REML", "torque"


@dataclass(frozen=True, eq=False)
class DegreeCurve:
    """Cross-validated torque errors (K, %) of ``degrees`` (K), log10(S/n), of all joints together, or of ``joint``
    alone with the others as they are tuned.

    All are on the same samples, those that are reliable for every degree: fewer than in a fit, unfiltered and at every
    speed, so that only differences along the curve count. ``marks`` are degrees (n) by name: "S = n", what "GCV" and
    "REML" choose by the positions alone, and what the "torque" chooses: the least smoothing, from S = n on, within
    0.5 % of the least error.
    """

    degrees: Array
    errors: Array
    joint: str | None
    marks: Mapping[str, tuple[float, ...]]

    __repr__ = brief


def degree_curve(
    model: Model,
    logs: Sequence[Log],
    spline: Callable[[tuple[float, ...]], Smoother],
    tuned: tuple[float, ...],
    joint: int | None,
    marks: Mapping[str, tuple[float, ...]],
) -> DegreeCurve:
    """Return the curve of a model on training logs; ``spline`` makes one of degrees (n), ``tuned`` are those of now.

    Raises InputError where no degree leaves samples that can be judged.
    """
    wanted = [_moved(tuned, degree, joint) for degree in DEGREES]
    tried = [_motions(model, logs, spline(one)) for one in wanted]
    usable = [0 if one is None else sum(int(motion.mask.sum()) for motion in one) for one in tried]
    kept = [k for k, count in enumerate(usable) if count > LEFT * max(usable)]
    if not kept:
        raise InputError(f"{logs[0].source}: no degree of smoothing leaves samples to judge it by; exclude less.")
    found = [one for k in kept if (one := tried[k]) is not None]
    masks = [np.logical_and.reduce([one.mask for one in some]) for some in zip(*found, strict=True)]
    errors = np.array([cross_validated_error(model, _thinned(one, masks)) for one in found])
    degrees = np.array([DEGREES[k] for k in kept])
    chosen = _moved(tuned, _least(degrees, errors), joint)
    return DegreeCurve(
        degrees, errors, None if joint is None else model.joints[joint].name, {**marks, TORQUE_MARK: chosen}
    )


def _least(degrees: Array, errors: Array) -> float:
    """Return the least degree with nearly the least error, not below S = n, as a smoother is chosen."""
    some = degrees >= 0
    degrees, errors = (degrees[some], errors[some]) if some.any() else (degrees, errors)
    return float(degrees[np.flatnonzero(errors <= errors.min() * (1 + TIE))[0]])


def _moved(tuned: tuple[float, ...], degree: float, joint: int | None) -> tuple[float, ...]:
    return tuple(degree if joint in (None, j) else was for j, was in enumerate(tuned))


def _motions(model: Model, logs: Sequence[Log], smoother: Smoother) -> tuple[Motion, ...] | None:
    """Return the motions of the logs, None where one cannot be smoothed so."""
    try:
        return tuple(model.remembering(motion_of(smoother, log)) for log in logs)
    except InputError:
        return None


def _thinned(motions: Sequence[Motion], masks: Sequence[NDArray[np.bool_]]) -> tuple[Motion, ...]:
    usable = [replace(motion, mask=mask) for motion, mask in zip(motions, masks, strict=True)]
    return thinned(usable, ROWS)


def rule_degrees(logs: Sequence[Log], noise: Sequence[Array], ends: float) -> dict[str, tuple[float, ...]]:
    """Return the degrees (n), the mean of the logs, that rules choose by the positions alone; ``noise`` is that (n) of
    each log. A rule that cannot smooth a log is left out."""
    found = {NOISE_MARK: (0.0,) * logs[0].q.shape[1]}
    for name, rule in ((GCV_MARK, GCV()), (REML_MARK, REML())):
        try:
            motions = [Spline(rule, ends=ends)(log) for log in logs]
        except InputError:
            continue
        left = [
            [degree_of(log.q[:, j] - one.q[:, j], float(size)) for j, size in enumerate(sizes)]
            for log, one, sizes in zip(logs, motions, noise, strict=True)
        ]
        found[name] = tuple(np.mean(left, axis=0).tolist())
    return found
