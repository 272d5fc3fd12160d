"""Derivatives of a simulation: against its own differences, with all that switches on the way, and against LSODA."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.models import Model
from dynident.models.friction import Dahl
from dynident.models.lagrangian import pendulum, slider
from dynident.models.simulation import SimulatedRecording, sensitivities, simulate_recording
from dynident.motion.log import Controller, Motion
from dynident.runtime import InputError, ModelError
from tests.models.simulation.loops import ARM, HINGE, LINKED, RUST, RUSTY, driven, loop

FINE, COARSE = np.arange(701) * 1e-3, np.arange(300) * 0.0037


def check(
    model: Model, theta: np.ndarray, motion: Motion, controller: Controller | None, **how: float
) -> SimulatedRecording:
    """Compare derivatives by random directions of parameters and start with central differences."""
    run = simulate_recording(model, theta, motion, controller, **how)
    assert run.failure is None
    n, rng = len(motion.joints), np.random.default_rng(3)
    directions = rng.uniform(-1, 1, (len(theta), 2)) * np.abs(theta)[:, None]
    start = rng.uniform(-1, 1, 2 * n)
    result = sensitivities(model, theta, run, controller, directions)
    ways = [(by, 0 * start, lambda which, k=k: getattr(result, which)[..., k]) for k, by in enumerate(directions.T)]
    ways.append((0 * theta, start, lambda which: getattr(result.start, which) @ start))
    h = 1e-6
    for by, moved, exact in ways:
        ends = []
        for sign in (h, -h):
            other = replace(motion, q=motion.q + sign * moved[:n], dq=motion.dq + sign * moved[n:])
            ends.append(simulate_recording(model, theta + sign * by, other, controller, **how))
        for which in ("q", "dq", "tau"):
            about = (getattr(ends[0], which) - getattr(ends[1], which)) / (2 * h)
            np.testing.assert_allclose(exact(which), about, rtol=0, atol=1e-5 * max(np.abs(about).max(), 1e-6))
    return run


@pytest.mark.parametrize("how", [{}, {"restart": 0.2}])
@pytest.mark.parametrize(("model", "theta"), [(RUSTY, RUST), (ARM, LINKED)])
def test_from_the_torque_with_joints_that_stick(model: Model, theta: np.ndarray, how: dict[str, float]) -> None:
    run = check(model, theta, driven(model, FINE[:451]), None, **how)
    assert 0.01 < (np.abs(run.dq) < 1e-12).mean() < 0.6


@pytest.mark.parametrize(
    ("kind", "model", "theta", "limit"),
    [
        *((kind, RUSTY, RUST, 0.6) for kind in ("pd", "tracking", "pid", "cascade", "function")),
        *((kind, ARM, LINKED, 1.0) for kind in ("pid", "function")),
    ],
)
def test_in_a_loop_that_is_limited(kind: str, model: Model, theta: np.ndarray, limit: float) -> None:
    """Coarse samples have several steps each; the integral stands while the input is limited."""
    motion = driven(model, COARSE[:200] if model is RUSTY else COARSE[:90])
    run = check(model, theta, motion, loop(kind, motion, limit))
    assert 0.01 < (np.abs(run.tau) == 2 * limit).mean() < 0.9


def test_many_steps_are_made_in_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    from dynident.models.simulation import sensitivity

    motion = driven(ARM, COARSE[:60])
    controller = loop("pid", motion, 1.0)
    run = simulate_recording(ARM, LINKED, motion, controller)
    full = sensitivities(ARM, LINKED, run, controller)
    monkeypatch.setattr(sensitivity, "AT_ONCE", 7 * 12 * 40)
    parts = sensitivities(ARM, LINKED, run, controller)
    for which in ("q", "dq", "tau"):
        np.testing.assert_allclose(getattr(parts, which), getattr(full, which), rtol=1e-12, atol=1e-12)


def test_what_has_no_derivatives_says_so() -> None:
    model = pendulum().with_terms(Dahl(HINGE))
    motion = driven(model, FINE[:50])
    run = simulate_recording(model, (0.0825, 0.25, 0.1), motion)
    assert run.failure is None
    with pytest.raises(ModelError, match=r"terms that remember \(Dahl\); leave them out"):
        sensitivities(model, (0.0825, 0.25, 0.1), run)
    away = simulate_recording(slider(), (0.0, 0.0, 0.0, 0.0), driven(slider(), FINE))
    with pytest.raises(InputError, match="failed has no derivatives"):
        sensitivities(slider(), (0.0, 0.0, 0.0, 0.0), away)
    with pytest.raises(InputError, match=r"directions has shape \(3, 1\), expected \(5, k\)"):
        sensitivities(RUSTY, RUST, simulate_recording(RUSTY, RUST, driven(RUSTY, FINE[:9])), None, np.ones((3, 1)))
