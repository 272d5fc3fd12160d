"""Effects that the torque has and the model lacks: named with joint, size and cost, and delays and ripples found."""

from functools import cache

import numpy as np
import pytest

from dynident.checks.explain import delay_findings, explain_residual
from dynident.checks.misfit import Misfit, fit_case, misfit
from dynident.checks.missing import TRIED_KINDS, faster_case, find_missing_effects, is_tried_effect, with_missing
from dynident.checks.robot_notes import LeftAtReversals, MissingTerm, TermKind
from dynident.identification.terms import TermChoice, TermTrial, TrialOutcome, library_kinds
from dynident.models import Model
from dynident.models.friction import LoadCoulomb, Ripple
from dynident.motion.log import Motion
from dynident.runtime import Finding, Severity
from tests.checks.moving_arm import MOVED, VALUES, arm, case, motion, truth, with_torque

Q, DQ, TAU = (x[:, 0] for x in (MOVED.q, MOVED.dq, MOVED.tau))
LOAD = arm().torque(MOVED.q, MOVED.dq, MOVED.ddq, [x.value or 0.0 for x in arm().parameters])[:, 0]
TREND = np.linspace(-1, 1, len(Q))
EFFECTS = {
    TermKind.SPRING: (4.0, 4.0 * Q),
    TermKind.ASYMMETRIC: (1.0, np.abs(DQ)),
    TermKind.QUADRATIC: (0.8, 0.8 * DQ * np.abs(DQ)),
    TermKind.LOAD: (0.3, 0.3 * np.abs(LOAD) * np.sign(DQ)),
    TermKind.GEAR_LOSS: (0.15, 0.15 * np.abs(TAU) * np.sign(DQ)),
    TermKind.SATURATION: (0.06, -0.06 * TAU**3 / np.mean(TAU**2)),
    TermKind.RIPPLE: (0.6, 0.6 * np.sin(17.3 * Q + 0.4)),
    TermKind.GAIN_DRIFT: (0.2, 0.2 * TREND * TAU),
    TermKind.DRIFT: (-0.5, -0.5 * TREND * (DQ + 1.5 * np.sign(DQ))),
}
LEFT_OUT = (TermKind.VISCOUS, TermKind.COULOMB, TermKind.OFFSET, TermKind.ROTOR)


@cache
def explained(kind: TermKind) -> list[Finding]:
    """What is said of a torque with an effect more, or of a model without a term."""
    if kind in EFFECTS:
        return list(explain_residual(case(with_torque(EFFECTS[kind][1]))))
    return list(explain_residual(case(model=arm(without=kind.value))))


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_of_one_joint_is_named_with_its_size(kind: TermKind) -> None:
    finding = explained(kind)[0]
    note = finding.message
    assert isinstance(note, MissingTerm)
    assert (finding.joint, note.effect) == ("j1", kind)
    assert note.value == pytest.approx(EFFECTS[kind][0], rel=0.25)
    is_warned = note.share > 0.4 or note.cost > 5.0
    assert finding.severity is (Severity.WARNING if is_warned else Severity.INFO)
    assert note.period == pytest.approx(2 * np.pi / 17.3 if kind is TermKind.RIPPLE else 0.0, rel=1e-3)
    if kind is TermKind.SATURATION:  # costs no more than was seen
        assert 0.0 < note.cost < 100 * 0.06 * np.square(TAU).max() / np.mean(TAU**2)


def test_a_gear_loss_is_not_named_where_the_model_has_friction_by_the_load() -> None:
    full = Model((*arm().terms, LoadCoulomb(arm().joints)))
    model = full.with_load([x.value or 0.0 for x in full.parameters])
    moved = model.remembering(with_torque(EFFECTS[TermKind.GEAR_LOSS][1]))
    notes = [finding.message for finding in explain_residual(case(moved, model))]
    assert TermKind.GEAR_LOSS not in [note.effect for note in notes if isinstance(note, MissingTerm)]


@pytest.mark.parametrize("kind", LEFT_OUT)
def test_a_term_that_was_left_out_is_named_with_its_cost_on_a_faster_motion(kind: TermKind) -> None:
    notes = [finding.message for finding in explained(kind)]
    assert {note.effect for note in notes} == {kind}
    assert any(note.forbidden for note in notes)
    if kind is TermKind.OFFSET:
        return
    given, full = case(model=arm(without=kind.value)), arm()
    fast = faster_case(given)
    right = full.torque(fast.q, fast.dq, fast.ddq, truth(full))
    error = np.linalg.norm(fast.torque(misfit(given).theta) - right) / np.linalg.norm(right)
    assert notes[0].cost == pytest.approx(100 * error, rel=0.25)


def test_a_coupled_motor_is_named_with_both_joints() -> None:
    first, *_ = explain_residual(case(with_torque(0.2 * MOVED.ddq[:, 0], 2, with_torque(0.2 * MOVED.ddq[:, 2]))))
    assert (first.joint, first.message.effect, first.message.partner) == ("j3", TermKind.COUPLED, "j1")
    assert first.message.value == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("joint", "other"), [(0, 1), (1, 2), (2, 1)])
