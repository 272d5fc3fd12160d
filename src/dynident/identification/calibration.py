"""The model with the plain set of terms, for the steps before a fit, and the choice of other terms."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np

from dynident.estimators import Estimate, Estimator, Problem
from dynident.identification.base_tilt import BaseTilt, SteepBase, find_base_tilt
from dynident.identification.cross_validation import motion_gain
from dynident.identification.dataset import Dataset, RoleMotions
from dynident.identification.mounting import has_gravity, tilt_base
from dynident.identification.prior_strength import PriorStrength, find_prior_strength, with_strength
from dynident.identification.recipe import Recipe
from dynident.identification.smoother_choice import SmootherChoice
from dynident.identification.terms import (
    MIN_DRIFT_DURATION,
    JointExcitation,
    NotChosen,
    PlainTerms,
    TermChoice,
    choose_terms,
    kind_of_class,
    library_kinds,
)
from dynident.identification.terms.candidates import TooFewSamplesError
from dynident.identification.time_offset import Alignment, TimeOffset, align_motion, trial_samples
from dynident.models import Model, RotorInertia, drop_load_dependence
from dynident.models.friction import Coulomb, Offset, Ripple, Viscous
from dynident.motion.log import Motion, subsample
from dynident.motion.smoothers import strip_time_offset
from dynident.regression import EVERYTHING, Regression, Selection
from dynident.runtime import Note, brief, call_part, report_progress

ROUNDS = 2  # the bodies make up for friction that grows with the load while it is left out


def with_load(
    model: Model,
    preliminary_model: Model,
    motions: tuple[Motion, ...],
    estimator: Estimator,
    selection: Selection = EVERYTHING,
) -> Model:
    """Return ``model`` with the load that it needs, and with the other terms as in ``preliminary_model``.

    ``preliminary_model`` is the model without the terms that remember the load, on its tilted base; the motions
    remember its states. It is returned itself where ``model`` needs no load or has one. The load is the torque of
    its bodies once the estimator, or its fast substitute, has fitted it to the motions, and again with that load.
    Raises the errors of ``Regression`` and the estimator.
    """
    if not model.needs_load or model.load is not None:
        return preliminary_model
    report_progress("finding the load")
    loaded_model, other_terms = preliminary_model, iter(preliminary_model.terms)
    terms = tuple(term if term.needs_load else next(other_terms) for term in model.terms)
    # The first load comes from a fit without load friction; the second round corrects what the bodies took up of it.
    for _ in range(ROUNDS):
        loaded_motions = tuple(map(loaded_model.remembering, motions))
        problem = Problem(loaded_model, loaded_motions, Regression(loaded_model, loaded_motions, selection))
        load = loaded_model.with_load(call_part(estimator.quick(), problem, Estimate).value).load
        loaded_model = replace(model, terms=terms, load=load)
    return loaded_model


PLAIN_TERMS = (RotorInertia, Viscous, Coulomb, Offset)


def with_plain_terms(model: Model) -> Model:
    """Return the model with rotor inertia, viscous and Coulomb friction and offset, where it lacks them."""
    terms = []
    for term_class in PLAIN_TERMS:
        names = {joint.name: term_class((joint,)).parameters[0].name for joint in model.joints}
        if on := tuple(joint for joint, name in names.items() if name not in model.names):
            terms.append(term_class(model.joints, on=on))
    return model.with_terms(*terms)


def preliminary_setup(model: Model, recipe: Recipe) -> tuple[Model, Estimator]:
    """Return model and estimator for the steps before a fit.

    The model is without load, and with the plain set where terms are still to be chosen; the estimator's settings
    for other parameters are dropped.
    """
    preliminary = drop_load_dependence(model)
    if recipe.terms is not None:
        preliminary = with_plain_terms(preliminary)
    same = preliminary.names == model.names
    return preliminary, recipe.estimator if same else recipe.estimator.among(preliminary.names)


@dataclass(frozen=True)
class Calibration:
    """How smoother, time offset, tilt of the base, terms, strength of the prior were found; None where not sought."""

    smoother: SmootherChoice | None = None
    time_offset: TimeOffset | None = None
    base_tilt: BaseTilt | None = None
    prior_strength: PriorStrength | None = None
    terms: TermChoice | None = None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Preparation:
    """The motions of all logs, aligned with the torque, and the model on its base: what a calibration begins with.

    ``model`` has no terms that need a fit before, and ``estimator`` knows only its parameters. ``tilt`` is how the
    ``angles`` (rad) of the base were found, None where they were given.
    """

    model: Model
    estimator: Estimator
    motions: RoleMotions
    alignment: Alignment
    tilt: BaseTilt | None = None
    angles: tuple[float, float] | None = None

    @property
    def time_offset(self) -> float:
        """The time offset (s), the same in all motions."""
        return self.motions.train[0].time_offset

    def is_near(self, other: Preparation) -> bool:
        """Return whether another one smooths alike, with nearly the same time offset and tilt."""
        tilt, other_tilt = (x.angles or (0.0, 0.0) for x in (self, other))
        has_same_smoother = strip_time_offset(self.alignment.smoother) == strip_time_offset(other.alignment.smoother)
        has_same_tilt = np.abs(np.subtract(tilt, other_tilt)).max() < MAX_SAME_TILT
        return has_same_smoother and bool(has_same_tilt) and abs(self.time_offset - other.time_offset) < MAX_SAME_OFFSET

    def is_better(self, other: Preparation, model: Model, other_model: Model, move: float = 0.0) -> bool:
        """Return whether a model predicts left-out stretches surely better than ``other_model`` on ``other`` motions.

        Its own motions are shifted by ``move`` (s).
        """
        pairs = list(zip(other.motions.train, self.motions.train, strict=True))
        common = [replace(new, mask=old.mask & new.mask) for old, new in pairs]
        rows = subsample(common, trial_samples(self.model))
        chosen = [(pair, at) for pair, at in zip(pairs, rows, strict=True) if len(at) > 1]
        models = [on_base(other_model, other.angles), on_base(model, self.angles)]
        before, after = ([models[k].remembering(pair[k]).shift(k * move, at) for pair, at in chosen] for k in range(2))
        gain = motion_gain(models[1], before, after, model_before=models[0])
        return gain.sure and gain.share > MIN_GAIN

    def with_terms(self, model: Model, recipe: Recipe) -> Preparation:
        """Return it with the terms of a model, without those that need a load, which a fit is to find."""
        model, estimator = preliminary_setup(model, recipe)
        model = on_base(model, self.angles)
        return replace(self, model=model, estimator=estimator, motions=self.motions.remember(model))


def on_base(model: Model, angles: tuple[float, float] | None) -> Model:
    """Return the model on a base tilted by the angles (rad), itself where there are none."""
    return model if angles is None else tilt_base(model, *angles)


def prepare(
    model: Model,
    data: Dataset,
    recipe: Recipe,
    executor: Executor | None = None,
    cache: dict[int, tuple[Motion, ...]] | None = None,
    angles: tuple[float, float] | None = None,
    *,
    presliding: bool = True,
) -> Preparation:
    """Align torque and motion, smooth all logs, and level the base, with the model as it is before a fit.

    ``cache`` keeps the motions by each smoother that is tried, for another call with other terms. The alignment is on a
    base tilted by ``angles`` (rad), where these are known: the torque of a tilt can look like a time offset, and so can
    ``presliding`` friction, which is beside the model unless its terms were chosen.
    """
    selection = recipe.selection(model.joints)
    model, estimator = preliminary_setup(model, recipe)
    # Smoother and time offset come first: everything else depends on the smoothed motion.
    alignment = align_motion(
        on_base(model, angles), data.train_logs, recipe.smoothers, recipe.time_offset,
        selection, executor=executor, cache=cache, by_joint=recipe.terms is None, presliding=presliding,
    )  # fmt: skip
    motions = data.motions(model, alignment.smoother, recipe)
    if recipe.base_tilt is None:
        return Preparation(model, estimator, motions, alignment)
    if recipe.base_tilt != "estimate":
        level_model = tilt_base(model, *recipe.base_tilt)
        return Preparation(level_model, estimator, motions, alignment, None, recipe.base_tilt)
    if not has_gravity(model):
        return Preparation(model, estimator, motions, alignment)
    report_progress("estimating the base tilt")
    tilt = find_base_tilt(model, motions.train, estimator, selection)
    return Preparation(tilt_base(model, tilt.x, tilt.y), estimator, motions, alignment, tilt, (tilt.x, tilt.y))


@dataclass(frozen=True, eq=False)
class Setup:
    """All that is chosen before the fit: the model and the ``recipe`` as used, in which nothing is left to choose.

    ``term_notes`` are those of the choice of terms.
    """

    model: Model
    recipe: Recipe
    motions: RoleMotions
    alignment: Alignment
    calibration: Calibration
    term_notes: tuple[Note, ...] = ()

    @property
    def notes(self) -> tuple[Note, ...]:
        """What is to be said of the calibration."""
        tilt = self.calibration.base_tilt
        return (*((SteepBase(*tilt.steep),) if tilt and tilt.steep else ()), *self.term_notes)

    def problem(self, data: Dataset) -> Problem:
        """Return the linear problem of the training logs, reduced to triangular factors."""
        motions = self.motions.train
        regression = Regression(self.model, motions, self.recipe.selection(self.model.joints))
        report_progress("reducing the regression to triangular factors")
        return Problem(
            self.model, motions, regression.factorise(), data.fitted_logs(self.motions), motions[0].time_offset
        )


def choose_setup(model: Model, data: Dataset, recipe: Recipe, executor: Executor | None = None) -> Setup:
    """Choose what the recipe leaves to the data: smoother, time offset, base tilt, terms, strength of the prior.

    Smoothers are tried on the ``executor``.
    """
    if recipe.terms is None:
        return calibrate(prepare_in_rounds(model, data, recipe, executor), model, recipe)
    terms, preparation = choose_in_rounds(model, data, recipe, executor)
    setup = calibrate(preparation, terms.model, terms.recipe)
    return replace(setup, calibration=replace(setup.calibration, terms=terms.choice), term_notes=terms.notes)


def calibrate(preparation: Preparation, model: Model, recipe: Recipe) -> Setup:
    """Find what needs a first fit: the load, on which friction may depend, and the strength of the prior.

    ``model`` is the one to fit, with its terms that need the load.
    """
    selection, motions = recipe.selection(model.joints), preparation.motions
    if model.needs_load and model.load is None:
        model = with_load(model, preparation.model, motions.train, preparation.estimator, selection)
        motions = motions.remember(model)
    else:
        model = preparation.model
    strength = find_prior_strength(model, motions.train, recipe.estimator, selection)
    alignment = preparation.alignment
    used_recipe = replace(
        recipe, smoother=alignment.smoother, estimator=with_strength(recipe.estimator, strength),
        time_offset=motions.train[0].time_offset, base_tilt=preparation.angles,
    )  # fmt: skip
    calibration = Calibration(alignment.choice, alignment.time_offset, preparation.tilt, strength)
    return Setup(model, used_recipe, motions, alignment, calibration)


@dataclass(frozen=True, eq=False)
class ChosenTerms:
    """A model and recipe with the terms that the data chose, and what is to be said of the choice."""

    model: Model
    recipe: Recipe
    choice: TermChoice
    notes: tuple[Note, ...]

    @property
    def ripple_delay(self) -> float:
        """The median delay (s) of the ripples that were chosen, 0 where there are none."""
        ripples = [term for term in self.choice.terms if isinstance(term, Ripple)]
        return float(np.median([x.constant("delay", name) for x in ripples for name in x.acts_on] or [0.0]))

    def loaded_model(self, *, without_delay: bool = False) -> Model:
        """Return the model with its load, ``without_delay`` with ripples that act at once where they were chosen."""
        ripples = [term for term in self.choice.terms if isinstance(term, Ripple) and without_delay]
        terms = tuple(replace(term, delay=0.0) if term in ripples else term for term in self.model.terms)
        return replace(self.model, terms=terms, load=self.choice.load if self.model.needs_load else None)


def add_chosen_terms(model: Model, recipe: Recipe, preparation: Preparation) -> ChosenTerms:
    """Choose the terms of a model on prepared motions; return model and recipe with them, and with minimum speeds.

    A note is on parameters that the recipe names, that might have been chosen, and were not.
    """
    choice = _choose_model_terms(model, recipe, preparation)
    model = replace(model.with_terms(*choice.terms), chooses_terms=False, proposed=())
    recipe_names = recipe.estimator.named
    absent_names = tuple(name for name in recipe_names if name not in model.names and name in _eligible_names(model))
    # with those that are misspelt, which the estimator refuses
    kept_names = [name for name in recipe_names if name not in absent_names]
    estimator = recipe.estimator.among((*model.names, *kept_names)) if absent_names else recipe.estimator
    speeds: Mapping[str, float] | float | None = recipe.min_speed
    if speeds is None:
        # to three digits: it stands in configurations and controls, where a person reads it
        speeds = {name: float(f"{v:.3g}") for name, v in zip(choice.joints, choice.min_speed, strict=True) if v} or None
    recipe = replace(recipe, estimator=estimator, min_speed=speeds, terms=None, proposed=())
    absent, plain = (NotChosen(absent_names),) if absent_names else (), () if choice.trials else (PlainTerms(),)
    return ChosenTerms(model, recipe, choice, (*absent, *plain))


MIN_GAIN = 1.0  # % of the squared cross-validated error that another alignment must remove
MAX_ROUNDS = 4  # of terms and alignment in turn, after the first
MIN_FURTHER_MOVE = 3e-3  # s: by which the offset must have moved for another round
MAX_SAME_OFFSET, MAX_SAME_TILT = 2e-4, 5e-3  # s, rad: a smaller change of the alignment does not change the terms


def prepare_in_rounds(model: Model, data: Dataset, recipe: Recipe, executor: Executor | None = None) -> Preparation:
    """Return the preparation of a model whose terms are given, aligned again on the base if that proves tilted."""
    cache: dict[int, tuple[Motion, ...]] = {}
    preparation = prepare(model, data, recipe, executor, cache)
    if preparation.tilt is None or not any(preparation.angles or ()):
        return preparation
    return prepare(model, data, recipe, executor, cache, preparation.angles)


def choose_in_rounds(
    model: Model, data: Dataset, recipe: Recipe, executor: Executor | None = None
) -> tuple[ChosenTerms, Preparation]:
    """Choose terms, smoothing, time offset and base tilt in turn, until none of them gains; return what was found.

    The plain set comes first: what it lacks may ask for another smoothing or offset than the terms chosen then.
    """
    cache: dict[int, tuple[Motion, ...]] = {}
    preparation = prepare(model, data, recipe, executor, cache)
    terms = add_chosen_terms(model, recipe, preparation)
    for _ in range(MAX_ROUNDS):
        # All is aligned anew by the terms that were chosen, with their load, and what no longer gains is dropped.
        # the samples below a minimum speed that was chosen hold reversals, which show the time offset best
        trial_recipe = replace(terms.recipe, min_speed=recipe.min_speed)
        full_model, trial_model, delay = (
            terms.loaded_model(),
            terms.loaded_model(without_delay=True),
            terms.ripple_delay,
        )
        # late ripples hold the offset that they were found with, unless they are late because of that
        if not delay or not preparation.is_better(preparation, trial_model, full_model, -delay):
            trial_model = full_model
        aligned = prepare(trial_model, data, trial_recipe, executor, cache, preparation.angles, presliding=False)
        if aligned.is_near(preparation):
            preparation = aligned
            break
        if not aligned.is_better(preparation, trial_model, full_model):
            break
        other_terms = add_chosen_terms(model, recipe, aligned)
        if not other_terms.choice.error < terms.choice.error:
            break
        move = abs(aligned.time_offset - preparation.time_offset)
        preparation, terms = aligned, other_terms
        # Presliding friction looks like an offset; with its terms, each round about halves the error of the offset.
        if move < MIN_FURTHER_MOVE:
            break
    return terms, preparation.with_terms(terms.model, terms.recipe)


def _eligible_names(model: Model) -> set[str]:
    """Return the names of the parameters of all terms that might be chosen."""
    # Sizes do not matter here: any excitation gives the names of the parameters.
    excitations = [JointExcitation(model.joints, joint, 1.0, 1.0, MIN_DRIFT_DURATION) for joint in model.joints]
    terms = [kind.sizes(excitation)[0] for excitation in excitations for kind in library_kinds()]
    return {parameter.name for term in terms for parameter in term.parameters}


def _choose_model_terms(model: Model, recipe: Recipe, preparation: Preparation) -> TermChoice:
    """Choose the terms of a model on its tilted base; the plain set where samples are too few.

    Classes that the recipe proposes take part beside those of the library. Raises the other errors of
    ``choose_terms``.
    """
    bodies = drop_load_dependence(on_base(model, preparation.angles))
    motions = tuple(map(bodies.remembering, preparation.motions.train))
    kinds = (*library_kinds(), *(kind_of_class(proposed.__name__, proposed) for proposed in recipe.proposed))
    try:
        return choose_terms(bodies, motions, recipe.selection(model.joints), kinds=kinds)
    except TooFewSamplesError:
        joints = tuple(joint.name for joint in model.joints)
        unknown, no_speeds = (np.nan,) * len(joints), (0.0,) * len(joints)
        return TermChoice(joints, with_plain_terms(model).terms[len(model.terms) :], (), unknown, unknown, no_speeds)
