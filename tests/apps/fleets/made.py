"""A fleet of small simulated arms, for tests."""

from pathlib import Path

import numpy as np
import polars as pl

import dynident as dy

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="4"/>
<inertia ixx="0.02" iyy="0.06" izz="0.06" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0.02 0"/><mass value="2"/>
<inertia ixx="0.01" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/><origin xyz="0.4 0 0"/>
<axis xyz="0 1 0"/></joint></robot>
"""
RECIPE = """
model: { file: arm.urdf, terms: [viscous, coulomb, offset], base_tilt: none }
time: { column: t, unit: s }
position: { shoulder: { column: q1, unit: rad }, elbow: { column: q2, unit: rad } }
torque: { shoulder: { column: tau1, unit: N m }, elbow: { column: tau2, unit: N m } }
smoother: { kind: spline, rule: gcv }
estimator: { kind: least_squares }
time_offset: 0
"""
FLEET = "recipe: robot.yaml\nlogs: logs/{robot}/{date}.csv\nreports: false\n"
RATE, SECONDS = 100.0, 4.0


def arm(folder: Path) -> dy.Model:
    """The model of the recipe, whose robot file is written to the folder."""
    (folder / "arm.urdf").write_text(URDF)
    return dy.read_robot(folder / "arm.urdf", terms=["viscous", "coulomb", "offset"])


def truth(model: dy.Model, **changed: float) -> np.ndarray:
    """The parameters of an arm: those of the file, and its friction, with some of them ``changed``."""
    reference = {"Fv": 1.0, "Fc": 0.6, "offset": 0.1}
    theta = np.array(
        [reference.get(parameter.name.split("_")[0], parameter.value or 0.0) for parameter in model.parameters]
    )
    for name, value in changed.items():
        theta[model.names.index(name)] = value
    return theta


def recording(model: dy.Model, theta: np.ndarray, seed: int, *, still: bool = False) -> pl.DataFrame:
    """A recording of a random motion, in which the elbow may stand ``still``."""
    rng, t = np.random.default_rng(seed), np.arange(round(SECONDS * RATE)) / RATE
    sizes, rates, phases = rng.uniform(0.3, 0.5, (3, 2)), rng.uniform(1.5, 7.0, (3, 2)), rng.uniform(0, 6.3, (3, 2))
    sizes = sizes * [1, not still]
    angle = rates * t[:, None, None] + phases
    q, dq, ddq = ((sizes * rates**order * np.sin(angle + order * np.pi / 2)).sum(axis=1) for order in range(3))
    tau = model.torque(q, dq, ddq, theta) + 0.02 * rng.standard_normal(q.shape)
    q = q + 1e-6 * rng.standard_normal(q.shape)
    return pl.DataFrame({"t": t, "q1": q[:, 0], "q2": q[:, 1], "tau1": tau[:, 0], "tau2": tau[:, 1]})


def write_log(folder: Path, robot: str, date: str, seed: int, **changed: float) -> Path:
    """Write a recording of a robot, as the fleet's pattern finds it."""
    model = arm(folder)
    path = folder / "logs" / robot / f"{date}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    recording(model, truth(model, **changed), seed).write_csv(path)
    return path


def make_fleet(folder: Path) -> Path:
    """Write a fleet of two robots, the first with two logs, and return its configuration."""
    for seed, (robot, date) in enumerate((("arm-1", "2026-01-01"), ("arm-1", "2026-01-02"), ("arm-2", "2026-01-01"))):
        write_log(folder, robot, date, seed)
    (folder / "robot.yaml").write_text(RECIPE)
    (folder / "fleet.yaml").write_text(FLEET)
    return folder / "fleet.yaml"
