"""A URDF becomes an MJCF and an MJCF a URDF, with the same torque."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from dynident.models import Model, RigidBodies
from dynident.project.export import (
    IdentifiedModel,
    Mjcf,
    Servo,
    Urdf,
    export,
    identified_mjcf,
    identified_urdf,
    random_states,
)
from dynident.project.export.simulators import Drake, IsaacLab, PinocchioFile
from dynident.project.export.tree_text import urdf_of
from tests.project.export.arms import STATES, arm
from tests.robots import ARM, ARM_MJCF, joint, link, urdf

SHAPES = (
    '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'
    '<visual><origin xyz="0 0 0.1"/><geometry><mesh filename="a.stl"/></geometry></visual>'
)


@pytest.mark.parametrize(("text", "exporter"), [(ARM, Mjcf()), (ARM_MJCF, Urdf())])
@pytest.mark.parametrize("options", [{}, {"joints_used": ("shoulder", "rail"), "locked": {"twist": 0.4}}])
def test_the_other_format_has_the_same_torque(text, exporter, options):
    states = STATES if not options else random_states(2, np.random.default_rng(0), 30)
    made = export(arm(text, gravity=(1.0, 2.0, -9.0), **options), exporter, states)
    assert made.ready, made.refusal
    assert len(made.proof.readers) == 2
    assert made.proof.agreement < 1e-12


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
    one = arm(gravity=(0.0, 1.0, -9.0))
    value = one.value.copy()
    value[-1] = 0.0  # no motor of two joints
    one = replace(one, value=value)
    model = mujoco.MjModel.from_xml_string(identified_mjcf(one).text)
    model.dof_frictionloss[:] = 0.0  # soft at rest
    model.jnt_limited[:] = model.actuator_ctrllimited[:] = model.actuator_forcelimited[:] = 0
    model.jnt_actfrclimited[:] = 0
    data = mujoco.MjData(model)
    for q, dq, ddq in zip(*STATES, strict=True):
        friction = np.array([2.0, 2.0, 2.0]) * np.sign(dq)
        data.qpos[:], data.qvel[:] = q, dq
        memory = np.zeros((1, one.model.memory))
        data.ctrl[:] = one.model.torque(q[None], dq[None], ddq[None], value, memory)[0] - friction
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(data.qacc, ddq, atol=1e-8)


def test_meshes_are_left_out():
    text = ARM.replace('<link name="base">', f'<link name="base">{SHAPES}')
    written = identified_mjcf(arm(text))
    assert any("meshes are not in the file" in note for note in written.notes)


def test_the_root_may_be_called_world():
    text = ARM.replace('"base"', '"world"')
    made = export(arm(text), Mjcf(), STATES)
    assert made.ready, made.refusal


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


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2, 1.0])
def test_orientations_at_the_pole_are_kept(pitch):
    body = '<body name="{}" pos="0.1 0 0.2" euler="0.3 {!r} 0.7"><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
    hinge = '<joint name="{}" axis="0 0.6 0.8"/>'
    parts = [body.format(name, pitch) + hinge.format(name) for name in "ab"]
    compiler = '<compiler angle="radian" eulerseq="xyz"/>'
    text = f"<mujoco>{compiler}<worldbody>{''.join(parts)}</body></body></worldbody></mujoco>"
    bodies = RigidBodies(text)
    turned = RigidBodies(urdf_of(bodies))
    for first, second in zip(bodies.arm.bodies, turned.arm.bodies, strict=True):
        np.testing.assert_allclose(first.placement, second.placement, atol=1e-14)


def test_names_from_files_are_escaped():
    name = '"><actuator/><x a="'
    text = ARM.replace('name="twist"', f"name='{name.replace('<', '&lt;')}'")
    written = identified_mjcf(arm(text)).text
    assert [mujoco.MjModel.from_xml_string(written).joint(2).name] == [name]
    assert "<actuator/>" not in written
    turned = identified_urdf(arm(written)).text
    assert RigidBodies(turned).joints[2].name == name
