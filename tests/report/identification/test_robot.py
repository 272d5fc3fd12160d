"""The robot in its report: coloured links, along its recordings, with its inertia."""

import re
from dataclasses import replace

from dynident.estimators import PhysicallyConsistent
from dynident.models import Model, RigidBodies
from dynident.models.geometry import build_geometry
from dynident.report.identification.robot import robot_blocks, robot_view
from dynident.report.page import Figure
from tests.report.robots import TREE, identified


def view(estimator: PhysicallyConsistent | None = None) -> Figure:
    *_, figure = robot_blocks(identified(estimator))
    return figure


def test_a_robot_file_without_masses_has_no_view() -> None:
    bare = RigidBodies(re.sub("<(inertial|collision)>.*?</\\1>", "", TREE, flags=re.DOTALL), ("pan", "reach", "wrist"))
    other = replace(identified(), model=Model((bare,)))
    assert list(robot_blocks(other, build_geometry(bare))) == []
    assert robot_view(other, build_geometry(bare)) is None
