"""The whole path of a new user: a robot file, and a CSV with other names, units and order of the joints."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml

from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from tests.cli.commands import succeed
from tests.saved_results import errors_by_log

URDF = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0.1 0 0.02"/><mass value="2.0"/>
    <inertia ixx="0.01" iyy="0.02" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
    <visual><geometry><mesh filename="package://nowhere/upper.stl"/></geometry></visual></link>
  <link name="fore"><inertial><origin xyz="0.08 0.01 0"/><mass value="1.0"/>
    <inertia ixx="0.004" iyy="0.008" izz="0.008" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><origin rpy="1.5707963 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="40" velocity="5"/></joint>
  <joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.3 0 0" rpy="0.4 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="20" velocity="5"/></joint>
</robot>"""
T = np.arange(1500) * 0.008
CONSTANT, RATIO = 0.05, {"shoulder": 100.0, "elbow": 50.0}  # N m/A, motor turns per joint turn


def truth() -> tuple[Model, np.ndarray]:
    bodies = RigidBodies(URDF)
    joints = bodies.joints
    rotor = RotorInertia(joints, values=(0.05, 0.03))
    friction = (Viscous(joints, values=(1.0, 0.5)), Coulomb(joints, values=(0.8, 0.4)))
    arm = Model((bodies, rotor, *friction, Offset(joints, values=(0.1, -0.05))))
    return arm, arm.values


