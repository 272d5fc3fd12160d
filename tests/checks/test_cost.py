"""What a cause costs is what it costs: the error of the torque on a faster motion, which a simulated robot has."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import misfit
from dynident.checks.missing import cost, faster_case, mean_square
from dynident.checks.robot_notes import Costly, MissingTerm, TermKind, TorqueGain, WrongValue
from dynident.runtime import Finding, Use
from tests.checks.moving_arm import arm, case, motion, truth

MOVED = motion()


def relative(error: np.ndarray, torque: np.ndarray) -> float:
    return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(torque))


def first(moved, model=None) -> Costly:
    return next(iter(explain_residual(case(moved, model)))).message


@pytest.mark.parametrize("kind", ["viscous", "coulomb", "rotor"])
def test_a_term_left_out_costs_its_error_on_the_faster_motion(kind: str) -> None:
    given = case(MOVED, arm(without=kind))
    fast, whole = faster_case(given), arm()
    right = whole.torque(fast.q, fast.dq, fast.ddq, truth(whole))
    wrong = fast.torque(misfit(given).theta)
    found = first(MOVED, arm(without=kind))
    assert found.effect is TermKind(kind)
    assert found.cost == pytest.approx(relative(wrong - right, right), rel=0.25)


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_a_gain_costs_its_error_in_the_unit_of_the_other_joints(gain: float) -> None:
    factor = np.array([1.0, gain, 1.0])
    given = case(replace(MOVED, tau=factor * MOVED.tau))
    fast, model = faster_case(given), arm()
    right = model.torque(fast.q, fast.dq, fast.ddq, truth(model))
    wrong = fast.torque(misfit(given).theta)
    found = first(replace(MOVED, tau=factor * MOVED.tau))
    assert isinstance(found, TorqueGain)
    assert found.cost == pytest.approx(relative(wrong - right, right), rel=0.1)
    assert found.joint_cost >= found.cost


def test_what_changes_nothing_costs_nothing() -> None:
    fit = misfit(case())
    assert cost(fit, fit).all == cost(fit, fit).joint == 0.0


@pytest.mark.parametrize(("size", "forbidden"), [(0.2, None), (5.1, Use.SIMULATION), (10.1, Use.CONTROL)])
def test_an_effect_forbids_by_its_cost(size: float, forbidden: Use | None) -> None:
    note = MissingTerm(TermKind.SPRING, 1.0, 0.1, 0.5, cost=size)
    assert note.forbidden is Finding(note, "j1").forbids is forbidden


def test_a_value_that_is_wrong_forbids_simulation_and_control_where_a_joint_is_far_off() -> None:
    found = {gain: first(replace(MOVED, tau=MOVED.tau * np.array([1.0, gain, 1.0]))) for gain in (1.1, 2.0)}
    assert all(isinstance(one, WrongValue) for one in found.values())
    assert [one.forbidden for one in found.values()] == [Use.SIMULATION, Use.CONTROL]


@pytest.mark.parametrize("kind", ["viscous", "coulomb"])
def test_what_a_term_removes_is_what_the_fit_with_it_leaves_less(kind: str) -> None:
    """The share of what is no white noise: the model with the term at all joints leaves only noise."""
    without, whole = misfit(case(MOVED, arm(without=kind))), misfit(case(MOVED))
    found = list(explain_residual(case(MOVED, arm(without=kind))))
    removed = dict(pair for one in found for pair in one.message.removed)
    less = mean_square(without) - mean_square(whole)
    names = [joint.name for joint in arm().joints]
    share = less / np.maximum(mean_square(without) - without.case.noise, less)
    assert removed == pytest.approx(dict(zip(names, share, strict=True)), rel=0.1)
    assert share.min() > 0.9


def test_what_changes_nothing_removes_nothing() -> None:
    fit = misfit(case())
    assert cost(fit, fit).removed == ()
    assert MissingTerm(TermKind.SPRING, 1.0, 0.1, 0.5).removed == ()
