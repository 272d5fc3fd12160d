"""From a request to whole designs of a small arm: from rest to rest, the same again, as accurate as announced."""

import importlib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.excitation import (
    Criterion,
    Interrupted,
    LeftOut,
    Program,
    Purpose,
    Trajectory,
    design,
    expected_accuracy,
    verify,
)
from dynident.apps.excitation.design import torque_information, unexcited_parameters
from dynident.apps.excitation.family import ClampedSpline, Fourier
from dynident.apps.excitation.interior import GridReserve, Interior
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.motion import (
    check_request,
    criterion_rows,
    find_best_motion,
    motion_pieces,
    reachable_motion,
    without_memory,
)
from dynident.apps.excitation.search import Plan, Stage, random_motion, search
from dynident.apps.excitation.way import RAMP_IN, RAMP_OUT, from_rest
from dynident.models.friction import Dahl
from dynident.motion.log import Motion
from dynident.regression import Regression, Selection, UnexcitedParameters, base_std
from dynident.runtime import ConfigError, InputError, progress_to
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, smooth_and_at_rest
from tests.apps.excitation.requests import BASIS, OPEN, REQUEST, SPACE, interior
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


SCALE = np.ones(BASIS.rank)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"period": 10.0}, "period of 10 s is longer than the duration of 9 s"),
        ({"start": np.array([0.0, 2.7])}, "start: joint 'bend' is at 2.7, outside of -2.52 to 2.52"),
        ({"start": np.array([np.nan, 0.0])}, "start: joint 'lift' is at nan"),
        ({"start": np.zeros(2)}, "the start: 'lower' and 'post' overlap"),
    ],
)
def test_what_cannot_be_is_refused(changes, message):
    with pytest.raises((ConfigError, InputError), match=message):
        check_request(Feasibility(MODEL, THETA, LIMITS, SPACE), replace(REQUEST, **changes))


def test_names_give_the_rows_of_their_base_parameters_and_a_value_of_zero_counts_as_what_is_usual():
    names, scale = ("Fv_lift", "Fv_bend"), np.arange(1.0, BASIS.rank + 1)
    request = replace(REQUEST, criterion=Criterion.A_OPTIMAL, named=names)
    which = [BASIS.leading.index(name) for name in names]
    rows, values = criterion_rows(BASIS, THETA, request, SCALE), BASIS.to_base(THETA)
    np.testing.assert_allclose(rows[:, which], np.diag(1 / np.abs(values[which])))
    assert (rows != 0).sum() == 2
    theta = THETA.copy()
    theta[BASIS.names.index("Fv_bend")] = 0.0
    rows, (k, j) = criterion_rows(BASIS, theta, request, scale), which
    assert 1 / rows[1, j] == pytest.approx(values[k] * scale[k] / scale[j])
    assert np.isfinite(criterion_rows(BASIS, 0 * theta, request, scale)).all()
    for changes in ({"criterion": Criterion.D_OPTIMAL}, {"named": ()}):
        assert criterion_rows(BASIS, THETA, replace(request, **changes), SCALE) is None


def test_names_that_are_not_there_or_never_alone_are_refused():
    request = replace(REQUEST, criterion=Criterion.A_OPTIMAL)
    with pytest.raises(ConfigError, match="there is no parameter 'Fv_lit'; did you mean 'Fv_lift'"):
        criterion_rows(BASIS, THETA, replace(request, named=("Fv_lit",)), SCALE)
    never = next(name for name in BASIS.names if name not in BASIS.leading)
    with pytest.raises(ConfigError, match=f"no motion shows '{never}' by itself"):
        criterion_rows(BASIS, THETA, replace(request, named=(never,)), SCALE)


def test_terms_that_remember_are_left_out_with_what_belongs_to_them():
    model = MODEL.with_terms(Dahl(MODEL.joints))
    information = np.arange(1.0, len(model.parameters) + 1)
    request = replace(REQUEST, prior=np.diag(information))
    theta = np.concatenate([THETA, np.ones(len(information) - len(THETA))])
    bare, remaining, request, notes = without_memory(model, theta, request)
    assert bare.names == MODEL.names
    np.testing.assert_array_equal(remaining, THETA)
    np.testing.assert_array_equal(np.diag(request.prior), information[: len(THETA)])
    assert notes == (LeftOut(("Dahl",)),)
    assert without_memory(MODEL, THETA, REQUEST) == (MODEL, THETA, REQUEST, ())


FREE = Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance)
SHORT = Plan(1, (Stage(1.0, 8), Stage(0.1, 8)))


def test_the_criterion_of_the_search_is_that_of_the_recording():
    test_interior = interior(space=OPEN, duration=13.0)  # two periods of 4 s beside the ways
    x = random_motion(test_interior, np.random.default_rng(0))
    request = replace(REQUEST, duration=13.0, max_periods=2)
    pieces = motion_pieces(FREE, test_interior.family, x, request, np.random.default_rng(0))
    motion = Trajectory(LIMITS.joints, tuple(piece for piece in pieces if piece.purpose is Purpose.MOTION))
    assert len(motion.pieces) == 2
    states = motion.states(np.arange(0.0, motion.duration, 1 / REQUEST.rate))
    recorded = expected_accuracy(MODEL, THETA, torque_information(MODEL, states, 1 / REQUEST.sigma**2), BASIS)
    assert test_interior.information.prior is None
    assert interior(space=OPEN, prior=np.eye(len(THETA))).information.prior.shape == (BASIS.rank, BASIS.rank)
    criterion = test_interior.information
    sought = 2 * np.log(criterion.scale).sum() - criterion.value(*test_interior.states(x)[:3])
    assert sought == pytest.approx(recorded.log_det, abs=1.0)  # of about 150: the sign of friction is smooth in one


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "log det"),
        ({"criterion": Criterion.CONDITION}, "condition number"),
        ({"criterion": Criterion.A_OPTIMAL, "named": ("Fv_lift",)}, "variances"),
    ],
)
def test_progress_says_what_is_sought(changes, words):
    seen, test_interior = [], interior(space=OPEN, **changes)
    with progress_to(seen.append):
        best_motion = find_best_motion(test_interior, FREE, Plan(1, (Stage(1.0, 1),)), np.random.default_rng(0))
    assert all(words in step for step in seen)
    if not changes:
        value = 2 * np.log(test_interior.information.scale).sum() - best_motion.criterion
        assert f"log det {value:.1f}" in seen[-1]


