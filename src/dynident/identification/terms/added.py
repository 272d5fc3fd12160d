"""A model with the plain set of terms, by which smoother, time offset and tilt are found, and the choice of others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynident.estimators import NamesParameters, among
from dynident.identification.base_tilt import mounted
from dynident.identification.recipe import Recipe
from dynident.identification.terms.candidates import KINDS, Seen, kind_of_class
from dynident.identification.terms.choice import NotChosen, TermChoice, TooFewSamplesError
from dynident.identification.terms.choose import choose_terms
from dynident.log import Motion
from dynident.models import Coulomb, Model, Offset, RotorInertia, Viscous, unloaded

__all__ = ["chosen", "first", "with_choice", "with_plain_terms"]

PLAIN = (RotorInertia, Viscous, Coulomb, Offset)


def with_plain_terms(model: Model) -> Model:
    """Return the model with rotor inertia, viscous and Coulomb friction and offset, where it lacks them."""
    terms = []
    for part in PLAIN:
        names = {joint.name: part((joint,)).parameters[0].name for joint in model.joints}
        if on := tuple(joint for joint, name in names.items() if name not in model.names):
            terms.append(part(model.joints, on=on))
    return model.with_terms(*terms)


def first(model: Model, recipe: Recipe) -> tuple[Model, Recipe]:
    """Return model and recipe of the steps before a fit: without the load, and with the plain set where terms are
    chosen; the estimator says nothing of parameters that come later."""
    early = unloaded(model) if recipe.terms is None else with_plain_terms(unloaded(model))
    if early.names == model.names:
        return early, recipe
    return early, replace(recipe, estimator=among(recipe.estimator, early.names))


def with_choice(model: Model, recipe: Recipe, choice: TermChoice) -> tuple[Model, Recipe, tuple[NotChosen, ...]]:
    """Return model and recipe with terms and minimum speeds as chosen, and a note on the parameters that the recipe
    names, might have been chosen, and were not."""
    model = model.with_terms(*choice.terms)
    named = recipe.estimator.named if isinstance(recipe.estimator, NamesParameters) else ()
    absent = tuple(name for name in named if name not in model.names and name in _names(model))
    known = [name for name in named if name not in absent]  # with those that are misspelt, which the estimator refuses
    estimator = among(recipe.estimator, (*model.names, *known)) if absent else recipe.estimator
    recipe = replace(recipe, estimator=estimator, min_speed=_speeds(recipe, choice), terms=None)
    return model, recipe, (NotChosen(absent),) if absent else ()


def _names(model: Model) -> set[str]:
    """Return the names of the parameters that might be chosen."""
    seen = [Seen(model.joints, joint, 1.0, 1.0, 1.0) for joint in model.joints]
    terms = [kind.sizes(one)[0] for one in seen for kind in KINDS]
    return {parameter.name for term in terms for parameter in term.parameters}


def chosen(
    model: Model,
    tilt: tuple[float, float] | None,
    motions: tuple[Motion, ...],
    min_speed: tuple[float, ...] | None,
    proposed: Sequence[type],
    progress: Callable[[str], None],
) -> TermChoice:
    """Return the choice of the terms of a model, on its base as it is tilted, with classes that are ``proposed`` beside
    those of the library: the plain set where samples are too few.

    Raises the other errors of ``choose_terms``.
    """
    bodies = unloaded(model if tilt is None else mounted(model, *tilt))
    kinds = (*KINDS, *(kind_of_class(one.__name__, one) for one in proposed))
    try:
        return choose_terms(bodies, tuple(map(bodies.remembering, motions)), min_speed, kinds=kinds, progress=progress)
    except TooFewSamplesError:
        joints = tuple(joint.name for joint in model.joints)
        unknown, none = (np.nan,) * len(joints), (0.0,) * len(joints)
        return TermChoice(joints, with_plain_terms(model).terms[len(model.terms) :], (), unknown, unknown, none)


def _speeds(recipe: Recipe, choice: TermChoice) -> Mapping[str, float] | float | None:
    """Return the minimum speed as the recipe gives it, else that of the joints for which one was chosen."""
    if recipe.min_speed is not None:
        return recipe.min_speed
    return {name: one for name, one in zip(choice.joints, choice.min_speed, strict=True) if one} or None
