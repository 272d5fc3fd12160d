"""Rests of the whole arm: cut off the ends, left out within where that predicts better, and nothing else touched."""

from functools import cache

import numpy as np
import pytest

from dynident.identification import Identification, Recipe, Rests, identify, moving_span
from dynident.identification.recipe import trim_rests, without_rests
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log, Motion
from dynident.regression import Selection
from dynident.testing.estimator import multisine_motion

STEP, NOISE = 0.005, 1e-5
JOINTS = ("joint1", "joint2")


def clock(*parts: tuple[float, float]) -> np.ndarray:
    """The phase of a motion in parts of (seconds, pace), of which 0 is a rest."""
    return np.cumsum(np.concatenate([np.full(round(length / STEP), pace * STEP) for length, pace in parts]))


def log(*parts: tuple[float, float], noise: float = NOISE, size: float = 1.0) -> Log:
    """Two joints that swing at the given paces."""
    s = clock(*parts)
    q = size * np.column_stack([np.sin(2 * s), 0.5 * np.cos(3 * s)])
    q = q + noise * np.random.default_rng(0).standard_normal(q.shape)
    return Log(np.arange(len(s)) * STEP, q, np.cos(q), JOINTS, "log")


def test_rests_at_the_ends_are_cut_but_for_a_moment() -> None:
    still = log((5.0, 0.0), (20.0, 1.0), (3.0, 0.0))
    assert moving_span(still) == pytest.approx((5.0, 25.0), abs=0.11)
    cut = trim_rests(still)
    assert (cut.t[0], cut.t[-1]) == pytest.approx((4.7, 25.3), abs=0.11)
    assert cut is trim_rests(still)  # found once
    assert cut.source == "log"


CREEPS = [((10.0, slow), (10.0, 1.0), (10.0, slow)) for slow in (0.1, 0.02, 0.009)]
STAY = {
    "a short rest at the start": log((0.3, 0.0), (20.0, 1.0)),
    "a short rest at the end": log((20.0, 1.0), (0.3, 0.0)),
    # a tenth of the usual pace, or less than the noise in a block: it creeps, and does not rest
    **{f"creeps {parts[0][1]} {noise}": log(*parts, noise=noise) for parts in CREEPS for noise in (NOISE, 1e-3)},
    **{f"crawls {noise}": log((60.0, 0.005), noise=noise) for noise in (NOISE, 1e-3)},
    # what stands for a second while it crosses its range in two minutes has only stuck
    "sticks": log((1.0, 0.0), (400.0, 0.02)),
    "never moves": log((20.0, 0.0)),
    "hardly moves": log((10.0, 0.0), (0.3, 1.0), (10.0, 0.0)),
    "few samples": log((0.4, 0.0), (0.4, 1.0)),
}


@pytest.mark.parametrize("still", STAY.values(), ids=STAY)
def test_what_is_no_long_rest_stays(still: Log) -> None:
    assert trim_rests(still) is still


@cache
def held(friction: float) -> tuple[Motion, Log]:
    """Swings with holds of the whole arm in between, in which friction has any value."""
    arm, rng = two_link_arm(), np.random.default_rng(2)
    s = clock(*[(2.0, 1.0), (1.5, 0.0)] * 8, (2.0, 1.0))
    ramps = np.convolve(np.pad(s, 20, mode="edge"), np.ones(41) / 41, "valid")  # no step of the speed
    angle = np.array([2.0, 3.0])
    rate = np.gradient(ramps, STEP)[:, None]
    q = np.array([1.0, 0.7]) * np.sin(angle * ramps[:, None])
    dq = np.array([1.0, 0.7]) * angle * rate * np.cos(angle * ramps[:, None])
    ddq = np.gradient(dq, STEP, axis=0)
    tau = arm.torque(q, dq, ddq, arm.values) + 0.02 * rng.standard_normal(q.shape)
    holds = np.repeat(rng.uniform(-1, 1, (200, 2)), -(-len(s) // 200), axis=0)[: len(s)]
    tau = tau + friction * holds * (np.abs(dq) < 1e-3)
    t = np.arange(len(s)) * STEP
    log = Log(t, q + NOISE * rng.standard_normal(q.shape), tau, JOINTS, "log")
    return Motion(t, q, dq, ddq, tau, JOINTS, np.ones(len(t), dtype=bool)), log


def test_holds_in_which_friction_has_any_value_are_left_out() -> None:
    motion, recorded = held(5.0)
    result, (note,) = without_rests(two_link_arm(), {"a": motion}, {"train": {"a": recorded}}, "trim")
    assert note.left_out
    assert note.gain.share > 10
    assert note.within == pytest.approx(8 * 1.5, rel=0.2)
    kept = result["a"].keep.all(axis=1)
    assert kept[np.abs(motion.dq).max(axis=1) > 0.1].all()
    assert kept[np.abs(motion.dq).max(axis=1) == 0].mean() < 0.2


def test_holds_that_carry_the_static_torque_stay() -> None:
    motion, recorded = held(0.0)
    result, (note,) = without_rests(two_link_arm(), {"a": motion}, {"train": {"a": recorded}}, "trim")
    assert result == {"a": motion}
    assert not note.left_out
    assert note.within > 0


def test_where_rests_are_kept_or_a_minimum_speed_is_set_nothing_is_decided() -> None:
    motion, recorded = held(5.0)
    logs = {"train": {"a": recorded}}
    assert without_rests(two_link_arm(), {"a": motion}, logs, "keep") == ({"a": motion}, ())
    result, (note,) = without_rests(two_link_arm(), {"a": motion}, logs, "trim", Selection(min_speed=(0.1, 0.1)))
    assert result == {"a": motion}
    assert note.gain is None
    _, (note,) = without_rests(two_link_arm(), {"a": motion}, logs, "trim", Selection(min_speed=(0.1, 0.0)))
    assert note.gain is not None, "the other joint is fitted at rest"


@cache
def waiting() -> Log:
    """A swing that stands before and after."""
    motion = multisine_motion(two_link_arm(), samples=2001)
    q = np.pad(motion.q, ((800, 600), (0, 0)), mode="edge")
    tau = np.pad(motion.tau, ((800, 600), (0, 0)), mode="edge")
    q = q + NOISE * np.random.default_rng(3).standard_normal(q.shape)
    return Log(np.arange(len(q)) * STEP, q, tau, JOINTS, "log")


def fitted(rests: str, case: Log) -> Identification:
    return identify(two_link_arm(), {"a": case}, {"b": case}, Recipe(rests=rests))  # type: ignore[arg-type]


def test_identify_trims_and_says_so() -> None:
    fit = fitted("trim", waiting())
    said = [note for note in fit.notes if isinstance(note, Rests)]
    assert [x.log for x in said] == ["a", "b"]
    assert [x.start for x in said] == pytest.approx([3.7, 3.7], abs=0.15)
    assert [x.end for x in said] == pytest.approx([2.7, 2.7], abs=0.15)
    assert {x.within for x in said} == {0.0}
    assert [len(validation.motion) for validation in fit.validations] == [len(trim_rests(waiting()))] * 2
    assert not any(isinstance(note, Rests) for note in fitted("keep", waiting()).notes)


def test_an_identification_without_rests_is_the_same_to_the_last_bit() -> None:
    moving = waiting().window(4.5, 13.5)
    assert trim_rests(moving) is moving
    first, second = (fitted(rests, moving) for rests in ("trim", "keep"))
    assert (first.estimate.value == second.estimate.value).all()
    assert first.notes == second.notes
    assert (first.validations[1].predicted_torque == second.validations[1].predicted_torque).all()
