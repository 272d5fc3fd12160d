"""What is written says what was identified: any tree, any physical bodies, read again by readers of others."""

import re

import numpy as np
import pinocchio
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.models import (
    CoupledMotor,
    Model,
    RigidBodies,
    RotorInertia,
    change_frame,
    consistency_violations,
    from_physical,
)
from dynident.models.friction import (
    AsymmetricCoulomb,
    AsymmetricViscous,
    Coulomb,
    Counterbalance,
    Offset,
    Power,
    Ripple,
    Spring,
    Stribeck,
    Viscous,
    WideCoulomb,
)
from dynident.project.export import (
    IdentifiedModel,
    Mjcf,
    Numpy,
    Urdf,
    export,
    identified_mjcf,
    identified_module,
    identified_urdf,
    prove,
)
from dynident.project.export.identified import link_inertias
from dynident.project.export.written import place_values
from dynident.regression import structural_base_parameters
from dynident.runtime.families import EXPORTERS
from tests.laws.test_damaged_robot_files import RICH_MJCF, RICH_URDF
from tests.laws.test_rigid_bodies import Peer, few, random_body, random_robot, states
from tests.robots import ARM, ARM_MJCF, words

seeds = st.integers(0, 2**32 - 1)
sizes = st.integers(1, 8)
CLOSE = 1e-8
UNTIED_MJCF = RICH_MJCF.replace("<equality><joint", '<equality><joint active="false"')


def physical(rng, count, scale=1.0):
    """Random bodies (count, 10): clouds of point masses, their centres off the joint."""
    rows = []
    for _ in range(count):
        mass, centre, _, tensor = random_body(rng)
        rows.append(from_physical(mass, centre, tensor))
    return scale * np.array(rows)


def identified(bodies, rng, scale=1.0):
    """A model of bodies and friction with random values that are physical."""
    joints = bodies.joints
    model = Model((bodies, Viscous(joints), Coulomb(joints)), name="arm")
    n = len(joints)
    return IdentifiedModel(model, np.concatenate([physical(rng, n, scale).ravel(), rng.uniform(0, 2, 2 * n)]))


def assert_same(result, expected):
    scale = np.maximum(np.linalg.norm(expected, axis=0), 1e-6 * np.linalg.norm(expected))
    assert (np.linalg.norm(result - expected, axis=0) <= CLOSE * scale).all()


def friction(model, columns, dq):
    return np.asarray(model.damping)[columns] * dq + np.asarray(model.friction)[columns] * np.sign(dq)


@few
@given(seeds, sizes, st.sampled_from([0.05, 1.0, 20.0]))
def test_urdf_read_by_pinocchio(seed, count, scale):
    """Links that are fixed or locked keep their inertias where they fit; the torque is the same in any case."""
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count)
    used = joints[: 1 + len(joints) // 2]
    locked = dict(zip(joints[len(used) :], rng.uniform(-2, 2, len(joints) - len(used)), strict=True))
    gravity = tuple(rng.normal(scale=9.81, size=3))
    identification = identified(RigidBodies(text, used, locked, gravity), rng, scale)
    written = identified_urdf(identification)
    state = states(rng, len(used), 20)
    peer = Peer(pinocchio.buildModelFromXML(written.text), used, gravity, still=locked)
    result = peer.torque(*state) + friction(peer.model, peer.columns, state[1])
    assert_same(result, identification.model.torque(*state, identification.value))
    assert any("gravity" in words for words in written.left_out)
    assert prove(written, identification, state, Urdf()).proven


@few
@given(seeds, sizes)
def test_links_sum_to_the_body_and_none_is_impossible(seed, count):
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count, massless=0.0)
    bodies = RigidBodies(text, joints[:1])
    values = physical(rng, 1, rng.choice([0.01, 1.0, 100.0]))
    links = link_inertias(bodies, values).links
    (body,) = bodies.arm.bodies_with_parameters
    total = np.zeros(10)
    for link, frame in zip(body.links, body.frames, strict=True):
        theta = links.get(link, bodies.file.links[link])
        assert consistency_violations(theta) == ()
        total += change_frame(theta, frame)
    np.testing.assert_allclose(total, values[0], rtol=1e-9, atol=1e-9 * np.abs(values).max())


