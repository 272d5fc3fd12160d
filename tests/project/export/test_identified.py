"""What robot files take of a model: shares of links, drives, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.models import Model, RigidBodies, from_physical
from dynident.models.friction import Viscous
from dynident.project.export import IdentifiedModel, Mjcf, Numpy, Urdf, Yaml, export, identified_urdf
from dynident.runtime import ModelError
from tests.project.export.arms import BODY, STATES, arm
from tests.robots import ARM, ARM_MJCF


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
