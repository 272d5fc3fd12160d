"""A tracker: blocks in order, gaps, saved states, what it refuses. That its end is the offline fit: tests/laws."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.online import MotionBlock, StreamSmoothing, Tracker, estimate_smoothing
from dynident.identification import Identification
from dynident.motion.log import Log
from dynident.motion.smoothers import Butterworth, Spline, smooth_log
from dynident.motion.splines import GCV, Constraint
from dynident.project.saved import load
from dynident.regression import GroupKind, ParallelFilter
from dynident.runtime import ConfigError, InputError
from tests.laws.test_online import identified, recorded


@cache
def plain() -> Identification:
    return identified({}, recorded())


@cache
def filtered() -> Identification:
    return identified({"filter": ParallelFilter(decimate=4), "time_offset": 0.004}, recorded())


@cache
def remembering() -> Identification:
    return identified({"memory": True, "time_offset": -0.002}, recorded())


def pushed(tracker: Tracker, log: Log, size: int) -> list[MotionBlock]:
    result: list[MotionBlock] = []
    for start in range(0, len(log), size):
        part = slice(start, start + size)
        result += tracker.push(log.t[part], log.q[part], log.tau[part])
    return [*result, *tracker.finish()]


@pytest.mark.parametrize(
    "smoother",
    [
        Spline(),
        Spline(GCV()),
        Spline(Constraint((900.0, 1000.0, 1100.0)), sigma={"rail": 1e-4}, factor={"shoulder": 2.0}),
    ],
)
def test_each_joint_is_smoothed_alone_as_beside_the_others(smoother: Spline) -> None:
    result, log = plain(), recorded()
    recipe = replace(result.recipe, smoother=smoother)
    smoothing = estimate_smoothing(replace(result, recipe=recipe), log)
    expected = smooth_log(smoother, recipe.repair(log)).smoothing["bandwidth"]
    np.testing.assert_allclose(smoothing.bandwidth, np.array(expected), rtol=1e-12)


@pytest.mark.parametrize(("make", "size"), [(plain, 100), (filtered, 1), (remembering, 1)])
def test_blocks_and_estimate_do_not_depend_on_how_samples_come(make, size: int) -> None:
    log, result = recorded(), make()
    smoothing = estimate_smoothing(result, log)
    trackers = [Tracker(result, smoothing, 0.1, {GroupKind.FRICTION: 3.0}) for _ in range(2)]
    first, second = (pushed(tracker, log, k) for tracker, k in zip(trackers, (len(log), size), strict=True))
    assert [len(each.motion) for each in first] == [len(each.motion) for each in second]
    t = np.concatenate([each.motion.t for each in first])
    assert (np.diff(t) > 0).all()
    assert len(t) >= len(log) - 1
    np.testing.assert_array_equal(*(each.estimate().value for each in trackers))


@pytest.mark.parametrize("make", [plain, filtered, remembering])
def test_a_saved_state_goes_on(make) -> None:
    log, result = recorded(), make()
    smoothing = estimate_smoothing(result, log)
    full, first, second = (
        Tracker(result, smoothing, 0.2, {GroupKind.FRICTION: 2.0, GroupKind.PAYLOAD: 5.0}) for _ in range(3)
    )
    pushed(full, log, 100)
    first.push(log.t[:731], log.q[:731], log.tau[:731])
    second.restore({name: np.array(x.tolist()) for name, x in first.state.items()})
    second.push(log.t[731:], log.q[731:], log.tau[731:])
    second.finish()
    np.testing.assert_allclose(second.estimate().value, full.estimate().value, rtol=0, atol=1e-9)
    assert second.fit.rows == pytest.approx(full.fit.rows, rel=1e-12)


def test_a_gap_lets_go_of_what_was_before() -> None:
    log, result = recorded(), filtered()
    smoothing = estimate_smoothing(result, log)
    test_log = Log(log.t + 60.0, log.q, log.tau, log.joints)
    first, second = Tracker(result, smoothing), Tracker(result, smoothing)
    before = pushed(first, log, 100)
    actual = [*before, *pushed(first, test_log, 100)]
    for each in (log, test_log):
        second.push(each.t, each.q, each.tau)
    second.finish()
    assert first.fit.rows == second.fit.rows == 2 * sum(e.tau.size for block in before for e in block.entries)
    np.testing.assert_allclose(first.estimate().value, second.estimate().value, rtol=0, atol=1e-10)
    np.testing.assert_allclose(actual[len(before)].motion.ddq, before[0].motion.ddq, rtol=0, atol=1e-6)


def test_a_block_is_late_by_what_the_tracker_says() -> None:
    log, result = recorded(), filtered()
    tracker = Tracker(result, estimate_smoothing(result, log), lag=0.1, window=20)
    last = 0.0
    for k in range(len(log)):
        for block in tracker.push(log.t[k], log.q[k], log.tau[k]):
            last = float(block.motion.t[-1])
        assert log.t[k] - last <= tracker.latest + 1e-9
    assert log.t[-1] - last > 0.3 * tracker.latest
    assert "0.1 s" in repr(tracker)


def test_rests_have_the_smoothing_of_what_moves() -> None:
    log, result = recorded(), plain()
    smoothing = estimate_smoothing(result, log)
    step, width = smoothing.step, smoothing.bandwidth
    q = log.q.copy()
    q[:, 1] = 0.3
    other = estimate_smoothing(result, Log(log.t, q, log.tau, log.joints))
    assert other.step == step == pytest.approx(0.005)
    np.testing.assert_allclose(other.bandwidth, [width[0], np.median(width[[0, 2]]), width[2]])
    with pytest.raises(ConfigError, match="no joint moves, so that the smoothing cannot be found"):
        estimate_smoothing(result, Log(log.t, np.full_like(q, 0.3), log.tau, log.joints))


def test_a_result_read_from_a_file_does_and_what_is_not_shown_keeps_its_value(tmp_path) -> None:
    log, result = recorded(), plain()
    read = load(result.save(tmp_path / "result.json"), result.model)
    first, second = (Tracker(each, estimate_smoothing(result, log)) for each in (result, read))
    np.testing.assert_array_equal(first.estimate().value, result.estimate.value)
    for tracker in (first, second):
        pushed(tracker, log, 100)
    np.testing.assert_allclose(first.estimate().value, second.estimate().value, rtol=0, atol=1e-12)


def test_other_smoothers_and_samples_are_refused() -> None:
    log = recorded()
    butter = identified({"smoother": Butterworth()}, log)
    with pytest.raises(ConfigError, match=r"smoothed by a cubic spline, and the result by Butterworth; identify again"):
        Tracker(butter, StreamSmoothing(0.005, [0.01] * 3))
    tracker = Tracker(plain(), estimate_smoothing(plain(), log))
    with pytest.raises(InputError, match="does not follow that before it"):
        tracker.push(log.t[[1, 0]], log.q[:2], log.tau[:2])
