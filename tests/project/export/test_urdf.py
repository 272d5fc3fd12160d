"""What a URDF holds, and what it leaves out."""

from __future__ import annotations

import numpy as np

from dynident.project.export import Urdf, export, identified_urdf, random_states
from dynident.project.export.robot_files import relocate_files
from tests.project.export.arms import STATES, arm
from tests.robots import ARM, joint, link, urdf


def test_urdf_says_what_it_leaves_out():
    left_out = identified_urdf(arm(width=0.05, gravity=(0, 0, 9.81))).left_out
    for words in ("Ia_rail = 0.5 kg", "offset_twist = -0.3 N m", "Ia_motor", "by tanh over 0.05", "gravity"):
        assert any(words in line for line in left_out), words
    assert not any("Ia_shoulder" in line for line in left_out)  # part of the bodies
    assert len(left_out) == 2 + 3 + 1 + 1 + 1
    assert identified_urdf(arm()).text.count('<dynamics damping="1.0" friction="2.0"/>') == 3


def test_locked_joints_are_noted():
    written = identified_urdf(arm(joints_used=("shoulder", "rail"), locked={"twist": 0.4}))
    assert any("'twist' were fixed" in note for note in written.notes)


def test_a_link_without_inertia_gets_one():
    text = urdf(link("base"), link("one"), link("two"), joint("a", "revolute", "base", "one"),
                joint("b", "revolute", "one", "two", (0.3, 0, 0), (1.0, 0.5, 0.2)))  # fmt: skip
    text = text.replace("<link", "\n  <link").replace("<joint", "\n  <joint")
    made = export(arm(text), Urdf(), random_states(2, np.random.default_rng(0), 30))
    assert made.ready, made.refusal
    assert '\n  <link name="one">\n    <inertial>\n      <origin xyz=' in made.written.text
    assert '\n  <link name="base"/>' in made.written.text


def test_a_root_that_is_not_declared_is_no_obstacle():
    text = ARM.replace('<joint name="flange"', joint("weld", "fixed", "world", "base") + '<joint name="flange"')
    made = export(arm(text), Urdf(), STATES)
    assert made.ready, made.refusal
    assert "Pinocchio" in made.proof.readers


def test_relative_file_names_lead_from_another_folder_to_the_same_files():
    text = ARM.replace(
        "</robot>",
        '<mujoco><compiler meshdir="parts" strippath="false"/></mujoco>'
        '<link name="x"><visual><geometry><mesh filename="parts/x.stl" scale="1 1 1"/></geometry></visual></link>'
        '<link name="y"><visual><geometry><mesh filename="package://arm/y.stl"/></geometry></visual></link>'
        '<link name="z"><visual><geometry><mesh filename="/parts/z.stl"/></geometry></visual></link></robot>',
    )
    made = relocate_files(text, "../..")
    assert '<compiler meshdir="../../parts" strippath="false"/>' in made
    assert made == text.replace('="parts', '="../../parts')
