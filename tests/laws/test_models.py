"""What every term and model obeys: conformance, Euler-Lagrange equations, energy, derivatives."""

from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import cumulative_simpson

from dynident.models import CoupledFriction, CoupledMotor, Joint, Lagrangian, Model, RigidBodies, RotorInertia, Unknown
from dynident.models.friction import (
    AsymmetricCoulomb,
    AsymmetricViscous,
    Coulomb,
    Counterbalance,
    Dahl,
    Drift,
    LoadCoulomb,
    LoadDahl,
    LoadRipple,
    LoadViscous,
    Offset,
    Power,
    Ripple,
    Spring,
    Stribeck,
    Viscous,
    WideCoulomb,
)
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import simulate
from dynident.testing import TERM_CHECKS, check_term
from dynident.testing.term import sample_states
from tests.robots import ARM, ARM_MJCF

GRAVITY = sp.Symbol("g")
JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
BANDS = {"base": 0.3, "rail": 0.0, "wrist": 0.0}
BALANCE = {"base_arm": {"base": 0.5, "wrist": 0.3}, "link_arm": 0.3, "angle": 2.0, "free_length": 0.2}
UNITS = {"m": "kg", "l": "m", "c": "m", "I": "kg m^2"}


def energies(points, spins, q, dq):
    """Kinetic and potential energy of masses at points (x, y), y upwards, with rotary inertias."""
    kinetic, potential = 0, 0
    for mass, (x, y) in points:
        velocity = [sum(sp.diff(z, s) * v for s, v in zip(q, dq, strict=True)) for z in (x, y)]
        kinetic += mass * (velocity[0] ** 2 + velocity[1] ** 2) / 2
        potential += mass * GRAVITY * y
    return kinetic + sum(inertia * rate**2 / 2 for inertia, rate in spins), potential


def assembled(joints, points, spins, q, dq, values):
    kinetic, potential = energies(points, spins, q, dq)
    unknowns = tuple(Unknown(s, UNITS[s.name[0]], value) for s, value in values.items())
    return Lagrangian(joints, q, dq, kinetic, potential, unknowns, {GRAVITY: 9.81})


def chain(count):
    """A planar arm of ``count`` revolute joints, angles relative, from hanging down."""
    q, dq = sp.symbols(f"q1:{count + 1}"), sp.symbols(f"v1:{count + 1}")
    m, length, c, inertia = (sp.symbols(f"{name}1:{count + 1}") for name in "mlcI")
    x, y, points, spins = 0, 0, [], []
    for k in range(count):
        angle = sum(q[: k + 1])
        points.append((m[k], (x + c[k] * sp.sin(angle), y - c[k] * sp.cos(angle))))
        spins.append((inertia[k], sum(dq[: k + 1])))
        x, y = x + length[k] * sp.sin(angle), y - length[k] * sp.cos(angle)
    unknowns = (*m, *length[:-1], *c, *inertia)
    values = np.random.default_rng(count).uniform(0.1, 0.6, len(unknowns))
    joints = tuple(Joint(f"joint{k + 1}") for k in range(count))
    return assembled(joints, points, spins, q, dq, dict(zip(unknowns, values, strict=True)))


def crane():
    """A revolute joint that carries a prismatic one, whose carriage carries a pendulum."""
    q, dq = sp.symbols("a r b"), sp.symbols("va vr vb")
    m1, m2, m3, c1, c3, I1, I3 = sp.symbols("m1 m2 m3 c1 c3 I1 I3")
    a, r, b = q
    carriage = (r * sp.cos(a), r * sp.sin(a))
    load = (carriage[0] + c3 * sp.sin(a + b), carriage[1] - c3 * sp.cos(a + b))
    points = [(m1, (c1 * sp.cos(a), c1 * sp.sin(a))), (m2, carriage), (m3, load)]
    spins = [(I1, dq[0]), (I3, dq[0] + dq[2])]
    values = {m1: 2.0, m2: 1.5, m3: 0.7, c1: 0.4, c3: 0.3, I1: 0.2, I3: 0.05}
    return assembled(JOINTS, points, spins, q, dq, values)


