"""The rules of the verdict, one by one, on a slider that is good for everything until something is taken from it."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from dynident.checks.log_notes import NoFriction
from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.identification import HeldOut, Identification, Recipe, Remedy, Verdict, identify, judge
from dynident.identification import verdict_reasons as why
from dynident.identification.unobservable import CommonGain, DriveFriction, MotionRatios, Zeros, unknowns
from dynident.identification.verdict_steps import CheckRipple, SetRight, Sharpen, SlowReversals
from dynident.models import Model, RigidBodies
from dynident.models.friction import Offset
from dynident.models.lagrangian import slider
from dynident.models.simulation import RunsAway
from dynident.motion.log import Log
from dynident.motion.smoothers import Difference
from dynident.runtime import Finding, Note, Remark, Severity, Use
from dynident.validation import Driver, LogValidation, Signals
from tests.robots import joint, link, urdf

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


def with_errors(log: LogValidation, **changes: Any) -> LogValidation:
    return replace(log, errors=replace(log.errors, **changes))


Change = Callable[[Identification], Identification]


def of_part(k: int, **changes: Any) -> Change:
    def change(found: Identification) -> Identification:
        logs = list(found.validations)
        logs[k] = replace(logs[k], **changes)
        return replace(found, validations=tuple(logs))

    return change


def with_part(identification: Identification, k: int, **changes: Any) -> Verdict:
    return judge(of_part(k, **changes)(identification))


def test_a_good_model_is_good_for_simulation(good: Identification) -> None:
    verdict = judge(good)
    assert verdict.use is Use.SIMULATION
    assert (verdict.reasons, verdict.next) == ((), ())
    held, train = good.validations[1], good.validations[0]
    assert verdict.held_out == HeldOut(held.errors.relative_error, train.errors.relative_error, None)
    assert (verdict.run.joint, verdict.residual.joint, verdict.residual.log) == ("slider", "slider", "fast")
    assert verdict.run.error == max(run.motion_error["slider"] for run in good.runs)
    assert verdict.residual.causes == held.residuals["slider"].causes


class NoSimulation(Note):
    """A note whose bearing is its type's."""

    forbids = Use.SIMULATION


def test_findings_forbid_a_use_by_severity_or_by_their_note(good: Identification) -> None:
    wrong = Finding(Remark("the torque is in another unit"), "slider", severity=Severity.ERROR)
    odd = Finding(Remark("the file has no limits"))
    mild = [Finding(NoSimulation(), joint) for joint in ("slider", "other")]
    for findings, use in (((odd,), Use.SIMULATION), ((odd, *mild), Use.CONTROL), ((*mild, wrong), Use.DO_NOT_USE)):
        assert judge(replace(good, warnings=findings)).use is use
    verdict = judge(replace(good, warnings=(*mild, wrong), validations=good.validations[:1]))
    assert verdict.reasons[:2] == (why.ForbiddingFindings((wrong,)), why.NoHoldOut())
    assert why.ForbiddingFindings(tuple(mild)) in verdict.reasons  # one reason for all joints


def test_a_fault_comes_before_the_errors_that_it_may_cause(good: Identification) -> None:
    """Though alone it would forbid a simulation only; without an error it stays there."""
    fault = Finding(NoSimulation(), "slider")
    large = with_errors(good.validations[1], relative_error=30.0)
    verdict = judge(replace(good, warnings=(fault,), validations=(good.validations[0], large)))
    assert verdict.use is Use.DO_NOT_USE
    assert [type(reason) for reason in verdict.reasons[:2]] == [why.ForbiddingFindings, why.TorqueErrorTooLarge]
    assert verdict.next[:2] == (Remedy.CORRECT, Remedy.CHECK)
    unjudged = judge(replace(good, warnings=(fault,), validations=good.validations[:1]))
    assert [type(reason) for reason in unjudged.reasons[:2]] == [why.NoHoldOut, why.ForbiddingFindings]


class Advice(Note):
    """A note that is advice, and forbids nothing."""

    advises = True


@pytest.mark.parametrize(("error", "remedy"), [(30.0, Remedy.CHECK), (8.0, Remedy.LONGER_TRAINING)])
def test_what_was_found_is_advised_before_looking_for_it_or_recording(
    good: Identification, error: float, remedy: Remedy
) -> None:
    large = with_errors(good.validations[1], relative_error=error)
    verdict = judge(replace(good, warnings=(Finding(Advice()),), validations=(good.validations[0], large)))
    assert verdict.next[:2] == (SetRight(Finding(Advice())), remedy)


