"""The configurations of docs/recipes.md read made-up files in the layout of each recorder, with the right units."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import scipy.io
import yaml
from numpy.typing import NDArray

from dynident.project.project import read_project
from tests.cli.commands import succeed
from tests.files.data_sets import write_data_set
from tests.robots import joint, link, urdf

PAGE = (Path(__file__).parents[2] / "docs" / "recipes.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^## (?P<heading>[^\n]+)\n(?:(?!^## ).)*?^```yaml\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
Array = NDArray[np.float64]
N = 400


def shown() -> dict[str, str]:
    """The configuration of each section that has one."""
    return {result["heading"]: result["body"] for result in BLOCK.finditer(PAGE)}


def robot(joints: tuple[str, ...], other: str, fixed: bool) -> str:
    """A URDF of an arm with these joints, and another one at its end, which may be fixed."""
    parts, parent = [link("base")], "base"
    limit = '<limit effort="100" velocity="5" lower="-3.1" upper="3.1"/>'
    for k, name in enumerate((*joints, other)):
        axis = (0, 0, 1) if k % 3 == 0 else (0, 1, 0)
        parts += [link(f"link{k}", 3.0 / (k + 1), (0.05, 0.01, 0.1))]
        kind = "fixed" if fixed and name == other else "revolute"
        parts += [joint(name, kind, parent, f"link{k}", (0, 0, 0.2), axis=axis, inside=limit)]
        parent = f"link{k}"
    return urdf(*parts)


def moved(n: int, step: float, seed: int) -> tuple[Array, Array, Array]:
    """Times (N), positions (N, n) in rad and torques in N m: any values, unlike from joint to joint."""
    t = np.arange(N) * step
    rate = (1.0 + 0.3 * seed) * (1.0 + np.arange(n) / n) * 2 * np.pi / (300 * step)
    phase = np.multiply.outer(t, rate)
    return t, 0.5 * np.sin(phase) + 0.1 * np.arange(n), (20.0 - 2 * np.arange(n)) * np.cos(phase) + 5.0


def numbered(values: Array, name: str, first: int = 0, *, form: str = "{}_{}") -> dict[str, Array]:
    return {form.format(name, k + first): column for k, column in enumerate(values.T)}


def rtde(path: Path, t: Array, q: Array, tau: Array) -> None:
    """The client of Universal Robots: blanks between the columns, seconds since the controller started."""
    gain = np.array([13.0, 13.0, 13.0, 10.5, 10.5, 10.5])
    columns = {"timestamp": 1234.5 + t} | numbered(q + 0.01, "target_q") | numbered(q, "actual_q")
    columns |= numbered(tau / gain, "actual_current") | numbered(0.9 * tau, "target_moment")
    columns |= numbered(0.1 * tau, "actual_TCP_force") | numbered(tau, "actual_current_as_torque")
    pl.DataFrame(columns).write_csv(path, separator=" ")


def libfranka(path: Path, t: Array, q: Array, tau: Array) -> None:
    """As ``franka::logToCSV``: ms, a blank after the commas of the header only."""
    names = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    groups = [", ".join(f"state.{name}[{k}]" for k in range(7)) for name in names]
    rows = np.column_stack([np.round(1e3 * t) + 5000, np.ones(N), q, q + 0.01, 0 * q, 0 * q, tau, 0.1 * tau])
    lines = [",".join(f"{value:.17g}" for value in row) for row in rows]
    path.write_text("\n".join(["time, success_rate, " + ",".join(groups), *lines]) + "\n")


def fri(path: Path, t: Array, q: Array, tau: Array) -> None:
    columns = {"time": t} | numbered(q, "measured_position", 1) | numbered(-tau, "measured_torque", 1)
    pl.DataFrame(columns | numbered(0.1 * tau, "external_torque", 1)).write_csv(path)


def lerobot(path: Path, t: Array, q: Array, tau: Array) -> None:
    """A data set of all episodes up to this one: degrees, counts of 0.007 N m; the last motor is the gripper."""
    episodes = []
    for seed in range(int(path.name[1:]) + 1):
        _, q, tau = moved(len(SO), 0.01, seed)
        values = {"action": np.rad2deg(q) + 1.0, "observation.state": np.rad2deg(q)}
        values["observation.current"] = np.round(tau / 0.007)
        episodes.append({name: np.column_stack([x, np.full(N, 3.0)]) for name, x in values.items()})
    motors = [*SO, "gripper"]
    positions = [f"{motor}.pos" for motor in motors]
    names = {"action": positions, "observation.state": positions, "observation.current": motors}
    write_data_set(path.parent, episodes, names)


def matlab(path: Path, t: Array, q: Array, tau: Array) -> None:
    """A struct ``log``: the second recording as MATLAB 7.3 writes it, in HDF5, arrays transposed."""
    log = {"t": t[:, None], "q": q, "tau": tau, "Kt": 0.5}
    if path.stem == "monday":
        scipy.io.savemat(path, {"log": log})
        return
    h5py = pytest.importorskip("h5py", reason='the extra "hdf5" is not installed')
    with h5py.File(path, "w", userblock_size=512) as file:
        group = file.create_group("log")
        group.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in log.items():
            group[name] = np.atleast_2d(values).T
            group[name].attrs["MATLAB_class"] = np.bytes_("double")
    with open(path, "r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")


def ros(path: Path, t: Array, q: Array, tau: Array) -> None:
    """A bag of joint states, the joints in another order and with a finger, as a broadcaster sends them."""
    bags = pytest.importorskip("tests.project.bags", reason='the extra "ros" is not installed')
    order, names = [2, 0, 1], ("joint_3", "joint_1", "joint_2", "finger")
    states = [
        bags.State(names, (*q[k, order], 0.02), (0.0,) * 4, (*tau[k, order], 0.1), round(1e9 * t[k])) for k in range(N)
    ]
    bags.write_bag(path.parent, "mcap", states, path.name)


@dataclass(frozen=True)
class Recipe:
    """What a section is for: the joints, another joint of the robot file, the writer, the time step (s), the precision
    of positions and of torques."""

    joints: tuple[str, ...]
    other: str
    write: Callable[[Path, Array, Array, Array], None]
    step: float = 0.002
    precision: tuple[float, float] = (1e-12, 1e-12)


UR = ("shoulder_pan_joint", "shoulder_lift_joint", "elbow_joint", "wrist_1_joint", "wrist_2_joint", "wrist_3_joint")
SO = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
RECIPES = {
    "ROS 2": Recipe(("joint_1", "joint_2", "joint_3"), "finger", ros),
    "Universal Robots (RTDE)": Recipe(UR, "tool", rtde),
    "Franka (libfranka)": Recipe(tuple(f"fr3_joint{k}" for k in range(1, 8)), "fr3_finger_joint1", libfranka, 0.001),
    "KUKA (FRI)": Recipe(tuple(f"A{k}" for k in range(1, 8)), "tool", fri),
    "LeRobot": Recipe(SO, "gripper", lerobot, 0.01, (1e-6, 0.004)),
    "MATLAB and Simulink": Recipe(("shoulder", "elbow"), "tool", matlab),
}


def model_of(config: dict[str, Any]) -> str:
    """The robot file that a configuration names."""
    model = config["model"]
    return str(model if isinstance(model, str) else model["file"])


def logs_of(config: dict[str, Any]) -> list[str]:
    return [x["file"] for x in (*config["train"], *config["validation"])]


def written(folder: Path, heading: str, text: str) -> tuple[Path, dict[str, Any]]:
    """Write a configuration, and the robot file and logs that it names; return its path and content."""
    recipe, config = RECIPES[heading], yaml.safe_load(text)
    fixed = "joints" not in config["model"]  # every joint that moves has a column: the other one is fixed
    (folder / model_of(config)).write_text(robot(recipe.joints, recipe.other, fixed))
    for seed, name in enumerate(logs_of(config)):
        recipe.write(folder / name, *moved(len(recipe.joints), recipe.step, seed))
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    return folder / "robot.yaml", config


def assert_read(config: Path, heading: str) -> None:
    recipe = RECIPES[heading]
    read, said = read_project(config).logs()
    assert said == ()
    for seed, role in enumerate(("train", "validation")):
        (log,) = read[role].values()
        t, q, tau = moved(len(recipe.joints), recipe.step, seed)
        assert log.joints == recipe.joints
        np.testing.assert_allclose(log.t - log.t[0], t, atol=1e-6)
        np.testing.assert_allclose(log.q, q, atol=recipe.precision[0])
        np.testing.assert_allclose(log.tau, tau, atol=recipe.precision[1])


def test_every_recipe_is_tried() -> None:
    assert shown().keys() == RECIPES.keys()
    for heading in RECIPES:  # the table at the top leads to each
        assert f"](#{re.sub('[^a-z0-9 -]', '', heading.lower()).replace(' ', '-')})" in PAGE


@pytest.mark.parametrize("heading", RECIPES)
def test_the_configuration_reads_the_layout(heading: str, tmp_path: Path) -> None:
    config, _ = written(tmp_path, heading, shown()[heading])
    assert_read(config, heading)


def drafted(folder: Path, model: str, *logs: str) -> tuple[str, str]:
    """What ``init`` prints, and its draft."""
    paths = [str(folder / name) for name in (model, *logs)]
    done = succeed("init", *paths, "-o", folder / "drafted.yaml")
    return done.output, (folder / "drafted.yaml").read_text(encoding="utf-8")


@pytest.mark.parametrize("heading", ["ROS 2", "Franka (libfranka)", "KUKA (FRI)", "MATLAB and Simulink"])
def test_init_drafts_the_same_columns(heading: str, tmp_path: Path) -> None:
    """Where no gain is to be filled in; the sign of the iiwa's torques cannot be known."""
    _, config = written(tmp_path, heading, shown()[heading])
    said, draft = drafted(tmp_path, model_of(config), *logs_of(config))
    content = yaml.safe_load(draft)
    for channel in config["torque"].values():
        channel.pop("gain", None)
    assert {key: content[key] for key in ("time", "position", "torque")} == {
        key: config[key] for key in ("time", "position", "torque")
    }
    assert ("Confirm or correct" in said) == (heading not in ("ROS 2", "KUKA (FRI)"))


