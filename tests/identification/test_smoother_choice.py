"""Among smoothers, the torque decides: by cross-validation over stretches of time."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.identification import Recipe, choose_smoother, cross_validated_error, identify, smoother_choice
from dynident.identification.smoother_choice import choose_by_joint
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Difference, Spline, smooth_log
from dynident.motion.smoothers.spline import SplineSettings
from dynident.runtime import ConfigError, InputError
from tests.identification.test_time_offset import swing


@cache
def motion() -> Motion:
    return swing(2001)[1]


def log(seed: int = 0, coloured: bool = False) -> Log:
    rng = np.random.default_rng(seed)
    recording = record(motion(), 1e-4, 1e-2, rng).log
    if not coloured:
        return recording
    slow = np.convolve(rng.standard_normal(2040), np.ones(40) / np.sqrt(40), "valid")[:2001, None]
    return replace(recording, q=recording.q + 1e-3 * slow)


FACTORS = tuple(Spline(factor=factor) for factor in (1.0, 4.0, 16.0))


def test_raw_differences_and_distorting_filters_lose_to_the_spline() -> None:
    candidates = (Difference(), Butterworth(), Spline())
    choice = choose_smoother(two_link_arm(), [log()], candidates)
    assert choice.smoother is candidates[2]
    assert choice.errors[2] < 2
    assert min(choice.errors[:2]) > 3 * choice.errors[2]
    assert choice.candidates == candidates


def test_a_candidate_that_cannot_smooth_is_passed_over() -> None:
    jittered = log()
    t = jittered.t + 0.001 * (np.arange(2001) % 2)
    choice = choose_smoother(two_link_arm(), [replace(jittered, t=t)], (Butterworth(), Spline()))
    assert choice.errors[0] == np.inf
    assert isinstance(choice.smoother, Spline)
    with pytest.raises(InputError, match="too irregular"):
        choose_smoother(two_link_arm(), [replace(jittered, t=t)], (Butterworth(),))


class Counted(ThreadPoolExecutor):
    """An executor that remembers whether it was used."""

    used = 0

    def submit(self, *given, **named):
        self.used += 1
        return super().submit(*given, **named)


def test_an_executor_smooths_and_chooses_the_same() -> None:
    """Also where a candidate fails, whose error is that of this process."""
    jittered = replace(log(), t=log().t + 0.001 * (np.arange(2001) % 2))
    for case, candidates in ((log(coloured=True), FACTORS), (jittered, (Butterworth(), Spline()))):
        reference: dict[int, tuple[Motion, ...]] = {}
        with Counted(2) as executor:
            spread = choose_smoother(two_link_arm(), [case], candidates, executor=executor, motion_cache=reference)
        assert spread == choose_smoother(two_link_arm(), [case], candidates)
        assert executor.used
        assert id(spread.smoother) in reference
    with Counted(2) as executor, pytest.raises(InputError, match="too irregular"):
        choose_smoother(two_link_arm(), [jittered], (Butterworth(),), executor=executor)


def test_identify_passes_its_executor_on() -> None:
    recipe = Recipe(smoother=(Difference(), Spline()), time_offset="estimate")
    alone = identify(two_link_arm(), {"a": log()}, recipe=recipe)
    with Counted(2) as executor:
        result = identify(two_link_arm(), {"a": log()}, recipe=recipe, executor=executor)
    assert executor.used
    assert np.array_equal(result.estimate.value, alone.estimate.value)


def test_long_logs_are_judged_by_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is chosen is what the whole would choose, and no candidate sees more than the pieces."""
    smoother = choose_smoother(two_link_arm(), [log(coloured=True)], FACTORS)
    seen: list[int] = []

    class Counted(Spline):
        def __call__(self, one: Log) -> Motion:
            seen.append(len(one))
            return super().__call__(one)

    monkeypatch.setattr(smoother_choice, "MAX_SAMPLES", 1000)
    monkeypatch.setattr(smoother_choice, "PIECES_PER_LOG", 1)
    monkeypatch.setattr(smoother_choice, "REGRESSION_SAMPLES", 300)
    choice = choose_smoother(two_link_arm(), [log(coloured=True)], [Counted(factor=x.factor) for x in FACTORS])
    assert choice.smoother.factor == smoother.smoother.factor
    assert set(seen) == {1000}


def test_no_candidates_and_torques_of_zero_choose_nothing() -> None:
    """Zero as of a log whose torque column is another one."""
    with pytest.raises(ConfigError, match="no smoother"):
        choose_smoother(two_link_arm(), [log()], ())
    silent = replace(log(), tau=0 * log().tau, source="silent")
    with pytest.raises(InputError, match="silent: the torque is zero"):
        choose_smoother(two_link_arm(), [silent], [Spline(sigma=1e-3), Spline(sigma=1e-2)])


@cache
def unlike_motion() -> Motion:
    """A fast joint and a slow one."""
    arm = two_link_arm()
    return simulate(
        arm,
        arm.values,
        lambda s: (0.3 * np.sin(14 * s) + 0.3 * np.sin(9.7 * s), 1.2 * np.sin(2.1 * s) + 0.4 * np.sin(2.9 * s)),
        np.arange(2000) * 0.005,
        tolerance=1e-5,
    )


@cache
def unlike_noise() -> Log:
    """White noise on the fast joint, and on the slow one noise far from white, so that it is taken as less."""
    motion, rng = unlike_motion(), np.random.default_rng(1)
    coloured = lfilter([1.0], [1.0, -0.9], rng.standard_normal(len(motion.t)))
    noise = np.column_stack([2e-5 * rng.standard_normal(len(motion.t)), 1e-2 * coloured / coloured.std()])
    tau = motion.tau + 0.002 * motion.tau.std(axis=0) * rng.standard_normal(motion.tau.shape)
    return Log(motion.t, motion.q + noise, tau, motion.joints)


def test_each_joint_takes_the_smoothing_that_it_needs() -> None:
    arm, log = two_link_arm(), unlike_noise()
    cache_of_motions: dict = {}
    splines = SplineSettings(rule="torque").build()
    common = choose_smoother(arm, [log], splines, motion_cache=cache_of_motions)
    choice = choose_by_joint(arm, [log], common, cache_of_motions)
    factor = choice.smoother.factor
    assert factor["joint1"] < common.smoother.factor <= factor["joint2"]
    errors = [cross_validated_error(arm, [smooth_log(x.smoother, log)]) for x in (common, choice)]
    assert errors[1] < errors[0]


def test_smoothers_that_differ_in_more_than_a_factor_stay_as_they_are() -> None:
    arm, log = two_link_arm(), unlike_noise()
    cache_of_motions: dict = {}
    common = choose_smoother(arm, [log], (Spline(factor=4.0), Butterworth()), motion_cache=cache_of_motions)
    assert choose_by_joint(arm, [log], common, cache_of_motions) == common
