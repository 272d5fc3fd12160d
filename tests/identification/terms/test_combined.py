"""Terms on single joints become one term per class."""

from __future__ import annotations

import numpy as np

from dynident.identification.terms.combined import combined
from dynident.models import Coulomb, Joint, Model, Ripple, Viscous

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
    whole = Model(combined(JOINTS, parts))
    single = {one.parameters[k].name: one.regressor for some in parts for one in some for k in [0]}
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 20, 3))
    Y = whole.regressor(q, dq, ddq)
    assert [type(one).__name__ for one in whole.terms] == ["Viscous", "Coulomb", "Ripple"]
    assert len(whole.names) == 8
    for name, regressor in single.items():
        assert np.allclose(Y[:, :, whole.names.index(name)], regressor(q, dq, ddq)[:, :, 0])
