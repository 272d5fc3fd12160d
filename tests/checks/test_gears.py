"""A wrong gear of a position, against what a joint alone lacks and against the clock."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import Misfit, misfit
from dynident.checks.robot_notes import SuspectQuantity, TorqueGain
from dynident.checks.suspects import Suspect, SuspectEstimate, clock_suspect, gear_suspects, is_beyond_own_effects
from dynident.motion.log import Motion
from tests.checks.moving_arm import arm, case, motion


def geared(joint: int, factor: float, seed: int = 0) -> Motion:
    """A motion whose positions of one joint are logged by another gear."""
    moved, factors = motion(seed), np.ones(3)
    factors[joint] = factor
    return replace(moved, q=factors * moved.q, dq=factors * moved.dq, ddq=factors * moved.ddq)


def test_what_the_data_cannot_tell_apart_is_said_with_both_in_the_finding_and_in_the_remedy() -> None:
    """About a vertical axis a gear scales the joint's own torque, much as a gain does."""
    (result,) = explain_residual(case(geared(0, 1.2, seed=5)))
    assert isinstance(result.message, TorqueGain)
    assert [(rival.quantity, rival.joint) for rival in result.message.others] == [(SuspectQuantity.GEAR, "j1")]
    (rival,) = result.message.others
    assert rival.value == pytest.approx(1 / 1.2, abs=0.05)
    for text in (str(result), result.message.remedy):
        assert f"positions {rival.value:.3g} times as large" in text


def explained(moved: Motion, suspect: Suspect, without: str = "") -> tuple[Misfit, SuspectEstimate]:
    """The fit of a motion by the arm or one that lacks a term, and what one step of a suspect explains of it."""
    fit = misfit(case(moved, arm(without=without)))
    (score,) = fit.score_tests([suspect.derivative(fit)])
    corrected = suspect.correct_case(fit.case, float(np.clip(score.value, -0.5, 0.5)))
    share = 1.0 - misfit(corrected, fit.weight.max(axis=0)).size / fit.size
    assert share > 0.04
    return fit, SuspectEstimate(suspect, score.value, score.std, share, corrected)


LACKS = [("rotor", None, 0), ("rotor", None, 1), ("rotor", None, 4), ("coulomb", None, 4)]  # what, gear or clock, seed


@pytest.mark.parametrize(("lack", "j", "seed"), [*LACKS, ("coulomb", 2, 0), ("spring", 1, 2)])
def test_what_a_joint_alone_lacks_is_no_gear_and_no_clock(lack: str, j: int | None, seed: int) -> None:
    """Both scale its friction and its inertia, and so take up a part of it; the other torques do not ask for them."""
    moved = motion(seed)
    if lack == "spring":
        moved = replace(moved, tau=moved.tau + 3.0 * moved.q * (np.arange(3) == 2))
    suspect = clock_suspect() if j is None else gear_suspects(arm())[j]
    assert not is_beyond_own_effects(*explained(moved, suspect, without=lack))
