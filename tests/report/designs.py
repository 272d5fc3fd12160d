"""A design that was not searched for: a motion of two links, with what its reports need."""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

from dynident.apps.excitation import (
    ClosestApproach,
    Design,
    Piece,
    Purpose,
    Trajectory,
    TrajectoryCheck,
    expected_accuracy,
)
from dynident.apps.excitation.design import torque_information
from dynident.apps.excitation.family import Fourier, LinearCourse
from dynident.apps.excitation.robot import ExcitationProject, read_excitation
from tests.apps.excitation.arms import TWO

CELL = {
    "floor": -1.5,
    "boxes": [{"name": "<i>table", "centre": [0.9, 0, 0], "size": [0.1, 0.1, 0.1]}],
    "cylinders": [{"name": "post", "centre": [0, 0.9], "radius": 0.1}],
}


@cache
def designed(text: str = TWO) -> tuple[ExcitationProject, Design]:
    """A project of the arm of two links in a cell, and a design of it."""
    file = Path(mkdtemp(), "two.urdf")
    file.write_text(text)
    project = read_excitation(file, None, CELL)
    series, n = Fourier(4.0, 2), len(project.limits.joints)
    x = 0.1 * np.random.default_rng(0).standard_normal((2, n, series.size))
    pair = [Trajectory(project.limits.joints, (Piece(LinearCourse(series, entry), Purpose.MOTION),)) for entry in x]
    model, theta, request = project.prior.model, project.prior.theta, project.request
    states = pair[0].states(pair[0].times(request.rate))
    told = expected_accuracy(model, theta, torque_information(model, states, 1 / request.sigma**2))
    near = ClosestApproach(0.0123, ("lower", "<i>table"), 1.5)
    checked = (TrajectoryCheck(5000, np.full((5, n), 0.9), ("the regressor",), near, None),) * 2
    return project, Design(model, theta, request, project.limits, project.space, *pair, told, checked)