SLOW = {"exponent": 0.5, "width": 0.4}
LAGRANGIANS = {
    "article": lambda: two_link_arm().terms[0],
    "3R": cache(lambda: chain(3)),
    "crane": cache(crane),
}
TERMS = {
    **LAGRANGIANS,
    "viscous": lambda: Viscous(JOINTS),
    "coulomb": lambda: Coulomb(JOINTS),
    "coulomb smooth": lambda: Coulomb(JOINTS, on=("wrist", "base"), width=0.2),
    "coulomb dead band": lambda: Coulomb(JOINTS, dead_band=0.3),
    "coulomb by joint": lambda: Coulomb(JOINTS, width={"base": 0.0, "rail": 0.3, "wrist": 0.0}, dead_band=BANDS),
    "wide coulomb": lambda: WideCoulomb(JOINTS, width={"base": 0.7, "rail": 0.3, "wrist": 2.0}),
    "asymmetric coulomb": lambda: AsymmetricCoulomb(JOINTS, width={"base": 0.7, "rail": 0.3, "wrist": 2.0}),
    "asymmetric viscous": lambda: AsymmetricViscous(JOINTS, on=("wrist", "rail")),
    "stribeck": lambda: Stribeck(JOINTS, velocity=0.8),
    "stribeck smooth": lambda: Stribeck(JOINTS, velocity={"base": 0.8, "rail": 1.2, "wrist": 3.0}, width=0.5),
    "power": lambda: Power(JOINTS, exponent={"base": 0.4, "rail": 1.7, "wrist": 3.0}),
    "power smooth": lambda: Power(JOINTS, on=("wrist",), exponent=0.3, width=0.5),
    "ripple": lambda: Ripple(JOINTS, cycles={"base": (3, 4.5), "rail": 6, "wrist": 1.0}, delay=0.02),
    "ripple by joint": lambda: Ripple(JOINTS, ("wrist", "rail"), cycles=5, delay={"rail": -0.1, "wrist": 0.0}),
    "spring": lambda: Spring(JOINTS, order={"base": 2, "rail": 3, "wrist": 1}),
    "counterbalance": lambda: Counterbalance(JOINTS, ("wrist", "base"), **BALANCE),
    "offset": lambda: Offset(JOINTS, on=("rail",)),
    "rotor inertia": lambda: RotorInertia(JOINTS, on=("wrist", "base")),
    "dahl": lambda: Dahl(JOINTS, length={"base": 0.05, "rail": 0.02, "wrist": 0.3}),
    "load coulomb": lambda: LoadCoulomb(JOINTS, on=("wrist", "base")),
    "load coulomb smooth": lambda: LoadCoulomb(JOINTS, width=0.2),
    "load viscous": lambda: LoadViscous(JOINTS),
    "load ripple": lambda: LoadRipple(JOINTS, on=("rail", "base"), cycles=(2, 5), delay=0.02),
    "load dahl": lambda: LoadDahl(JOINTS, on=("rail", "wrist"), length=0.1),
    "drift": lambda: Drift(JOINTS, time=0.5),
    "coupling": lambda: CoupledMotor(JOINTS, {"base": 1.0, "wrist": -6.0}, "motor", offset=True, width=0.4),
    "coupling of slides": lambda: CoupledMotor(JOINTS, {"rail": 2.0}, "motor", coulomb=False),
    "friction of a coupling": lambda: CoupledFriction(JOINTS, {"base": 1.0, "wrist": -6.0}, "motor", "power", SLOW),
    "asymmetric friction of a coupling": lambda: CoupledFriction(JOINTS, {"rail": 2.0}, "motor", "asymmetric_viscous"),
    "bodies of a urdf": lambda: RigidBodies(ARM, joints_used=("twist", "shoulder", "rail")),
    "bodies of an mjcf": lambda: RigidBodies(ARM_MJCF, locked={"rail": 0.2}),
}
every_term = pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
every_arm = pytest.mark.parametrize("arm", LAGRANGIANS.values(), ids=LAGRANGIANS)


def values(term):
    return np.array([p.value for p in term.parameters])


@pytest.mark.parametrize("check", TERM_CHECKS, ids=lambda check: check.__name__)
@every_term
def test_every_term(term, check):
    check(term())


class Steep(Viscous):
    """A term with a wrong derivative."""

    def slopes(self, q, dq, ddq):
        return None, 2 * np.ones_like(dq), None


def test_a_term_that_breaks_a_promise_is_found():
    with pytest.raises(AssertionError):
        check_term(Steep(JOINTS))


