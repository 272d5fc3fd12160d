"""The limits of the rules, on an arm of a robot file that is good for simulation until something is taken from it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynident.estimators import Ridge
from dynident.identification import Identification, Remedy, Verdict, judge
from dynident.identification import verdict_reasons as why
from dynident.identification import verdict_rules as rules
from dynident.identification.links import scaled_covariance
from dynident.identification.verdict_rules import ConstraintEffect
from dynident.identification.verdict_steps import ExcitingMotion, HoldOutFaster, Sharpen
from dynident.motion.log import stack_states, subsample
from dynident.runtime import Use
from dynident.validation import Driver, FloorOrigin, LogValidation, NoiseFloor
from tests.kept import check_kept, facts


def with_held(identification: Identification, **changes: Any) -> Verdict:
    return judge(
        replace(
            identification,
            validations=(identification.validations[0], replace(identification.validations[1], **changes)),
        )
    )


def with_errors(identification: Identification, trained: dict[str, Any], **held: Any) -> Verdict:
    def changed(log: LogValidation, changes: dict[str, Any]) -> LogValidation:
        return replace(log, errors=replace(log.errors, **changes))

    return judge(
        replace(
            identification,
            validations=(changed(identification.validations[0], trained), changed(identification.validations[1], held)),
        )
    )


def test_bodies_must_have_been_held_to_physics(arm: Identification) -> None:
    consistency = arm.estimate.consistency

    def reasons(**changes: Any) -> tuple[why.Reason, ...]:
        return judge(replace(arm, estimate=replace(arm.estimate, **changes))).reasons

    assert reasons(consistency=None) == (why.InertiasFree(),)
    assert reasons(consistency=replace(consistency, eigenvalues={})) == (why.InertiasFree(),)
    assert reasons(consistency=replace(consistency, eigenvalues={"upper": 1.0, "fore": -1e-8})) == (why.InertiasFree(),)
    assert reasons(consistency=replace(consistency, eigenvalues={"upper": 1.0, "fore": -1e-10})) == ()


@pytest.mark.parametrize(
    ("trained", "held"),
    [
        ({"relative_error": 10.0}, {"relative_error": 10.0}),
        ({"relative_error": 4.0}, {"relative_error": 8.0}),
        ({"relative_error": 1.0}, {"relative_error": 5.0}),
        ({"relative_error_filtered": 3.0}, {"relative_error": 25.0, "relative_error_filtered": 3.0}),
    ],
)
def test_a_limit_itself_is_allowed_and_no_more(
    arm: Identification, trained: dict[str, Any], held: dict[str, Any]
) -> None:
    def beyond(value: Any) -> Any:
        return {name: beyond(x) for name, x in value.items()} if isinstance(value, dict) else value * (1 + 1e-6)

    assert with_errors(arm, trained, **held).use is Use.SIMULATION
    worse = {name: value if name == "relative_error_filtered" else beyond(value) for name, value in held.items()}
    assert with_errors(arm, trained, **worse).use is Use.DO_NOT_USE


def test_an_error_is_harmless_where_it_is_small_beside_what_the_joint_can_exert(arm: Identification) -> None:
    largest = float(max(np.abs(log.motion.tau[:, 0]).max() for log in arm.validations))
    above_floor = {"floors": {}}

    def judged(error: float, rms: float, **more: Any) -> Verdict:
        train, held = arm.validations
        sizes = {"per_joint": {"shoulder": error, "elbow": 1.0}, "rmse": {"shoulder": rms, "elbow": 0.01}}
        errors = replace(held.errors, **sizes, effort_share=more.get("effort_share", {}))
        floors = more.get("floors", {})
        return judge(replace(arm, validations=(train, replace(held, errors=errors, floors=floors))))

    harmful = why.JointErrorsTooLarge("two", (("shoulder", 40.0),), 25.0)
    assert harmful in judged(40.0, 0.05 * largest, **above_floor).reasons
    assert judged(40.0, 0.05 * largest).use is Use.DO_NOT_USE
    assert judged(25.0, 0.05 * largest).use is Use.SIMULATION
    weak = judged(40.0, 0.049 * largest)
    assert weak.use is Use.CONTROL
    assert weak.reasons == (why.WeakJoints("two", (("shoulder", 40.0, 0.049 * largest),)),)
    assert Remedy.LONGER_TRAINING not in weak.next
    # the effort limit of the robot file decides where there is one
    assert judged(40.0, 0.2 * largest, effort_share={"shoulder": 2.99}).use is Use.CONTROL
    assert harmful in judged(40.0, 0.01 * largest, effort_share={"shoulder": 3.0}).reasons
    # no fit leaves less than the noise of the sensor
    at_floor = {"shoulder": NoiseFloor(0.2 * largest, 1.0, 1.05, FloorOrigin.WHITE)}
    assert judged(40.0, 0.2 * largest, floors=at_floor).use is Use.CONTROL


@pytest.mark.parametrize(("driver", "limit"), [(Driver.TORQUE, 25.0), (Driver.CONTROLLER, 1.0)])
def test_limits_of_the_free_simulation(arm: Identification, driver: Driver, limit: float) -> None:
    run = arm.validations[1].free_run

    def simulated(error: float) -> Verdict:
        errors = {"shoulder": np.nan, "elbow": error}
        first = replace(run, name="one", motion_error={"shoulder": 0.5, "elbow": 0.1})
        logs = (first, replace(run, driver=driver, motion_error=errors))
        return judge(
            replace(arm, validations=tuple(replace(a, free_run=b) for a, b in zip(arm.validations, logs, strict=True)))
        )

    good, bad = simulated(limit), simulated(limit * (1 + 1e-6))
    assert (good.use, bad.use) == (Use.SIMULATION, Use.CONTROL)
    assert (good.run.log, good.run.joint, good.run.error) == ("two", "elbow", limit)
    (reason,) = bad.reasons
    assert isinstance(reason, why.FreeRunAstray)
    assert (reason.log, reason.joint) == ("two", "elbow")


def test_a_quarter_of_the_base_parameters_may_be_missing_for_control(arm: Identification) -> None:
    on_data, structural = arm.base.on_data, arm.base.structural

    def reasons(seen: int, whole: int) -> tuple[why.Reason, ...]:
        base = replace(arm.base, on_data=replace(on_data, rank=seen), structural=replace(structural, rank=whole))
        return judge(replace(arm, base=base)).reasons

    assert reasons(8, 8) == reasons(9, 8) == ()
    assert reasons(7, 8) == (why.PartlyUnexcited(1, 8),)
    assert reasons(6, 8) == (why.PartlyUnexcited(2, 8),)
    assert reasons(5, 8) == (why.MostlyUnexcited(3, 8),)


@pytest.mark.parametrize(
    ("growth", "apart", "use"),
    [
        (4.99, 50.0, Use.SIMULATION),
        (50.0, 0.99, Use.SIMULATION),
        (5.0, 1.0, Use.CONTROL),
        (50.0, 7.0, Use.CONTROL),
        (5.0, 7.01, Use.DO_NOT_USE),
    ],
)
def test_limits_of_what_physics_may_hold_back(
    arm: Identification, growth: float, apart: float, use: Use, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rules, "constraint_effect", lambda x: ConstraintEffect(growth, apart))
    arm = replace(arm)  # a verdict is found once
    assert judge(arm).use is use
    assert judge(arm).reasons == (() if use is Use.SIMULATION else (why.HeldBack(growth, apart),))
    assert (Remedy.CHECK in judge(arm).next) == (use is not Use.SIMULATION)
    free = judge(replace(arm, estimate=replace(arm.estimate, consistency=None)))
    assert free.reasons == (why.InertiasFree(),)
    drawn = judge(replace(arm, recipe=replace(arm.recipe, estimator=Ridge())))
    assert [type(reason) for reason in drawn.reasons] == ([] if use is Use.SIMULATION else [why.DrawnBack])


@pytest.mark.parametrize(("share", "use"), [(0.501, Use.SIMULATION), (0.499, Use.CONTROL)])
def test_held_out_motion_must_have_half_the_speed_of_the_training(arm: Identification, share: float, use: Use) -> None:
    """Joints count alike, and at rest not at all: a share of both is their root mean square."""
    train, held = arm.validations
    usual = np.sqrt(np.mean(train.motion.dq[train.motion.mask] ** 2, axis=0))
    own = np.sqrt(np.mean(held.motion.dq[held.motion.mask] ** 2, axis=0))
    dq = held.motion.dq * (share * usual / own) * (np.sqrt(1.5), np.sqrt(0.5))
    signals = replace(held.signals, motion=replace(held.motion, dq=dq))
    verdict = judge(replace(arm, validations=(train, replace(held, signals=signals))))
    assert verdict.use is use
    slow = [reason for reason in verdict.reasons if isinstance(reason, why.SlowHoldOut)]
    assert [x.share for x in slow] == ([] if use is Use.SIMULATION else [pytest.approx(share)])
    assert all(x.remedy == HoldOutFaster(1.0 / x.share) in verdict.next for x in slow)


def test_the_error_announced_on_a_larger_and_faster_motion_is_asked_for(arm: Identification) -> None:
    """By hand: the same sum of variances, one torque at a time."""
    covariance, basis = scaled_covariance(arm), arm.base.on_data
    states = stack_states(arm.training_motions, subsample(arm.training_motions, rules.MAX_SAMPLES_BEYOND))
    middle = states["q"].mean(axis=0)
    rows = arm.model.regressor(2 * states["q"] - middle, 4 * states["dq"], 8 * states["ddq"])
    torque = np.linalg.norm(rows @ arm.estimate.value)
    variance = sum(y @ covariance @ y for y in rows[:, :, list(basis.independent)].reshape(-1, len(covariance)))
    right = rules.announced_error(arm)
    assert right == pytest.approx(100 * np.sqrt(variance) / torque)
    assert right < rules.MAX_ANNOUNCED_ERROR
    for error, use in ((2.99, Use.SIMULATION), (3.01, Use.CONTROL), (30.0, Use.CONTROL)):
        larger = replace(arm, errors=replace(arm.errors, base_std=error / right * arm.errors.base_std))
        verdict = judge(larger)
        assert verdict.use is use
        assert verdict.reasons == (() if use is Use.SIMULATION else (why.Uncertain(pytest.approx(error)),))


@pytest.mark.parametrize(("ratio", "error"), [(1.6, 4.1), (4.0, 3.2), (1.6, 3.0), (1.4, 20.0)])
def test_a_joint_clearly_above_its_noise_floor_is_never_praised_without_a_word(
    arm: Identification, ratio: float, error: float
) -> None:
    floors = {joint: NoiseFloor(1.0, 1.0, 1.1, FloorOrigin.WHITE) for joint in ("shoulder", "elbow")}
    floors["elbow"] = NoiseFloor(0.1, ratio, 2 * ratio, FloorOrigin.WHITE)
    errors = replace(
        arm.validations[1].errors,
        rmse={"shoulder": 1.0, "elbow": 0.1 * ratio},
        per_joint={"shoulder": 2.0, "elbow": error},
    )
    verdict = with_held(arm, errors=errors, floors=floors)
    assert not any(isinstance(reason, why.AboveFloor) for reason in verdict.reasons)  # its free simulation is good
    alone = replace(arm, validations=tuple(replace(log, free_run=None) for log in arm.validations))
    verdict = with_held(alone, errors=errors, floors=floors)
    is_large = ratio > rules.MAX_FLOOR_RATIO and error * np.sqrt(1 - ratio**-2) > rules.MAX_EXCESS_ERROR
    reason = why.AboveFloor("two", (("elbow", floors["elbow"]),))
    assert (reason in verdict.reasons) == is_large
    assert verdict.residual.joint == "elbow"  # not the larger torque of the shoulder, which is noise
    assert f"{ratio:.2g} times" in str(verdict)


def test_the_residual_shown_is_where_most_torque_is_left(arm: Identification) -> None:
    """rms times relative error: a large share of a tiny torque is not it, nor what could not be tested."""
    test = arm.validations[1].residuals["elbow"]
    errors = replace(
        arm.validations[1].errors, rmse={"shoulder": 0.2, "elbow": 1.0}, per_joint={"shoulder": 9.0, "elbow": 2.0}
    )
    both = {"shoulder": test, "elbow": test}
    residual = with_held(arm, errors=errors, residuals=both).residual
    assert residual.joint == "elbow"
    for name, wrong in (("lag1", np.nan), ("per_joint", {"shoulder": 9.0, "elbow": np.inf})):
        told = both | {"elbow": replace(test, lag1=np.nan)} if name == "lag1" else both
        other = replace(errors, per_joint=wrong) if name == "per_joint" else errors
        verdict = with_held(arm, errors=other, residuals=told)
        assert verdict.residual.joint == "shoulder"
    neither = {name: replace(test, lag1=np.nan) for name in both}
    assert with_held(arm, errors=errors, residuals=neither).residual is None


def sharpened(identification: Identification, worst: dict[str, float]) -> list[Sharpen]:
    """The steps where the parameters named have these standard errors over their values, the others none."""
    value = identification.estimate.value
    std = np.array([worst.get(name, 0.0) for name in identification.model.names]) * np.abs(value)
    errors = replace(identification.errors, std=std, base_covariance=None)
    alone = replace(identification, base=replace(identification.base, on_data=None), errors=errors)
    return [step for step in judge(alone).next if isinstance(step, Sharpen)]


def test_the_motion_asked_for_is_one_that_shows_the_parameter(arm: Identification) -> None:
    steps = sharpened(arm, {"fore.mx": 0.5, "fore.Iyy": 5.0, "Fv_shoulder": 0.5, "Fc_elbow": 0.5, "upper.Iyy": 3.0})
    told = {step.parameter: (step.excitation, step.joint) for step in steps}
    assert told == {
        "fore.mx": (ExcitingMotion.MANY_POSES, "elbow"),
        "fore.Iyy": (ExcitingMotion.ACCELERATE, "elbow"),
        "upper.Iyy": (ExcitingMotion.ACCELERATE, "shoulder"),
        "Fv_shoulder": (ExcitingMotion.CONSTANT_SPEEDS, "shoulder"),
        "Fc_elbow": (ExcitingMotion.CONSTANT_SPEEDS, "elbow"),
    }
    assert [step.share for step in steps] == sorted((step.share for step in steps), reverse=True)
    (motion,) = (log.motion for log in arm.validations if log.role == "train")
    k = arm.model.names.index("Fv_shoulder")
    (case,) = (step for step in steps if step.parameter == "Fv_shoulder")
    torque = case.std * np.linalg.norm(arm.model.regressor(motion.q, motion.dq, motion.ddq)[:, :, k])
    assert case.share == pytest.approx(100 * torque / np.linalg.norm(motion.tau), rel=0.02)


def test_the_figures_of_an_identification_stay(arm: Identification) -> None:
    lines = [*facts(judge(arm), "verdict"), *facts(arm.estimate, "estimate", 1), *facts(arm.errors, "errors", 1)]
    for log in arm.validations:
        lines += [*facts(log.errors, log.name), *facts(log.residuals, log.name), *facts(log.floors, log.name)]
    check_kept("identified_arm", "\n".join(lines))
