"""The search for the value of one unknown."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import robot_notes
from dynident.checks.misfit import misfit
from dynident.checks.suspects import estimate_suspect, geometry_suspects, promising_suspects
from tests.checks.moving_arm import arm, case, motion

(ZERO,) = (one for one in geometry_suspects(arm()) if (one.joint, one.quantity) == ("j2", "zero"))
OFF = np.array([0.0, 0.1, 0.0])


def test_a_zero_is_found_within_its_standard_error() -> None:
    moved = motion()
    fit = misfit(case(replace(moved, q=moved.q - OFF)))
    found = estimate_suspect(fit, ZERO)
    assert found is not None
    assert found.value == pytest.approx(0.1, abs=4 * found.std)
    assert found.std < 0.01
    assert misfit(found.case).size < 1.1 * misfit(case(moved)).size
    note = ZERO.note(found.value, found.std, found.share, ())
    assert note == robot_notes.ZeroOff(found.value, found.std, found.share)


def test_what_is_not_wrong_is_neither_tested_further_nor_found() -> None:
    fit = misfit(case())
    assert list(promising_suspects(fit, [ZERO])) == []
    assert estimate_suspect(fit, ZERO) is None


def test_a_value_beyond_what_is_plausible_is_no_explanation() -> None:
    moved = motion()
    fit = misfit(case(replace(moved, q=moved.q - OFF)))
    assert estimate_suspect(fit, replace(ZERO, limit=0.05)) is None
