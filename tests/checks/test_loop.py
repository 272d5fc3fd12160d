"""The controller of a log against the torque that was measured."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import loop_findings
from dynident.checks.motion_notes import LoopDiffers, LoopGain, LoopVelocity
from dynident.models.simulation import PD, PID, CascadePD, DifferencingLoop, Function
from dynident.motion.log import Controller, Log
from dynident.runtime import ModelError, Severity

STEP, JOINTS = 1e-3, ("shoulder", "elbow")
T = np.arange(601) * STEP


def motion(t: np.ndarray) -> np.ndarray:
    return np.column_stack([0.4 * np.sin(12 * t), 0.3 * np.sin(18 * t + 1)])


def velocity(steps: float) -> np.ndarray:
    """What a drive takes for the velocity: a difference over so many steps."""
    return np.gradient(motion(T - steps * STEP / 2), STEP, axis=0)


# loops whose reference leads the motion
CASCADE = CascadePD(
    JOINTS, T, motion(T + 0.02), np.full(2, 40.0), np.full(2, 5.0), np.full(2, 2.0), np.full(2, 1e3), np.zeros((601, 2))
)
PLAIN = PD(
    JOINTS, T, CASCADE.reference, np.full(2, 200.0), np.full(2, 5.0), CASCADE.gain, CASCADE.saturation,
    CASCADE.feedforward,
)  # fmt: skip
INTEGRATING = PID(PLAIN, np.full(2, 50.0))


def commands(controller: Controller, dq: np.ndarray) -> np.ndarray:
    q = motion(T)
    if not hasattr(controller, "begin"):
        return np.array([controller(t, *states) for t, *states in zip(T, q, dq, strict=True)])
    state, torques = controller.begin(T[0], STEP, q[0], dq[0], np.zeros(2)), []
    for t, *states in zip(T, q, dq, strict=True):
        torque, state = controller.advance(t, STEP, *states, state)
        torques.append(torque)
    return np.array(torques)


def record(controller: Controller = CASCADE, noise: float = 1e-6, every: int = 1, steps: int = 1) -> Log:
    """The torque that a controller asks for along the motion."""
    rng, q, rows = np.random.default_rng(0), motion(T), slice(None, None, every)
    tau = commands(controller, velocity(steps)) + 0.01 * rng.standard_normal(q.shape)
    q = q + noise * rng.standard_normal(q.shape)
    return Log(T[rows], q[rows], tau[rows], JOINTS, "monday", controller=controller)


RECORDED = record()


def notes(log: Log, **knows: object) -> list[tuple[str | None, object]]:
    """What is said of a log that knows, perhaps, another controller."""
    result = list(loop_findings([replace(log, **knows)]))
    assert all(x.severity is Severity.WARNING and x.topic == "loop" and x.source == "monday" for x in result)
    return [(x.joint, x.message) for x in result]


@pytest.mark.parametrize(
    ("controller", "every", "noise"),
    [(CASCADE, 4, 1e-6), (CASCADE, 1, 2e-3), (PLAIN, 1, 1e-6), (INTEGRATING, 1, 1e-6), (INTEGRATING, 4, 1e-6)],
    ids=["cascade", "coarse", "pd", "pid", "slow pid"],
)
def test_the_controller_that_ran_is_not_doubted_at_any_rate_and_by_coarse_encoders(
    controller: Controller, every: int, noise: float
) -> None:
    assert notes(record(controller, noise, every)) == []


def test_a_velocity_over_other_steps_is_found() -> None:
    """The log has the torque of a difference over three steps, the configuration says one."""
    log = record(steps=3)
    ((joint, note),) = notes(log)
    assert joint is None
    assert isinstance(note, LoopVelocity)
    assert (note.given, note.steps) == (1, 3)
    assert note.corrected_error < 0.1 * note.error
    assert notes(log, controller=DifferencingLoop(CASCADE, 3)) == []


def test_a_drive_that_is_faster_than_its_log_is_found() -> None:
    """Its velocity is over 1 ms, the configuration knows the references of each fourth."""
    slow = replace(CASCADE, t=T[::4], reference=CASCADE.reference[::4], feedforward=CASCADE.feedforward[::4])
    ((joint, note),) = notes(record(every=4), controller=slow)
    assert joint is None
    assert isinstance(note, LoopVelocity)
    assert (note.given, note.steps) == (1, 0)


def test_a_factor_on_one_joint_is_found() -> None:
    ((joint, note),) = notes(RECORDED, controller=replace(CASCADE, gain=np.array([2.0, 2.5])))
    assert joint == "elbow"
    assert isinstance(note, LoopGain)
    assert note.factor == pytest.approx(0.8, abs=0.005)
    assert note.error == pytest.approx(0.25, abs=0.01)


def test_another_reference_is_found() -> None:
    wrong = CASCADE.reference + np.outer(0.1 * np.sin(21 * T), [1.0, 0.0])
    ((joint, note),) = notes(RECORDED, controller=replace(CASCADE, reference=wrong))
    assert joint == "shoulder"
    assert isinstance(note, LoopDiffers)
    assert note.error > 0.5


@pytest.mark.parametrize("silent", [(0.0, 1.0), (0.0, 0.0)])
def test_of_a_joint_that_is_silent_nothing_is_said(silent: tuple[float, float]) -> None:
    assert notes(RECORDED, tau=RECORDED.tau * silent) == []


def fail(t: float, q: np.ndarray, dq: np.ndarray, reference: np.ndarray) -> np.ndarray:
    raise ValueError(t)


def test_without_a_controller_that_gives_numbers_nothing_is_said() -> None:
    huge = np.full(2, 1e300)
    beyond = replace(CASCADE, kp=huge, kv=huge, gain=huge, saturation=np.full(2, np.inf))
    failing = Function(JOINTS, T, CASCADE.reference, fail, CASCADE.gain, CASCADE.saturation, CASCADE.feedforward)
    with pytest.raises(ModelError):
        failing(0.0, np.zeros(2), np.zeros(2))
    assert [notes(RECORDED, controller=x) for x in (None, beyond, failing)] == [[]] * 3
    assert list(loop_findings([])) == []


@pytest.mark.parametrize("controller", [CASCADE, INTEGRATING], ids=["cascade", "pid"])
@pytest.mark.parametrize("kept", [0, 1, 5])
def test_of_few_samples_nothing_is_said(controller: Controller, kept: int) -> None:
    excluded = np.ones(len(T), dtype=bool)
    excluded[100 : 100 + kept] = False
    assert notes(RECORDED, controller=controller, excluded=excluded) == []
