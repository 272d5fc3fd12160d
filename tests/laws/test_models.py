"""What every term and model obeys: conformance, Euler-Lagrange equations, energy, derivatives."""

import pickle
from functools import cache

import numpy as np
import pytest
import sympy as sp
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import cumulative_simpson

from dynident.gallery import two_link_arm
from dynident.model import Model
from dynident.simulation import simulate
from dynident.terms import Bodies, Coulomb, Coupling, Joint, Lagrangian, Offset, RotorInertia, Unknown, Viscous
from tests.robots import ARM, ARM_MJCF

GRAVITY = sp.Symbol("g")
JOINTS = (Joint("base"), Joint("rail", "prismatic"), Joint("wrist"))
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


LAGRANGIANS = {
    "article": lambda: two_link_arm().terms[0],
    "2R": cache(lambda: chain(2)),
    "3R": cache(lambda: chain(3)),
    "crane": cache(crane),
}
TERMS = {
    **LAGRANGIANS,
    "viscous": lambda: Viscous(JOINTS),
    "coulomb": lambda: Coulomb(JOINTS),
    "coulomb smooth": lambda: Coulomb(JOINTS, on=("wrist", "base"), width=0.2),
    "coulomb dead band": lambda: Coulomb(JOINTS, dead_band=0.3),
    "offset": lambda: Offset(JOINTS, on=("rail",)),
    "rotor inertia": lambda: RotorInertia(JOINTS, on=("wrist", "base")),
    "coupling": lambda: Coupling(JOINTS, {"base": 1.0, "wrist": -6.0}, "motor", offset=True, width=0.4),
    "coupling of slides": lambda: Coupling(JOINTS, {"rail": 2.0}, "motor", coulomb=False),
    "bodies of a urdf": lambda: Bodies(ARM, joints_used=("twist", "shoulder", "rail")),
    "bodies of an mjcf": lambda: Bodies(ARM_MJCF, locked={"rail": 0.2}),
}
every_term = pytest.mark.parametrize("term", TERMS.values(), ids=TERMS)
every_arm = pytest.mark.parametrize("arm", LAGRANGIANS.values(), ids=LAGRANGIANS)


