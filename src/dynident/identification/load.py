"""The load of the joints, by which friction can grow: the torque of the bodies by a first fit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from dynident.errors import called
from dynident.estimators import Estimate, Estimator, Problem, quick
from dynident.log import Motion
from dynident.models import Model, needs_load
from dynident.regression import ParallelFilter, Regression

__all__ = ["with_load"]

ROUNDS = 2  # the bodies make up for friction that grows with the load while it is left out


def with_load(
    model: Model,
    first: Model,
    motions: tuple[Motion, ...],
    estimator: Estimator,
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Model:
    """Return ``model`` with the load that it needs, and with the other terms as they are in ``first``.

    ``first`` is the model without the terms that remember the load, on its base as it is tilted, and the motions
    remember what it does; it is returned itself where ``model`` needs no load or has one. The load is the torque of its
    bodies once the estimator, or its fast substitute, has fitted it to the motions, and again with that load.
    Raises the errors of ``Regression`` and the estimator.
    """
    if not model.needs_load or model.load is not None:
        return first
    progress("finding the load")
    found, others = first, iter(first.terms)
    terms = tuple(one if needs_load(one) else next(others) for one in model.terms)
    for _ in range(ROUNDS):
        seen = tuple(map(found.remembering, motions))
        problem = Problem(found, seen, Regression(found, seen, parallel_filter, min_speed))
        load = found.loaded(called(quick(estimator), problem, Estimate).value).load
        found = replace(model, terms=terms, load=load)
    return found
