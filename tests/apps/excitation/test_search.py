"""The search: its barrier, feasible and better motions, and its polished end."""

import importlib
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from dynident.apps.excitation import Criterion, polish
from dynident.apps.excitation.polish import polish_motion
from dynident.apps.excitation.search import STAGES, Plan, Stage, improve_motion, random_motion, search
from dynident.runtime import InputError, progress_to
from tests.apps.excitation.arms import LIMITS
from tests.apps.excitation.requests import OPEN, interior

searching = importlib.import_module("dynident.apps.excitation.search")  # the package has the function by this name


@pytest.mark.parametrize("family", ["fourier", "bspline"])
def test_random_motions_keep_to_all_limits_and_use_them(family):
    test_interior = interior(family=family)
    rng = np.random.default_rng(0)
    result = [random_motion(test_interior, rng) for _ in range(6)]
    assert all(map(test_interior.is_inside, result))
    used = [1 - test_interior.range_slack(x).min() for x in result]
    assert np.median(used) > 0.3
    assert np.abs(result[0] - result[1]).max() > 0.1


def test_where_only_standing_is_possible_it_is_said():
    test_interior = interior(space=OPEN)
    heavy = test_interior.with_reserve(replace(test_interior.spare, torque=np.ones(2)))
    with pytest.raises(InputError, match="no random motion keeps to the limits"):
        random_motion(heavy, np.random.default_rng(0))


TIGHT = replace(LIMITS, torque=np.array([11.0, 3.5]))  # near what gravity takes


