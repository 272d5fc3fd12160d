"""The controller of a log against the torque that was measured."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import loop_findings
from dynident.checks.motion_notes import LoopDiffers, LoopGain, LoopVelocity
from dynident.models.simulation import PD, PID, CascadePD, DifferencingLoop, Function
from dynident.motion.log import Controller, Log
from dynident.runtime import Finding, ModelError, Severity

STEP, JOINTS = 1e-3, ("shoulder", "elbow")


def motion(t: np.ndarray) -> np.ndarray:
    return np.column_stack([0.4 * np.sin(2 * t), 0.3 * np.sin(3 * t + 1)])


def cascade(t: np.ndarray) -> CascadePD:
    """Loops whose reference leads the motion."""
    still = np.zeros((len(t), 2))
    return CascadePD(JOINTS, t, motion(t + 0.02), np.full(2, 40.0), np.full(2, 5.0), np.full(2, 2.0), np.full(2, 1e3),
                     still)  # fmt: skip


def record(controller: Controller, knows: Controller | None = None, noise: float = 1e-6, every: int = 1) -> Log:
    """The torque that a controller asks for along the motion, in a log that knows this or another controller."""
    t = np.arange(4001) * STEP
    q = motion(t)
    rate = np.gradient(motion(t - STEP / 2), STEP, axis=0)  # as a difference over one step
    found, state = np.empty_like(q), np.zeros(0)
    if hasattr(controller, "begin"):
        state = controller.begin(t[0], STEP, q[0], rate[0], np.zeros(2))
    for k in range(len(t)):
        if len(state):
            found[k], state = controller.advance(t[k], STEP, q[k], rate[k], state)
        else:
            found[k] = controller(t[k], q[k], rate[k])
    rng = np.random.default_rng(0)
    rows = slice(None, None, every)
    noisy = q + noise * rng.standard_normal(q.shape), found + 0.01 * rng.standard_normal(q.shape)
    return Log(t[rows], *(one[rows] for one in noisy), JOINTS, "monday", controller=knows or controller)


T = np.arange(4001) * STEP


def notes(log: Log) -> list[tuple[str | None, object]]:
    found = list(loop_findings([log]))
    assert all(one.severity is Severity.WARNING and one.topic == "loop" and one.source == "monday" for one in found)
    return [(one.joint, one.message) for one in found]


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("kind", ["cascade", "pd", "pid"])
def test_the_controller_that_ran_is_not_doubted(kind: str, every: int) -> None:
    c = cascade(T)
    pd = PD(JOINTS, T, c.reference, np.full(2, 200.0), np.full(2, 5.0), c.gain, c.saturation, c.feedforward)
    one: Controller = {"cascade": c, "pd": pd, "pid": PID(pd, np.full(2, 50.0))}[kind]
    assert notes(record(one, every=every)) == []


def test_coarse_encoders_do_not_make_it_doubtful() -> None:
    assert notes(record(cascade(T), noise=2e-3)) == []


def test_a_velocity_over_other_steps_is_found() -> None:
    """The log has the torque of a difference over three steps, the configuration says one."""
    c = cascade(T)
    seen = replace(c, reference=c.reference)
    t, q = T, motion(T)
    slow = np.gradient(motion(t - 1.5 * STEP), STEP, axis=0)
    tau = np.array([c(t[k], q[k], slow[k]) for k in range(len(t))])
    log = Log(t, q, tau, JOINTS, "monday", controller=seen)
    ((joint, note),) = notes(log)
    assert joint is None
    assert isinstance(note, LoopVelocity)
    assert (note.given, note.steps) == (1, 3)
    assert note.left < 0.1 * note.error
    assert notes(replace(log, controller=DifferencingLoop(c, 3))) == []


def test_a_drive_that_is_faster_than_its_log_is_found() -> None:
    """Its velocity is over 1 ms, the configuration knows the references of each fourth."""
    log = record(c := cascade(T), every=4)
    held = replace(c, t=T[::4], reference=c.reference[::4], feedforward=c.feedforward[::4])
    ((joint, note),) = notes(replace(log, controller=held))
    assert joint is None
    assert isinstance(note, LoopVelocity)
    assert (note.given, note.steps) == (1, 0)


def test_a_factor_on_one_joint_is_found() -> None:
    c = cascade(T)
    ((joint, note),) = notes(record(c, replace(c, gain=np.array([2.0, 2.5]))))
    assert joint == "elbow"
    assert isinstance(note, LoopGain)
    assert note.factor == pytest.approx(0.8, abs=0.005)
    assert note.error == pytest.approx(0.25, abs=0.01)


def test_another_reference_is_found() -> None:
    c = cascade(T)
    wrong = c.reference.copy()
    wrong[:, 0] += 0.1 * np.sin(7 * T)
    ((joint, note),) = notes(record(c, replace(c, reference=wrong)))
    assert joint == "shoulder"
    assert isinstance(note, LoopDiffers)
    assert note.error > 0.5


def test_nothing_is_said_without_a_controller_or_of_a_joint_that_is_silent() -> None:
    c = cascade(T)
    log = record(c)
    assert notes(replace(log, controller=None)) == []
    tau = log.tau.copy()
    tau[:, 0] = 0.0
    assert notes(replace(log, tau=tau)) == []
    assert notes(replace(log, tau=np.zeros_like(tau))) == []


@pytest.mark.parametrize("kind", ["cascade", "pid"])
def test_of_few_samples_or_gains_beyond_numbers_nothing_is_said(kind: str) -> None:
    c = cascade(T)
    pd = PD(JOINTS, T, c.reference, np.full(2, 200.0), np.full(2, 5.0), c.gain, c.saturation, c.feedforward)
    one: Controller = c if kind == "cascade" else PID(pd, np.full(2, 50.0))
    log = record(one)
    excluded = np.ones(len(log.t), dtype=bool)
    for kept in (0, 1, 5):
        excluded[100 : 100 + kept] = False
        assert notes(replace(log, excluded=excluded.copy())) == []
    huge = np.full(2, 1e300)
    beyond = replace(c, kp=huge, kv=huge, gain=huge, saturation=np.full(2, np.inf))
    assert notes(replace(log, controller=beyond)) == []


def test_a_function_that_fails_is_left_to_the_simulation() -> None:
    def law(t: float, q: np.ndarray, dq: np.ndarray, reference: np.ndarray) -> np.ndarray:
        raise ValueError(t)

    c = cascade(T)
    failing = Function(JOINTS, T, c.reference, law, c.gain, c.saturation, c.feedforward)
    with pytest.raises(ModelError):
        failing(0.0, np.zeros(2), np.zeros(2))
    assert notes(record(c, failing)) == []
    assert list[Finding](loop_findings([])) == []
