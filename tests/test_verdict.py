"""The rules of the verdict, one by one, on a slider that is good for everything until something is taken from it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynident.estimators import LeastSquares
from dynident.gallery import slider
from dynident.identify import Identification, Recipe, identify
from dynident.log import Log
from dynident.smoothers import Difference
from dynident.verdict import Verdict, judge

M, FV, FC, OFFSET = 5.0, 8.0, 3.0, 0.5


def log(rate: float, source: str, seed: int = 0) -> Log:
    t = np.arange(3000) * 0.002
    x, dx, ddx = (k * np.sin(rate * t + phase) for k, phase in ((0.3, 0), (0.3 * rate, np.pi / 2), (-0.3 * rate**2, 0)))
    force = M * ddx + FV * dx + FC * np.sign(dx) + OFFSET + 0.1 * np.random.default_rng(seed).standard_normal(3000)
    return Log(t, x[:, None], force[:, None], ("slider",), source)


@pytest.fixture(scope="module")
def good() -> Identification:
    recipe = Recipe(Difference("central"), LeastSquares(), restart=0.5)
    return identify(slider(), [log(3.0, "slow")], [log(4.0, "fast", 1)], recipe)


def with_log(found: Identification, k: int, **changes: Any) -> Verdict:
    logs = list(found.logs)
    logs[k] = replace(logs[k], **changes)
    return judge(replace(found, logs=tuple(logs)))


def test_a_good_model_is_good_for_simulation(good: Identification) -> None:
    verdict = judge(good)
    assert verdict.word == "good for simulation"
    assert verdict.reasons == ()
    assert len(verdict.sentences) == 3
    assert verdict.sentences[0].startswith("Good for simulation and control on motions like these: on held-out motion")
    assert "positive definite" in verdict.sentences[1]
    assert "slider (fast)" in verdict.sentences[2]


def test_without_a_held_out_log_nothing_is_good(good: Identification) -> None:
    verdict = judge(replace(good, logs=good.logs[:1]))
    assert verdict.word == "do not use"
    assert "no log was held out" in verdict.reasons[0]
    assert "Record another motion" in verdict.next_steps[0]


def test_a_torque_that_was_not_recorded_forbids_use(good: Identification) -> None:
    train = good.logs[0].motion
    verdict = with_log(good, 0, motion=replace(train, tau=0 * train.tau))
    assert verdict.word == "do not use"
    assert verdict.reasons[0] == "the torque of slider is zero in all of the training: nothing shows it"
    assert "right torque column" in verdict.next_steps[0]


def test_a_repeat_of_the_training_motion_holds_nothing_out(good: Identification) -> None:
    again = identify(slider(), [log(3.0, "slow")], [log(3.0, "again", 1)], Recipe(Difference("central"), restart=0.5))
    verdict = judge(again)
    assert verdict.word == "do not use"
    assert "again repeats the motion of slow" in verdict.reasons[0]
    both = judge(replace(again, logs=(*again.logs, good.logs[1])))
    assert both.word == "good for simulation"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"relative_error": 11.0}, "the torque error on fast is 11 %, above 10 %"),
        ({"relative_error": 26.0, "relative_error_filtered": 3.0}, "unfiltered, the torque error on fast is 26 %"),
        ({"per_joint": {"slider": 40.0}}, "single joints have a torque error above 25 %: slider 40 %"),
        ({"relative_error": 9.0}, "times that of the training"),
        ({"relative_error": float("nan")}, "is nan %"),
    ],
)
def test_held_out_errors(good: Identification, changes: dict[str, Any], words: str) -> None:
    verdict = with_log(good, 1, **changes)
    assert verdict.word == "do not use"
    assert any(words in reason for reason in verdict.reasons)


def test_a_large_error_of_a_small_torque_does_no_harm(good: Identification) -> None:
    changes = {"per_joint": {"slider": 40.0}, "effort_share": {"slider": 0.5}}
    assert with_log(good, 1, **changes).word == "good for simulation"


def test_an_error_that_the_low_pass_takes_away_is_forgiven_up_to_a_limit(good: Identification) -> None:
    first = replace(good.logs[0], relative_error_filtered=3.0)
    held = replace(good.logs[1], relative_error=20.0, relative_error_filtered=4.0)
    verdict = judge(replace(good, logs=(first, held)))
    assert verdict.word == "good for simulation"
    assert "4 % of the torque unexplained after the low-pass" in verdict.sentences[0]
    assert "20 % of it as measured" in verdict.sentences[0]


def test_a_mass_matrix_that_is_not_positive_forbids_use(good: Identification) -> None:
    assert good.mass is not None
    verdict = judge(replace(good, mass=replace(good.mass, positive=False, smallest=-0.1)))
    assert verdict.word == "do not use"
    assert "not positive definite (eigenvalue -0.1)" in verdict.reasons[0]
    assert any("kind: consistent" in step for step in verdict.next_steps)


def test_negative_friction_forbids_simulation_only(good: Identification) -> None:
    value = good.estimate.value * (1, -1, 1, 1)
    verdict = judge(replace(good, estimate=replace(good.estimate, value=value)))
    assert verdict.word == "good for control"
    assert verdict.reasons == ("negative values that physics forbids: Fv",)
    assert verdict.sentences[1].startswith("Not for simulation")


def test_without_a_free_simulation_none_is_promised(good: Identification) -> None:
    verdict = judge(replace(good, runs=()))
    assert verdict.word == "good for control"
    assert any("simulation:" in step for step in verdict.next_steps)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"motion_error": {"slider": 30.0}}, "is off by 30 % of the way of slider within 0.5 s of the measured torque"),
        ({"motion_error": {"slider": 2.0}, "driver": "controller"}, "in the controller's loop"),
        ({"failure": "it runs away"}, "fails: it runs away"),
    ],
)
def test_free_simulations_that_go_astray(good: Identification, changes: dict[str, Any], words: str) -> None:
    verdict = judge(replace(good, runs=(good.runs[0], replace(good.runs[1], **changes))))
    assert verdict.word == "good for control"
    assert words in verdict.reasons[0]


def test_parameters_known_badly_are_given_a_motion(good: Identification) -> None:
    assert good.std_hac is not None
    verdict = judge(replace(good, std_hac=np.array([4.0, 6.0, 0.01, np.inf])))
    steps = " ".join(verdict.next_steps)
    assert "accelerate slider harder" in steps
    assert "move slider at several constant speeds" in steps
    assert "offset" not in steps
    assert judge(good).next_steps == ()


def test_figures_behind_the_verdict(good: Identification) -> None:
    """The slider's truth is within its robust errors, its mass matrix is the mass,."""
    assert good.std_hac is not None
    assert good.mass is not None
    np.testing.assert_array_less(np.abs(good.estimate.value - (M, FV, FC, OFFSET)), 5 * good.std_hac)
    assert good.mass.smallest == pytest.approx(good.estimate.value[0])
    assert [run.name for run in good.runs] == ["slow", "fast"]
    held = good.logs[1]
    assert held.explained["slider"] == pytest.approx(1 - (held.rmse["slider"] ** 2) / np.var(held.motion.tau), rel=1e-2)
    assert held.effort_share == {}
    assert slider().limits == {}