def test_the_torque_of_a_neighbour_is_named_with_it_and_forbids_control(joint: int, other: int) -> None:
    """As the motors of a differential have it: other parameters take up part of it, which another motion shows."""
    first, *_ = explain_residual(case(with_torque(0.8 * MOVED.tau[:, other], joint)))
    note = first.message
    assert (first.joint, note.effect, note.partner) == (f"j{joint + 1}", TermKind.NEIGHBOUR, f"j{other + 1}")
    assert note.value == pytest.approx(0.8, abs=0.05)
    assert first.severity is Severity.WARNING


def test_a_complete_model_lacks_nothing_and_an_effect_is_missed_once() -> None:
    assert find_missing_effects(misfit(case())) == []
    stiff = case(with_torque(4.0 * Q))
    first, *_ = find_missing_effects(misfit(stiff))
    assert find_missing_effects(misfit(with_missing(stiff, first))) == []


ENTERED, WITHIN_ERROR, NEGATIVE = TrialOutcome.ENTERED, TrialOutcome.WITHIN_ERROR, TrialOutcome.NEGATIVE


@pytest.mark.parametrize(
    ("effect", "joint", "kind", "gain", "std", "outcome", "is_tried"),
    [
        (TermKind.RIPPLE, "j2", "ripple", 0.1, 0.2, WITHIN_ERROR, False),  # of another joint
        (TermKind.RIPPLE, "j1", "spring", 0.1, 0.2, WITHIN_ERROR, False),
        (TermKind.RIPPLE, "j1", "ripple 2", 3.0, 0.2, ENTERED, True),
        (TermKind.LOAD, "j1", "load_coulomb", 21.0, 20.0, WITHIN_ERROR, False),  # much, but within its error
        (TermKind.LOAD, "j1", "load_coulomb", 3.0, 20.0, WITHIN_ERROR, True),
        (TermKind.LOAD, "j1", "load_coulomb", 21.0, 20.0, NEGATIVE, True),
        (TermKind.LOAD, "j1", "load_coulomb", 21.0, 20.0, ENTERED, True),
    ],
)
def test_an_effect_that_a_choice_has_tried_on_that_joint_is_known(
    effect: TermKind, joint: str, kind: str, gain: float, std: float, outcome: TrialOutcome, is_tried: bool
) -> None:
    finding = Finding(MissingTerm(effect, 1.0, 0.1, 0.5), "j1")
    trial = TermTrial(joint, kind, (), gain, std, outcome)
    assert is_tried_effect(finding, TermChoice(("j1", "j2"), (), (trial,), (), (), ())) is is_tried
    assert is_tried_effect(finding)


def test_what_is_left_at_reversals_is_open_until_a_choice_has_tried_friction_that_builds_up() -> None:
    finding = Finding(LeftAtReversals(37.0, 0.45), "j1")
    assert is_tried_effect(finding)
    assert not is_tried_effect(finding, TermChoice(("j1", "j2"), (), (), (), (), ()))


def test_the_kinds_of_a_choice_that_stand_for_effects_exist() -> None:
    assert set().union(*TRIED_KINDS.values()) <= {kind.name for kind in library_kinds()} | {"ripple"}


PUNCTUAL = motion(5)


def find_delays(moved: Motion) -> list[Finding]:
    return list(delay_findings(misfit(fit_case(arm(), [moved])), [moved]))


def delay_torque(joint: int, delay: float) -> Motion:
    tau = PUNCTUAL.tau[:, joint]
    return with_torque(np.interp(PUNCTUAL.t - delay, PUNCTUAL.t, tau) - tau, joint, PUNCTUAL)


@pytest.mark.parametrize(("joint", "delay"), [(0, 0.01), (2, -0.015), (2, 0.03)])
def test_a_late_torque_is_named_with_its_delay(joint: int, delay: float) -> None:
    (finding,) = find_delays(delay_torque(joint, delay))
    note = finding.message
    assert (finding.severity, finding.joint) == (Severity.WARNING, f"j{joint + 1}")
    assert note.effect is TermKind.DELAY
    assert note.value == pytest.approx(delay, rel=0.3, abs=3 * note.std)
    assert note.std < abs(delay) / 4
    assert note.cost < 10.0


def test_torques_in_time_are_not_named_even_where_friction_reverses_late() -> None:
    """As presliding has it: the rest of the torque is in time."""
    assert find_delays(PUNCTUAL) == []
    sign = np.sign(PUNCTUAL.dq[:, 2])
    delayed = np.interp(PUNCTUAL.t - 0.02, PUNCTUAL.t, sign)
    assert find_delays(with_torque(VALUES["coulomb"] * (delayed - sign), 2, PUNCTUAL)) == []


@pytest.mark.parametrize(("delay", "is_named"), [(0.0008, False), (0.004, True)])
def test_a_ripple_that_is_a_cycle_late_is_no_delay(delay: float, is_named: bool) -> None:
    bodies, *terms = arm().terms
    model = Model((bodies, *terms, Ripple(bodies.joints, on=("j1",), cycles=(30.0,))))
    delayed = with_torque(5.0 * np.sin(30.0 * (Q - delay * DQ)), moved=motion(noise=0.002))
    effects = {effect.kind for effect in find_missing_effects(misfit(case(delayed, model)))}
    assert (TermKind.DELAY in effects) == is_named


def ripple(rate: float, joint: int = 0) -> Misfit:
    return misfit(case(with_torque(0.5 * np.sin(rate * MOVED.q[:, joint] + 0.7), joint)))
