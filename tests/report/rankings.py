"""A made ranking for its report: as many combinations as there may be, failures, a truth."""

import math
from dataclasses import replace

import numpy as np

from dynident.apps.ranking import (
    Candidate,
    Combination,
    CombinationOutcome,
    InapplicablePart,
    RankedCombination,
    Ranking,
    TruthFigures,
)
from dynident.estimators import LeastSquares
from dynident.motion.smoothers import Difference

JOINTS = ("shoulder", "elbow")


def ranking(smoothers: int = 3, estimators: int = 2, joint: str = "elbow", *, basis: str = "validation") -> Ranking:
    """Return a ranking in which the first combination is the best, the second as good, and the last failed."""
    joints = ("shoulder", joint)
    names = [(f"smoother{i}", f"estimator{j}") for j in range(estimators) for i in range(smoothers)]
    rows = [row(k, *pair, joints) for k, pair in enumerate(names)]
    last = RankedCombination(rows[-1].combination, CombinationOutcome.FAILED, "InputError: <b>too short</b>")
    parts = tuple(Candidate(f"smoother{i}", (Difference(),), "", i == 0) for i in range(smoothers))
    others = tuple(Candidate(f"estimator{j}", (LeastSquares(),), "", j == 0) for j in range(estimators))
    return Ranking(
        "robot",
        joints,
        "train" if basis == "train" else "validation",
        (*rows[:-1], last),
        (InapplicablePart("", "instruments", "monday: has no controller"),),
        {"monday": 80.0, "tuesday": 95.0},
        {"smoother0": 99.0, "smoother1": 81.0},
        0.5,
        40.0,
        True,
        5,
        ("Fv_elbow", "m1 + 0.1*m2"),
        ("N m s/rad", "kg"),
        parts,
        others,
        len(names),
    )


def row(k: int, smoother: str, estimator: str, joints: tuple[str, ...]) -> RankedCombination:
    """Return the k-th best combination."""
    error, apart = 3.0 + 0.4 * k, 0.4 * k
    by_joint = dict(zip(joints, (error - 1.0, error + 1.0), strict=True))
    return RankedCombination(
        Combination(smoother, estimator, k == 0),
        CombinationOutcome.OK,
        error=error,
        overall=error - 0.5,
        held_out=by_joint,
        same_motion=by_joint,
        training=by_joint,
        cross_validated=by_joint,
        interval=(apart - 0.5, apart + 0.5) if k else (0.0, 0.0),
        p_value=1.0 if k < 2 else 0.001,
        condition=12.5,
        eigenvalue=-0.01 if k == 0 else 0.02,
        seconds_smoothing=0.1,
        seconds_estimate=2.0 / (k + 1),
        truth=TruthFigures(np.array([0.1, np.nan]), np.array([0.2, 0.1]), 2.5, 1.2, 1, 1),
    )


def untold(result: Ranking) -> Ranking:
    """Return the same of logs that are too short to tell differences from chance."""
    rows = tuple(replace(x, interval=(math.nan, math.nan), p_value=math.nan) for x in result.rows)
    return replace(result, rows=rows, has_enough_blocks=False, blocks=4.0)