@every_arm
def test_regressor_gives_the_euler_lagrange_torque(arm):
    """Article, eq. (1), with numbers put in and the time derivative taken along q(t) = q + dq t + ddq t^2 / 2."""
    arm, t = arm(), sp.Symbol("t")
    numbers = {u.symbol: sp.Float(u.value, 30) for u in arm.unknowns} | {
        s: sp.Float(x) for s, x in arm.constants.items()
    }
    lagrangian = (arm.kinetic - arm.potential).subs(numbers)
    q, dq, ddq = sample_states(len(arm.q), seed=7, samples=2)
    result = arm.regressor(q, dq, ddq) @ values(arm)
    for row in range(2):
        path = {s: q[row, k] + dq[row, k] * t + ddq[row, k] * t**2 / 2 for k, s in enumerate(arm.q)}
        path |= {s: dq[row, k] + ddq[row, k] * t for k, s in enumerate(arm.dq)}
        for i, (position, rate) in enumerate(zip(arm.q, arm.dq, strict=True)):
            momentum = sp.diff(lagrangian, rate).subs(path)
            torque = sp.diff(momentum, t).subs(t, 0) - sp.diff(lagrangian, position).subs(path).subs(t, 0)
            assert float(torque) == pytest.approx(result[row, i], rel=1e-11, abs=1e-12)


@every_arm
def test_mass_matrix_is_symmetric_and_positive_definite(arm):
    arm = arm()
    model, n = Model((arm,)), len(arm.q)
    bounded = arrays(float, (4, n), elements=st.floats(-3.2, 3.2))

    @given(bounded)
    def holds(q):
        D = model.mass_matrix(q, values(arm))
        np.testing.assert_allclose(D, D.swapaxes(1, 2), rtol=1e-12, atol=1e-13)
        assert model.check_mass_matrix(q, values(arm)).positive

    holds()


@every_arm
def test_mass_matrix_is_that_of_the_kinetic_energy(arm):
    """T = dq' D dq / 2: article, eq. (3)."""
    arm = arm()
    q, dq, _ = sample_states(len(arm.q), seed=8)
    D = Model((arm,)).mass_matrix(q, values(arm))
    kinetic = energy(arm, "kinetic")(q, dq)
    np.testing.assert_allclose(np.einsum("ni,nij,nj->n", dq, D, dq) / 2, kinetic, rtol=1e-12)


@every_arm
def test_forward_dynamics_invert_the_inverse_dynamics(arm):
    arm = arm()
    model, n = Model((arm, Viscous(arm.joints))), len(arm.q)
    theta = np.append(values(arm), np.full(n, 0.1))

    @given(arrays(float, (3, 1, n), elements=st.floats(-3.0, 3.0)))
    def holds(state):
        q, dq, ddq = state
        back = model.forward_dynamics(q, dq, model.torque(q, dq, ddq, theta), theta)
        np.testing.assert_allclose(back, ddq, rtol=1e-9, atol=1e-9)

    holds()


def energy(arm, which):
    numbers = {u.symbol: u.value for u in arm.unknowns} | arm.constants
    function = sp.lambdify((arm.q, arm.dq), getattr(arm, which).subs(numbers), "numpy")
    return lambda q, dq: function(q.T, dq.T)


@every_arm
def test_energy_gained_is_the_work_of_the_torque(arm):
    """T + V at the end minus the start equals the integral of tau . dq, without friction."""
    arm = arm()
    n, t = len(arm.q), np.linspace(0.0, 1.0, 2001)
    w = np.arange(1.0, n + 1)
    motion = simulate(
        Model((arm,)), values(arm), lambda s: 0.3 * np.sin(w * s + 1), t, q0=np.full(n, 0.7), tolerance=1e-12
    )
    total = energy(arm, "kinetic")(motion.q, motion.dq) + energy(arm, "potential")(motion.q, motion.dq)
    work = cumulative_simpson((motion.tau * motion.dq).sum(axis=1), x=t, initial=0)
    scale = np.abs(energy(arm, "kinetic")(motion.q, motion.dq)).max()
    assert np.abs(work[-1]) > 1e-3 * scale
    assert abs(total[-1] - total[0] - work[-1]) < 1e-9 * scale


def test_friction_only_takes_energy():
    """The article's arm, released, loses energy from sample to sample."""
    arm = two_link_arm()
    links, t = arm.terms[0], np.linspace(0.0, 1.0, 101)
    theta = np.append(arm.values[:5], [0.02, 0.02])
    motion = simulate(arm, theta, lambda s: [0.0, 0.0], t, q0=[1.5, 0.5])
    total = energy(links, "kinetic")(motion.q, motion.dq) + energy(links, "potential")(motion.q, motion.dq)
    assert (np.diff(total) < 0).all()
