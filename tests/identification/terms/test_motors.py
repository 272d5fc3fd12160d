"""Friction of a motor that two joints share is found at both, and is one term."""

from dataclasses import replace

import numpy as np

from dynident.identification.terms import TrialOutcome, choose_terms
from dynident.identification.terms.motors import coupled_motors
from dynident.models import CoupledFriction, CoupledMotor, Model
from tests.identification.terms import simulated
from tests.identification.terms.simulated import PLAIN, bodies, recorded

SHARES = {"j2": 1.0, "j3": 1.0}


def model() -> Model:
    return Model((bodies(), CoupledMotor(bodies().joints, SHARES, "m")))


def test_motors_of_one_joint_are_none() -> None:
    alone = Model((bodies(), CoupledMotor(bodies().joints, {"j2": 6.0}, "m")))
    assert coupled_motors(alone) == ()
    assert [coupled_motor.name for coupled_motor in coupled_motors(model())] == ["m"]


def test_its_friction_is_found() -> None:
    motion = recorded(simulated.coulomb, 1)
    dphi = motion.dq[:, 1] + motion.dq[:, 2]
    more = 0.8 * np.sign(dphi) * np.abs(dphi) ** 0.3
    motion = replace(motion, tau=motion.tau + np.outer(more, [0.0, 1.0, 1.0]))
    choice = choose_terms(model(), [motion], kinds=PLAIN)
    result = [term for term in choice.terms if isinstance(term, CoupledFriction)]
    assert [(x.name, x.acts_on) for x in result] == [("m", ("j2", "j3"))]
    tried = [trial for trial in choice.trials if trial.kind == f"coupled {result[0].law}"]
    assert any(x.outcome is TrialOutcome.ENTERED for x in tried)


def test_none_enters_without_it() -> None:
    choice = choose_terms(model(), [recorded(simulated.coulomb, 1)], kinds=PLAIN)
    assert not any(isinstance(term, CoupledFriction) for term in choice.terms)