def states(rate: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and accelerations (N, 2) of the arm, ``rate`` times as fast as its first recording."""
    phase, speed = rate * np.multiply.outer(T, [1.7, 2.3]), rate * np.array([1.7, 2.3])
    q = 0.7 * np.sin(phase) + 0.4 * np.sin(2.6 * phase + 1) - [1.2, 0.3]
    dq = speed * (0.7 * np.cos(phase) + 1.04 * np.cos(2.6 * phase + 1))
    return q, dq, -(speed**2) * (0.7 * np.sin(phase) + 2.704 * np.sin(2.6 * phase + 1))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A robot file and two recordings: elbow first, motor currents in mA, joint angles in degrees, times in ms."""
    place = tmp_path_factory.mktemp("user")
    (place / "arm.urdf").write_text(URDF)
    arm, theta = truth()
    rng = np.random.default_rng(0)
    for name, rate in (("monday", 1.0), ("tuesday", 1.3)):
        q, dq, ddq = states(rate)
        tau = arm.torque(q, dq, ddq, theta)
        q = q + 1e-5 * rng.standard_normal(q.shape)
        columns = {"stamp [ms]": 1000 * T}
        for j, joint in reversed(list(enumerate(("shoulder", "elbow")))):
            columns[f"{joint} angle"] = np.rad2deg(q[:, j])
            columns[f"{joint} i_q"] = 1000 * (
                tau[:, j] / (RATIO[joint] * CONSTANT) + 0.002 * rng.standard_normal(len(T))
            )
        pl.DataFrame(columns).write_csv(place / f"{name}.csv", separator=";")
    return place


def identify(folder: Path, **changes: Any) -> dict[str, Any]:
    def current(joint: str) -> dict[str, Any]:
        return {"column": f"{joint} i_q", "gain": 1e-3 * CONSTANT * RATIO[joint], "unit": "N m"}

    settings = {
        "model": "arm.urdf",
        "time": {"column": "stamp [ms]", "unit": "ms"},
        "position": {joint: {"column": f"{joint} angle", "unit": "deg"} for joint in ("elbow", "shoulder")},
        "torque": {joint: current(joint) for joint in ("elbow", "shoulder")},
        "train": [{"file": "monday.csv"}],
        "validation": [{"file": "tuesday.csv"}],
        **changes,
    }
    (folder / "identify.yaml").write_text(yaml.safe_dump(settings))
    succeed("identify", folder / "identify.yaml", "--out", folder / "out")
    return json.loads((folder / "out" / "result.json").read_text())


@cache
def fitted(folder: Path, kind: str) -> dict[str, Any]:
    return identify(folder, estimator={"kind": kind})


@pytest.mark.parametrize("kind", ["least_squares", "consistent"])
def test_names_units_and_order_do_not_matter(folder: Path, kind: str) -> None:
    result = fitted(folder, kind)
    (errors,) = errors_by_log(result, "validation").values()
    assert errors["relative_error"] < 3
    actual = {x["name"]: x["value"] for x in result["parameters"]}
    true = {"Fv_shoulder": 1.0, "Fv_elbow": 0.5, "Fc_shoulder": 0.8, "Fc_elbow": 0.4}
    for name, value in true.items():
        assert actual[name] == pytest.approx(value, abs=0.03), name


def test_consistent_parameters_are_physical_and_near_the_truth_in_what_acts(folder: Path) -> None:
    result = fitted(folder, "consistent")
    actual = {x["name"]: x["value"] for x in result["parameters"]}
    assert actual["upper.mass"] > 0
    assert actual["fore.mass"] > 0
    arm, theta = truth()
    rng = np.random.default_rng(1)
    q, dq, ddq = rng.uniform(-1, 1, (3, 200, 2))
    value = np.array([actual[name] for name in arm.names])
    error = arm.torque(q, dq, ddq, value) - arm.torque(q, dq, ddq, theta)
    assert np.linalg.norm(error) < 0.02 * np.linalg.norm(arm.torque(q, dq, ddq, theta))


def test_motor_angles_through_a_transmission(folder: Path) -> None:
    """The same recording told from the motors' side: turned by the gears, and coupled at the elbow."""
    gears = np.array([[100.0, 0.0], [-50.0, 50.0]])
    for name in ("monday", "tuesday"):
        table = pl.read_csv(folder / f"{name}.csv", separator=";")
        q = np.deg2rad(np.column_stack([table[f"{joint} angle"] for joint in ("shoulder", "elbow")]))
        i_q = np.column_stack([table[f"{joint} i_q"] for joint in ("shoulder", "elbow")])
        tau = i_q * 1e-3 * CONSTANT * np.array([RATIO["shoulder"], RATIO["elbow"]])
        motor, torque = (q - [0.3, 0.0]) @ gears.T, np.linalg.solve(gears.T, tau.T).T
        columns = {"m1": motor[:, 0], "m2": motor[:, 1], "t1": torque[:, 0], "t2": torque[:, 1]}
        pl.DataFrame({"stamp [ms]": table["stamp [ms]"], **columns}).write_csv(folder / f"motor-{name}.csv")
    plain = fitted(folder, "least_squares")
    motors = identify(
        folder,
        estimator={"kind": "least_squares"},
        position={"shoulder": {"column": "m1", "unit": "rad", "multi_turn": True},
                  "elbow": {"column": "m2", "unit": "rad", "multi_turn": True}},
        torque={"shoulder": {"column": "t1", "unit": "N m"}, "elbow": {"column": "t2", "unit": "N m"}},
        transmission={"shoulder": {"shoulder": 100}, "elbow": {"shoulder": -50, "elbow": 50}},
        zero={"shoulder": 0.3},
        train=[{"file": "motor-monday.csv"}],
        validation=[{"file": "motor-tuesday.csv"}],
    )  # fmt: skip
    for first, second in zip(plain["parameters"], motors["parameters"], strict=True):
        assert second["value"] == pytest.approx(first["value"], rel=1e-4, abs=1e-5), first["name"]


def test_slow_samples_can_be_left_out(folder: Path) -> None:
    named = {"file": "arm.urdf", "terms": ["rotor", "viscous", "coulomb", "offset"], "base_tilt": "none"}
    settings = {"model": named, "filter": {"decimate": 5}, "smoother": {"kind": "spline"}, "time_offset": 0}
    everything, faster = identify(folder, **settings), identify(folder, **settings, min_speed={"elbow": 0.3})
    (a,), (b,) = (errors_by_log(x, "train").values() for x in (everything, faster))
    assert b["relative_error_filtered"] < a["relative_error_filtered"]
    assert b["relative_error"] == pytest.approx(a["relative_error"], rel=0.2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"model": "amr.urdf"}, "arm.urdf"),
        ({"model": {"file": "arm.urdf", "joints": ["sholder"]}}, "did you mean 'shoulder'"),
        ({"min_speed": {"wrist": 0.1}}, "no joint 'wrist'"),
        ({"zero": {"wrist": 0.1}}, "no joint 'wrist'"),
        ({"transmission": {"shoulder": {"elbow": 2}, "elbow": {"elbow": 3}}}, "singular"),
        ({"transmission": {"shoulder": {"wrist": 2}}}, "no joint 'wrist'"),
        ({"model": {"file": "arm.urdf", "couplings": {"m": {"joints": {"wrist": 1}}}}}, "no joint 'wrist'"),
        ({"model": {"file": "arm.urdf", "terms": ["stiction"]}}, "coulomb"),
        ({"estimator": {"kind": "consistent", "bounds": {"fore.mas": [0, 1]}}}, "did you mean 'fore.mass'"),
        ({"estimator": {"kind": "consistent", "total_mass": [5, 4]}}, "total mass"),
        ({"estimator": {"kind": "consistent", "centre_of_mass": {"hand": [[0, 0, 0], [1, 1, 1]]}}}, "hand"),
        ({"smoother": {"kind": "spline", "rule": "torqe"}}, "did you mean 'torque'"),
    ],
)
def test_mistakes_are_explained(folder: Path, changes: dict[str, Any], words: str) -> None:
    with pytest.raises(AssertionError) as told:
        identify(folder, **changes)
    assert words in str(told.value)
    assert "Traceback" not in str(told.value)
