"""Terms switched on and off, joint by joint, and those that a joint could have."""

import numpy as np
import pytest

from dynident.apps.tuning.switches import Offers, Switches, _basis
from dynident.identification import Recipe, identify
from dynident.identification.terms.samples import columns_of
from dynident.models import CoupledMotor, Model, RigidBodies, Term
from dynident.models.friction import Coulomb, Offset, Stribeck, Viscous
from dynident.motion.smoothers import Spline
from dynident.runtime import ModelError
from dynident.runtime.families import TERMS
from tests.apps.tuning.arms import BODIES, JOINTS, MODEL, THETA, recording

MOTOR = CoupledMotor(BODIES.joints, {"shoulder": 1.0, "twist": -1.0}, name="m")
GIVEN = Model((BODIES, Viscous(BODIES.joints, names=("a", "b", "c")), Coulomb(BODIES.joints, width=0.02), MOTOR))
OFFERED: tuple[dict[str, tuple[Term, ...]], ...] = (
    {},
    {"stribeck": (Stribeck(BODIES.joints, on=("rail",), velocity=0.1),)},
    {"offset": (Offset(BODIES.joints, on=("twist",)),)},
)


def switches() -> Switches:
    viscous, coulomb = Viscous(BODIES.joints), Coulomb(BODIES.joints, width=0.02)
    own = ({"viscous": (viscous.for_joint(name),), "coulomb": (coulomb.for_joint(name),)} for name in JOINTS)
    return Switches(GIVEN, (("viscous", "coulomb"),) * 3, tuple(a | b for a, b in zip(own, OFFERED, strict=True)))


def test_what_is_not_changed_stays_as_it_was_written() -> None:
    made = switches()
    assert made.terms(made.start) == (GIVEN.terms[1], GIVEN.terms[2])
    backwards = tuple(tuple(reversed(x)) for x in made.start)
    assert made.with_terms(backwards).terms == GIVEN.terms


def test_kinds_are_switched_joint_by_joint() -> None:
    made = switches()
    bodies, *terms, motor = made.with_terms((("viscous",), ("stribeck", "viscous"), ("coulomb", "offset"))).terms
    assert isinstance(bodies, RigidBodies)
    assert motor == MOTOR
    on = {
        type(term).__name__: term.acts_on for term in terms if isinstance(term, Viscous | Coulomb | Stribeck | Offset)
    }
    assert on == {"Viscous": ("shoulder", "rail"), "Stribeck": ("rail",), "Coulomb": ("twist",), "Offset": ("twist",)}
    (coulomb,) = (term for term in terms if isinstance(term, Coulomb))
    assert coulomb.constant("width", "twist") == 0.02
    assert made.kinds == ("viscous", "coulomb", "stribeck", "offset")
    with pytest.raises(ModelError, match="shoulder: there is no term of kind 'stribeck'"):
        made.with_terms((("stribeck",), (), ()))


def test_without_offers_nothing_can_be_switched() -> None:
    made = Switches.of(GIVEN, None)
    assert made.kinds == ()
    assert made.with_terms(made.start) is GIVEN


TRUE = Model((*MODEL.terms, Stribeck(BODIES.joints, on=("twist",), velocity=0.15)))


def test_sizes_are_those_that_explain_what_is_left() -> None:
    log = recording(1, model=TRUE, theta=np.append(THETA, 3.0))
    result = identify(MODEL, [log], recipe=Recipe(Spline()))
    offers = Offers.of(result.model, result.estimate.value, [result.validations[0].motion])
    kinds = dict(offers.kinds_of_joint(2))
    (term,) = kinds["stribeck"]
    assert isinstance(term, Stribeck)
    assert 0.1 < float(term.constant("velocity", "twist")) < 0.25
    assert term.acts_on == ("twist",)
    assert {"viscous", "dahl", "load_coulomb", "spring", "power"} <= kinds.keys()
    assert all(TERMS.kind_of(x) == kind for kind, some in kinds.items() for x in some)
    # what the model has already gains nothing, whatever rounding leaves of its columns
    rows = offers.samples.keep[:, 2]
    own = columns_of(offers.samples, Viscous(BODIES.joints, on=("twist",)), 2, offers.loads)[:, rows]
    assert offers._gain(Viscous(BODIES.joints, on=("twist",)), 2, rows, _basis(own)) == 0.0
    assert offers._gain(term, 2, rows, _basis(own)) > 0.0


def test_a_joint_of_which_nothing_is_fitted_has_offers_too() -> None:
    result = identify(MODEL, [recording(1)], recipe=Recipe(Spline(), unfitted=("rail",)))
    offers = Offers.of(result.model, result.estimate.value, [result.validations[0].motion])
    assert "stribeck" in dict(offers.kinds_of_joint(1))