@pytest.mark.parametrize(
    ("text", "options"),
    [
        (RICH_URDF, {}),
        (RICH_URDF, {"joints_used": ("finger",), "locked": {"elbow": 0.4}}),
        (RICH_URDF, {"locked": {"follower": 0.1}}),
        (RICH_MJCF, {}),
        (RICH_MJCF, {"joints_used": ("c", "a")}),
        (UNTIED_MJCF, {"locked": {"b": 0.1}}),
        (UNTIED_MJCF, {"locked": {"a": 0.1}}),
    ],
)
def test_mimic_joints_several_joints_of_a_body_and_shapes_are_written(text, options):
    rng = np.random.default_rng(0)
    bodies = RigidBodies(text, **options)
    joints, count = bodies.joints, len(bodies.parameters) // 10
    model = Model((bodies, Viscous(joints), Coulomb(joints), RotorInertia(joints)), name="arm")
    identified_model = IdentifiedModel(
        model, np.concatenate([physical(rng, count).ravel(), rng.uniform(0, 2, 3 * len(joints))])
    )
    for exporter in (EXPORTERS.get(kind)() for kind in EXPORTERS.table):
        made = export(identified_model, exporter, states(rng, len(joints), 20))
        assert made.ready, made.refusal


@pytest.mark.parametrize(("text", "exporter"), [(ARM, Urdf()), (ARM_MJCF, Mjcf())], ids=["urdf", "mjcf"])
def test_terms_that_no_robot_file_holds_are_listed_and_model_py_has_them(text, exporter):
    rng = np.random.default_rng(3)
    bodies = RigidBodies(text)
    joints, n = bodies.joints, len(bodies.joints)
    turning = [joint.name for joint in joints if joint.kind == "revolute"]
    widths = {joint.name: 0.1 * k for k, joint in enumerate(joints)}
    beyond = (
        AsymmetricCoulomb(joints, width=0.2),
        AsymmetricViscous(joints),
        Stribeck(joints, velocity=0.5, width=widths),
        Power(joints, exponent=0.6),
        Ripple(joints, cycles=(3, 20), delay=0.01),
        Spring(joints, order=2),
        Counterbalance(joints, turning[:1], base_arm=0.5, link_arm=0.2, angle=3.0, free_length=0.3),
        WideCoulomb(joints, width=0.7),
    )
    model = Model((bodies, Viscous(joints), Coulomb(joints, width=widths), *beyond), name="arm")
    rest = len(model.names) - 10 * n
    identified_model = IdentifiedModel(model, np.concatenate([physical(rng, n).ravel(), rng.uniform(0.1, 2, rest)]))
    state = states(rng, n, 50)
    assert export(identified_model, Numpy(), state).ready
    made = export(identified_model, exporter, state)
    assert made.ready, made.refusal
    left = " ".join(made.written.left_out)
    names = [p.name for term in beyond for p in term.parameters if f"{p.name} = " not in left]
    assert {name[-4:] for name in names} <= {"sin1", "cos1"}  # gravity of the bodies may hold one period in a turn
    assert all(f"by tanh over {0.1 * k:.3g} rad/s" in left for k in range(1, n))


