"""What a URDF and an MJCF hold, what they leave out, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.errors import ModelError
from dynident.export import Identified, export, identified_mjcf, identified_urdf, random_states
from dynident.models import Coulomb, CoupledMotor, Model, Offset, RigidBodies, RotorInertia, Viscous, from_physical
from tests.robots import ARM, ARM_MJCF, joint, link, urdf

STATES = random_states(3, np.random.default_rng(0), 30)
BODY = from_physical(3.0, [0.01, 0.02, 0.1], np.diag([0.2, 0.3, 0.4]))


def arm(text=ARM, body=BODY, width=0.0, viscous=1.0, **options):
    bodies = RigidBodies(text, **options)
    joints, n = bodies.joints, len(bodies.joints)
    motor = CoupledMotor(joints, {joints[0].name: 1, joints[-1].name: 6}, "motor", viscous=False, coulomb=False)
    terms = (bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints, width=width), Offset(joints), motor)
    friction = [*[0.5] * n, *[viscous] * n, *[2.0] * n, *[-0.3] * n, 0.01]
    return Identified(Model(terms, name="arm"), np.concatenate([np.tile(body, n), friction]))


def test_urdf_says_what_it_leaves_out():
    left_out = identified_urdf(arm(width=0.05, gravity=(0, 0, 9.81))).left_out
    for words in ("Ia_shoulder = 0.5 kg m^2", "offset_twist = -0.3 N m", "Ia_motor", "tanh(dq/0.05)", "gravity"):
        assert any(words in line for line in left_out), words
    assert len(left_out) == 3 + 3 + 1 + 1 + 1
    assert identified_urdf(arm()).text.count('<dynamics damping="1.0" friction="2.0"/>') == 3


def test_mjcf_holds_rotor_inertia_and_gravity():
    written = identified_mjcf(arm(ARM_MJCF, gravity=(0.0, 9.81, 0.0)))
    assert [line.split(" = ")[0] for line in written.left_out] == [
        "offset_shoulder", "offset_rail", "offset_twist", "Ia_motor",
    ]  # fmt: skip
    assert '<option gravity="0.0 9.81 0.0"/>' in written.text
    again = RigidBodies(written.text, gravity=(0.0, 9.81, 0.0))
    assert again.armature == {"shoulder": 0.5, "rail": 0.5, "twist": 0.5}  # over the default classes
    assert again.notes == ()


def test_gravity_is_set_where_the_file_states_it():
    text = ARM_MJCF.replace("<default>", '<option timestep="0.1"/><option gravity="1 2 3"/><default>', 1)
    written = identified_mjcf(arm(text)).text
    assert '<option timestep="0.1"/><option gravity="0.0 0.0 -9.81"/>' in written
    assert "<option" not in identified_mjcf(arm(ARM_MJCF)).text  # the format's own default


def test_compiler_settings_that_change_inertias_go():
    text = ARM_MJCF.replace("<compiler ", '<compiler inertiafromgeom="true" settotalmass="5" boundmass="1" ')
    written = identified_mjcf(arm(text))
    assert written.text.count("<compiler angle=") == 1
    assert any("settotalmass" in note for note in written.notes)
    kept = identified_mjcf(arm(ARM_MJCF.replace("<compiler ", '<compiler inertiafromgeom="auto" '))).text
    assert 'inertiafromgeom="auto"' in kept


def test_a_welded_body_whose_inertia_comes_from_shapes_gets_none():
    tool = '<inertial mass="0.5" pos="0 0 0.05" diaginertia="0.002 0.002 0.001"/>'
    text = ARM_MJCF.replace(tool, '<geom size="0.1"/>')
    made = export(arm(text), "mjcf", STATES)
    assert made.ready, made.refusal
    assert '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>' in made.written.text
    assert any("'tool': the file computes its inertia" in note for note in made.written.notes)


def test_fixed_links_keep_their_inertias_where_they_fit():
    tool = 'mass value="0.5"'
    assert tool in identified_urdf(arm()).text
    light = from_physical(0.2, [0.0, 0.0, 0.1], np.diag([0.01, 0.01, 0.01]))
    written = identified_urdf(arm(body=light))
    assert tool not in written.text
    assert any("'tool' do not fit" in note and "%" in note for note in written.notes)
    assert export(arm(body=light), "urdf", STATES).ready


def test_fixed_links_that_are_impossible_lose_their_inertias():
    text = ARM.replace('mass value="0.5"', 'mass value="-0.5"')
    made = export(arm(text), "urdf", STATES)
    assert made.ready, made.refusal
    assert '<link name="tool"></link>' in made.written.text
    assert any("no inertia" in note for note in made.written.notes)


def test_locked_joints_are_told():
    written = identified_urdf(arm(joints_used=("shoulder", "rail"), locked={"twist": 0.4}))
    assert any("'twist' were fixed" in note for note in written.notes)


def test_a_link_without_inertia_gets_one():
    text = urdf(link("base"), link("one"), link("two"), joint("a", "revolute", "base", "one"),
                joint("b", "revolute", "one", "two", (0.3, 0, 0), (1.0, 0.5, 0.2)))  # fmt: skip
    text = text.replace("<link", "\n  <link").replace("<joint", "\n  <joint")
    made = export(arm(text), "urdf", random_states(2, np.random.default_rng(0), 30))
    assert made.ready, made.refusal
    assert '\n  <link name="one">\n    <inertial>\n      <origin xyz=' in made.written.text
    assert '\n  <link name="base"/>' in made.written.text


def test_a_root_that_is_not_declared_is_no_obstacle():
    text = ARM.replace('<joint name="flange"', joint("weld", "fixed", "world", "base") + '<joint name="flange"')
    made = export(arm(text), "urdf", STATES)
    assert made.ready, made.refusal
    assert "Pinocchio" in made.proof.readers


def test_values_that_are_not_identified_stay_those_of_the_file():
    text = ARM.replace('<axis xyz="1.0 0.0 0.0"/>', '<axis xyz="1.0 0.0 0.0"/><dynamics friction="0.7"/>')
    bodies = RigidBodies(text)
    model = Model((bodies, Viscous(bodies.joints, on=("rail",))), name="arm")
    made = export(Identified(model, np.concatenate([np.tile(BODY, 3), [0.25]])), "urdf", STATES)
    assert made.ready, made.refusal
    assert '<dynamics friction="0.7" damping="0.25"/>' in made.written.text
    assert any("friction 0.7 of joint 'rail'" in note for note in made.written.notes)


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (from_physical(-1.0, [0, 0, 0.1], np.eye(3)), "negative mass"),
        (from_physical(1.0, [0, 0, 0.1], np.diag([1.0, 1.0, 3.0])), "triangle"),
        (np.zeros(10), "singular"),
        (from_physical(1.0, [0, 0, 0.1], np.zeros((3, 3))), "singular"),
    ],
)
def test_impossible_bodies_are_refused_by_robot_files_only(body, words):
    for kind in ("urdf", "numpy", "yaml"):
        made = export(arm(body=body), kind, STATES)
        assert made.ready == (kind != "urdf")
        assert (words in made.refusal) == (kind == "urdf")
        assert ("kind: consistent" in made.refusal) == (kind == "urdf")


@pytest.mark.parametrize(("text", "kind"), [(ARM, "urdf"), (ARM_MJCF, "mjcf")])
def test_negative_friction_is_refused(text, kind):
    made = export(arm(text, viscous=-0.1), kind, STATES)
    assert made.written is None
    assert "Fv_shoulder is -0.1 N m s/rad" in made.refusal


def test_the_other_format_is_refused():
    with pytest.raises(ModelError, match="`mjcf`"):
        identified_urdf(arm(ARM_MJCF))
    with pytest.raises(ModelError, match="`urdf`"):
        identified_mjcf(arm(ARM))
    joints = RigidBodies(ARM).joints
    with pytest.raises(ModelError, match="does not come from a robot file"):
        identified_urdf(Identified(Model((Viscous(joints),)), np.ones(3)))
    with pytest.raises(ModelError, match="did you mean 'urdf'"):
        export(arm(), "udrf", STATES)