def test_what_forbids_use_is_advised_first(good: Identification) -> None:
    """Only then what to record next, and a simulation last."""
    wrong = (Finding(Remark("a fault"), "slider", severity=Severity.ERROR),)
    alone = replace(good, validations=tuple(replace(validation, free_run=None) for validation in good.validations))
    unsure = replace(alone, errors=replace(good.errors, std=np.array([4.0, 6.0, 0.01, np.inf])))
    for result, first in ((replace(unsure, warnings=wrong), Remedy.CORRECT), (unexcited(unsure), Remedy.EXCITE)):
        verdict = judge(result)
        assert verdict.use is Use.DO_NOT_USE
        assert verdict.next[0] is first
        assert {type(step) for step in verdict.next[1:-1]} == {Sharpen}
        assert verdict.next[-1] is Remedy.SIMULATE
    assert judge(unsure).next[0] is Remedy.SIMULATE


def unexcited(identification: Identification) -> Identification:
    """Two of the four parameters are not determined."""
    determined = replace(identification.estimate.determined, rank=2)
    base = replace(identification.base, on_data=None, structural=None)
    return replace(identification, estimate=replace(identification.estimate, determined=determined), base=base)


def test_a_repeat_of_the_training_motion_holds_nothing_out(good: Identification) -> None:
    again = identify(slider(), [log(3.0, "slow")], [log(3.0, "again", 1)], Recipe(Difference("central"), restart=0.5))
    verdict = judge(again)
    assert verdict.use is Use.DO_NOT_USE
    assert verdict.reasons[0] == why.Repeats((("again", "slow"),))
    assert verdict.next[0] is Remedy.ANOTHER_MOTION
    both = judge(replace(again, validations=(*again.validations, good.validations[1])))
    assert both.use is Use.SIMULATION


def test_an_error_must_carry_over_and_be_a_number(good: Identification) -> None:
    verdict = judge(of_errors(relative_error=9.0)(good))
    assert verdict.use is Use.DO_NOT_USE
    assert verdict.reasons[0] == why.NotCarriedOver("fast", 9.0 / good.validations[0].errors.relative_error)
    (reason, *_) = judge(of_errors(relative_error=float("nan"))(good)).reasons
    assert isinstance(reason, why.TorqueErrorTooLarge)
    assert np.isnan(reason.error)


@pytest.mark.parametrize(
    ("trained", "held", "use"),
    [
        (11.0, 5.4, Use.DO_NOT_USE),
        (11.0, 5.6, Use.SIMULATION),
        (9.9, 2.0, Use.SIMULATION),
        (11.0, 0.0, Use.SIMULATION),  # an error without size is no measure
        (11.0, float("nan"), Use.DO_NOT_USE),  # no number, where the held-out torque is zero
    ],
)
def test_a_fit_that_misses_its_own_data_is_not_good_by_an_easier_log(
    good: Identification, trained: float, held: float, use: Use
) -> None:
    both = zip(good.validations, (trained, held), strict=True)
    verdict = judge(replace(good, validations=tuple(with_errors(entry, relative_error=x) for entry, x in both)))
    worse = [reason for reason in verdict.reasons if isinstance(reason, why.TrainedWorse)]
    assert worse == ([why.TrainedWorse(good.validations[0].name, trained, trained / held)] if held == 5.4 else [])
    assert verdict.use is use


def of_errors(**changes: Any) -> Change:
    return lambda x: of_part(1, errors=replace(x.validations[1].errors, **changes))(x)


def of_run(**changes: Any) -> Change:
    return lambda x: of_part(1, free_run=replace(x.runs[1], **changes))(x)


def silent(identification: Identification) -> Identification:
    train = identification.validations[0].motion
    return of_part(0, signals=Signals(replace(train, tau=0 * train.tau), train.tau))(identification)


def negative(identification: Identification) -> Identification:
    return replace(
        identification, estimate=replace(identification.estimate, value=identification.estimate.value * (1, -1, 1, 1))
    )


NO_RUN: Change = lambda x: of_part(0, free_run=None)(of_part(1, free_run=None)(x))  # noqa: E731
FAULTS: list[tuple[Change, why.Reason]] = [
    (lambda x: replace(x, validations=x.validations[:1]), why.NoHoldOut()),
    (silent, why.SilentTorque(("slider",))),
    (of_errors(relative_error=11.0), why.TorqueErrorTooLarge("fast", 11.0, 10.0)),
    (of_errors(relative_error=26.0, relative_error_filtered=3.0), why.UnfilteredErrorTooLarge("fast", 26.0, 25.0)),
    (
        lambda x: replace(x, mass=replace(x.mass, positive=False, smallest=-0.1)),
        why.MassMatrixNotPositive(-0.1),
    ),
]
LIMITS: list[tuple[Change, why.Reason, Remedy | None]] = [
    (negative, why.NegativeValues(("Fv",)), Remedy.CONSISTENT_FIT),
    (NO_RUN, why.NoFreeRun(), Remedy.SIMULATE),
    (
        of_run(motion_error={"slider": 30.0}),
        why.FreeRunAstray("fast", "slider", 30.0, Driver.TORQUE, 0.5),
        Remedy.CONTROLLER_LOOP,
    ),
    (
        of_run(motion_error={"slider": 2.0}, driver=Driver.CONTROLLER),
        why.FreeRunAstray("fast", "slider", 2.0, Driver.CONTROLLER, 0.5),
        None,
    ),
    (of_run(failure=RunsAway(0.2)), why.FreeRunFails(("fast",), RunsAway(0.2)), None),
]


