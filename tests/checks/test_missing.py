"""Effects that the torque has and the model lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import misfit
from dynident.checks.missing import TRIED_KINDS, find_missing_effects, is_tried_effect, with_missing
from dynident.checks.robot_notes import MissingTerm, TermKind
from dynident.identification.terms import TermChoice, TermTrial, TrialOutcome, library_kinds
from dynident.runtime import Severity
from tests.checks.moving_arm import arm, case, motion

MOVED = motion()


def with_effect(effect: np.ndarray, joint: int = 0):
    tau = MOVED.tau.copy()
    tau[:, joint] += effect
    return case(replace(MOVED, tau=tau))


EFFECTS = {
    TermKind.SPRING: (4.0, lambda q, dq, ddq: 4.0 * q[:, 0]),
    TermKind.ASYMMETRIC: (1.0, lambda q, dq, ddq: np.abs(dq[:, 0])),
    TermKind.QUADRATIC: (0.8, lambda q, dq, ddq: 0.8 * dq[:, 0] * np.abs(dq[:, 0])),
    TermKind.LOAD: (0.15, lambda q, dq, ddq: 0.15 * np.abs(MOVED.tau[:, 0]) * np.sign(dq[:, 0])),
    TermKind.SATURATION: (0.06, lambda q, dq, ddq: -0.06 * MOVED.tau[:, 0] ** 3 / np.mean(MOVED.tau[:, 0] ** 2)),
    TermKind.RIPPLE: (0.6, lambda q, dq, ddq: 0.6 * np.sin(17.3 * q[:, 0] + 0.4)),
    TermKind.GAIN_DRIFT: (0.2, lambda q, dq, ddq: 0.2 * np.linspace(-1, 1, len(q)) * MOVED.tau[:, 0]),
    TermKind.DRIFT: (-0.5, lambda q, dq, ddq: -0.5 * np.linspace(-1, 1, len(q)) * (dq + 1.5 * np.sign(dq))[:, 0]),
}


@pytest.mark.parametrize("kind", EFFECTS)
def test_an_effect_of_one_joint_is_named_with_its_size(kind: TermKind) -> None:
    size, effect = EFFECTS[kind]
    found = next(iter(explain_residual(with_effect(effect(MOVED.q, MOVED.dq, MOVED.ddq)))))
    assert (found.topic, found.joint) == ("missing term", "j1")
    assert isinstance(found.message, MissingTerm)
    assert found.message.effect is kind
    assert found.message.value == pytest.approx(size, rel=0.25)
    warned = found.message.share > 0.4 or found.message.cost > 5.0
    assert found.severity is (Severity.WARNING if warned else Severity.INFO)


@pytest.mark.parametrize("kind", [TermKind.VISCOUS, TermKind.COULOMB, TermKind.OFFSET, TermKind.ROTOR])
def test_a_term_that_was_left_out_is_named(kind: TermKind) -> None:
    found = [one.message for one in explain_residual(case(MOVED, arm(without=kind.value)))]
    assert found
    assert {note.effect for note in found} == {kind}
    assert any(note.forbidden for note in found)


def test_a_coupled_motor_is_named_with_both_joints() -> None:
    tau = MOVED.tau.copy()
    tau[:, 0] += 0.2 * MOVED.ddq[:, 2]
    tau[:, 2] += 0.2 * MOVED.ddq[:, 0]
    found = next(iter(explain_residual(case(replace(MOVED, tau=tau)))))
    assert found.joint == "j3"
    assert found.message.effect is TermKind.COUPLED
    assert found.message.partner == "j1"
    assert found.message.value == pytest.approx(0.2, abs=0.02)


@pytest.mark.parametrize(("joint", "other"), [(0, 1), (1, 2), (2, 1)])
def test_the_torque_of_a_neighbour_is_named_with_it_and_forbids_control(joint: int, other: int) -> None:
    """As the motors of a differential have it: other parameters take up part of it, which another motion shows."""
    found = next(iter(explain_residual(with_effect(0.8 * MOVED.tau[:, other], joint))))
    note = found.message
    assert (found.joint, note.effect, note.partner) == (f"j{joint + 1}", TermKind.NEIGHBOUR, f"j{other + 1}")
    assert note.value == pytest.approx(0.8, abs=0.05)
    assert found.severity is Severity.WARNING


def test_a_ripple_is_named_with_its_period_and_a_saturation_costs_no_more_than_was_seen() -> None:
    ripple, saturated = (
        next(iter(explain_residual(with_effect(EFFECTS[kind][1](MOVED.q, MOVED.dq, MOVED.ddq))))).message
        for kind in (TermKind.RIPPLE, TermKind.SATURATION)
    )
    assert ripple.period == pytest.approx(2 * np.pi / 17.3, rel=0.02)
    most = 0.06 * float(np.square(MOVED.tau[:, 0]).max() / np.mean(MOVED.tau[:, 0] ** 2))
    assert 0.0 < saturated.cost < 100 * most
    assert saturated.period == 0.0


def test_a_late_torque_is_named_with_its_delay() -> None:
    tau = MOVED.tau.copy()
    tau[:, 1] = np.interp(MOVED.t - 0.05, MOVED.t, tau[:, 1])
    found = next(iter(explain_residual(case(replace(MOVED, tau=tau)))))
    assert (found.joint, found.message.effect) == ("j2", TermKind.DELAY)
    assert found.message.value == pytest.approx(0.05, rel=0.25)


def test_a_complete_model_lacks_nothing_and_an_effect_is_missed_once() -> None:
    assert find_missing_effects(misfit(case(MOVED))) == []
    stiff = with_effect(4.0 * MOVED.q[:, 0])
    first = find_missing_effects(misfit(stiff))[0]
    assert find_missing_effects(misfit(with_missing(stiff, first))) == []


def test_an_effect_that_a_choice_has_tried_on_that_joint_is_known() -> None:
    (found, *_) = explain_residual(with_effect(EFFECTS[TermKind.RIPPLE][1](MOVED.q, MOVED.dq, MOVED.ddq)))
    trials = tuple(
        TermTrial(joint, kind, (), 0.1, 0.2, TrialOutcome.WITHIN_ERROR)
        for joint, kind in (("j1", "spring"), ("j2", "ripple"))
    )
    choice = TermChoice(("j1", "j2"), (), trials, (), (), ())
    assert is_tried_effect(found)
    assert not is_tried_effect(found, choice)  # of another joint
    own = TermTrial("j1", "ripple 2", (), 3.0, 0.2, TrialOutcome.ENTERED)
    assert is_tried_effect(found, replace(choice, trials=(*trials, own)))


@pytest.mark.parametrize(
    ("outcome", "gain", "is_tried"),
    [
        (TrialOutcome.WITHIN_ERROR, 21.0, False),
        (TrialOutcome.WITHIN_ERROR, 3.0, True),
        (TrialOutcome.NEGATIVE, 21.0, True),
        (TrialOutcome.ENTERED, 21.0, True),
    ],
)
def test_an_effect_that_gained_much_but_within_its_error_is_still_said(
    outcome: TrialOutcome, gain: float, is_tried: bool
) -> None:
    found = next(iter(explain_residual(with_effect(EFFECTS[TermKind.LOAD][1](MOVED.q, MOVED.dq, MOVED.ddq)))))
    trial = TermTrial("j1", "load_coulomb", (), gain, 20.0, outcome)
    assert is_tried_effect(found, TermChoice(("j1",), (), (trial,), (), (), ())) == is_tried


def test_the_kinds_of_a_choice_that_stand_for_effects_exist() -> None:
    assert set().union(*TRIED_KINDS.values()) <= {kind.name for kind in library_kinds()} | {"ripple"}
