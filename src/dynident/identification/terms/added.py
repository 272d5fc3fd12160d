"""A model with the plain set of terms, by which smoother, time offset and tilt are found, or with those chosen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from dynident.identification.base_tilt import mounted
from dynident.identification.load import with_load
from dynident.identification.recipe import Recipe
from dynident.identification.terms.choice import TermChoice
from dynident.identification.terms.choose import choose_terms
from dynident.log import Motion
from dynident.models import Coulomb, Model, Offset, RotorInertia, Viscous, unloaded

__all__ = ["completed", "first", "speeds", "with_chosen_terms", "with_plain_terms"]

PLAIN = (RotorInertia, Viscous, Coulomb, Offset)


def with_plain_terms(model: Model) -> Model:
    """Return the model with rotor inertia, viscous and Coulomb friction and offset, where it lacks them."""
    terms = []
    for part in PLAIN:
        names = {joint.name: part((joint,)).parameters[0].name for joint in model.joints}
        if on := tuple(joint for joint, name in names.items() if name not in model.names):
            terms.append(part(model.joints, on=on))
    return model.with_terms(*terms)


def first(model: Model, recipe: Recipe) -> Model:
    """Return the model of the steps before a fit: without the load, and with the plain set where terms are chosen."""
    return unloaded(model) if recipe.terms is None else with_plain_terms(unloaded(model))


def completed(
    model: Model,
    fitted: Model,
    tilt: tuple[float, float] | None,
    motions: tuple[Motion, ...],
    recipe: Recipe,
    progress: Callable[[str], None],
) -> tuple[Model, TermChoice | None]:
    """Return the model of the fit, with the load that it needs, on its base as it is tilted, and the choice of terms.

    ``fitted`` is the model that the steps before have used, which the motions remember. Raises the errors of
    ``with_load`` and ``choose_terms``.
    """
    min_speed = recipe.min_speeds([joint.name for joint in model.joints])
    if recipe.terms is None:
        return with_load(model, fitted, motions, recipe.estimator, recipe.filter, min_speed, progress), None
    whole = model if tilt is None else mounted(model, *tilt)
    bodies = unloaded(whole)
    choice = choose_terms(bodies, tuple(map(bodies.remembering, motions)), min_speed, progress=progress)
    return with_chosen_terms(whole, choice), choice


def with_chosen_terms(model: Model, choice: TermChoice) -> Model:
    """Return the model with the terms that were chosen, and with the load that they were chosen with."""
    found = model.with_terms(*choice.terms)
    return replace(found, load=choice.load if found.needs_load else None)


def speeds(recipe: Recipe, choice: TermChoice | None) -> Mapping[str, float] | float | None:
    """Return the minimum speed as the recipe gives it, else that of the joints for which one was chosen."""
    if choice is None or recipe.min_speed is not None:
        return recipe.min_speed
    return {name: one for name, one in zip(choice.joints, choice.min_speed, strict=True) if one} or None
