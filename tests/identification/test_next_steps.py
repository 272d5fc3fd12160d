"""What to do next and what it gains, against what it does gain where the truth is known."""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynident.estimators import LeastSquares
from dynident.identification import Identification, NextStep, Recipe, identify
from dynident.identification.next_steps import next_steps
from dynident.identification.training_parts import parts_of
from dynident.identification.verdict_steps import (
    Cover,
    ExcitingMotion,
    LeaveOut,
    SetRight,
    Sharpen,
    SlowReversals,
    gain_points,
    judged_log,
)
from dynident.models.lagrangian import slider
from dynident.motion.log import Log
from dynident.motion.smoothers import Difference
from dynident.runtime import Finding, Note, Severity
from tests.identification.motions import sines

RECIPE = Recipe(Difference("central"), LeastSquares())
NOISE = 0.3


def moved(source: str, rates: Iterable[float] = (3.0, 4.1), *, seed: int = 0, late: float = 0.0, **more: Any) -> Log:
    """A slider of 5 kg, 8 N s/m, 3 N, 0.5 N for 20 s; ``late`` delays its Coulomb friction behind reversals (s)."""
    t = np.arange(10_000) * 0.002
    rate = np.array([*rates])[:, None]
    x, v, a = sines(t, 0.2, rate, rate)
    _, earlier, _ = sines(t - late, 0.2, rate, rate)
    force = slider().torque(x, v, a, (5.0, 8.0, 0.0, 0.5)) + 3.0 * np.sign(earlier)
    force = force[:, 0] + NOISE * np.random.default_rng(seed).standard_normal(10_000)
    for (start, stop), size in more.get("pushed", {}).items():
        force = force + size * ((t >= start) & (t < stop))
    return Log(t, x, force[:, None], ("slider",), source)


def fitted(train: Log, held: Log, recipe: Recipe = RECIPE) -> Identification:
    return identify(slider(), [train], [held], recipe)


def of_kind(identification: Identification, kind: type[NextStep]) -> list[Any]:
    return [step for step in next_steps(identification) if isinstance(step, kind)]


def error(identification: Identification) -> float:
    return judged_log(identification).errors.relative_error


@pytest.fixture(scope="module")
def pushed() -> Identification:
    """Somebody leans against the slider from 8.2 to 9.1 s."""
    return fitted(moved("train", pushed={(8.2, 9.1): 15.0}), moved("held", (2.4, 4.3), seed=1))


def test_seconds_that_the_rest_contradicts_are_to_be_left_out(pushed: Identification) -> None:
    (step,) = of_kind(pushed, LeaveOut)
    assert step.log == "train"
    assert step.start <= 8.25
    assert step.stop >= 9.05
    assert step.stop - step.start < 2.2  # parts are 1 s long
    assert step.ratio > 4
    assert next_steps(pushed)[0] == step


def test_leaving_them_out_gains_what_is_said(pushed: Identification) -> None:
    (step,) = of_kind(pushed, LeaveOut)
    full = moved("train", pushed={(8.2, 9.1): 15.0})
    parts = [full.window(stop=step.start - 0.01), full.window(start=step.stop + 0.01)]
    parts = [replace(x, source=f"part {k}") for k, x in enumerate(parts)]
    better = identify(slider(), parts, [moved("held", (2.4, 4.3), seed=1)], RECIPE)
    assert step.gain == pytest.approx(error(pushed) - error(better), rel=0.5)
    errors = replace(judged_log(pushed).errors, rmse={"slider": 2.0}, relative_error=10.0, sensor_noise={})
    loud = replace(pushed, validations=(pushed.validations[0], replace(judged_log(pushed), errors=errors)))
    removed = judged_log(pushed).errors.rmse["slider"] ** 2 - judged_log(better).errors.rmse["slider"] ** 2
    assert of_kind(loud, LeaveOut)[0].gain == pytest.approx(10.0 * (1 - np.sqrt(1 - removed / 4)), rel=0.5)


def test_nothing_is_left_out_of_a_sound_training() -> None:
    fit = fitted(moved("train"), moved("held", (2.4, 4.3), seed=1))
    assert next_steps(fit) == ()
    residual = parts_of(fit).residual  # each part as well predicted from the others as noise allows
    assert np.sqrt(np.mean(residual**2)) == pytest.approx(1.0, rel=0.03)


def test_what_is_left_at_reversals_is_an_upper_limit_of_the_gain() -> None:
    """The sign of friction is late: with the right model of it, the noise alone would be left."""
    fit = fitted(moved("train", late=0.008), moved("held", (2.4, 4.3), seed=1, late=0.008))
    (step,) = of_kind(fit, SlowReversals)
    right = fitted(moved("train"), moved("held", (2.4, 4.3), seed=1))
    assert 0.5 * (error(fit) - error(right)) < step.gain < 1.1 * (error(fit) - error(right))
    dq = judged_log(fit).motion.dq
    assert step.speeds == pytest.approx((0.05 * np.sqrt(np.mean(dq**2)),), rel=0.01)