def test_init_says_once_that_arrays_were_transposed(tmp_path: Path) -> None:
    _, config = written(tmp_path, "MATLAB and Simulink", shown()["MATLAB and Simulink"])
    (tmp_path / "arm.urdf").write_text((tmp_path / model_of(config)).read_text())
    t = np.arange(N) * 0.005
    q = np.stack([np.sin(t), np.cos(2 * t)])
    scipy.io.savemat(tmp_path / "flat.mat", {"t": t, "q": q, "tau": 3.0 * q})
    said, _ = drafted(tmp_path, "arm.urdf", "flat.mat")
    for name in ("q", "tau"):
        assert " ".join(said.split()).count(f"'{name}' has the shape (2, {N})") == 1


@pytest.mark.parametrize("heading", ["Universal Robots (RTDE)", "LeRobot"])
def test_init_asks_for_the_gains_of_currents(heading: str, tmp_path: Path) -> None:
    _, config = written(tmp_path, heading, shown()[heading])
    if heading != "LeRobot":  # an older controller sends no torques
        for path in map(tmp_path.joinpath, logs_of(config)):
            pl.read_csv(path, separator=" ").select(pl.exclude("^.*as_torque.*$")).write_csv(path, separator=" ")
    said, draft = drafted(tmp_path, model_of(config), *logs_of(config))
    assert "the gains: torque constant times gear ratio" in said
    assert yaml.safe_load(draft)["position"].items() >= config["position"].items()
    for channel in config["torque"].values():
        assert f"column: {channel['column']}" in draft.replace('"', "")
