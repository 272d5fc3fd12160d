"""Robot files that are written: what URDF and MJCF hold and leave out, one from the other, and what is refused."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynident.models import Model, RigidBodies, from_physical
from dynident.models.friction import Viscous
from dynident.project.export import (
    IdentifiedModel,
    Mjcf,
    Numpy,
    Servo,
    Urdf,
    Yaml,
    export,
    identified_mjcf,
    identified_urdf,
    random_states,
)
from dynident.project.export.simulators import Drake, IsaacLab, PinocchioFile
from dynident.project.export.tree_text import urdf_of
from dynident.runtime import ModelError
from tests.project.export.arms import BODY, STATES, arm
from tests.robots import ARM, ARM_MJCF, joint, link, urdf


def test_a_root_that_is_not_declared_is_no_obstacle():
    text = ARM.replace('<joint name="flange"', joint("weld", "fixed", "world", "base") + '<joint name="flange"')
    made = export(arm(text), Urdf(), STATES)
    assert made.ready, made.refusal
    assert "Pinocchio" in made.proof.readers


def test_mjcf_holds_rotor_inertia_and_gravity():
    test_arm = arm(ARM_MJCF, gravity=(0.0, 9.81, 0.0))
    written = identified_mjcf(replace(test_arm, value=np.append(test_arm.value[:-1], 0.0)))
    assert [line.split(" = ")[0] for line in written.left_out] == [
        "offset_shoulder", "offset_rail", "offset_twist",
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
    text = ARM_MJCF.replace(tool, '<geom type="mesh" mesh="shell"/>')
    made = export(arm(text), Mjcf(), STATES)
    assert made.ready, made.refusal
    assert '<inertial pos="0 0 0" mass="0" diaginertia="0 0 0"/>' in made.written.text
    assert any("'tool': its inertia follows from meshes" in note for note in made.written.notes)


SHAPES = (
    '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
    '<visual><origin xyz="0 0 0.1"/><geometry><mesh filename="a.stl"/></geometry></visual>'
)


def test_an_mjcf_of_a_urdf_is_complete():
    text = ARM.replace('<link name="base">', f'<link name="base">{SHAPES}')
    servos = {"shoulder": Servo(17.0, 1.5, 3.0, 0.02)}
    written = identified_mjcf(replace(arm(text, gravity=(0.0, 1.0, -9.0)), servos=servos))
    model = mujoco.MjModel.from_xml_string(written.text)
    assert model.opt.gravity.tolist() == [0.0, 1.0, -9.0]
    assert [model.joint(k).name for k in range(model.njnt)] == ["shoulder", "rail", "twist"]
    assert model.dof_damping.tolist() == [1.0, 1.0, 1.0]
    assert model.dof_frictionloss.tolist() == [2.0, 2.0, 2.0]
    assert (model.dof_armature > 0).all()
    assert model.jnt_range[0].tolist() == [-1.0, 1.0]
    assert model.ngeom == 1
    assert model.geom_size[0].tolist() == [0.05, 0.1, 0.15]
    assert model.body_mass.sum() == pytest.approx(4.0 + 3 * 3.0, rel=1e-6)  # no shape adds any
    # force = kp (ctrl - q) - kv dq - offset within limits, or a torque within the limit of the file
    assert model.actuator("shoulder").gainprm[0] == 17.0
    assert model.actuator("shoulder").biasprm[:3].tolist() == [0.3, -17.0, -1.5]
    np.testing.assert_allclose(model.actuator("shoulder").forcerange, [-2.7, 3.3])
    assert model.actuator("rail").biasprm[:3].tolist() == [0.3, 0.0, 0.0]
    assert model.actuator("rail").ctrlrange.tolist() == [-10.0, 10.0]
    assert not written.left_out


def test_actuators_follow_as_the_model_says():
    """MuJoCo's own forward dynamics with the torque of the model as control has the model's acceleration."""
    case = arm(gravity=(0.0, 1.0, -9.0))
    value = case.value.copy()
    value[-1] = 0.0  # no motor of two joints
    case = replace(case, value=value)
    model = mujoco.MjModel.from_xml_string(identified_mjcf(case).text)
    model.dof_frictionloss[:] = 0.0  # soft at rest
    model.jnt_limited[:] = model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = 0
    model.jnt_actfrclimited[:] = 0
    data = mujoco.MjData(model)
    for q, dq, ddq in zip(*STATES, strict=True):
        friction = np.array([2.0, 2.0, 2.0]) * np.sign(dq)
        data.qpos[:], data.qvel[:] = q, dq
        memory = np.zeros((1, case.model.memory))
        data.ctrl[:] = case.model.torque(q[None], dq[None], ddq[None], value, memory)[0] - friction
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, ddq, atol=1e-8)


def test_mimic_joints_follow_in_every_format():
    follower = '<mimic joint="a" multiplier="-2.0" offset="0.3"/>'
    text = urdf(link("base"), link("one", 1.0), link("two", 1.0, (0.1, 0, 0)),
                joint("a", "revolute", "base", "one", axis=(0, 1, 0)),
                joint("b", "revolute", "one", "two", (0.3, 0, 0), (1.0, 0.5, 0.2), inside=follower))  # fmt: skip
    bodies = RigidBodies(text)
    value = np.array([parameter.value for parameter in bodies.parameters])
    states = random_states(1, np.random.default_rng(0), 30)
    files = {}
    for exporter in (Mjcf(), PinocchioFile(), Drake(), IsaacLab()):
        made = export(IdentifiedModel(Model((bodies,), name="arm"), value), exporter, states)
        assert made.ready, made.refusal
        files[exporter.format] = made.written.text
    again = RigidBodies(files["mjcf"])
    assert {x.name: x.follows for x in again.file.joints}["b"] == ("a", -2.0, 0.3)
    assert '<mimic joint="a" multiplier="-2.0" offset="0.3"/>' in urdf_of(again)


def test_fixed_links_keep_their_inertias_where_they_fit():
    tool = 'mass value="0.5"'
    assert tool in identified_urdf(arm()).text
    light = from_physical(0.2, [0.0, 0.0, 0.1], np.diag([0.01, 0.01, 0.01]))
    written = identified_urdf(arm(body=light))
    assert tool not in written.text
    assert any("'tool' do not fit" in note and "%" in note for note in written.notes)
    assert export(arm(body=light), Urdf(), STATES).ready


def test_fixed_links_that_are_impossible_lose_their_inertias():
    text = ARM.replace('mass value="0.5"', 'mass value="-0.5"')
    made = export(arm(text), Urdf(), STATES)
    assert made.ready, made.refusal
    assert '<link name="tool"></link>' in made.written.text
    assert any("no inertia" in note for note in made.written.notes)


def test_values_that_are_not_identified_stay_those_of_the_file():
    text = ARM.replace('<axis xyz="1.0 0.0 0.0"/>', '<axis xyz="1.0 0.0 0.0"/><dynamics friction="0.7"/>')
    bodies = RigidBodies(text)
    model = Model((bodies, Viscous(bodies.joints, on=("rail",))), name="arm")
    made = export(IdentifiedModel(model, np.concatenate([np.tile(BODY, 3), [0.25]])), Urdf(), STATES)
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
    for exporter in (Urdf(), Numpy(), Yaml()):
        made = export(arm(body=body), exporter, STATES)
        of_robot = made.format == "urdf"
        assert made.ready != of_robot
        assert (words in made.refusal) == of_robot
        assert ("kind: consistent" in made.refusal) == of_robot


@pytest.mark.parametrize(("text", "exporter"), [(ARM, Urdf()), (ARM_MJCF, Mjcf())])
def test_negative_friction_is_refused(text, exporter):
    made = export(arm(text, viscous=-0.1), exporter, STATES)
    assert made.written is None
    assert "Fv_shoulder is -0.1 N m s/rad" in made.refusal


def test_a_model_without_a_robot_file_is_refused():
    joints = RigidBodies(ARM).joints
    with pytest.raises(ModelError, match="does not come from a robot file"):
        identified_urdf(IdentifiedModel(Model((Viscous(joints),)), np.ones(3)))
