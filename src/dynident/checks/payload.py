"""Whether the arm carries another payload in a held-out log than in training."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks.case import Case, case_of
from dynident.checks.cost import faster
from dynident.checks.finding import Finding, Topic
from dynident.checks.misfit import misfit
from dynident.checks.robot_notes import OtherPayload
from dynident.checks.suspect import CERTAIN
from dynident.errors import Severity
from dynident.log import Motion
from dynident.models import INERTIAL, Model
from dynident.regression import ParallelFilter

__all__ = ["payload_findings"]

Array = NDArray[np.float64]
SHARE = 0.5  # of the squared residual of both logs that another payload must explain
SAMPLES = 800
LIGHTEST = 0.02  # kg


def payload_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> Iterator[Finding]:
    """Yield the held-out logs in which the last body is heavier or lighter than in training.

    The training logs and one other are fitted together, with columns of their own for the last body in that log: what
    training does not determine then explains nothing.
    """
    last = [k for k, parameter in enumerate(model.parameters) if parameter.role in INERTIAL][-10:]
    for name, motion in held_out.items() if last else ():
        found = _payload(case_of(model, [*motions, motion], parallel_filter, min_speed, SAMPLES), last)
        if found is not None:
            yield Finding(Severity.WARNING, None, found, Topic.PAYLOAD, source=name)


def _payload(case: Case, last: Sequence[int]) -> OtherPayload | None:
    other = np.arange(len(case.q)) >= len(case.q) - case.lengths[-1]
    own = _of_last(case, last) * other[:, None, None]
    before = misfit(case)
    weight = before.weight.max(axis=0)
    rest = replace(case, extra=tuple(own[:, :, k] for k in range(1, 10)))
    fit = misfit(rest, weight)
    (evidence,) = fit.evidence([own[:, :, 0]])
    if evidence is None or abs(evidence.value) < max(CERTAIN * evidence.std, LIGHTEST):
        return None
    share = 1.0 - fit.size * (1.0 - evidence.share) / before.size
    return OtherPayload(evidence.value, evidence.std, share, cost=_cost(case, last, other)) if share > SHARE else None


def _cost(case: Case, last: Sequence[int], other: NDArray[np.bool_]) -> float:
    """Return the torque of the payload in the other log at twice its speed, in % of the whole torque there."""
    own = _of_last(case, last) * other[:, None, None]
    fit, quick = misfit(replace(case, extra=tuple(own[:, :, k] for k in range(10)))), faster(case)
    added = (_of_last(quick, last) @ fit.extra)[other]
    whole = added + quick.torque(fit.theta)[other]
    return 100.0 * float(np.linalg.norm(added) / (np.linalg.norm(whole) or np.inf))


def _of_last(case: Case, last: Sequence[int]) -> Array:
    """Return the regressor (M, n, 10) of the last body."""
    return case.model.regressor(**case.states)[:, :, list(last)]
