"""A tracker: blocks in order, gaps, saved states; the motion of its stream is that of the spline, each sample once."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.apps.online import FinalMotion, FixedLag, MotionBlock, StreamSmoothing, Tracker, estimate_smoothing
from dynident.apps.online.fixed_lag import Context
from dynident.identification import Identification
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Spline, smooth_log
from dynident.motion.splines import GCV, Constraint, Fixed, smooth
from dynident.regression import GroupKind, ParallelFilter
from dynident.runtime import ConfigError, InputError
from dynident.runtime.arrays import Array
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


def test_other_smoothers_and_samples_are_refused() -> None:
    log = recorded()
    butter = identified({"smoother": Butterworth()}, log)
    with pytest.raises(ConfigError, match=r"smoothed by a cubic spline, and the result by Butterworth; identify again"):
        Tracker(butter, StreamSmoothing(0.005, [0.01] * 3))
    tracker = Tracker(plain(), estimate_smoothing(plain(), log))
    with pytest.raises(InputError, match="does not follow that before it"):
        tracker.push(log.t[[1, 0]], log.q[:2], log.tau[:2])


N = 200


def motion(start: int, stop: int, usable: int = 0) -> Motion:
    """Samples whose time is their number, usable from one of them on."""
    t = np.arange(start, stop, dtype=float)
    x = np.outer(t, [1.0, 2.0])
    return Motion(t, x, x + 1, x + 2, x + 3, ("a", "b"), t >= usable)


@pytest.mark.parametrize(
    ("before", "after", "multiple", "usable"), [(0, 0, 1, 0), (7, 5, 1, 3), (10, 12, 4, 9), (3, 30, 7, 40)]
)
@pytest.mark.parametrize("size", [2, 3, 11, 64])
def test_each_sample_is_delivered_once_with_those_around_it(before, after, multiple, usable, size) -> None:
    context, seen, held = Context(before, after, multiple), [], []
    stops = [*range(size, N - 1, size), N]
    for start, stop in zip([0, *stops[:-1]], stops, strict=True):
        result = context.push(motion(start, stop, usable), ended=stop == N)
        if result is None:
            continue
        full, new = result
        seen += full.t[new].tolist()
        assert full.t[0] <= max(0.0, full.t[new.start] - before)
        assert stop == N or full.t[-1] >= full.t[new.stop - 1] + after
        if full.t[0] > usable:
            assert (full.t[0] - usable) % multiple == 0
        held.append(len(full))
    assert seen == list(range(N))
    assert max(held) <= before + after + multiple + 2 * size + 2
    assert context.held is None


STEP, WIDTH, NAMES = 0.004, (0.01, 0.016), ("one", "two")


def recording(samples: int = 1500, jitter: float = 0.0, start: float = 0.0) -> Log:
    rng = np.random.default_rng(0)
    t = start + np.arange(samples) * STEP + jitter * STEP * rng.uniform(-0.5, 0.5, samples)
    q = np.stack([np.sin(3 * t) + 0.2 * np.sin(17 * t), np.cos(5 * t)], axis=1)
    return Log(t, q + 1e-4 * rng.standard_normal(q.shape), np.cos(q), NAMES)


def streamed(stream: FixedLag, log: Log, size: int = 100) -> list[FinalMotion]:
    result: list[FinalMotion] = []
    for start in range(0, len(log), size):
        part = slice(start, start + size)
        result += stream.push(log.t[part], log.q[part], log.tau[part])
    return [*result, *stream.finish()]


def signal(result: list[FinalMotion], name: str) -> Array:
    return np.concatenate([getattr(x.motion, name) for x in result])


@pytest.mark.parametrize(("jitter", "start"), [(0.0, 0.0), (0.0, 1.7e9), (0.8, 0.0)])
def test_with_the_whole_lag_it_is_the_spline_of_a_recording(jitter: float, start: float) -> None:
    log = recording(jitter=jitter, start=start)
    sigma = dict(zip(NAMES, (1.0, 1.0), strict=True))
    full = Spline(Fixed(lam=[width**4 / STEP for width in WIDTH]), sigma)(log)
    result = streamed(FixedLag(NAMES, StreamSmoothing(STEP, WIDTH)), log)
    for name in ("t", "tau"):
        np.testing.assert_array_equal(signal(result, name), getattr(full, name))
    for name in ("q", "dq", "ddq"):
        expected = getattr(full, name)
        np.testing.assert_allclose(signal(result, name), expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    if not jitter:
        np.testing.assert_array_equal(signal(result, "mask"), full.mask)
    assert [x.ends for x in result] == [False] * (len(result) - 1) + [True]
    assert all(x.motion.smoothing["bandwidth"] == WIDTH for x in result)


@pytest.mark.parametrize("jitter", [0.0, 0.8])
def test_the_lag_leaves_no_more_than_it_says(jitter: float) -> None:
    log = recording(500, jitter)
    rule = Fixed(lam=[width**4 / STEP for width in WIDTH])
    test_motion = smooth(log.t, log.q, rule, sigma=1.0)
    errors = []
    for lag in (0.0, 0.06, 0.12):
        stream = FixedLag(NAMES, StreamSmoothing(STEP, WIDTH), lag, window=2)
        result = streamed(stream, log)[:-1]
        off = signal(result, "ddq") - test_motion.derivative(2)[: len(signal(result, "t"))]
        errors.append((stream.remaining_error, np.sqrt((off[200:] ** 2).mean(axis=0))))
    error, rms = map(np.stack, zip(*errors, strict=True))
    ratio = (rms / rms[0]) / (error / error[0])
    assert (ratio < 3.0).all()
    assert (ratio > 0.05).all()


def test_memory_does_not_grow() -> None:
    stream = FixedLag(NAMES, StreamSmoothing(STEP, WIDTH))
    sizes = []
    for k in range(6):
        log = recording(2000, start=8.0 * k)
        stream.push(log.t, log.q, log.tau)
        sizes.append(sum(x.size for x in stream.state.values()))
    assert max(sizes[1:]) < 2 * min(sizes[1:])


def test_a_state_of_other_settings_is_refused() -> None:
    state = FixedLag(NAMES, StreamSmoothing(STEP, WIDTH), lag=0.2).state
    for other in (
        FixedLag(("one",), StreamSmoothing(STEP, [0.01])),
        FixedLag(NAMES, StreamSmoothing(STEP, WIDTH), lag=0.1),
    ):
        with pytest.raises(InputError, match="is of another step, bandwidth or lag, or of other joints"):
            other.restore(state)


def test_a_single_sample_is_checked_as_several_are() -> None:
    log, stream = recording(300), FixedLag(NAMES, StreamSmoothing(STEP, WIDTH), lag=0.1)
    stream.push(log.t[:100], log.q[:100], log.tau[:100])
    before, t, q, tau = stream.state, log.t[100:101], log.q[100:101], log.tau[100:101]
    nan = np.array([[0.0, np.nan]])
    wrong_times, wrong_shapes = ((t - STEP, q, tau), (t + np.nan, q, tau)), ((t, q[:, :1], tau), (t, q, tau[:, :1]))
    for bad in (*wrong_times, *wrong_shapes, (t, nan, tau), (t, q, nan)):
        with pytest.raises(InputError):
            stream.push(*bad)
    for name, value in before.items():
        np.testing.assert_array_equal(stream.state[name], value, err_msg=name)
    assert stream.push(float(t[0]), q[0], tau[0]) == ()
    np.testing.assert_array_equal(stream.state["q"], log.q[len(log.q[:101]) - len(stream.state["q"]) : 101])
    (end,) = stream.push(t + 13 * STEP, q, tau)  # a gap ends the spline
    assert end.ends
    assert end.motion.t[-1] == t[0]


def test_bad_samples_are_refused_whole() -> None:
    log, stream = recording(300), FixedLag(NAMES, StreamSmoothing(STEP, WIDTH))
    stream.push(log.t[:100], log.q[:100], log.tau[:100])
    before = stream.state
    t, q, tau = log.t[100:110].copy(), log.q[100:110].copy(), log.tau[100:110].copy()
    with pytest.raises(InputError, match=r"the stamp 0.4 s does not follow that before it"):
        stream.push(t[[0, 2, 0]], q[:3], tau[:3])
    with pytest.raises(InputError, match=r"does not follow that before it"):  # no spline goes through such a step
        stream.push(t[0] + np.array([0.0, 1e-12]), q[:2], tau[:2])
    with pytest.raises(InputError, match=r"q and tau have shapes \(9, 2\) and \(10, 2\); they must be \(10, 2\)"):
        stream.push(t, q[1:], tau)
    with pytest.raises(InputError, match=r"they must be \(10, 2\)"):
        stream.push(t, q.T, tau.T)
    tau[3, 1] = np.nan
    with pytest.raises(InputError, match=r"tau of sample 3 is \[.*nan\]; leave out what is not finite"):
        stream.push(t, q, tau)
    for name, x in stream.state.items():
        np.testing.assert_array_equal(x, before[name])


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"step": 0.0}, "step = 0.0 s; give the time between samples"),
        ({"bandwidth": [0.01]}, "give a number from 0 for each of one, two"),
        ({"bandwidth": [0.01, np.inf]}, "give a number from 0 for each of one, two"),
        ({"lag": -1.0}, "a lag of -1.0 s"),
        ({"lag": 1e6}, "one of at most 50000 samples"),
        ({"window": 1}, "window = 1"),
        ({"bandwidth": [0.01, 1e9]}, "one of at most 50000 samples"),
    ],
)
def test_bad_settings_are_named(settings: dict, words: str) -> None:
    smoothing = StreamSmoothing(settings.get("step", STEP), settings.get("bandwidth", WIDTH))
    with pytest.raises(ConfigError, match=words):
        FixedLag(NAMES, smoothing, settings.get("lag"), settings.get("window"))
