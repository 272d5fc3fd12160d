"""Terms on single joints become one term per class."""

from __future__ import annotations

import numpy as np

from dynident.identification.terms.candidates import combine_terms
from dynident.models import Joint, Model
from dynident.models.friction import Coulomb, Ripple, Viscous

JOINTS = tuple(map(Joint, ("a", "b", "c")))


def test_the_regressor_of_the_whole_is_that_of_the_parts() -> None:
    parts = [
        [Viscous(JOINTS, on=("a",)), Coulomb(JOINTS, on=("a",), width=0.1)],
        [Coulomb(JOINTS, on=("b",), width=0.2)],
        [
            Viscous(JOINTS, on=("c",)),
            Ripple(JOINTS, on=("c",), cycles=(10.0,)),
            Ripple(JOINTS, on=("c",), cycles=(7.0,)),
        ],
    ]
    whole = Model(combine_terms(JOINTS, parts))
    single = {one.parameters[k].name: one.regressor for some in parts for one in some for k in [0]}
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 3))
    Y = whole.regressor(q, dq, ddq)
    assert [type(one).__name__ for one in whole.terms] == ["Viscous", "Coulomb", "Ripple"]
    assert len(whole.names) == 8
    for name, regressor in single.items():
        assert np.allclose(Y[:, :, whole.names.index(name)], regressor(q, dq, ddq)[:, :, 0])


def test_ripples_of_one_joint_keep_their_delays() -> None:
    early, late = (Ripple(JOINTS, on=("c",), cycles=(k,), delay=d) for k, d in ((10.0, -0.002), (7.0, 0.004)))
    elsewhere = Ripple(JOINTS, on=("a",), cycles=(5.0,), delay=0.001)
    found = combine_terms(JOINTS, [[elsewhere], [], [early, late]])
    assert [one.acts_on for one in found] == [("a", "c"), ("c",)]  # type: ignore[attr-defined]
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 3))
    whole = Model(found).regressor(q, dq, ddq)
    parts = Model((elsewhere, early, late)).regressor(q, dq, ddq)
    assert np.allclose(whole, parts)
