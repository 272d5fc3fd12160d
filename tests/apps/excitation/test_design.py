"""Whole designs of a small arm: within the limits, the same again, and as accurate as announced."""

import importlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.excitation import Interrupted, LeftOut, Program, Purpose, design, expected_accuracy, verify
from dynident.apps.excitation.criterion import base_information
from dynident.apps.excitation.design import torque_information, unexcited_parameters
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.search import Plan, Stage
from dynident.models.friction import Dahl
from dynident.motion.log import Motion
from dynident.regression import Regression, Selection, UnexcitedParameters, base_std
from dynident.runtime import InputError, progress_to
from tests.apps.excitation.arms import LIMITS, MODEL, THETA
from tests.apps.excitation.requests import BASIS, OPEN, REQUEST, SPACE
from tests.kept import check_kept, digits, facts

SIGMA = np.array([0.4, 0.1])


def states(samples=3000, still=()):
    rng = np.random.default_rng(0)
    result = rng.uniform(-2.0, 2.0, (3, samples, 2))
    result[1:, :, list(still)] = 0.0
    result[0][:, list(still)] = 0.7
    return result


@pytest.mark.parametrize("slow", [None, (0.5, 0.1)])
def test_the_errors_are_those_of_least_squares_with_known_noise(slow):
    q, dq, ddq = states()
    information = torque_information(MODEL, states(), 1 / SIGMA**2, None if slow is None else np.array(slow))
    accuracy = expected_accuracy(MODEL, THETA, information, BASIS)
    names = tuple(joint.name for joint in MODEL.joints)
    motion = Motion(np.arange(len(q)) / 100.0, q, dq, ddq, np.zeros_like(q), names, np.ones(len(q), dtype=bool), "x")
    factors = Regression(MODEL, (motion,), selection=Selection(min_speed=slow)).triangular_factors
    np.testing.assert_allclose(accuracy.std, base_std(BASIS, factors, SIGMA, 1 / SIGMA), rtol=1e-6)
    np.testing.assert_allclose(accuracy.value, BASIS.to_base(THETA))
    assert accuracy.open_parameters == unexcited_parameters(MODEL, information, accuracy) == ()
    k = BASIS.leading.index("Fv_lift")
    assert accuracy.relative[k] == pytest.approx(100 * accuracy.std[k] / 1.0)


def test_determinant_and_condition_are_those_of_the_weighted_regressor():
    accuracy = expected_accuracy(MODEL, 0 * THETA, torque_information(MODEL, states(), 1 / SIGMA**2))
    Y = MODEL.regressor(*states())[:, :, list(BASIS.independent)] / SIGMA[:, None]
    X = Y.reshape(-1, BASIS.rank)
    assert accuracy.log_det == pytest.approx(np.linalg.slogdet(X.T @ X)[1])
    assert accuracy.condition == pytest.approx(np.linalg.cond(X / np.linalg.norm(X, axis=0)), rel=1e-6)
    assert np.isinf(accuracy.relative).all()  # of values that are zero


def test_what_stays_open_is_said_with_the_joint_that_would_show_it():
    information = torque_information(MODEL, states(still=(1,)), 1 / SIGMA**2)
    accuracy = expected_accuracy(MODEL, THETA, information, BASIS)
    assert {"Fv_bend", "Fc_bend"} <= set(accuracy.open_parameters)
    assert "Fv_lift" not in accuracy.open_parameters
    assert (accuracy.log_det, accuracy.condition) == (-np.inf, np.inf)
    notes = unexcited_parameters(MODEL, information, accuracy)
    assert notes
    assert {joint for note in notes for joint in note.joints} == {"bend"}


def test_what_is_known_before_adds_up_on_base_parameters():
    prior = np.diag(np.linspace(1.0, 2.0, len(THETA)))
    nothing = expected_accuracy(MODEL, THETA, np.zeros((26, 26)), BASIS, prior)
    np.testing.assert_allclose(
        nothing.std, np.sqrt(np.diag(BASIS.combination @ np.diag(1 / np.diag(prior)) @ BASIS.combination.T))
    )
    assert unexcited_parameters(MODEL, np.zeros((26, 26)), nothing, prior) == ()


module = importlib.import_module("dynident.apps.excitation.design")  # the package has the function by this name


