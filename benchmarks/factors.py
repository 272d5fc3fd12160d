"""From a motion, or from a log, to the triangular factors that least squares needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from bodies import chain, states
from commands import example, recordings
from numpy.typing import NDArray

Call = Callable[[], object]
Array = NDArray[np.float64]
GEARS = (32.0, 32.0, 45.0, -48.0, 45.0, 32.0)  # of the TX40; its last motor turns with the fifth joint, too
RATE, USED = 5000.0, 25_001  # Hz, samples of the training


def triangular(way: str, joints: int, samples: int) -> Call:
    """Regressor and QR of an arm with friction; the peer's are those of all columns, block by block."""
    q, dq, ddq = states(joints, samples)
    tau = np.random.default_rng(1).standard_normal(q.shape)
    if way == "Pinocchio, NumPy":
        return lambda: plain(joints, q, dq, ddq, tau)
    from dynident.motion.log import Motion
    from dynident.regression import Regression

    model = arm(joints)
    names = tuple(joint.name for joint in model.joints)
    t = np.linspace(0, 5e-3 * (samples - 1), samples)
    motion = Motion(t, q, dq, ddq, tau, names, np.ones(samples, dtype=bool))
    return lambda: Regression(model, (replace(motion),)).triangular_factors  # factors of the same motion are kept


def arm(joints: int) -> Any:
    """A chain of so many joints with friction, as a model."""
    from dynident.models import Model, RigidBodies
    from dynident.models.friction import Coulomb, Offset, Viscous

    bodies = RigidBodies(chain(joints))
    return Model((bodies, *(term(bodies.joints, values=(0.5,) * joints) for term in (Viscous, Coulomb, Offset))))


def plain(joints: int, q: Array, dq: Array, ddq: Array, tau: Array, size: int = 4096) -> Array:
    """The same with Pinocchio and NumPy, as one would write it down."""
    import pinocchio as pin

    model = pin.buildModelFromXML(chain(joints))
    data, p = model.createData(), 13 * joints
    factors = np.zeros((joints, p + 1, p + 1))
    for start in range(0, len(q), size):
        part = slice(start, start + size)
        rows = np.zeros((joints, len(q[part]), p + 1))
        for k, state in enumerate(zip(q[part], dq[part], ddq[part], strict=True)):
            rows[:, k, : 10 * joints] = pin.computeJointTorqueRegressor(model, data, *state)
        for j in range(joints):
            columns = [(10 + k) * joints + j for k in range(3)]
            rows[j][:, columns] = np.c_[dq[part, j], np.sign(dq[part, j]), np.ones(rows.shape[1])]
        rows[:, :, -1] = tau[part].T
        factors = np.asarray(np.linalg.qr(np.concatenate((factors, rows), axis=1), mode="r"))
    return factors


def tx40(way: str, decimate: int) -> Call:
    """The training log of the TX40, smoothed and differentiated, its equations filtered and every so many-th taken."""
    if way == "figaroh":
        return figaroh(decimate)
    from dynident.motion.smoothers import Spline
    from dynident.project.project import read_project
    from dynident.regression import ParallelFilter, Regression, Selection

    project = read_project(example("tx40"))
    (log,) = project.logs()[0]["train"].values()
    smoother, low_pass = Spline(), ParallelFilter(decimate) if decimate > 1 else None
    return lambda: Regression(project.model, (smoother(replace(log)),), Selection(low_pass)).triangular_factors


def figaroh(decimate: int) -> Call:
    """FIGAROH 1.0 on the same samples: its low-pass, differences, regressor, decimation and QR, as its own example of
    this robot calls them, without the three columns of the coupled motor."""
    from figaroh.identification.base_identification import BaseIdentification
    from pinocchio import RobotWrapper, buildModelFromUrdf

    folder = recordings("tx40")
    q, tau = (
        np.loadtxt(folder / name, delimiter=",", skiprows=1, max_rows=USED)
        for name in ("pos_read_data.csv", "curr_data.csv")
    )
    turned = np.diag(GEARS)
    turned[5, 4] = GEARS[5]
    q = q @ np.linalg.inv(turned).T + [0, -np.pi / 2, np.pi / 2, 0, 0, 0]
    tau = tau @ turned
    robot = RobotWrapper(buildModelFromUrdf(str(folder / "tx40_mdh_modified.urdf")))  # its meshes are not needed

    class Identification(BaseIdentification):  # type: ignore[misc]
        def __init__(self) -> None:  # without a configuration file
            self.robot, self.model, self.data = robot, robot.model, robot.data
            actuated = list(range(6))
            columns = dict.fromkeys(("has_friction", "has_actuator_inertia", "has_joint_offset"), True)
            self.identif_config = columns | {"is_joint_torques": True, "act_idxq": actuated, "act_idxv": actuated}
            self.identif_config |= {name: [0.0] * 6 for name in ("fv", "fs", "Ia", "off")}
            settings = {"nbutter": 4, "f_butter": 100.0, "med_fil": 5, "f_sample": RATE}
            self.filter_config = {"differentiation_method": "gradient", "filter_params": settings}
            self.stages: list[Any] = []

        def load_trajectory_data(self, _: str | None = None) -> dict[str, Any]:
            t = np.arange(len(q))[:, None] / RATE
            return {"timestamps": t, "positions": q, "velocities": None, "accelerations": None, "torques": tau}

    def once() -> Any:
        result = Identification()
        result.process_data()
        result.calculate_full_regressor()
        result.initialize_standard_parameters()
        reduced, active = result._eliminate_zero_columns(0.001)
        rows = (
            result._apply_decimation(reduced, decimate) if decimate > 1 else result._prepare_undecimated_data(reduced)
        )
        return result._calculate_base_parameters(*rows, active)["phi_base"]

    return once


def consistent(_: str, joints: int, samples: int) -> Call:
    """A physically consistent fit of 25 s with torque noise of 0.5 N m, from triangular factors that are known."""
    from dynident.estimators import PhysicallyConsistent, Problem
    from dynident.motion.log import Motion
    from dynident.regression import Regression

    model, t = arm(joints), np.linspace(0, 25, samples)
    q, dq, ddq = states(joints, samples, float(t[1]))
    tau = model.torque(q, dq, ddq, model.values) + 0.5 * np.random.default_rng(1).standard_normal(q.shape)
    names = tuple(joint.name for joint in model.joints)
    motion = Motion(t, q, dq, ddq, tau, names, np.ones(samples, dtype=bool))
    problem = Problem(model, (motion,), Regression(model, (motion,)))
    assert problem.regression.triangular_factors.factors.any()
    return lambda: PhysicallyConsistent(costs=False)(problem)
