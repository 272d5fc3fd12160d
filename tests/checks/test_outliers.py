"""Findings on outliers name joint, row and time; a clean log has none."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import channel_notes, check_log, check_log_fully, log_notes, run_checks
from dynident.identification import Recipe
from dynident.models import Model
from dynident.models.friction import Coulomb
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.runtime import Severity
from tests.checks.pendulum import PENDULUM, T, swing
from tests.classes import classes_of

OURS = classes_of(log_notes)


def log(seed: int, rate: float = 9.0) -> Log:
    return swing(seed, (0.1, rate), (0.5, 2.3))


ONE = log(1)


def put(name: str, rows: list[int] | slice, value: float, *, add: bool = False) -> Log:
    x = getattr(ONE, name).copy()
    x[rows] = x[rows] + value if add else value
    return replace(ONE, q=x if name == "q" else ONE.q, tau=x if name == "tau" else ONE.tau)


def found(*train: Log, held: tuple[Log, ...] = (), model: Model = PENDULUM, **changes) -> list:
    logs = {
        role: {f"{role} {k}": x for k, x in enumerate(part)} for role, part in (("train", train), ("validation", held))
    }
    recipe = replace(Recipe(Spline(sigma=1e-4), time_offset=0.0, base_tilt=(0.0, 0.0)), **changes)
    return [x for x in run_checks(model, logs, recipe).findings if isinstance(x.message, OURS)]


@pytest.mark.parametrize("seed", range(4))
def test_no_clean_log_has_findings(seed: int) -> None:
    assert found(log(seed), held=(log(seed + 100, 8.0),)) == []


@pytest.mark.parametrize("outliers", ["mask", "keep"])
def test_a_torque_of_5000_is_said_with_its_row(outliers: str) -> None:
    (case,) = found(put("tau", [777], 5000.0), outliers=outliers)
    assert (case.joint, case.source, case.severity) == ("pivot", "train 0", Severity.WARNING)
    note = case.message
    assert isinstance(note, log_notes.TorqueSpikes)
    assert (note.count, note.rows, note.masked, note.held_out) == (1, (777,), outliers == "mask", False)
    assert note.times == pytest.approx((777 * 0.005,))
    assert note.largest == pytest.approx(5000, abs=2)


def test_frozen_and_clipped_torques_are_said_with_their_stretch() -> None:
    (case,) = found(put("tau", slice(400, 600), 0.0))
    assert isinstance(case.message, log_notes.FrozenTorque)
    assert (case.message.row, case.message.count, case.message.value) == (400, 200, 0.0)
    limit = 0.6 * np.abs(ONE.tau).max()
    clipped = np.clip(ONE.tau, -limit, limit)
    for note in (x.message for x in found(replace(ONE, tau=clipped))):
        assert isinstance(note, log_notes.ClippedTorque)
        first = int(np.flatnonzero(clipped == note.value)[0])
        assert (note.row, note.time) == (first, ONE.t[first])


def test_too_many_are_not_left_out() -> None:
    (case,) = found(put("tau", list(range(50, 950, 20)), 50.0))
    assert isinstance(case.message, log_notes.ManyTorqueOutliers)
    assert case.message.share == pytest.approx(45 / 1000, abs=0.005)
    assert case.forbids is not None


def test_spikes_and_frozen_stretches_of_the_position_are_said() -> None:
    (case,) = found(put("q", [500, 901], 0.3, add=True))
    assert isinstance(case.message, log_notes.PositionSpikes)
    assert (case.message.rows, case.message.replaced) == ((500, 901), True)
    (held,) = found(put("q", slice(700, 800), float(ONE.q[700, 0])))
    assert isinstance(held.message, log_notes.FrozenPosition)
    assert held.message.row == pytest.approx(700, abs=2)


def test_a_wrap_is_an_error_and_a_jump_is_not() -> None:
    turning = 8 * T + 0.3 * np.sin(6 * T)
    wrapped = Log(T, ((turning + np.pi) % (2 * np.pi) - np.pi)[:, None], ONE.tau, ("pivot",))
    (finding,) = check_log(wrapped, {"pivot": "revolute"})
    assert isinstance(finding.message, channel_notes.WrappedPosition)
    assert finding.severity is Severity.ERROR
    assert finding.message.period == pytest.approx(2 * np.pi, rel=0.02)
    assert finding.message.count == 6
    assert abs(wrapped.q[finding.message.row + 1, 0] - wrapped.q[finding.message.row, 0]) > 6
    shifted = put("q", slice(700, None), 0.4, add=True)
    (jump,) = (x for x in check_log_fully(shifted, {"pivot": "revolute"}) if isinstance(x.message, OURS))
    assert isinstance(jump.message, log_notes.PositionJump)
    assert (jump.message.count, jump.message.row) == (1, 699)
    assert jump.message.size == pytest.approx(0.4, abs=0.05)


def test_interpolated_positions_are_said() -> None:
    coarse = np.interp(T, T[::5], ONE.q[::5, 0])
    notes = [x.message for x in check_log_fully(replace(ONE, q=coarse[:, None]), {"pivot": "revolute"})]
    (note,) = (x for x in notes if isinstance(x, log_notes.InterpolatedPositions))
    assert note.share == pytest.approx(0.8, abs=0.02)


@pytest.mark.parametrize(
    ("turn", "at_end"),
    [(0.0, False), (0.5, False), (3.5, False), (5.5, False), (0.5, True), (5.5, True)],
)
def test_a_reversal_in_the_first_or_last_samples_is_no_spike(turn: float, at_end: bool) -> None:
    model, time = PENDULUM.with_terms(Coulomb(PENDULUM.joints)), T - turn * 0.005
    q, dq, ddq = (x[:, None] for x in (np.cos(2.3 * time), -2.3 * np.sin(2.3 * time), -(2.3**2) * np.cos(2.3 * time)))
    rng, theta = np.random.default_rng(0), [*(x.value for x in PENDULUM.parameters), 0.5]
    tau = model.torque(q, dq, ddq, theta) + 0.01 * rng.standard_normal(q.shape)
    order = slice(None, None, -1 if at_end else 1)
    recording = Log(T, (q + 1e-5 * rng.standard_normal(q.shape))[order], tau[order], ("pivot",), "a")

    def spikes(one: Log) -> list:
        notes = [x.message for x in found(one, model=model, smoother=Spline(sigma=1e-5))]
        return [note for note in notes if isinstance(note, log_notes.TorqueSpikes)]

    assert spikes(recording) == []
    if turn < 4:  # a spike before a step is seen as neither
        wrong = recording.tau.copy()
        wrong[-1 if at_end else 0] += 5.0  # more than any friction
        (note,) = spikes(replace(recording, tau=wrong))
        assert note.largest == pytest.approx(5.0, abs=1.2)
