"""Terms that a joint could have besides its own."""

from __future__ import annotations

import numpy as np

from dynident.apps.tuning.switches import Offers, kind_of
from dynident.identification import Recipe, identify
from dynident.models import Model
from dynident.models.friction import Stribeck, Viscous
from dynident.motion.smoothers import Spline
from tests.apps.tuning.arms import BODIES, MODEL, THETA, recording

TRUE = Model((*MODEL.terms, Stribeck(BODIES.joints, on=("twist",), velocity=0.15)))


def test_sizes_are_those_that_explain_what_is_left() -> None:
    log = recording(1, model=TRUE, theta=np.append(THETA, 3.0))
    found = identify(MODEL, [log], recipe=Recipe(Spline()))
    offers = Offers.of(found.model, found.estimate.value, [found.validations[0].motion])
    kinds = dict(offers.kinds_of_joint(2))
    (term,) = kinds["stribeck"]
    assert isinstance(term, Stribeck)
    assert 0.1 < float(term.constant("velocity", "twist")) < 0.25
    assert term.acts_on == ("twist",)
    assert {"viscous", "dahl", "load_coulomb", "spring", "power"} <= kinds.keys()
    assert all(kind_of(one) == kind for kind, some in kinds.items() for one in some)


def test_a_joint_of_which_nothing_is_fitted_has_offers_too() -> None:
    found = identify(MODEL, [recording(1)], recipe=Recipe(Spline(), unfitted=("rail",)))
    offers = Offers.of(found.model, found.estimate.value, [found.validations[0].motion])
    assert "stribeck" in dict(offers.kinds_of_joint(1))


def test_kinds_are_named_as_a_configuration_lists_them() -> None:
    assert kind_of(Viscous(BODIES.joints)) == "viscous"
    assert kind_of(BODIES) == "RigidBodies"
