"""Least squares of recordings that are smoothed anew: a first model where that of the given motion is of no use."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Problem
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.loops import log_of
from dynident.log import Motion
from dynident.smoothers import Smoother

__all__ = ["resmoothed"]

Array = NDArray[np.float64]


def resmoothed(problem: Problem, smoother: Smoother) -> Array:
    """Return least squares (p) of the motion that a smoother makes of the recordings of a problem.

    Raises DynidentError where smoother or fit do.
    """
    motions = tuple(_motion(problem, k, smoother) for k in range(len(problem.motions)))
    regression = replace(problem.regression, motions=motions)
    return LeastSquares(weights="per_joint")(replace(problem, motions=motions, regression=regression)).value


def _motion(problem: Problem, k: int, smoother: Smoother) -> Motion:
    """Return the k-th motion, smoothed anew where its log is known; samples that are not used do not count."""
    motion, log = problem.motions[k], log_of(problem, k)
    if log is None:
        return motion
    stamped = motion.shifted(-motion.time_offset)
    used = replace(log, q=np.where(motion.mask[:, None], log.q, stamped.q))
    found = smoother(used).shifted(motion.time_offset)
    return replace(motion, q=found.q, dq=found.dq, ddq=found.ddq, mask=motion.mask & found.mask)
