"""The steps of a free simulation: in plain numbers for one joint as in arrays, whatever changes on the way."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dynident.models import Joint, Model, Parameter, Partials, Term
from dynident.models.friction import Coulomb, Dahl, LoadCoulomb, Offset, Viscous
from dynident.models.lagrangian import pendulum, slider
from dynident.models.simulation import CascadePD, simulate
from dynident.models.simulation.steps import integrate, integrate_arrays
from dynident.models.simulation.trace import MAX_POSITION, Machine, Trace
from dynident.motion.log import Controller, Motion
from dynident.runtime import ModelError

JOINTS = pendulum().joints
RUSTY = Model((*pendulum().terms, Viscous(JOINTS), Coulomb(JOINTS), Coulomb(JOINTS, names=("more",)), Offset(JOINTS)))
RUST = (0.0825, 0.25, 0.05, 1.0, 2.0, 0.05)


@dataclass(frozen=True)
class EndStop(Term):
    """A stop at ``at`` (m), beyond which a spring acts, and far beyond which there is no value."""

    at: float
    joints: tuple[Joint, ...]
    asked: list[int]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("stop", "N/m"),)

    def regressor(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        if (q > self.at + 0.2).any():
            raise ValueError("behind the wall")
        self.asked.append(len(q))
        return np.maximum(q - self.at, 0.0)[:, :, None]

    def partials(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, theta: np.ndarray) -> Partials:
        raise NotImplementedError


def motion(model: Model, t: np.ndarray, tau: np.ndarray, dq: float = 0.0) -> Motion:
    zero = np.zeros((len(t), 1))
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, zero + 0.1, zero + dq, zero, tau[:, None], names, np.ones(len(t), dtype=bool), "run")


def both(model: Model, theta: tuple[float, ...], run: Motion, controller: Controller | None) -> list[np.ndarray]:
    """Return q and tau in plain numbers, then in arrays."""
    rows, machine = np.arange(len(run.t))[None], Machine(model, theta)
    return [
        *sampled(integrate(machine, run, rows, controller)),
        *sampled(integrate_arrays(machine, run, rows, controller)),
    ]


def sampled(trace: Trace) -> tuple[np.ndarray, np.ndarray]:
    """Return q and tau (B, K, n) at the samples."""
    return trace.q[trace.samples].swapaxes(0, 1), trace.tau.swapaxes(0, 1)


RAIL = (5.0, 8.0, 3.0, 0.5)


@pytest.mark.parametrize(
    ("model", "theta", "step", "loop"),
    [(RUSTY, RUST, 0.002, True), (RUSTY, RUST, 0.0035, False), (slider(), RAIL, 0.002, True)],
)
def test_one_joint_moves_in_plain_numbers_as_in_arrays(
    model: Model, theta: tuple[float, ...], step: float, loop: bool
) -> None:
    """With stamps that jitter; the reference rests for a while, and so does the joint."""
    rng = np.random.default_rng(1)
    count = round((3.0 if loop else 1.6) / step)  # a joint in a loop rests later
    t = step * (np.arange(count) + rng.uniform(-0.3, 0.3, count))
    run = motion(model, t, 4.0 * np.sin(3 * t), dq=0.4)
    held = np.where(t % 2 < 1, 0.3, np.sin(4 * t))[:, None]
    ones = np.ones(1)
    drive = CascadePD(run.joints, t, held, 20 * ones, 3 * ones, 2 * ones, 4 * ones, 0.1 * held)
    q, tau, q_arrays, tau_arrays = both(model, theta, run, drive if loop else None)
    assert 0.01 < (np.diff(q[0, :, 0]) == 0).mean() < 0.95
    np.testing.assert_allclose(q, q_arrays, rtol=0, atol=1e-11)
    np.testing.assert_allclose(tau, tau_arrays, rtol=0, atol=1e-9)


def test_what_was_tried_with_an_old_bias_does_not_stay() -> None:
    """A mass slides freely, so that more and more steps are taken at once, then meets a stop which they pass."""
    rail, asked = slider().joints, list[int]()
    model = Model((*slider().terms, EndStop(2.0, rail, asked)))
    run = motion(model, np.arange(4001) * 0.001, np.zeros(4001), dq=1.0)
    q, _, q_arrays, _ = both(model, (5.0, 0.0, 0.0, 0.0, 2000.0), run, None)
    assert q.max() == pytest.approx(2.0 + np.sqrt(5 / 2000), abs=1e-4)
    np.testing.assert_allclose(q, q_arrays, rtol=0, atol=1e-12)
    assert max(asked) > 500  # two rows a step


def test_a_model_that_fails_on_the_way_says_so_and_one_that_runs_away_stops() -> None:
    rail = slider().joints
    model = Model((*slider().terms, EndStop(2.0, rail, [])))
    run = motion(model, np.arange(4001) * 0.001, np.zeros(4001), dq=1.0)
    with pytest.raises(ModelError, match="behind the wall"):
        integrate(Machine(model, (5.0, 0.0, 0.0, 0.0, 1e-9)), run, np.arange(4001)[None], None)
    q, _, q_arrays, _ = both(slider(), (1.0, -300.0, 0.0, 0.0), run, None)
    assert q[np.isfinite(q)].max() > MAX_POSITION
    np.testing.assert_array_equal(np.isfinite(q), np.isfinite(q_arrays))
    assert not np.isfinite(q[0, -1, 0])


@pytest.mark.parametrize(("share", "holds"), [(0.8, False), (1.2, True)])
def test_friction_by_the_load_holds_a_joint_up_to_its_level(share, holds):
    """A pendulum at rest, held by a share of its own weight."""
    theta = np.array([0.0825, 0.25, share])
    model = pendulum().with_terms(LoadCoulomb(JOINTS)).with_load(theta)
    machine = Machine(model, theta)
    assert machine.F.tolist() == [share]
    t = np.arange(101) * 0.005
    still = np.zeros((101, 1))
    motion = Motion(t, still + 0.7, still, still, still, ("pivot",), np.ones(101, bool))
    path, _ = sampled(integrate(machine, model.remembering(motion), np.arange(101)[None], None))
    assert (np.ptp(path) < 1e-9) == holds


def test_steps_remember_the_way():
    """A pendulum with Dahl's friction, as the integrator has it; its start is in the middle of the motion."""
    theta = np.array([0.0825, 0.25, 0.3])
    model, t = pendulum().with_terms(Dahl(JOINTS, length=0.05)), np.arange(151) * 0.002
    motion = simulate(model, theta, lambda s: [np.sin(15 * s)], t, [0.3])
    rows = np.arange(60, 151)[None]
    path, _ = sampled(integrate(Machine(model, theta), motion, rows, None))
    np.testing.assert_allclose(path[0], motion.q[rows[0]], atol=2e-4)
    fresh, _ = sampled(integrate(Machine(model, theta), replace(motion, memory=0 * motion.memory), rows, None))
    assert np.abs(fresh[0] - motion.q[rows[0]]).max() > 2e-3, "without the memory of its start it is another"
