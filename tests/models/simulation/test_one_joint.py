"""Steps in plain numbers: a model that changes smoothly is asked for many of them at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from dynident.models import Joint, Model, Parameter, Partials, Term
from dynident.models.lagrangian import slider
from dynident.models.simulation.steps import integrate, integrate_arrays
from dynident.models.simulation.trace import Machine
from tests.models.simulation.loops import driven


@dataclass(frozen=True)
class Valley(Term):
    """A torque that changes with the position everywhere."""

    joints: tuple[Joint, ...]
    asked: list[int]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("valley", "N"),)

    def regressor(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray) -> np.ndarray:
        self.asked.append(len(q))
        return np.sin(3 * q)[:, :, None]

    def partials(self, q: np.ndarray, dq: np.ndarray, ddq: np.ndarray, theta: np.ndarray) -> Partials:
        raise NotImplementedError


def test_a_model_that_changes_smoothly_is_asked_far_less_often_than_there_are_steps() -> None:
    asked = list[int]()
    model = Model((*slider().terms, Valley(slider().joints, asked)))
    machine, rows = Machine(model, (0.5, 0.1, 0.2, 0.0, 4.0)), np.arange(3001)[None]
    motion = driven(model, np.arange(3001) * 1e-3)
    asked.clear()
    quick = integrate(machine, motion, rows, None)
    assert len(asked) < 600
    exact = integrate_arrays(machine, motion, rows, None)
    np.testing.assert_allclose(quick.q, exact.q, atol=1e-11)
    np.testing.assert_allclose(quick.dq, exact.dq, atol=1e-10)
    assert np.ptp(quick.q) == pytest.approx(np.ptp(exact.q))
