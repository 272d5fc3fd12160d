"""Maximum likelihood: the estimator alone, on the problems that the commands pose."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any
from unittest import mock

from commands import example

Call = Callable[[], object]


class Posed(BaseException):
    """The problem is posed: what follows is not wanted."""


def robot(_: str, name: str) -> Call:
    """An example, with this estimator in place of its own."""
    from dynident.estimators.maximum_likelihood import MaximumLikelihood
    from dynident.project.project import read_project

    posed: list[Any] = []

    def caught(estimator: MaximumLikelihood, problem: Any) -> None:
        posed.extend((estimator, problem))
        raise Posed

    project = read_project(example(name, "maximum_likelihood"))
    with mock.patch.object(MaximumLikelihood, "__call__", caught), suppress(Posed):
        project.identify()
    estimator, problem = posed
    return lambda: estimator(problem)


def article(_: str, runs: int = 10) -> Call:
    """Recordings of the article's arm, smoothed and estimated."""
    import numpy as np

    from dynident.apps.article import SCENARIOS
    from dynident.estimators import Problem
    from dynident.estimators.maximum_likelihood import MaximumLikelihood
    from dynident.models.lagrangian import two_link_arm
    from dynident.motion.smoothers import Spline
    from dynident.regression import Regression

    arm, estimator = two_link_arm(), MaximumLikelihood(start="rest")
    logs = [SCENARIOS["stated"].record(1e-6, rng).log for rng in np.random.default_rng(7).spawn(runs)]

    def once() -> dict[str, float]:
        taken = []
        for log in logs:
            began = time.process_time()
            motions = (Spline()(log),)
            estimator(Problem(arm, motions, Regression(arm, motions), (log,)))
            taken.append(time.process_time() - began)
        return {"cpu": float(np.median(taken))}

    return once
