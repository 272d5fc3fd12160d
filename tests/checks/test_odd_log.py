"""Logs that do not fit together."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import robot_findings
from dynident.checks.motion import odd_log_findings
from dynident.checks.motion_notes import OddLog, OtherPayload
from dynident.motion.log import Motion
from dynident.runtime import Finding, Severity, Use
from tests.checks.moving_arm import arm, motion, swap_torques, truth

MODEL = arm()


def named(source: str, seed: int, change: Callable[[Motion], Motion] = lambda moved: moved) -> Motion:
    return replace(change(motion(seed)), source=source)


def shifted(moved: Motion) -> Motion:
    return replace(moved, q=moved.q + np.array([0.0, 0.2, 0.0]))


@pytest.mark.parametrize("change", [swap_torques, shifted])
def test_the_odd_one_of_three_logs_is_named_wherever_it_is(change: Callable[[Motion], Motion]) -> None:
    for odd in "abc":
        a, b, c = (named(x, k, change if x == odd else lambda moved: moved) for k, x in enumerate("abc"))
        (result,) = odd_log_findings(MODEL, [a, b], {"c": c})
        assert (result.source, result.severity, result.forbids) == (odd, Severity.WARNING, Use.SIMULATION)
        assert isinstance(result.message, OddLog)
        assert result.message.after < result.message.before / 2


def test_logs_of_one_robot_fit_together_and_so_does_a_fault_of_all() -> None:
    assert list(odd_log_findings(MODEL, [named("a", 1), named("b", 2)], {"c": named("c", 3)})) == []
    assert list(odd_log_findings(MODEL, [named("a", 1, swap_torques)], {"b": named("b", 2, swap_torques)})) == []
    assert list(odd_log_findings(MODEL, [named("a", 1, swap_torques)], {})) == []


def few(moved: Motion, samples: int) -> Motion:
    """The motion with only its first samples, the others masked out."""
    return replace(moved, mask=np.arange(len(moved)) < samples)


@pytest.mark.parametrize("samples", [0, 1, 6])
def test_a_log_of_few_usable_samples_is_no_obstacle(samples: int) -> None:
    """Fewer equations than parameters: its triangular factor has fewer rows than the others'."""
    right, short = named("a", 1), few(named("b", 2), samples)
    assert list(odd_log_findings(MODEL, [right], {"b": short})) == []
    (result,) = odd_log_findings(MODEL, [right, named("c", 3, swap_torques)], {"b": short})
    assert result.source == "c" if samples == 0 else result.source != "b"


@pytest.mark.parametrize("samples", [12, 30])
def test_short_logs_are_not_odd_for_being_explained_by_any_fit(samples: int) -> None:
    def short(moved: Motion) -> Motion:
        noise = np.random.default_rng(samples).standard_normal(moved.tau.shape)
        middle = np.abs(np.arange(len(moved)) - len(moved) // 2) < samples // 2
        return replace(moved, tau=moved.tau + 0.2 * np.ptp(moved.tau) * noise, mask=moved.mask & middle)

    assert list(odd_log_findings(MODEL, [named("a", 1, short)], {"b": named("b", 2, short)})) == []


def findings_beside(odd: Motion) -> list[Finding]:
    return list(robot_findings(MODEL, [named("a", 1), replace(odd, source="odd")], {"b": named("b", 2)}))


def test_what_changed_between_training_logs_is_no_drift() -> None:
    (swapped,) = findings_beside(swap_torques(motion(3)))
    assert (swapped.source, type(swapped.message)) == ("odd", OddLog)
    loaded_theta = truth(MODEL)
    loaded_theta[20] += 1.0  # kg, of the last link
    (loaded,) = findings_beside(motion(3, theta=loaded_theta))
    assert (loaded.source, type(loaded.message)) == ("odd", OtherPayload)
    assert loaded.message.mass == pytest.approx(1.0, abs=5 * loaded.message.std)