def test_what_is_left_at_reversals_gains_no_more_than_its_excess() -> None:
    """Half of the residual in the fifth of the time that the slider is slow: three tenths of it are not by chance."""
    fit = fitted(moved("train", late=0.008), moved("held", (2.4, 4.3), seed=1, late=0.008))
    log = judged_log(fit)
    test = replace(log.residuals["slider"], reversal_share=0.5, slow_share=0.2)
    errors = replace(log.errors, rmse={"slider": 2.0}, relative_error=10.0, sensor_noise={})
    told = replace(log, errors=errors, residuals={"slider": test})
    (step,) = of_kind(replace(fit, validations=(fit.validations[0], told)), SlowReversals)
    assert step.gain == pytest.approx(10.0 * (1 - np.sqrt(0.7)))


def test_motion_beyond_the_training_is_to_be_trained() -> None:
    """A model that lacks what only fast motion shows, here friction that grows with the square of the speed."""

    def dragged(log: Log, part: slice) -> Log:
        v = np.gradient(log.q, log.t, axis=0)
        return replace(log, tau=log.tau + 2.0 * v * np.abs(v)).rows(part, log.source)

    slow, fast = (
        dragged(moved("train", (2.0, 1.5)), slice(None)),
        dragged(moved("held", (2.1, 1.6), seed=1), slice(None)),
    )
    quick = dragged(moved("held", (4.0, 5.0), seed=2), slice(0, 1500))
    both = Log(
        np.concatenate([fast.t, fast.t[-1] + 0.002 + quick.t - quick.t[0]]),
        np.concatenate([fast.q, quick.q + (fast.q[-1] - quick.q[0])]),
        np.concatenate([fast.tau, quick.tau]),
        ("slider",),
        "held",
    )
    fit = fitted(slow, both)
    (step,) = of_kind(fit, Cover)
    assert (step.log, step.joint) == ("held", "slider")
    assert 19.9 < step.start < step.stop <= 23.0
    motion, train = judged_log(fit).motion, fit.validations[0].motion
    assert step.faster > np.abs(motion.dq[motion.mask]).max() / np.abs(train.dq).max() - 1e-9
    assert step.speed == pytest.approx(step.faster * np.abs(train.dq[train.mask]).max())
    inside = fitted(slow, fast)
    assert step.gain == pytest.approx(error(fit) - error(inside), rel=0.2)
    assert of_kind(inside, Cover) == []


class Removing(Note):
    """A note that says which share of the residual beside noise it removes."""

    size: float = 0.0

    @property
    def removed(self) -> tuple[tuple[str, float], ...]:
        return (("slider", self.size),) if self.size else ()


class Advice(Note):
    """A note that says what to do."""

    advises = True


def test_what_the_checks_find_gains_what_it_removes() -> None:
    sound = fitted(moved("train"), moved("held", (2.4, 4.3), seed=1))
    log = judged_log(sound)
    noise = {"slider": NOISE}
    worse = replace(log, errors=replace(log.errors, rmse={"slider": 2 * NOISE}, relative_error=8.0, sensor_noise=noise))
    result = replace(sound, validations=(sound.validations[0], worse))
    notes = [Removing(0.5), Removing(1e-4), Removing(0.9), Advice(), Removing()]  # shares of 3 NOISE^2
    findings = [Finding(note, "slider", severity=Severity.INFO) for note in notes]
    steps = of_kind(replace(result, warnings=tuple(findings)), SetRight)
    assert [step.finding for step in steps] == [findings[2], findings[0], findings[3]]
    assert steps[0].gain == pytest.approx(8.0 * (1 - np.sqrt(1 - 2.7 / 4)))
    assert steps[1].gain == pytest.approx(8.0 * (1 - np.sqrt(1 - 1.5 / 4)))
    assert steps[2].gain is None
    assert next_steps(replace(result, warnings=tuple(findings[::-1])))[:2] == tuple(steps[:2])


def test_a_parameter_gains_what_its_error_costs_the_held_out_motion() -> None:
    """With the friction of the fit off by its standard error, which the mass takes up as well as it can."""
    train, held = moved("train"), moved("held", (2.4, 4.3), seed=1)
    result = fitted(train, held)
    log = judged_log(result)
    log = replace(log, errors=replace(log.errors, rmse={"slider": 6.0}, relative_error=40.0))  # above the noise
    result = replace(result, validations=(result.validations[0], log))
    wide = replace(result, errors=replace(result.errors, std=np.array([0.0, 6.0, 0.0, 0.0])))
    (step,) = of_kind(wide, Sharpen)
    assert (step.excitation, step.faster) == (ExcitingMotion.CONSTANT_SPEEDS, None)
    Y, moving = (
        result.model.regressor(m.q, m.dq, m.ddq)[:, 0] for m in (validation.motion for validation in result.validations)
    )
    others = np.linalg.lstsq(Y[:, [0, 2, 3]], -6.0 * Y[:, 1], rcond=None)[0]
    off = 6.0 * moving[:, 1] + moving[:, [0, 2, 3]] @ others
    assert step.gain == pytest.approx(gain_points(log, {"slider": float(np.mean(off**2))}), rel=0.05)
    heavy = replace(result, errors=replace(result.errors, std=np.array([6.0, 0.0, 0.0, 0.0])))
    (step,) = of_kind(heavy, Sharpen)
    assert step.excitation is ExcitingMotion.ACCELERATE
    assert step.faster == pytest.approx(np.sqrt(6.0 / (0.3 * result.estimate.value[0])))