def random_mjcf(rng, count):
    """A tree of ``count`` bodies, some of them welded, with anchors away from the bodies' frames."""
    bodies = [f'<body name="L{k}"' for k in range(count)]
    inside: list[list[str]] = [[] for _ in range(count)]
    roots, moving = [], []
    for k in reversed(range(count)):
        mass, centre, _, tensor = random_body(rng)
        full = words(tensor[place] for place in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        parts = [f'<inertial pos="{words(centre)}" mass="{float(mass)!r}" fullinertia="{full}"/>']
        if k == 0 or rng.random() < 0.7:
            kind = rng.choice(["hinge", "slide"])
            anchor, axis = rng.normal(scale=0.2, size=3), rng.normal(size=3)
            ref = rng.uniform(-1, 1)
            parts.append(
                f'<joint name="J{k}" type="{kind}" pos="{words(anchor)}" axis="{words(axis)}" ref="{float(ref)!r}"/>'
            )
            moving.append(f"J{k}")
        place = f' pos="{words(rng.normal(scale=0.3, size=3))}" quat="{words(rng.normal(size=4))}">'
        total = bodies[k] + place + "".join(parts + inside[k]) + "</body>"
        (inside[rng.integers(k)] if k else roots).append(total)
    head = (
        '<mujoco><compiler angle="radian"/><default><joint damping="0.3" armature="0.2" frictionloss="0.1"/></default>'
    )
    return f"{head}<worldbody>{''.join(roots)}</worldbody></mujoco>", tuple(rng.permutation(moving).tolist())


def with_rotors(bodies, rng):
    identification = identified(bodies, rng)
    joints = bodies.joints
    model = Model((*identification.model.terms, RotorInertia(joints)), name="arm")
    return IdentifiedModel(model, np.concatenate([identification.value, rng.uniform(0, 1, len(joints))]))


@few
@given(seeds, sizes)
def test_rotors_go_into_links_as_far_as_the_torque_and_physics_allow(seed, count):
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count, massless=0.0)
    model = with_rotors(RigidBodies(text, joints, gravity=tuple(rng.normal(scale=9.81, size=3))), rng)
    best, state = place_values(model, armature=False), states(rng, len(joints), 20)
    assert_same(best.model.torque(*state, best.value), model.model.torque(*state, model.value))
    assert all(consistency_violations(body) == () for body in best.bodies[1])
    n = len(joints)
    assert (best.value[-n:] >= 0).all()
    effect = structural_base_parameters(model.model).scale[-n:]
    assert np.linalg.norm(effect * best.value[-n:]) <= np.linalg.norm(effect * model.value[-n:])
    written = identified_urdf(model)
    assert prove(written, model, state, Urdf()).proven
    lost = {line.split(" = ")[0] for line in written.left_out if line.startswith("Ia_")}
    assert lost == {
        name for name, value in zip(model.model.names, best.value, strict=True) if name[:3] == "Ia_" and value
    }


