"""Controllers: their formulas, limits and integral, and that what they say of themselves is so."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from dynident.models.simulation import PID, Broken, simulate_recording
from dynident.motion.log import HasState
from dynident.runtime import InputError, ModelError
from tests.models.simulation.loops import ARM, LINKED, RUST, RUSTY, driven, loop, reference

T = np.arange(401) * 2e-3
MOTION = driven(ARM, T)
KINDS = ("pd", "tracking", "pid", "cascade", "function")


def test_a_pd_controller_is_its_formula() -> None:
    k, wanted = 7, reference(MOTION)
    q, dq = np.array([0.2, -0.1]), np.array([0.3, 0.5])
    speed = np.gradient(wanted, T, axis=0)
    asked = 10 * (wanted[k] - q) + 0.2 * (speed[k] - dq) + 0.1 * wanted[k]
    np.testing.assert_allclose(loop("tracking", MOTION)(T[k] + 1e-3, q, dq), 2 * asked)
    np.testing.assert_allclose(loop("tracking", MOTION, 0.5)(T[k], q, dq), 2 * np.clip(asked, -0.5, 0.5))
    np.testing.assert_allclose(loop("pd", MOTION)(T[k], q, dq), 2 * (asked - 0.2 * speed[k]))


def test_the_integral_gathers_the_error_and_stands_at_the_limit() -> None:
    drive, h = loop("pid", MOTION, 3.0), 2e-3
    assert isinstance(drive, HasState)
    wanted, none = reference(MOTION)[5], np.zeros(2)
    tau, state = drive.advance(T[5], h, wanted - 0.1, none, np.array([0.01, 0.02]))
    np.testing.assert_allclose(state, np.array([0.01, 0.02]) + h * 0.1)
    np.testing.assert_allclose(tau, 2 * (10 * 0.1 + 40 * state + 0.1 * wanted))
    far = np.array([0.5, -0.5])
    tau, stood = drive.advance(T[5], h, wanted - far, none, state)
    np.testing.assert_allclose(tau, [6.0, -6.0])
    np.testing.assert_allclose(stood, state)
    _, back = drive.advance(T[5], h, wanted + 0.1, none, np.array([0.5, 0.5]))  # beyond the limit, but on its way back
    np.testing.assert_allclose(back, 0.5 - h * 0.1)


def test_the_integral_begins_with_the_measured_torque() -> None:
    """Whatever it has gathered before."""
    drive, q, dq, h = loop("pid", MOTION), np.array([0.2, -0.1]), np.array([0.3, 0.5]), 2e-3
    tau, _ = drive.advance(T[9], h, q, dq, drive.begin(T[9], h, q, dq, np.array([1.5, -0.7])))
    np.testing.assert_allclose(tau, [1.5, -0.7])
    without = replace(drive, ki=np.array([0.0, 40.0]))
    assert without.begin(T[9], h, q, dq, np.ones(2))[0] == 0.0


def test_a_loop_gives_back_what_it_made_from_any_sample_on() -> None:
    drive = loop("pid", MOTION)
    made = simulate_recording(ARM, LINKED, MOTION, drive).motion
    again = simulate_recording(ARM, LINKED, made, drive, rows=slice(100, 401))
    np.testing.assert_allclose(again.q, made.q[100:], atol=2e-4)  # it does not know the last position
    np.testing.assert_allclose(again.tau[0], made.tau[100], atol=1e-2)


@pytest.mark.parametrize("kind", KINDS)
def test_derivatives_are_those_of_the_law(kind: str) -> None:
    from dynident.models.simulation import ControllerInput

    drive = loop(kind, MOTION, 1.5)
    rng = np.random.default_rng(0)
    rows = np.arange(0, 400, 8)
    m = 2 if isinstance(drive, HasState) else 0
    seen = ControllerInput(
        T[rows], np.full(50, 2e-3), *rng.uniform(-0.4, 0.4, (2, 50, 2)), rng.uniform(-0.05, 0.05, (50, m))
    )

    class Plain:
        """The same without its derivatives."""

        joints = drive.joints

        def __call__(self, t: float, q: np.ndarray, dq: np.ndarray) -> np.ndarray:
            return drive(t, q, dq)

    class Remembering(Plain):
        begin, advance = getattr(drive, "begin", None), getattr(drive, "advance", None)

    given, about = seen.slopes_of(drive), seen.slopes_of(Remembering() if m else Plain())
    for name in ("tau", "state"):
        for case, two in zip(getattr(given, name), getattr(about, name), strict=True):
            np.testing.assert_allclose(case, two, atol=1e-6)


@pytest.mark.parametrize(("kind", "limit"), [*((kind, 0.4) for kind in KINDS), ("pid", np.inf)])
def test_one_joint_in_plain_numbers_is_driven_as_in_arrays(kind: str, limit: float) -> None:
    from dynident.models.simulation.steps import integrate, integrate_arrays
    from dynident.models.simulation.trace import Machine

    motion = driven(RUSTY, np.arange(301) * 0.0023)
    drive, rows = loop(kind, motion, limit), np.arange(301)[None]
    ways = [way(Machine(RUSTY, RUST), motion, rows, drive) for way in (integrate, integrate_arrays)]
    for name in ("q", "dq", "tau", "states"):
        np.testing.assert_allclose(getattr(ways[0], name), getattr(ways[1], name), atol=1e-10)


@pytest.mark.parametrize("kind", KINDS)
def test_a_controller_survives_pickling_and_other_times(kind: str) -> None:
    drive = loop(kind, MOTION, 2.0)
    q, dq = np.array([0.1, 0.2]), np.array([-0.3, 0.4])
    again = pickle.loads(pickle.dumps(drive))
    np.testing.assert_array_equal(again(0.5, q, dq), drive(0.5, q, dq))
    np.testing.assert_array_equal(drive.timed(T + 3.0)(3.5, q, dq)[:1], drive(0.5, q, dq)[:1])
    assert len(repr(drive)) < 400


def test_shapes_that_do_not_fit_are_named() -> None:
    pd = loop("pd", MOTION)
    with pytest.raises(InputError, match=r"controller: kd has shape \(3,\), expected \(2,\)"):
        replace(pd, kd=np.ones(3))
    with pytest.raises(InputError, match=r"velocity_reference has shape \(2,\), expected \(401, 2\)"):
        replace(pd, velocity_reference=np.ones(2))
    with pytest.raises(InputError, match=r"ki has shape \(\), expected \(2,\)"):
        PID(pd, 3.0)


def test_a_function_that_fails_or_returns_nonsense_ends_the_simulation_with_its_reason() -> None:
    drive = loop("function", MOTION)
    with pytest.raises(ModelError, match=r"controller: bad failed at t = 0.1 s: ZeroDivisionError"):
        replace(drive, law=bad)(0.1, np.zeros(2), np.zeros(2))
    with pytest.raises(ModelError, match=r"controller: ends failed at t = 0.1 s: SystemExit"):
        replace(drive, law=ends)(0.1, np.zeros(2), np.zeros(2))
    run = simulate_recording(ARM, LINKED, MOTION, replace(drive, law=short))
    assert isinstance(run.failure, Broken)
    assert "short returned 1.0 at t = 0 s; return 2 finite numbers" in run.failure.reason


def bad(t: float, q: np.ndarray, dq: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return wanted * (1 / int(0 * t))


def ends(t: float, q: np.ndarray, dq: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    raise SystemExit(wanted)


def short(t: float, q: np.ndarray, dq: np.ndarray, wanted: np.ndarray) -> float:
    return 1.0