def test_a_torque_beyond_the_limit_between_the_points_is_mended_by_more_search_or_a_smaller_motion(monkeypatch):
    test_interior = interior(space=OPEN)
    x = search(test_interior, SHORT, np.random.default_rng(1)).x
    tight = replace(LIMITS, torque=0.9 * np.abs(MODEL.torque(*test_interior.states(x)[:3], THETA)).max(axis=0))
    narrow = interior(space=OPEN, limits=tight)
    loose = replace(narrow, spare=replace(narrow.spare, torque=np.full(2, -0.1)))  # as if the grid missed so much
    beyond = loose.between(search(loose, SHORT, np.random.default_rng(1)).x, MODEL)
    assert beyond.torque.max() > 0
    criteria = []
    for restarts in (2, 0):
        monkeypatch.setattr("dynident.apps.excitation.motion.MAX_RESTARTS", restarts)
        mended = find_best_motion(loose, replace(FREE, limits=tight), SHORT, np.random.default_rng(1))
        assert narrow.between(mended.x, MODEL) is None
        fine = np.asarray(narrow.family.values(np.linspace(0.0, narrow.family.duration, 4001)) @ mended.x.T)
        assert (np.abs(MODEL.torque(*fine[:3], THETA)) <= tight.torque).all()
        criteria.append(mended.criterion)
    assert criteria[0] < criteria[1] - 1.0


@pytest.mark.parametrize("start", [None, np.array([0.4, -0.3])])
@pytest.mark.parametrize("family", ["fourier", "bspline"])
def test_motions_go_from_rest_to_rest_within_the_time(family, start):
    request = replace(REQUEST, duration=15.0, family=family, start=start)
    test_interior = interior(space=OPEN, duration=15.0, family=family, start=start)
    assert isinstance(test_interior.family, Fourier if family == "fourier" else ClampedSpline)
    x = random_motion(test_interior, np.random.default_rng(1))
    pieces = motion_pieces(FREE, test_interior.family, x, request, np.random.default_rng(0))
    trajectory = Trajectory(LIMITS.joints, pieces)
    assert trajectory.duration <= 15.0
    periods = [piece.label for piece in pieces if piece.purpose is Purpose.MOTION]
    ways = sum(piece.course.duration for piece in pieces if piece.purpose is Purpose.WAY)
    count = int((15.0 - ways) / 4.0) if family == "fourier" else 1
    assert periods == [str(k + 1) for k in range(count)]
    ramps = [piece.label for piece in pieces if piece.label in (RAMP_IN, RAMP_OUT)]
    assert ramps == ([RAMP_IN, RAMP_OUT] if family == "fourier" else [])
    verify(trajectory, Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance))
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose([first, last], [first if start is None else start] * 2, atol=1e-9)


def test_without_the_time_for_the_ways_it_is_said():
    test_interior = interior(space=OPEN)
    x = random_motion(test_interior, np.random.default_rng(1))
    with pytest.raises(InputError, match=r"takes .* s with the ways to it and back, more than the 4 s"):
        motion_pieces(FREE, test_interior.family, x, replace(REQUEST, duration=4.0), np.random.default_rng(0))


def test_what_cannot_be_kept_between_the_points_is_named(monkeypatch):
    test_interior = interior()
    far = GridReserve(np.zeros(2), np.linspace(0.0, 1.0, len(SPACE.pairs)))
    monkeypatch.setattr(Interior, "between", lambda *_: far)
    monkeypatch.setattr("dynident.apps.excitation.motion.MAX_RESTARTS", 0)
    pair = " and ".join(map(repr, SPACE.pairs[-1]))
    with pytest.raises(InputError, match=f"{pair} come too close"):
        find_best_motion(test_interior, FREE, SHORT, np.random.default_rng(1))


def test_where_no_way_leads_into_a_motion_a_smaller_one_is_driven(monkeypatch):
    test_interior = interior(space=OPEN, duration=13.0)
    x = random_motion(test_interior, np.random.default_rng(1))
    size = np.abs(x[:, 1:]).max()

    def small(feasible, course, *rest):
        return from_rest(feasible, course, *rest) if np.abs(course.x[:, 1:]).max() < 0.6 * size else None

    monkeypatch.setattr("dynident.apps.excitation.motion.from_rest", small)
    request = replace(REQUEST, duration=13.0)
    pieces = reachable_motion(test_interior, FREE, x, request, np.random.default_rng(0))
    verify(Trajectory(LIMITS.joints, pieces), Feasibility(MODEL, THETA, LIMITS, OPEN, REQUEST.clearance))
    monkeypatch.setattr("dynident.apps.excitation.motion.from_rest", lambda *_: None)
    with pytest.raises(InputError, match="torque limits hold the arm"):
        reachable_motion(test_interior, FREE, x, request, np.random.default_rng(0))
    with pytest.raises(InputError, match="another start pose, or none"):
        reachable_motion(test_interior, FREE, x, replace(request, start=np.zeros(2)), np.random.default_rng(0))