@few
@given(seeds, sizes)
def test_mjcf_read_by_mujoco(seed, count):
    pytest.importorskip("mujoco", reason="the extra mujoco is not installed")
    rng = np.random.default_rng(seed)
    text, joints = random_mjcf(rng, count)
    used = joints[: 1 + len(joints) // 2]
    locked = dict(zip(joints[len(used) :], rng.uniform(-2, 2, len(joints) - len(used)), strict=True))
    model = with_rotors(RigidBodies(text, used, locked, tuple(rng.normal(scale=9.81, size=3))), rng)
    proof = prove(identified_mjcf(model), model, states(rng, len(used), 20), Mjcf())
    assert proof.readers.keys() == {"MuJoCo", "dynident"}
    assert proof.agreement <= CLOSE


@few
@given(seeds, sizes)
def test_mjcf_read_by_dynident_and_pinocchio(tmp_path_factory, seed, count):
    rng = np.random.default_rng(seed)
    text, joints = random_mjcf(rng, count)
    text = re.sub(r' ref="[^"]*"', "", text)  # Pinocchio gives it another meaning
    gravity = tuple(rng.normal(scale=9.81, size=3))
    model = with_rotors(RigidBodies(text, joints, gravity=gravity), rng)
    written = identified_mjcf(model)
    state = states(rng, len(joints), 20)
    again = RigidBodies(written.text, joints, gravity=gravity)
    assert again.notes == ()
    theta = np.array([p.value for p in again.parameters])
    assert_same(again.regressor(*state) @ theta, model.bodies[0].regressor(*state) @ model.bodies[1].ravel())
    path = tmp_path_factory.mktemp("mjcf") / "arm.xml"
    path.write_text(written.text)
    peer = Peer(pinocchio.buildModelFromMJCF(str(path)), joints, gravity)
    result = peer.torque(*state) + friction(peer.model, peer.columns, state[1])
    assert_same(result, model.model.torque(*state, model.value))


@few
@given(seeds, sizes)
def test_numpy_module_holds_any_values(seed, count):
    """Impossible bodies, negative friction, couplings, offsets, softened signs; one sample or many."""
    rng = np.random.default_rng(seed)
    text, joints = random_robot(rng, count)
    bodies = RigidBodies(text, joints, gravity=tuple(rng.normal(scale=9.81, size=3)))
    test_joints = bodies.joints
    motor = CoupledMotor(test_joints, dict.fromkeys(joints, 2.0), "motor", offset=True, dead_band=0.3)
    terms = (
        bodies,
        RotorInertia(test_joints),
        Viscous(test_joints),
        Coulomb(test_joints, width=0.1),
        Offset(test_joints),
        motor,
    )
    model = Model(terms, name='a "quoted"\n name')
    theta = rng.normal(size=len(model.parameters))
    state = states(rng, len(joints), 20)
    namespace = {}
    exec(identified_module(IdentifiedModel(model, theta)).text, namespace)
    result = namespace["inverse_dynamics"](*state)
    assert_same(result, model.torque(*state, theta))
    assert namespace["JOINTS"] == joints
    np.testing.assert_allclose(namespace["inverse_dynamics"](*(x[0] for x in state)), result[0], rtol=1e-9, atol=1e-9)
    mass = namespace["mass_matrix"](state[0])
    np.testing.assert_allclose(mass, model.mass_matrix(state[0], theta), rtol=1e-8, atol=1e-8)
    assert namespace["mass_matrix"](state[0][0]).shape == (len(joints),) * 2
    rest = namespace["gravity"](state[0])
    held = bodies.regressor(state[0], 0 * state[1], 0 * state[2]) @ theta[: 10 * len(joints)]
    np.testing.assert_allclose(rest, held, rtol=1e-8, atol=1e-8)
    parts = model.torque(state[0], state[1], 0 * state[2], theta) - model.torque(
        state[0], 0 * state[1], 0 * state[2], theta
    )
    rigid = bodies.regressor(state[0], state[1], 0 * state[2]) @ theta[: 10 * len(joints)] - held
    np.testing.assert_allclose(namespace["friction"](state[1]), parts - rigid, rtol=1e-8, atol=1e-7)


DRESSED = (
    ARM.replace("<link", "<!-- a comment: <inertial> --><link", 1)
    .replace("</robot>", '<transmission name="t"><type>x</type></transmission>\n<gazebo/></robot>\n<!-- end -->\n')
    .replace(
        '<link name="tool">',
        "<link name='tool' >\r\n  <visual><geometry><mesh filename='a>b.stl'/></geometry></visual>",
    )
)


@pytest.mark.parametrize(("text", "exporter"), [(DRESSED, Urdf()), (ARM_MJCF, Mjcf())])
def test_all_else_stays_byte_by_byte(text, exporter):
    rng = np.random.default_rng(0)
    identification = identified(RigidBodies(text), rng, scale=50.0)
    made = export(identification, exporter, states(rng, 3, 20))
    assert made.ready
    edited = re.compile(
        r"<inertial.*?</inertial>|<dynamics[^>]*/>" if made.format == "urdf" else r"<inertial[^>]*/>|<joint name[^>]*/>"
    )
    assert made.written.text != text
    assert edited.sub("", made.written.text) == edited.sub("", text)
    link = '<link name="base"><inertial><origin xyz="0.0 0.0 0.0" rpy="0.0 0.0 0.0"/><mass value="4.0"/>'
    assert made.format != "urdf" or link in made.written.text  # a link that stands still