@pytest.mark.parametrize(("change", "reason"), FAULTS)
def test_what_forbids_any_use(good: Identification, change: Change, reason: why.Reason) -> None:
    verdict = judge(change(good))
    assert verdict.use is Use.DO_NOT_USE
    assert reason in verdict.reasons
    assert reason.remedy in verdict.next
    assert (verdict.held_out is None) == isinstance(reason, why.NoHoldOut)


@pytest.mark.parametrize(("change", "reason", "remedy"), LIMITS)
def test_what_forbids_simulation_only(
    good: Identification, change: Change, reason: why.Reason, remedy: Remedy | None
) -> None:
    verdict = judge(change(good))
    assert verdict.use is Use.CONTROL
    assert verdict.reasons == (reason,)
    assert reason.remedy is remedy
    assert verdict.next == (() if remedy is None else (remedy,))
    assert (verdict.run is None) == isinstance(reason, why.NoFreeRun | why.FreeRunFails)


def test_what_residuals_point_to_becomes_advice(good: Identification) -> None:
    """A ripple and friction at reversals, which the tests of the residuals say by type."""
    test = good.validations[1].residuals["slider"]
    ripple = replace(test, peak=26.0, peak_share=0.9, reversal_share=0.0, sign_correlation=0.0)
    friction = replace(test, peak_share=0.0, reversal_share=0.9, slow_share=0.01)
    for kind, told in ((CheckRipple, ripple), (SlowReversals, friction)):
        (step,) = with_part(good, 1, residuals={"slider": told}).next
        assert isinstance(step, kind)
        assert step.joints == ("slider",)
        assert getattr(step, "frequencies", (26.0,)) == (26.0,)
        assert 0 < step.gain < good.validations[1].errors.relative_error


def test_what_no_data_can_show_is_said_of_a_good_model(good: Identification) -> None:
    assert judge(good).unknown == (CommonGain(),)
    assert judge(replace(good, validations=good.validations[:1])).unknown == ()
    weighed = replace(good.recipe, estimator=PhysicallyConsistent(total_mass=5.0))
    assert judge(replace(good, recipe=weighed)).unknown == (CommonGain(),), "the base's mass takes the factor up"
    frictionless = replace(good, warnings=(*good.warnings, Finding(NoFriction(0.1))))
    assert judge(frictionless).unknown == (CommonGain(), DriveFriction())


def test_zeros_that_parameters_take_up_are_unknown(good: Identification) -> None:
    """Of a vertical axis, which gravity does not show, and of the last, which turns the last body."""
    bodies = [
        joint("turn", "revolute", "base", "column", axis=(0, 0, 1)),
        joint("lift", "revolute", "column", "upper", (0.1, 0.0, 0.2), (0.0, 0.0, 0.1), axis=(0, 1, 0)),
        joint("wrist", "revolute", "upper", "hand", (0.4, 0.05, 0.0), axis=(0, 1, 0)),
    ]
    links = [link("base", 1.0), *(link(name, 2.0, (0.1, 0.02, 0.05)) for name in ("column", "upper", "hand"))]
    model = Model((RigidBodies(urdf(*links, *bodies)),))
    result = replace(good, model=model, estimate=replace(good.estimate, value=np.asarray(model.values)))
    assert tuple(unknowns(result)) == (CommonGain(), Zeros(("turn", "wrist")))


def test_the_lead_of_an_axis_that_acts_on_no_other_is_unknown(good: Identification) -> None:
    bodies = [
        joint("arm", "revolute", "base", "upper", axis=(0, 0, 1)),
        joint("quill", "prismatic", "upper", "hand", (0.3, 0.0, 0.0), axis=(0, 0, 1)),
    ]
    file = RigidBodies(urdf(*(link(name, 2.0, (0.1, 0.02, 0.05)) for name in ("base", "upper", "hand")), *bodies))
    for model, taken in ((Model((file,)), ("arm",)), (Model((file, Offset(file.joints))), ("arm", "quill"))):
        values = np.append(np.asarray(Model((file,)).values), np.zeros(len(model.names) - len(file.parameters)))
        result = replace(good, model=model, estimate=replace(good.estimate, value=values))
        assert MotionRatios(taken) in tuple(unknowns(result)), "gravity tells the mass where no offset is beside it"
