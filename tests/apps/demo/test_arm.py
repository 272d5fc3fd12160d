"""The demo arm: its robot file is sound, and what is true of it is physical and unlike the file."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from dynident.apps.demo.arm import JOINTS, LINKS, TILT, controller, true_model, true_values, urdf
from dynident.checks import check_robot
from dynident.models import RigidBodies, consistency_violations
from dynident.models.rigid_bodies import read_robot_file
from dynident.runtime import Severity


def test_the_robot_file_has_nothing_to_complain_of() -> None:
    file = read_robot_file(urdf(), "arm.urdf")
    assert [one for one in check_robot(file) if one.severity is not Severity.INFO] == []
    bodies = RigidBodies(urdf())
    assert [joint.name for joint in bodies.joints] == [joint.name for joint in JOINTS]
    assert bodies.notes == ()


@pytest.mark.parametrize("link", LINKS, ids=lambda link: link.name)
def test_truth_is_physical_and_5_to_15_percent_off(link) -> None:
    true, drawn = link.true_parameters, link.shape.inertia(link.mass)
    assert not list(consistency_violations(true))
    assert 0.05 <= abs(true[0] / drawn[0] - 1) <= 0.15
    assert np.linalg.norm(true[1:4] / true[0] - drawn[1:4] / drawn[0]) > 0.003


def test_the_true_model_has_the_terms_that_a_draft_has_and_stands_on_a_tilted_base() -> None:
    model, value = true_model(), true_values()
    assert len(model.names) == len(value) == 84
    known = dict(zip(model.names, value, strict=True))
    for joint in JOINTS:
        for prefix, wanted in (
            ("Ia", joint.rotor),
            ("Fv", joint.viscous),
            ("Fc", joint.coulomb),
            ("offset", joint.offset),
        ):
            assert known[f"{prefix}_{joint.name}"] == wanted
    (bodies, *_) = model.terms
    down = np.array(bodies.gravity) / 9.81
    assert np.degrees(np.arccos(-down[2])) == pytest.approx(np.degrees(np.hypot(*TILT)), rel=1e-3)


def test_the_gains_are_a_part_of_a_configuration() -> None:
    simulation = yaml.safe_load(controller())["simulation"]
    assert simulation["kind"] == "cascade"
    for joint in JOINTS:
        drive = simulation["joints"][joint.name]
        assert (drive["kp"], drive["kv"], drive["saturation"]) == (joint.kp, joint.kv, joint.effort)