def states(n, seed=0, samples=6):
    """Positions within 0.2 and 1.2, where the crane's carriage is off its axis; velocities off the jumps."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(0.2, 1.2, (samples, n))
    return q, rng.choice([-1, 1], (samples, n)) * rng.uniform(0.4, 2.0, (samples, n)), rng.normal(size=(samples, n))


def values(term):
    return np.array([p.value for p in term.parameters])


@every_term
def test_term_describes_its_parameters(term):
    term = term()
    names = [p.name for p in term.parameters]
    assert len(set(names)) == len(names) > 0
    assert all(p.name and p.unit and p.expression for p in term.parameters)


@every_term
def test_term_returns_finite_arrays_of_the_right_shape(term):
    term = term()
    n, p = len(term.joints), len(term.parameters)
    for samples in (0, 1, 5):
        s = states(n, samples=samples)
        Y, slopes = term.regressor(*s), term.partials(*s, np.ones(p))
        assert Y.shape == (samples, n, p)
        assert {slopes.q.shape, slopes.dq.shape, slopes.ddq.shape} == {(samples, n, n)}
        assert all(np.isfinite(a).all() and a.dtype == float for a in (Y, slopes.q, slopes.dq, slopes.ddq))


@every_term
def test_a_torque_of_its_own_is_that_of_the_regressor(term):
    term = term()
    s, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    whole, model = term.regressor(*s) @ theta, Model((term,))
    np.testing.assert_allclose(model.torque(*s, theta), whole, rtol=1e-11, atol=1e-11 * np.abs(whole).max())
    many = np.tile(theta, (len(whole), 1))
    np.testing.assert_allclose(model.torque(*s, many), whole, rtol=1e-11, atol=1e-11 * np.abs(whole).max())


@every_term
def test_term_works_row_by_row(term):
    term = term()
    s, theta = states(len(term.joints)), np.linspace(0.5, 1.5, len(term.parameters))
    rows = [tuple(x[k : k + 1] for x in s) for k in range(6)]
    np.testing.assert_allclose(term.regressor(*s), np.concatenate([term.regressor(*r) for r in rows]), rtol=1e-13)
    for name in ("q", "dq", "ddq"):
        whole = getattr(term.partials(*s, theta), name)
        single = [getattr(term.partials(*r, theta), name) for r in rows]
        np.testing.assert_allclose(whole, np.concatenate(single), rtol=1e-12, atol=1e-14)


@every_term
def test_term_does_not_change_its_arguments(term):
    term = term()
    s = states(len(term.joints))
    for x in s:
        x.flags.writeable = False
    term.partials(*s, np.ones(len(term.parameters)))
    np.testing.assert_array_equal(term.regressor(*s), term.regressor(*s))


@every_term
def test_term_survives_pickling(term):
    term = term()
    s, theta = states(len(term.joints)), np.ones(len(term.parameters))
    Y, slope = term.regressor(*s), term.partials(*s, theta).dq
    copy = pickle.loads(pickle.dumps(term))
    assert (copy.joints, copy.parameters) == (term.joints, term.parameters)
    np.testing.assert_array_equal(copy.regressor(*s), Y)
    np.testing.assert_array_equal(copy.partials(*s, theta).dq, slope)


@every_term
def test_partials_are_linear_in_theta(term):
    term = term()
    s, (a, b) = states(len(term.joints)), np.random.default_rng(1).normal(size=(2, len(term.parameters)))
    for name in ("q", "dq", "ddq"):
        one, two, both = (getattr(term.partials(*s, x), name) for x in (a, b, 2 * a - b))
        np.testing.assert_allclose(both, 2 * one - two, rtol=1e-10, atol=1e-12)


@every_term
def test_partials_are_the_slopes_of_the_torque(term):
    """Central differences of fourth order; the velocities keep off the jumps of the hard signs."""
    term = term()
    s, h = states(len(term.joints)), 1e-3
    theta = np.random.default_rng(2).uniform(0.5, 1.5, len(term.parameters))
    slopes = term.partials(*s, theta)
    for which, name in enumerate(("q", "dq", "ddq")):
        for k in range(len(term.joints)):

            def torque(step, which=which, k=k):
                moved = [x.copy() for x in s]
                moved[which][:, k] += step
                return term.regressor(*moved) @ theta

            slope = (8 * (torque(h) - torque(-h)) - torque(2 * h) + torque(-2 * h)) / (12 * h)
            np.testing.assert_allclose(getattr(slopes, name)[:, :, k], slope, rtol=1e-7, atol=1e-8)


@every_arm
def test_regressor_gives_the_euler_lagrange_torque(arm):
    """Article, eq. (1), with numbers put in and the time derivative taken along q(t) = q + dq t + ddq t^2 / 2."""
    arm, t = arm(), sp.Symbol("t")
    numbers = {u.symbol: sp.Float(u.value, 30) for u in arm.unknowns} | {
        s: sp.Float(x) for s, x in arm.constants.items()
    }
    lagrangian = (arm.kinetic - arm.potential).subs(numbers)
    q, dq, ddq = states(len(arm.q), seed=7, samples=2)
    found = arm.regressor(q, dq, ddq) @ values(arm)
    for row in range(2):
        path = {s: q[row, k] + dq[row, k] * t + ddq[row, k] * t**2 / 2 for k, s in enumerate(arm.q)}
        path |= {s: dq[row, k] + ddq[row, k] * t for k, s in enumerate(arm.dq)}
        for i, (position, rate) in enumerate(zip(arm.q, arm.dq, strict=True)):
            momentum = sp.diff(lagrangian, rate).subs(path)
            torque = sp.diff(momentum, t).subs(t, 0) - sp.diff(lagrangian, position).subs(path).subs(t, 0)
            assert float(torque) == pytest.approx(found[row, i], rel=1e-11, abs=1e-12)


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
    q, dq, _ = states(len(arm.q), seed=8)
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
        back = model.forward(q, dq, model.torque(q, dq, ddq, theta), theta)
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