@pytest.mark.parametrize("kind", list(Criterion))
@pytest.mark.parametrize("family", ["fourier", "bspline"])
def test_the_gradient_is_that_of_the_value(kind, family):
    test_interior = interior(criterion=kind, family=family, limits=TIGHT)
    rng = np.random.default_rng(1)
    x = random_motion(test_interior, rng)
    assert test_interior.gaps(test_interior.states(x)[0]).min() < 0.3
    assert test_interior.torque_slack(test_interior.states(x)).min() < 0.3
    for weight in (0.0, 30.0):  # 30: of the barrier alone
        gradient = test_interior.at(x, weight).gradient
        step = rng.normal(size=x.shape) * 1e-6
        ends = [test_interior.at(x + side * step, weight).value for side in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(2 * float((gradient * step).sum()), rel=2e-5)


@pytest.mark.parametrize("limit", ["lower", "velocity", "acceleration", "jerk", "torque", "clearance"])
def test_each_limit_alone_is_kept_and_only_within_all_there_is_a_value(limit):
    test_interior = interior()
    x = random_motion(test_interior, np.random.default_rng(5))
    states = np.abs(test_interior.states(x) - np.stack([LIMITS.middle, *np.zeros((3, 2))])[:, None]).max(axis=1)
    used = dict(zip(("lower", "velocity", "acceleration", "jerk"), states, strict=True))
    match limit:
        case "clearance":
            tight = interior(clearance=2.0)
        case "torque":
            tight = interior(limits=replace(LIMITS, torque=0.1 * LIMITS.torque))
        case "lower":
            ends = {"lower": LIMITS.middle - 0.9 * used[limit], "upper": LIMITS.middle + 0.9 * used[limit]}
            tight = interior(limits=replace(LIMITS, **ends))
        case _:
            tight = interior(limits=replace(LIMITS, **{limit: 0.9 * used[limit]}))
    assert (test_interior.is_inside(x), tight.is_inside(x)) == (True, False)
    assert test_interior.at(x, 1.0) is not None
    assert tight.at(x, 1.0) is None


SHORT = (Stage(1.0, 10), Stage(0.1, 10, 0.5))
ONE = interior(space=OPEN)


def test_the_motion_found_is_better_than_random_ones_and_keeps_to_the_limits():
    outcome = search(ONE, Plan(2, (Stage(1.0, 15), Stage(0.05, 15))), np.random.default_rng(0))
    rng = np.random.default_rng(1)
    others = [ONE.at(random_motion(ONE, rng), 0.0).criterion for _ in range(40)]
    assert outcome.criterion < min(others) - 3
    assert outcome.criterion == pytest.approx(ONE.at(outcome.x, 0.0).criterion)
    assert ONE.is_inside(outcome.x)
    assert not outcome.interrupted


def test_the_executor_does_not_change_the_motion_nor_does_another_process():
    alone = search(ONE, Plan(3, SHORT), np.random.default_rng(4))
    with ThreadPoolExecutor(2) as two:
        copy = pickle.loads(pickle.dumps(ONE))
        spread = search(copy, Plan(3, SHORT), np.random.default_rng(4), executor=two)
    np.testing.assert_array_equal(alone.x, spread.x)
    other = search(ONE, Plan(1, SHORT), np.random.default_rng(5))
    assert np.abs(other.x - alone.x).max() > 1e-3


def test_stopped_it_gives_the_best_so_far():
    calls = []

    def stop(step):
        calls.append(float(step.words.split()[-1]))
        if step.completed == 2:
            raise KeyboardInterrupt

    with progress_to(stop):
        outcome = search(ONE, Plan(4, SHORT), np.random.default_rng(4))
    assert outcome.interrupted
    log_det = 2 * np.log(ONE.information.scale).sum() - outcome.criterion
    assert max(calls) == float(f"{log_det:.1f}")
    assert ONE.is_inside(outcome.x)


def test_stopped_before_anything_was_found_it_stops(monkeypatch):
    monkeypatch.setattr(searching, "random_motion", Mock(side_effect=KeyboardInterrupt))
    with pytest.raises(KeyboardInterrupt):
        search(ONE, Plan(2), np.random.default_rng(0))


def test_a_start_beyond_the_limits_is_refused():
    x = 10 * random_motion(ONE, np.random.default_rng(9))
    with pytest.raises(InputError, match="does not keep to the limits"):
        improve_motion(ONE, x, STAGES[0])
    with pytest.raises(InputError, match="no motion was found"):
        search(ONE, Plan(1), np.random.default_rng(0), initial=[x])


def test_large_problems_keep_to_the_barrier(monkeypatch):
    tight = interior(limits=TIGHT)
    assert polish.is_small_enough(tight)
    monkeypatch.setattr(polish, "MAX_JACOBIAN_SIZE", 10)
    assert not polish.is_small_enough(tight)
    monkeypatch.setattr(searching, "LARGE_PROBLEM_STAGES", (Stage(0.1, 4),))
    monkeypatch.setattr(searching, "polish_motion", pytest.fail)
    outcome = search(tight, Plan(1, (Stage(1.0, 4), Stage(0.0, 4))), np.random.default_rng(0))
    assert tight.is_inside(outcome.x)


TIGHT_TORQUE = interior(limits=replace(LIMITS, torque=np.array([11.0, 3.5])))


def test_at_the_best_motion_no_small_step_within_the_limits_gains():
    rng = np.random.default_rng(3)
    x, _ = improve_motion(TIGHT_TORQUE, random_motion(TIGHT_TORQUE, rng), Stage(0.1, 40))
    best, value = polish_motion(TIGHT_TORQUE, x, 200)
    for _ in range(40):
        near = TIGHT_TORQUE.shrink(best + 1e-2 * rng.normal(size=x.shape) * np.abs(best).max())
        if near is not None:
            assert TIGHT_TORQUE.information.value(*TIGHT_TORQUE.states(near)[:3]) > value - 0.01


def test_a_solver_that_fails_makes_no_step(monkeypatch):
    class Failing:
        def __init__(self, *_: object) -> None:
            pass

        def solve(self):
            return type("Solution", (), {"x": [np.nan], "z": [np.nan]})()

    monkeypatch.setattr("clarabel.DefaultSolver", Failing)
    x = random_motion(TIGHT_TORQUE, np.random.default_rng(0))
    np.testing.assert_array_equal(polish_motion(TIGHT_TORQUE, x, 3)[0], x)


def test_a_longer_polish_is_better_and_goes_on_where_the_barrier_ends_within_the_limits():
    x, value = improve_motion(TIGHT_TORQUE, random_motion(TIGHT_TORQUE, np.random.default_rng(0)), Stage(0.1, 20))
    start = value
    for steps in (1, 5, 15):
        better, after = polish_motion(TIGHT_TORQUE, x, steps)
        assert after <= value
        assert TIGHT_TORQUE.is_inside(better)
        assert after == pytest.approx(TIGHT_TORQUE.at(better, 0.0).criterion)
        value = after
    assert value < start - 0.5
