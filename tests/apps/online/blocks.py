"""Blocks of scores without a robot: base parameters of three groups, and what is left at two joints."""

from collections.abc import Sequence

import numpy as np

from dynident.apps.online.candidates import Candidates
from dynident.apps.online.scores import Scores
from dynident.regression import GroupKind, ParameterGroup

INFORMATION = 400.0
SPREAD = 9.0  # of the scores, over that of white noise


def candidates(tolerance: float = 0.0) -> Candidates:
    """Friction of two joints (2 directions each), a payload (4), and what is left at both joints."""
    kinds = [(GroupKind.FRICTION, "one", 2), (GroupKind.FRICTION, "two", 2), (GroupKind.PAYLOAD, "two", 4)]
    ends = np.cumsum([0, *(k for _, _, k in kinds)])
    groups = [
        ParameterGroup(kind, joint, np.eye(8)[:, ends[g] : ends[g + 1]], tuple(f"p{i}" for i in range(k)), ("",) * k)
        for g, (kind, joint, k) in enumerate(kinds)
    ]
    rest = [
        ParameterGroup(GroupKind.RESIDUAL, joint, np.eye(2)[:, [j]], ("left",), ("",))
        for j, joint in ((0, "one"), (1, "two"))
    ]
    return Candidates((*groups, *rest), np.ones(8), tolerance)


def block(
    rng: np.random.Generator, k: int, change: Sequence[float] | None = None, louder: float = 0.0, mixed: float = 0.3
) -> Scores:
    """Return the k-th block, of 5 s, after a ``change`` (8) of the parameters; the second joint is ``louder``."""
    A = INFORMATION * rng.uniform(0.5, 1.5) * (np.eye(8) * (1 - mixed) + mixed)
    noise = np.sqrt(SPREAD) * np.linalg.cholesky(A) @ rng.standard_normal(8)
    score = noise if change is None else noise + A @ np.asarray(change)
    left = 0.1 * rng.standard_normal(2) + [0.0, louder]
    return Scores(5.0 * k, 5.0 * k + 5.0, 1000, A, score, left, np.exp(left))
