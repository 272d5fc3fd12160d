"""The rigid-body term is what Pinocchio, an independent reader of the same file, says; and what a Lagrangian says."""

import numpy as np
import pinocchio
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.models import Model, RigidBodies
from dynident.models.lagrangian import two_link_arm
from tests.robots import ARM_MJCF, joint, link, urdf

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 10)
few = settings(max_examples=25, deadline=None)


def random_body(rng):
    points, masses = rng.normal(scale=0.1, size=(6, 3)), rng.uniform(0.1, 1.0, 6)
    square = (points**2).sum(axis=1)[:, None, None] * np.eye(3)
    tensor = np.einsum("k,kij->ij", masses, square - points[:, :, None] * points[:, None, :])
    return masses.sum(), rng.normal(scale=0.2, size=3), rng.uniform(-3, 3, 3), tensor


def random_robot(rng, count, massless=0.2):
    """A tree of ``count`` joints, the last of which moves, with its parts in any order."""
    kinds = rng.choice(["revolute", "continuous", "prismatic", "fixed"], size=count)
    kinds[-1] = rng.choice(["revolute", "continuous", "prismatic"])
    parts = [link("L0", *random_body(rng))]
    for k, kind in enumerate(kinds, start=1):
        body = () if kind != kinds[-1] and rng.random() < massless else random_body(rng)
        parts.append(link(f"L{k}", *body))
        place = rng.normal(scale=0.3, size=3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        parts.append(joint(f"J{k}", kind, f"L{rng.integers(k)}", f"L{k}", *place))
    rng.shuffle(parts)
    moving = [f"J{k}" for k, kind in enumerate(kinds, start=1) if kind != "fixed"]
    return urdf(*parts), tuple(rng.permutation(moving).tolist())


def states(rng, n, samples=3):
    return rng.uniform(-3, 3, (samples, n)), rng.normal(size=(samples, n)), rng.normal(size=(samples, n))


def values(term):
    return np.array([p.value for p in term.parameters])


class Peer:
    """Pinocchio with its own reader of the file; joints by name, those not named stand at ``still``."""

    def __init__(self, model, joints, gravity=(0.0, 0.0, -9.81), still=None):
        self.model, self.data, self.still = model, model.createData(), still or {}
        self.model.gravity = pinocchio.Motion(np.array(gravity), np.zeros(3))
        self.columns = [model.joints[model.getJointId(name)].idx_v for name in joints]
        self.joints = joints

    def configuration(self, q):
        out = pinocchio.neutral(self.model)
        for name, x in {**self.still, **dict(zip(self.joints, q, strict=True))}.items():
            j = self.model.joints[self.model.getJointId(name)]
            out[j.idx_q : j.idx_q + j.nq] = x if j.nq == 1 else (np.cos(x), np.sin(x))
        return out

    def spread(self, values):
        out = np.zeros(self.model.nv)
        out[self.columns] = values
        return out

    def torque(self, q, dq, ddq):
        rows = [
            pinocchio.rnea(self.model, self.data, self.configuration(a), self.spread(b), self.spread(c))
            for a, b, c in zip(q, dq, ddq, strict=True)
        ]
        return np.array(rows)[:, self.columns]

    def kinetic(self, q, dq):
        return [
            pinocchio.computeKineticEnergy(self.model, self.data, self.configuration(a), self.spread(b))
            for a, b in zip(q, dq, strict=True)
        ]


def assert_close(result, expected, tolerance=1e-13):
    assert np.abs(result - expected).max() <= tolerance * max(np.abs(expected).max(), 1e-3)


@few
@given(seeds, sizes)
def test_torque_is_that_of_pinocchio(seed, count):
    """Any tree, any order of joints, any gravity."""
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count)
    gravity = tuple(rng.normal(scale=9.81, size=3))
    term, state = RigidBodies(text, joints_used=joints, gravity=gravity), states(rng, len(joints))
    peer = Peer(pinocchio.buildModelFromXML(text), joints, gravity)
    assert_close(term.regressor(*state) @ values(term), peer.torque(*state))


