"""Dahl's friction follows its differential equation; friction by the load is that without it, times the load."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynident.models import Joint, Past
from dynident.models.friction import Coulomb, Dahl, LoadCoulomb, LoadDahl, LoadViscous, Viscous
from dynident.testing.term import make_past

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


def test_it_depends_on_the_path_alone_where_no_joint_reverses():
    slow, fast = (np.linspace(0.0, 1.0, samples) for samples in (7, 700))
    found = [
        Dahl(JOINTS[:1], length=0.2).remember(Past(t, x, np.ones_like(x), 0 * x, 0 * x))[-1]
        for t, x in ((t, t[:, None] ** 2) for t in (slow, fast))
    ]
    np.testing.assert_allclose(found[0], found[1], rtol=1e-12)
    np.testing.assert_allclose(found[0], 1.0 - np.exp(-1.0 / 0.2), rtol=1e-12)


def test_it_is_bounded_and_tends_to_the_sign_of_the_velocity():
    t = np.linspace(0.0, 6.0, 6001)
    found, dq = remembered(t, length={"a": 1e-5, "b": 0.5}), sines(t)[1]
    assert np.abs(found).max() <= 1.0
    fast = (np.abs(dq[:, 0]) > 0.1) & (t > 0.01)
    np.testing.assert_allclose(found[fast, 0], np.sign(dq[fast, 0]), atol=1e-9)
    assert np.abs(found[:, 1]).max() < 0.8, "a long one does not slide"


PAIR = (Joint("a"), Joint("rail", "prismatic"))
PAST = make_past(2)


@pytest.mark.parametrize(
    ("term", "plain"),
    [
        (LoadCoulomb(PAIR), Coulomb(PAIR)),
        (LoadCoulomb(PAIR, width=0.3), Coulomb(PAIR, width=0.3)),
        (LoadViscous(PAIR), Viscous(PAIR)),
        (LoadDahl(PAIR, length=0.02), Dahl(PAIR, length=0.02)),
    ],
)
def test_it_is_friction_times_the_load(term, plain):
    states = PAST.q, PAST.dq, PAST.ddq
    memory = [one.remember(PAST) if hasattr(one, "remember") else None for one in (term, plain)]
    found, expected = (
        one.regressor(*states, *([] if m is None else [m])) for one, m in zip((term, plain), memory, strict=True)
    )
    np.testing.assert_allclose(found, expected * np.abs(PAST.load)[:, :, None], rtol=1e-12)


def test_units_are_those_of_torque_per_torque():
    assert [one.unit for one in LoadCoulomb(PAIR).parameters] == ["1", "1"]
    assert [one.unit for one in LoadViscous(PAIR).parameters] == ["s/rad", "s/m"]
    assert {one.role for one in LoadDahl(PAIR).parameters} == {"coulomb"}


def test_only_the_joints_it_is_on_are_remembered():
    term = LoadCoulomb(PAIR, on=("rail",))
    past = Past(PAST.t, PAST.q, PAST.dq, PAST.ddq, PAST.load)
    np.testing.assert_array_equal(term.remember(past), PAST.load[:, 1:])
