"""What terms remember is needed where they are evaluated."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.models import Model, drop_load_dependence
from dynident.models.friction import Coulomb, Dahl, Drift, LoadCoulomb, Viscous
from dynident.models.lagrangian import pendulum
from dynident.motion.log import Motion
from dynident.regression import Regression
from dynident.runtime import InputError, ModelError

JOINTS = pendulum().joints
HYSTERETIC = pendulum().with_terms(Dahl(JOINTS, length=0.02), Viscous(JOINTS), Drift(JOINTS, time=2.0))
LOADED = pendulum().with_terms(LoadCoulomb(JOINTS, width=0.1), Viscous(JOINTS))


def swinging(samples=5000):
    t = np.linspace(0.0, 10.0, samples)
    q, dq, ddq = (np.sin(4 * t + k * np.pi / 2)[:, None] * 4**k for k in range(3))
    return Motion(t, q, dq, ddq, 0 * q, ("pivot",), np.ones(samples, bool), "swing")


def test_a_motion_without_its_memory_or_with_another_is_refused():
    with pytest.raises(ModelError, match=r"the motion before \(Dahl, Drift\).*`Model.remembering`"):
        Regression(HYSTERETIC, (swinging(),))
    with pytest.raises(ModelError, match="no memory of it is given"):
        HYSTERETIC.torque(*np.zeros((3, 2, 1)), np.ones(5))
    with pytest.raises(ModelError, match=r"memory has shape \(2, 1\), expected \(2, 2\)"):
        HYSTERETIC.torque(*np.zeros((3, 2, 1)), np.ones(5), np.zeros((2, 1)))
    with pytest.raises(InputError, match="memory has shape"):
        replace(swinging(50), memory=np.zeros((49, 1)))


def test_the_load_is_found_without_the_terms_that_need_it():
    assert drop_load_dependence(LOADED).names == ("J", "h", "Fv_pivot")
    assert drop_load_dependence(LOADED.with_load(np.ones(4))).needs_load
    assert drop_load_dependence(HYSTERETIC) is HYSTERETIC
    with pytest.raises(ModelError, match="no term is of bodies"):
        drop_load_dependence(Model((Coulomb(JOINTS), LoadCoulomb(JOINTS))))
    with pytest.raises(ModelError, match="load has 1 parameters, but its bodies have 2"):
        replace(LOADED, load=(1.0,))
