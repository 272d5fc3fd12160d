"""What FIGAROH's own functions find for an arm: PYTHON figaroh_fit.py IN.npz OUT.json.

Run by a Python that has figaroh 1.0.2, not by that of dynident. IN holds the robot file (``urdf``), ``gravity`` (3),
``t`` (N) s, ``q`` and ``tau`` (N, n), and, if others, ``decimate`` and ``joints``; OUT the fits: their names, the
parameters (10 a link, then rotor inertia, viscous and Coulomb friction and offset by joint; zero where a base parameter
stands for them) and the seconds of CPU.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from figaroh.identification.base_identification import BaseIdentification
from pinocchio import RobotWrapper, buildModelFromUrdf, buildReducedModel, neutral

CUTOFF, DECIMATE = 10.0, 30  # Hz; those with the least error held out, of 2 to 80 Hz and of 2 to 40
BLOCKS = ("fv", "fs", "ia", "off")  # as its columns are; the order of the answer is ia, fv, fs, off
ORDER = (2, 0, 1, 3)


class Fit(BaseIdentification):  # type: ignore[misc]
    """Its identification of a recording, without a configuration file."""

    def __init__(self, robot: RobotWrapper, recording: dict[str, Any]) -> None:
        self.robot, self.model, self.data, self.recording = robot, robot.model, robot.data, recording
        n = robot.model.nv
        columns = dict.fromkeys(("has_friction", "has_actuator_inertia", "has_joint_offset"), True)
        self.identif_config = columns | {"is_joint_torques": True, "act_idxq": [*range(n)], "act_idxv": [*range(n)]}
        self.identif_config |= {name: [0.0] * n for name in ("fv", "fs", "Ia", "off")}
        rate = 1 / float(np.median(np.diff(recording["t"])))
        settings = {"nbutter": 4, "f_butter": CUTOFF, "med_fil": 5, "f_sample": rate}
        self.filter_config = {"differentiation_method": "gradient", "filter_params": settings}
        self.stages: list[Any] = []

    def load_trajectory_data(self, _: str | None = None) -> dict[str, Any]:
        t, q, tau = (self.recording[name] for name in ("t", "q", "tau"))
        return {"timestamps": t[:, None], "positions": q, "velocities": None, "accelerations": None, "torques": tau}


def fits(robot: RobotWrapper, recording: dict[str, Any]) -> list[dict[str, Any]]:
    """Plain least squares of the base parameters that its QR finds, then its weighted ones."""
    began = time.process_time()
    result = Fit(robot, recording)
    result.process_data()
    result.calculate_full_regressor()
    result.initialize_standard_parameters()
    reduced, active = result._eliminate_zero_columns(0.001)
    rows = result._apply_decimation(reduced, int(recording.get("decimate", DECIMATE)))
    plain = result._calculate_base_parameters(*rows, active)["phi_base"]
    first = time.process_time() - began
    result._fit_blocks = lambda: range(robot.model.nv)  # one block of rows for each joint
    weighted = result._apply_weighted_least_squares()[0]
    second = time.process_time() - began
    kept = np.flatnonzero(np.isin(np.arange(result.dynamic_regressor.shape[1]), places(result, active)))
    columns = kept[list(result._base_indices)]
    pairs = (("least squares", plain, first), ("weighted least squares", weighted, second))
    return [{"name": name, "value": ordered(phi, columns, robot.model.nv), "seconds": s} for name, phi, s in pairs]


def places(fit: Fit, active: Any) -> list[int]:
    """The columns of the whole regressor that are not zero."""
    names = list(fit.standard_parameter)
    return [names.index(name) for name in active]


def ordered(phi: Any, columns: Any, n: int) -> list[float]:
    """All parameters, in the order of the answer."""
    every = np.zeros(14 * n)
    every[columns] = phi
    blocks = every[10 * n :].reshape(4, n)
    return [*every[: 10 * n].tolist(), *(blocks[list(ORDER)].ravel().tolist())]


def main() -> None:
    recording = dict(np.load(sys.argv[1]))
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(str(recording["urdf"]))
        robot = RobotWrapper(buildModelFromUrdf(str(file)))
    if "joints" in recording:  # others, as of a gripper, are held
        names, model = set(recording["joints"].tolist()), robot.model
        others = [model.getJointId(name) for name in model.names[1:] if name not in names]
        robot = RobotWrapper(buildReducedModel(model, others, neutral(model)))
    robot.model.gravity.linear = recording["gravity"]
    Path(sys.argv[2]).write_text(json.dumps(fits(robot, recording)))


if __name__ == "__main__":
    main()
