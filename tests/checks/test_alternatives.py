"""Large faults are found by trying, and a right log has none."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import file_notes
from dynident.checks.alternatives import (
    _alternatives,
    _NormalEquations,
    _plausible_alternatives,
    _relative_error,
    better_alternative,
)
from dynident.checks.file_notes import AffectedColumns, ColumnReversed, JointsSwapped, OtherAxis
from dynident.models import Model, RigidBodies
from tests.checks.moving_arm import arm, case, motion, text, truth

MOVED = motion()
ORDER = [0, 2, 1]


def found(moved=MOVED, model: Model | None = None):
    return list(better_alternative(case(moved, model, samples=400)))


def changed(channel: AffectedColumns, change):
    names = {
        AffectedColumns.TORQUE: ("tau",),
        AffectedColumns.POSITION: ("q", "dq", "ddq"),
        AffectedColumns.BOTH: ("tau", "q", "dq", "ddq"),
    }
    return replace(MOVED, **{name: change(getattr(MOVED, name)) for name in names[channel]})


def test_a_right_log_has_none() -> None:
    assert found() == []


@pytest.mark.parametrize("channel", AffectedColumns)
def test_columns_of_two_joints_that_are_exchanged(channel: AffectedColumns) -> None:
    (one,) = found(changed(channel, lambda x: x[:, ORDER]))
    assert one.topic == "swapped"
    assert isinstance(one.message, JointsSwapped)
    assert (one.message.joints, one.message.channel) == (("j2", "j3"), channel)
    assert one.message.after < 0.5 * one.message.before


@pytest.mark.parametrize("channel", [AffectedColumns.POSITION, AffectedColumns.BOTH])
@pytest.mark.parametrize("joint", [1, 2])
def test_a_column_that_is_reversed(channel: AffectedColumns, joint: int) -> None:
    sign = np.where(np.arange(3) == joint, -1.0, 1.0)
    (one,) = found(changed(channel, lambda x: sign * x))
    assert (one.topic, one.joint) == ("sign", f"j{joint + 1}")
    assert isinstance(one.message, ColumnReversed)
    assert one.message.channel is channel


def test_an_axis_that_is_another() -> None:
    (one,) = found(model=arm(text(axis=(1, 0, 0))))
    assert (one.topic, one.joint) == ("axis", "j3")
    assert isinstance(one.message, OtherAxis)
    assert one.message.given == (1, 0, 0)
    assert np.abs(one.message.fitted).tolist() == [0, 1, 0]


def test_gravity_that_is_another_whatever_the_inertias_of_the_file() -> None:
    gravity = (9.81, 0.0, 0.0)
    bodies = RigidBodies(text(), gravity=gravity)
    hung = Model((bodies, *arm().terms[1:]))
    light = arm(re.sub(r'mass value="[^"]*"', 'mass value="0.001"', text()))
    (one,) = found(motion(model=hung, theta=truth(hung)), light)
    assert one.topic == "gravity"
    assert isinstance(one.message, file_notes.OtherGravity)
    np.testing.assert_allclose(one.message.fitted, np.round(gravity, 1))


def test_the_normal_equations_tell_the_error_of_every_alternative() -> None:
    """They use directions that act less than the precision of the file, so that the error may be a little less."""
    given = case(samples=100)
    for one in _alternatives(given):
        exact, least = _relative_error(one.case), _NormalEquations(one.case).error(one.case.tau)
        assert 0.5 * exact < least < 1.001 * exact


def test_orders_and_signs_of_the_torques_share_a_regressor(monkeypatch: pytest.MonkeyPatch) -> None:
    given, calls = case(samples=100), []
    monkeypatch.setattr(Model, "regressor", lambda self, **states: calls.append(1) or evaluated(self, **states))
    tried = list(_alternatives(given))
    assert list(_plausible_alternatives(given, tried, np.inf)) == tried
    moved = {(id(one.case.q), id(one.case.model)) for one in tried}
    assert len(calls) == len(moved) < 0.7 * len(tried)


def test_of_many_joints_only_neighbours_are_exchanged(monkeypatch: pytest.MonkeyPatch) -> None:
    def exchanged() -> int:
        return sum(one.note(2.0, 1.0).topic == "swapped" for one in _alternatives(case(samples=50)))

    assert exchanged() == 3 * len(AffectedColumns)
    monkeypatch.setattr("dynident.checks.alternatives.MAX_JOINTS_ALL_PAIRS", 2)
    assert exchanged() == 2 * len(AffectedColumns)


evaluated = Model.regressor


@pytest.mark.parametrize("seed", [1, 2])
def test_what_a_simple_term_explains_better_is_no_large_fault(seed: int) -> None:
    """Without its rotors an arm seems to hang, and with a strong spring its columns to be exchanged."""
    assert list(better_alternative(case(motion(seed), arm(without="rotor"), samples=150))) == []
    moved = motion(seed)
    sprung = replace(moved, tau=moved.tau + 10.0 * moved.q * np.array([0.0, 0.0, 1.0]))
    assert list(better_alternative(case(sprung, samples=150))) == []


def test_the_fitted_gravity_has_no_negative_zeros() -> None:
    fitted = [one.note(2.0, 1.0).fitted for one in _alternatives(case()) if one.note(2.0, 1.0).topic == "gravity"]  # type: ignore[attr-defined]
    assert (0.0, 0.0, 9.8) in fitted
    assert "-0.0" not in str(fitted)
