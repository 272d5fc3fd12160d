"""From a request to the best motion, from rest to rest; requests that contradict themselves are refused."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import Criterion, LeftOut, Program, Purpose, Trajectory, expected_accuracy, verify
from dynident.apps.excitation.design import torque_information
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
from dynident.runtime import ConfigError, InputError, progress_to
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, smooth_and_at_rest
from tests.apps.excitation.requests import BASIS, OPEN, REQUEST, SPACE, interior

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
        check_request(LIMITS, SPACE, replace(REQUEST, **changes))


def test_a_period_matters_to_motions_that_have_one():
    for changes in ({"family": "bspline"}, {"program": Program.FRICTION}):
        check_request(LIMITS, SPACE, replace(REQUEST, period=10.0, **changes))


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
