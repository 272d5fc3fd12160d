"""What an MJCF holds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.models import RigidBodies
from dynident.project.export import Mjcf, export, identified_mjcf
from tests.project.export.arms import STATES, arm
from tests.robots import ARM_MJCF


def test_mjcf_holds_rotor_inertia_and_gravity():
    one = arm(ARM_MJCF, gravity=(0.0, 9.81, 0.0))
    written = identified_mjcf(replace(one, value=np.append(one.value[:-1], 0.0)))
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