@pytest.fixture(autouse=True)
def short(monkeypatch):
    stages = (Stage(1.0, 6), Stage(0.1, 6), Stage(0.0, 4))
    monkeypatch.setattr(module, "Plan", lambda starts: Plan(starts, stages))
    monkeypatch.setattr(module, "QUICK", Plan(1, (Stage(1.0, 4),)))


def designed(seed=0, model=MODEL, theta=THETA, space=OPEN, executor=None, **changes):
    return design(
        model, theta, LIMITS, space, replace(REQUEST, **changes), np.random.default_rng(seed), executor=executor
    )


def positions(case):
    return [each.states(each.times(50.0))[0] for each in (case.trajectory, case.validation)]


def test_both_motions_keep_to_the_limits_and_go_around_the_post():
    seen = []
    with progress_to(seen.append):
        case = designed(space=SPACE, start=np.array([1.2, 0.5]), duration=13.0)
    for each in (case.trajectory, case.validation):
        verify(each, Feasibility(MODEL, THETA, LIMITS, SPACE, REQUEST.clearance))
        np.testing.assert_allclose(each.states(np.zeros(1))[0, 0], [1.2, 0.5])
    assert case.trajectory.duration <= 13.0
    assert np.isfinite(case.expected.std).all()
    assert case.notes == ()
    assert [step for step in seen if not step.startswith("searching")] == [
        "finding base parameters",
        "finding the ways to it and back",
        "a second motion, for validation",
        "checking both",
    ]


@cache
def plain(seed=0):
    return designed(seed)


def test_the_generator_alone_decides_also_over_an_executor():
    case = positions(plain())
    with ThreadPoolExecutor(2) as two:
        for before, after in zip(case, positions(designed(executor=two)), strict=True):
            np.testing.assert_array_equal(before, after)
    assert np.abs(positions(plain(4))[0][0] - case[0][0]).max() > 1e-3


def test_the_validation_motion_is_another_one_at_other_speeds():
    case = plain()
    (fitted, *_), (held,) = (
        [piece.course for piece in each.pieces if piece.purpose is Purpose.MOTION]
        for each in (case.trajectory, case.validation)
    )
    assert held.duration == pytest.approx(module.VALIDATION_PERIOD_FACTOR * fitted.duration)
    share = np.linspace(0.0, 1.0, 100)
    ways = [course.states(share * course.duration)[0] for course in (held, fitted)]
    assert np.abs(ways[0] - ways[1]).max() > 0.1


@cache
def complete():
    return designed(program=Program.ALL, duration=60.0)


def test_a_design_of_all_programs():
    case = complete()
    assert case.trajectory.duration <= 60.0 * (1 + 1e-9)
    purposes = {piece.purpose for piece in case.trajectory.pieces}
    assert purposes == {Purpose.FRICTION, Purpose.POSE, Purpose.MOTION, Purpose.WAY}
    assert not any(isinstance(note, UnexcitedParameters) for note in case.notes)
    assert np.isfinite(case.expected.std).all()


def test_what_is_known_before_lowers_the_errors():
    prior = np.diag(np.linspace(1e5, 1e6, len(THETA)))
    least = np.sqrt(np.diag(np.linalg.inv(base_information(BASIS, prior))))
    assert (designed(prior=prior, starts=1).expected.std < least).all()
    assert (plain().expected.std > least).any()


def test_stopped_it_says_so_and_keeps_to_the_limits_and_terms_that_remember_are_left_out():
    def stop(step):
        if step.startswith("searching"):
            raise KeyboardInterrupt

    model = MODEL.with_terms(Dahl(MODEL.joints))
    theta = np.concatenate([THETA, np.ones(len(model.parameters) - len(THETA))])
    with progress_to(stop):
        case = designed(model=model, theta=theta)
    assert case.notes == (LeftOut(("Dahl",)), Interrupted())
    assert case.model.names == MODEL.names
    np.testing.assert_array_equal(case.theta, THETA)
    verify(case.trajectory, Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance))


def test_a_motion_that_fails_the_last_check_is_refused(monkeypatch):
    def fails(*args, **kwargs):
        raise InputError("the trajectory is refused.")

    monkeypatch.setattr(module, "verify", fails)
    with pytest.raises(InputError, match="refused"):
        designed()


def test_the_figures_of_a_design_stay():
    lines = []
    for case in (plain(), complete()):
        lines += [line for part in (case.expected, *case.checks) for line in facts(part)]
        lines += [digits(each.states(each.times(10.0))) for each in (case.trajectory, case.validation)]
    check_kept("design", "\n".join(lines))