@few
@given(seeds, sizes)
def test_locked_joints_stand_still(seed, count):
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count)
    used = joints[: 1 + len(joints) // 2]
    locked = dict(zip(joints[len(used) :], rng.uniform(-2, 2, len(joints) - len(used)), strict=True))
    term, state = RigidBodies(text, joints_used=used, locked=locked), states(rng, len(used))
    peer = Peer(pinocchio.buildModelFromXML(text), used, still=locked)
    assert_close(term.regressor(*state) @ values(term), peer.torque(*state))


@few
@given(seeds, sizes)
def test_regressor_and_partials_hold_for_any_parameters(seed, count):
    """Mass zero or below, a moment without mass: central differences of fourth order, and linearity."""
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count)
    term, n = RigidBodies(text, joints_used=joints), len(joints)
    theta = rng.normal(size=(n, 10))
    theta[:, 0] *= rng.choice([0.0, -1.0, 1e-9, 1.0], n)
    theta[rng.random(n) < 0.2] = 0.0
    theta[rng.random(n) < 0.2, :4] = 0.0  # inertia without mass
    theta = theta.ravel()
    state, h = states(rng, n), 1e-3
    assert_close(term.torque(*state, theta), term.regressor(*state) @ theta)
    slopes = term.partials(*state, theta)
    for which, name in enumerate(("q", "dq", "ddq")):
        moved = np.array([[s + h * step * np.eye(n)[k] * (i == which) for i, s in enumerate(state)]
                          for k in range(n) for step in (-2, -1, 1, 2)])  # fmt: skip
        torque = np.array([term.regressor(*s) @ theta for s in moved]).reshape(n, 4, *state[0].shape)
        slope = np.tensordot([1, -8, 8, -1], torque, axes=(0, 1)) / (12 * h)
        assert_close(getattr(slopes, name), slope.transpose(1, 2, 0), 1e-8)


@few
@given(seeds, sizes)
def test_mass_matrix_is_that_of_the_kinetic_energy(seed, count):
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count, massless=0.0)
    term, (q, dq, _) = RigidBodies(text, joints_used=joints), states(rng, len(joints))
    model, theta = Model((term,)), values(term)
    D = model.mass_matrix(q, theta)
    assert_close(D, D.swapaxes(1, 2), 1e-12)
    assert model.check_mass_matrix(q, theta).positive
    kinetic = np.einsum("ni,nij,nj->n", dq, D, dq) / 2
    assert_close(kinetic, np.array(Peer(pinocchio.buildModelFromXML(text), joints).kinetic(q, dq)))
    assert [note for note in term.notes if "limbs move from the base 'L0'" not in note] == []


def test_the_articles_arm_is_the_lagrangian_one():
    """Two links in the vertical plane, hanging at zero; the numbers of eq. 37."""
    lagrangian = two_link_arm().terms[0]
    p = {u.symbol.name: u.value for u in lagrangian.unknowns}
    text = urdf(
        link("base"),
        link("link1", p["m1"], (0, 0, -p["lc1"]), tensor=np.diag([0.0024, p["I1"], 0.0010])),
        link("link2", p["m2"], (0, 0, -p["lc2"]), tensor=np.diag([0.0031, p["I2"], 0.0012])),
        joint("joint1", "revolute", "base", "link1", axis=(0, 1, 0)),
        joint("joint2", "revolute", "link1", "link2", (0, 0, -p["l1"]), axis=(0, 1, 0)),
    )
    term, state = RigidBodies(text), states(np.random.default_rng(0), 2, 50)
    expected = lagrangian.regressor(*state) @ values(lagrangian)
    assert_close(term.regressor(*state) @ values(term), expected, 1e-13)
    slopes, others = term.partials(*state, values(term)), lagrangian.partials(*state, values(lagrangian))
    for name in ("q", "dq", "ddq"):
        assert_close(getattr(slopes, name), getattr(others, name), 1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("", ""),
        ('eulerseq="xyz"', 'eulerseq="zyx"'),
        ('axis="0 0.6 0.8"', 'axis="0 0.6 0.8" pos="0.1 -0.2 0.3"'),
        ('type="slide"', 'type="slide" ref="0.2"'),
        ('axis="0 0.6 0.8"', 'axis="0 0.6 0.8" ref="0.3" pos="0.1 0.2 0"'),
        ('axisangle="0 1 0 0.5"', 'zaxis="0.3 -0.2 0.5"'),
        ('angle="radian"', ""),
    ],
)
def test_mjcf_is_read_as_pinocchio_reads_it(tmp_path, old, new):
    """Where it does: it knows no fixed Euler axes, and takes an axis or a pair of axes for normal as it is."""
    plain = ARM_MJCF.replace('eulerseq="XYZ"', 'eulerseq="xyz"').replace(
        'axisangle="0 2 0 0.5"', 'axisangle="0 1 0 0.5"'
    )
    plain = plain.replace(' -1 1 0"', ' -0.644217687237691 0.7648421872844885 0"').replace(' class="main"', "")
    plain = plain.replace('<geom type="mesh" mesh="shell"/>', "")
    assert old in plain
    text = plain.replace(old, new, 1)
    (tmp_path / "arm.xml").write_text(text, encoding="utf-8")
    peer = Peer(pinocchio.buildModelFromMJCF(str(tmp_path / "arm.xml")), ("shoulder", "rail", "twist"))
    # the armature, which it counts into the torque, is another term here
    peer.model.armature = np.zeros(3)
    term, state = RigidBodies(text), states(np.random.default_rng(2), 3)
    assert_close(term.regressor(*state) @ values(term), peer.torque(*state))
