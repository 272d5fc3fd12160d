"""Findings on outliers name joint, row and time; a clean log has none."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.checks import channel_notes, check_log, check_log_fully, log_notes, run_checks
from dynident.identification import Recipe
from dynident.models.friction import Coulomb
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.runtime import Severity
from tests.classes import classes_of

ARM = pendulum()
T = np.arange(2000) * 0.005
OURS = classes_of(log_notes)


@cache
def motion(rate: float) -> Motion:
    return simulate(ARM, ARM.values, lambda t: [0.4 * np.sin(rate * t) + np.sin(2.3 * t)], T)


def log(seed: int, rate: float = 9.0) -> Log:
    return record(motion(rate), sigma_q=1e-4, sigma_tau=0.02, rng=np.random.default_rng(seed)).log


ONE = log(1)


def put(name: str, rows: list[int] | slice, value: float, *, add: bool = False) -> Log:
    x = getattr(ONE, name).copy()
    x[rows] = x[rows] + value if add else value
    return replace(ONE, q=x if name == "q" else ONE.q, tau=x if name == "tau" else ONE.tau)


def found(one: Log, held: Log | None = None, **changes) -> list:
    logs = {"train": {"a": one}, "validation": {} if held is None else {"b": held}}
    return [
        finding
        for finding in run_checks(ARM, logs, replace(Recipe(Spline(sigma=1e-4)), **changes)).findings
        if isinstance(finding.message, OURS)
    ]


@pytest.mark.parametrize("seed", range(20))
def test_no_clean_log_has_findings(seed: int) -> None:
    assert found(log(seed), log(seed + 100, 8.0)) == []


def test_a_torque_of_5000_is_said_with_its_row() -> None:
    (one,) = found(put("tau", [777], 5000.0))
    assert (one.joint, one.source, one.severity) == ("pivot", "a", Severity.WARNING)
    note = one.message
    assert isinstance(note, log_notes.TorqueSpikes)
    assert (note.count, note.rows, note.masked, note.held_out) == (1, (777,), True, False)
    assert note.times == pytest.approx((777 * 0.005,))
    assert note.largest == pytest.approx(5000, abs=2)
    assert not found(put("tau", [777], 5000.0), outliers="keep")[0].message.masked


def test_a_held_out_spike_is_said() -> None:
    (one,) = found(log(3, 8.0), put("tau", [777], 50.0))
    assert (one.source, one.message.held_out, one.message.masked) == ("b", True, False)


def test_frozen_and_clipped_torques_are_said_with_their_stretch() -> None:
    (one,) = found(put("tau", slice(800, 1100), 0.0))
    assert isinstance(one.message, log_notes.FrozenTorque)
    assert (one.message.row, one.message.count, one.message.value) == (800, 300, 0.0)
    kinds = {type(one.message) for one in found(replace(ONE, tau=np.clip(ONE.tau, -0.8, 0.8)))}
    assert kinds == {log_notes.ClippedTorque}


def test_too_many_are_not_left_out() -> None:
    (one,) = found(put("tau", list(range(100, 1900, 20)), 50.0))
    assert isinstance(one.message, log_notes.ManyTorqueOutliers)
    assert one.message.share == pytest.approx(90 / 2000, abs=0.005)
    assert one.forbids is not None


def test_spikes_and_frozen_stretches_of_the_position_are_said() -> None:
    (one,) = found(put("q", [500, 901], 0.3, add=True))
    assert isinstance(one.message, log_notes.PositionSpikes)
    assert (one.message.rows, one.message.replaced) == ((500, 901), True)
    (held,) = found(put("q", slice(900, 1000), float(ONE.q[900, 0])))
    assert isinstance(held.message, log_notes.FrozenPosition)
    assert held.message.row == pytest.approx(900, abs=2)


def test_a_wrap_is_an_error_and_a_jump_is_not() -> None:
    turning = 4 * T + 0.3 * np.sin(3 * T)
    wrapped = Log(T, ((turning + np.pi) % (2 * np.pi) - np.pi)[:, None], ONE.tau, ("pivot",))
    (one,) = check_log(wrapped, {"pivot": "revolute"})
    assert isinstance(one.message, channel_notes.WrappedPosition)
    assert one.severity is Severity.ERROR
    assert one.message.period == pytest.approx(2 * np.pi, rel=0.02)
    assert one.message.count == 6
    assert abs(wrapped.q[one.message.row + 1, 0] - wrapped.q[one.message.row, 0]) > 6
    shifted = put("q", slice(900, None), 0.4, add=True)
    (jump,) = (f for f in check_log_fully(shifted, {"pivot": "revolute"}) if isinstance(f.message, OURS))
    assert isinstance(jump.message, log_notes.PositionJump)
    assert (jump.message.count, jump.message.row) == (1, 899)
    assert jump.message.size == pytest.approx(0.4, abs=0.05)


def test_interpolated_positions_are_said() -> None:
    coarse = np.interp(T, T[::5], ONE.q[::5, 0])
    notes = [one.message for one in check_log_fully(replace(ONE, q=coarse[:, None]), {"pivot": "revolute"})]
    (note,) = (one for one in notes if isinstance(one, log_notes.InterpolatedPositions))
    assert note.share == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize("turn", [0.0, 0.5, 1.5, 3.5, 5.5])
@pytest.mark.parametrize("at_end", [False, True])
def test_a_reversal_in_the_first_or_last_samples_is_no_spike(turn: float, at_end: bool) -> None:
    arm, phase = ARM.with_terms(Coulomb(ARM.joints)), 2.3 * (T - turn * 0.005)
    q, dq, ddq = (x[:, None] for x in (np.cos(phase), -2.3 * np.sin(phase), -(2.3**2) * np.cos(phase)))
    rng, theta = np.random.default_rng(0), [*ARM.values, 0.5]
    tau = arm.torque(q, dq, ddq, theta) + 0.01 * rng.standard_normal(q.shape)
    q = q + 1e-5 * rng.standard_normal(q.shape)
    recording = Log(T, q[::-1] if at_end else q, tau[::-1] if at_end else tau, ("pivot",), "a")
    recipe = Recipe(Spline(sigma=1e-5))
    assert not [one for one in run_checks(arm, {"train": {"a": recording}}, recipe).findings
                if isinstance(one.message, log_notes.TorqueSpikes)]  # fmt: skip
    if turn > 4:  # a spike before a step is seen as neither
        return
    wrong = recording.tau.copy()
    wrong[-1 if at_end else 0] += 5.0  # more than any friction
    loose = replace(recording, tau=wrong)
    (one,) = [one for one in run_checks(arm, {"train": {"a": loose}}, recipe).findings
              if isinstance(one.message, log_notes.TorqueSpikes)]  # fmt: skip
    assert one.message.largest == pytest.approx(5.0, abs=1.2)
