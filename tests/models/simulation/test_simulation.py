"""Simulated motion against closed forms, and its recording with noise."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

from dynident.models import Model
from dynident.models.friction import Coulomb, Dahl, Drift, LoadCoulomb
from dynident.models.lagrangian import pendulum, slider, two_link_arm
from dynident.models.simulation import record, simulate, simulate_many
from dynident.runtime import ConfigError, InputError, ModelError

T = np.linspace(0.0, 0.4, 41)
SLIDER = (5.0, 8.0, 3.0, 0.5)  # M, Fv, Fc, offset


def rest(t):
    return [0.0]


def push(t):
    return [1.1 * np.sin(3 * t), 0.7 * np.cos(2 * t)]


def test_pendulum_swings_as_the_elliptic_functions_do():
    """From rest at q0: sin(q / 2) = k cd(w t, k^2) with k = sin(q0 / 2), here through 120 degrees for 10 s."""
    pivot, q0, t = pendulum(), 2 * np.pi / 3, np.linspace(0.0, 10.0, 201)
    J, h = pivot.values
    k2 = np.sin(q0 / 2) ** 2
    sn, _, _, _ = ellipj(np.sqrt(9.81 * h / J) * t + ellipk(k2), k2)
    motion = simulate(pivot, pivot.values, rest, t, q0=[q0])
    np.testing.assert_allclose(motion.q[:, 0], 2 * np.arcsin(np.sqrt(k2) * sn), rtol=0, atol=1e-9)


@pytest.mark.parametrize("own", [{"q0", "torque"}, {"theta", "q0", "dq0", "torque"}], ids=sorted)
def test_runs_together_equal_runs_alone(own):
    arm, rng, t = two_link_arm(), np.random.default_rng(4), T[:9]
    theta = arm.values * rng.uniform(0.9, 1.1, (3, 7))
    q0, dq0, gain = rng.normal(size=(3, 2)), rng.normal(size=(3, 2)), rng.normal(size=(3, 1))
    together = simulate_many(
        arm,
        theta if "theta" in own else arm.values,
        (lambda s: gain * push(s)) if "torque" in own else push,
        t,
        q0 if "q0" in own else q0[0],
        dq0 if "dq0" in own else None,
    )
    assert len(together) == 3
    for k, motion in enumerate(together):
        alone = simulate(
            arm,
            theta[k] if "theta" in own else arm.values,
            (lambda s, k=k: gain[k] * push(s)) if "torque" in own else push,
            t,
            q0[k] if "q0" in own else q0[0],
            dq0[k] if "dq0" in own else None,
        )
        for name, close in (("q", 1e-9), ("dq", 1e-9), ("ddq", 1e-6), ("tau", 0)):
            np.testing.assert_allclose(getattr(motion, name), getattr(alone, name), rtol=0, atol=close)


def test_hard_coulomb_sign_is_stopped():
    """A body held by friction makes the integrator chatter: it must end, and say why."""
    rail = slider(1e-3, SLIDER)
    terms = (*rail.terms[:2], Coulomb(rail.joints, names=("Fc",)))
    with pytest.raises(ModelError, match=r"600 evaluations of stuck reached only t = 0\..*'width' of Coulomb"):
        simulate(Model(terms, name="stuck"), [5.0, 8.0, 3.0], lambda t: [1.0], T, dq0=[0.1], max_evaluations=600)


def test_failed_integration_names_the_time_reached():
    """The torque has a pole at 0.2 s."""
    rail = slider(1e-3, SLIDER)
    with pytest.raises(ModelError, match=r"slider (stopped after|reached only) t = 0\.\d+ s"):
        simulate(rail, rail.values, lambda t: [1 / (0.2 - t) ** 3], T, max_evaluations=900)


@pytest.mark.parametrize(("mass", "words"), [(-0.002, "slider"), (0.0, "mass matrix is singular")])
def test_impossible_masses_are_reported(mass, words):
    """A negative mass runs away exponentially, until its numbers overflow."""
    with pytest.raises(ModelError, match=words):
        simulate(slider(1e-3), [mass, 8.0, 3.0, 0.5], lambda t: [1.0], T, max_evaluations=900)


@pytest.mark.parametrize(
    ("changes", "error", "message"),
    [
        ({"t": [0.0]}, InputError, r"strictly increasing times \(s\), got \[0.\]"),
        ({"t": [0.0, 1.0, 1.0]}, InputError, "strictly increasing"),
        ({"t": [0.0, np.nan]}, InputError, "finite, strictly increasing"),
        ({"q0": [0.0]}, InputError, r"q0 has shape \(1,\), expected \(2,\) or \(runs, 2\)"),
        ({"dq0": [0.0, np.inf]}, InputError, "dq0 holds a value that is not finite"),
        ({"theta": np.ones(3)}, InputError, r"theta has shape \(3,\), expected \(7,\)"),
        (
            {"theta": np.ones((2, 7))},
            InputError,
            r"theta has shape \(2, 7\); for several runs at once use simulate_many",
        ),
        ({"torque": lambda t: np.ones((2, 2))}, InputError, "use simulate_many"),
        ({"torque": rest}, InputError, r"torque has shape \(1,\)"),
        ({"torque": lambda t: [0.0, 0.0] if t < 0.2 else [0.0]}, InputError, r"torque at t = 0\.\d+ s is \[0.0\]"),
        ({"torque": lambda t: [0.0, 0.0 if t < 0.2 else np.nan]}, InputError, r"is \[0.0, nan\]; it must be finite"),
        ({"tolerance": 0.0}, ConfigError, "tolerance is 0.0; give a number from 1e-13"),
    ],
)
def test_wrong_arguments(changes, error, message):
    arguments = {"theta": two_link_arm().values, "torque": push, "t": T} | changes
    with pytest.raises(error, match=message):
        simulate(two_link_arm(), **arguments)


def test_numbers_of_runs_must_agree():
    arm = two_link_arm()
    with pytest.raises(InputError, match=r"numbers of runs differ: {'theta': 3, 'q0': 2}"):
        simulate_many(arm, np.tile(arm.values, (3, 1)), push, T, q0=np.zeros((2, 2)))


@pytest.fixture(scope="module")
def truth():
    arm = two_link_arm()
    return simulate(arm, arm.values, push, np.linspace(0.0, 0.2, 2001), source="truth")


def test_record_adds_independent_normal_noise(truth):
    """Eqs. (44)-(46): 2001 samples give each standard deviation to 1.6 % (one sigma)."""
    recording = record(truth, [1e-3, 2e-3], 0.1, np.random.default_rng(5))
    noise = np.hstack([recording.log.q - truth.q, recording.log.tau - truth.tau])
    np.testing.assert_allclose(noise.std(axis=0), [1e-3, 2e-3, 0.1, 0.1], rtol=0.08)
    assert (np.abs(noise.mean(axis=0)) < 5 * noise.std(axis=0) / np.sqrt(2001)).all()
    assert np.abs(np.corrcoef(noise.T) - np.eye(4)).max() < 5 / np.sqrt(2001)
    assert np.abs(np.mean(noise[1:] * noise[:-1], axis=0) / noise.var(axis=0)).max() < 5 / np.sqrt(2001)
    assert recording.truth is truth


def test_record_without_noise_is_the_truth(truth):
    log = record(truth, 0.0, 0.0, np.random.default_rng(0)).log
    for name in ("t", "q", "tau"):
        np.testing.assert_array_equal(getattr(log, name), getattr(truth, name))
    assert (log.joints, log.source, log.dq) == (truth.joints, "truth", None)


@pytest.mark.parametrize(
    ("sigmas", "message"),
    [
        ((-1e-3, 0.1), "sigma_q is -0.001; a standard deviation is 0 or more"),
        ((1e-3, [0.1, -0.1]), r"sigma_tau is \[0.1, -0.1\]"),
        ((np.nan, 0.1), "sigma_q is nan"),
        (([1e-3] * 3, 0.1), r"sigma_q has shape \(3,\); give one number, or one per joint"),
    ],
)
def test_wrong_noise(truth, sigmas, message):
    with pytest.raises(ConfigError, match=message):
        record(truth, *sigmas, np.random.default_rng(0))


def test_what_terms_remember_is_integrated():
    """Dahl's friction is a further state of the plain equations of motion, friction by the load is implicit."""
    joints = pendulum().joints
    length, theta = 0.05, np.array([0.0825, 0.25, 0.3, 0.1, 0.05])
    terms = Dahl(joints, length=length), LoadCoulomb(joints, width=0.2), Drift(joints, time=0.5)
    model, t = pendulum().with_terms(*terms).with_load(theta), np.linspace(0.0, 0.1, 51)
    motion = simulate(model, theta, lambda s: [np.sin(15 * s)], t, [0.3], tolerance=1e-9)
    np.testing.assert_allclose(model.torque(**motion.states(), theta=theta), motion.tau, atol=1e-9)
    np.testing.assert_allclose(model.remembering(motion).memory, motion.memory, atol=2e-5)

    def slope(s, x):
        q, dq, z = x
        weight, rest = 0.25 * 9.81 * np.sin(q), 0.3 * z + 0.05 * (1 - np.exp(-s / 0.5)) - np.sin(15 * s)
        ddq = 0.0
        for _ in range(13):  # each takes a tenth of the error
            ddq = -(weight + 0.1 * np.abs(0.0825 * ddq + weight) * np.tanh(dq / 0.2) + rest) / 0.0825
        return [dq, ddq, (dq - np.abs(dq) * z) / length]

    exact = solve_ivp(slope, (0.0, 0.1), [0.3, 0.0, 0.0], t_eval=t, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(motion.q[:, 0], exact.y[0], atol=1e-6)
