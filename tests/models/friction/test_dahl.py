"""Dahl's friction follows its differential equation."""

import numpy as np
from scipy.integrate import solve_ivp

from dynident.models import Joint, Past
from dynident.models.friction import Dahl

JOINTS = (Joint("a"), Joint("b"))
LENGTH = 0.05


def sines(t):
    w = np.array([3.0, 5.0])
    angle = np.outer(t, w) + np.array([0.3, 1.1])
    return np.sin(angle) / w, np.cos(angle), -np.sin(angle) * w


def remembered(t, **given):
    q, dq, ddq = sines(t)
    return Dahl(JOINTS, **given).remember(Past(t, q, dq, ddq, np.zeros_like(q)))


def test_the_state_solves_the_equation():
    def rate(t, z):
        dq = sines(np.array([t]))[1][0]
        return dq - np.abs(dq) * z / LENGTH

    t = np.linspace(0.0, 3.0, 1501)
    exact = solve_ivp(rate, (0.0, 3.0), np.zeros(2), t_eval=t, rtol=1e-10, atol=1e-13, max_step=0.002).y.T / LENGTH
    np.testing.assert_allclose(remembered(t, length=LENGTH), exact, atol=1e-5)
    np.testing.assert_allclose(remembered(t[::10], length=LENGTH), exact[::10], atol=2e-3)
