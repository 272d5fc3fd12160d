"""The checks beside an identification, with its motions and what it chose."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from dataclasses import replace
from typing import Any

from dynident.checks.check import run_checks
from dynident.checks.missing import tried_by
from dynident.errors import Severity
from dynident.identification import Identification, Recipe
from dynident.identification.terms.added import with_plain_terms
from dynident.log import Log, Motion
from dynident.models import Model, unloaded

__all__ = ["with_findings"]


def with_findings(
    identification: Identification,
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe,
    *,
    multi_turn: Set[str] = frozenset(),
    progress: Callable[[str], None] | None = None,
) -> Identification:
    """Return an identification with the errors and warnings of ``run_checks`` on what it was made from, and with what
    else would lower its error; without the effects that a choice of terms has tried.

    ``model``, ``logs`` and ``recipe`` are as they were given to ``identify``; the motions are those of the fit.
    """
    motions: dict[str, dict[str, Motion]] = {"train": {}, "validation": {}}
    for one in identification.validations:
        motions[one.role][one.name] = one.motion
    used, choice = identification.recipe, identification.calibration.terms
    known: dict[str, Any] = {key: getattr(used, key) for key in ("estimator", "base_tilt", "min_speed")}
    plain = None if choice is None else with_plain_terms(unloaded(model))
    model = model if choice is None else model.with_terms(*choice.terms)
    model = replace(model, load=identification.model.load)
    found = run_checks(
        model,
        logs,
        replace(recipe, terms=None, **known),
        multi_turn=multi_turn,
        motions=motions,
        described=False,
        progress=progress,
        plain=plain,
    ).findings
    if choice is not None:
        found = tuple(one for one in found if not tried_by(one, choice))
    warned = tuple(one for one in found if one.severity is not Severity.INFO or one.removed)
    return replace(identification, warnings=(*identification.warnings, *warned))
