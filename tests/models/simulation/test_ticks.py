"""A drive that is faster than its log: simulated at its own times, it goes where it went."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.models.simulation import PD, longest_stretch, simulate_recording, ticks
from dynident.motion.log import Motion
from dynident.runtime import InputError
from dynident.validation import free_run
from tests.models.simulation.loops import ARM, LINKED, driven, loop, reference

FAST, EVERY = np.arange(2001) * 1e-3, 4


@cache
def logged() -> tuple[Motion, PD]:
    """Every fourth sample of an arm in a loop at 1 kHz, and the controller as the log knows it."""
    motion = driven(ARM, FAST)
    run = simulate_recording(ARM, LINKED, motion, loop("pd", motion)).motion
    columns = {name: getattr(run, name)[::EVERY] for name in ("t", "q", "dq", "ddq", "tau", "mask")}
    few = replace(run, **columns)
    return few, replace(loop("pd", few), reference=reference(few))


def test_a_drive_at_its_own_rate_goes_where_it_went() -> None:
    few, slow = logged()
    errors = [max(free_run(ARM, LINKED, few, drive).motion_error.values()) for drive in (slow, slow.every(1e-3))]
    assert errors[1] < 0.1 * errors[0], errors
    assert errors[1] < 0.1  # %, of references that are straight between samples


def test_the_samples_are_among_the_times() -> None:
    few, slow = logged()
    result = ticks(few, slow.every(1e-3), slice(5, 105))
    np.testing.assert_allclose(result.motion.t[result.at], few.t[5:105], atol=1e-9)
    np.testing.assert_allclose(result.motion.q[result.at], few.q[5:105], atol=1e-9)
    assert len(result.motion.t) == 99 * EVERY + 1


def test_a_motion_stays_where_the_controller_knows_no_more() -> None:
    few, slow = logged()
    apart = slow.every(1e-3).timed(slow.every(1e-3).t + 4e-4)  # samples that are not among the drive's times
    for drive in (None, slow, apart):
        assert ticks(few, drive, slice(0, 100)).motion is few
    assert ticks(few, slow, longest_stretch(replace(few, mask=few.t < 0))).rows == slice(0, 0)


@pytest.mark.parametrize("period", [0.003, 0.005, 1e-7, 0.0, -0.001, np.inf, np.nan])
def test_a_period_that_does_not_fit_is_said(period: float) -> None:
    _, slow = logged()
    with pytest.raises(InputError, match=r"period = .* s does not fit the 0.004 s from sample to sample; give a whole"):
        slow.every(period)
