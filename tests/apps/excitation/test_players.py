"""Programs beside a motion, for ROS 2 and arms of Universal Robots and Franka, each run on a stand-in for its robot."""

import csv
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from dynident.apps.excitation.files import trajectory_files
from dynident.apps.excitation.players import FRANKA, ROS, players
from dynident.project.arms import UNIVERSAL_ROBOTS
from tests.apps.excitation.test_files import WIDE, motion, wide

UR = tuple(f"left_{name}" for name in UNIVERSAL_ROBOTS)
PANDA = tuple(f"panda_joint{k}" for k in range(1, 8))
STEP = 0.002  # s, of the controller
# a robot that is where it was last told to be, and whose torques are ten times its positions
LIBFRANKA = """
#include <array>
#include <cstdlib>
#include <functional>
#include <stdexcept>
namespace franka {
struct Exception : std::runtime_error { using std::runtime_error::runtime_error; };
struct Duration { double toSec() const { return 0.001; } };
struct RobotState { std::array<double, 7> q, q_d, tau_J; };
struct JointPositions {
  JointPositions(const std::array<double, 7>& x) : q(x) {}
  std::array<double, 7> q;
  bool motion_finished = false;
};
inline JointPositions MotionFinished(JointPositions x) { x.motion_finished = true; return x; }
struct Robot {
  RobotState state{};
  explicit Robot(const char* address) {
    for (int j = 0; j < 7; ++j) state.q[j] = state.q_d[j] = std::atof(address);
  }
  RobotState readOnce() { return state; }
  void control(std::function<JointPositions(const RobotState&, Duration)> next) {
    for (bool first = true;; first = false) {
      JointPositions told = next(state, Duration());
      for (int j = 0; j < 7; ++j) {
        if (std::abs(told.q[j] - state.q[j]) > (first ? 1e-6 : 1e-2)) throw Exception("a jump");
        state.q[j] = state.q_d[j] = told.q[j];
        state.tau_J[j] = 10 * told.q[j];
      }
      if (told.motion_finished) return;
    }
  }
};
}  // namespace franka
"""


def test_programs_are_for_the_arms_that_run_them() -> None:
    assert set(players(("lift", "bend"))) == {ROS}
    assert set(players(PANDA)) == {ROS, FRANKA}
    assert set(players([f"iiwa_joint_{k}" for k in range(1, 8)])) == {ROS}
    assert "motion.script" not in trajectory_files(motion(period=4.0), "motion", 250.0, WIDE)
    assert "motion.script" not in trajectory_files(motion(UR[::-1], 4.0), "motion", 250.0, wide(UR))


class Halted(Exception):  # noqa: N818 -- no error
    """The end of a script."""


def play(script: str, here: Sequence[float]) -> tuple[list[list[float]], list[str]]:
    """Run a URScript, Python but for its ends, `local`, `global` and `halt`; return commands and what is said."""
    lines = [line for line in script.splitlines() if line.strip() != "end"]
    text = re.sub(r"\blocal ", "", "\n".join(lines)).replace("halt\n", "raise Halted\n")
    text = re.sub(r"^(\s*)global (\w+) = (.*)$", r"\1globals()['\2'] = \3", text, flags=re.MULTILINE)
    text = re.sub(r"local q = q1|\bq = q1$", "q = list(q1)", text, flags=re.MULTILINE)  # arrays are values there
    commands: list[list[float]] = []
    said: list[str] = []

    def servoj(q: list[float], t: float, lookahead_time: float, gain: float) -> None:
        assert (t, lookahead_time >= 0.03, 100 <= gain <= 2000) == (STEP, True, True)
        commands.append(list(q))

    robot = {
        "Halted": Halted,
        "servoj": servoj,
        "get_steptime": lambda: STEP,
        "get_actual_joint_positions": lambda: list(here),
        "norm": abs,
        "str_cat": lambda a, b: f"{a}{b}",
        "popup": lambda words, title, error, blocking: said.append(words),
        "stopj": lambda a: said.append("stopped"),
    }
    (name,) = re.findall(r"^def (\w+)\(\):", text, re.MULTILINE)
    exec(text, robot)
    try:
        robot[name]()
    except Halted:
        said.append("halted")
    return commands, said


def test_the_script_plays_the_motion_on_an_arm_of_universal_robots() -> None:
    course = motion(UR, 4.0)
    script = trajectory_files(course, "motion", 250.0, wide(UR))["motion.script"]
    assert isinstance(script, str)
    begin = course.states(np.zeros(1))[0, 0]
    commands, said = play(script, begin + 0.01)
    assert said == ["stopped"]
    t = STEP * np.arange(1, len(commands) + 1)
    assert t[-1] == pytest.approx(4.0, abs=0.02)
    states = course.states(np.minimum(t, 4.0))[0]
    # a designed motion starts at rest, this one does not: up to its first point it is another one
    np.testing.assert_allclose(commands[6:], states[6:], atol=1e-5)
    commands, said = play(script, begin + 0.03 * np.eye(6)[2])
    assert commands == []
    assert said == ["Move the arm to where the motion starts. Away from there is joint 2", "halted"]


@pytest.fixture(scope="module")
def franka(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The program for libfranka, compiled against the stand-in; a motion that starts at zero beside it."""
    compiler = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
    if compiler is None:
        pytest.skip("there is no C++ compiler")
    folder = tmp_path_factory.mktemp("franka")
    (folder / "franka").mkdir()
    (folder / "franka" / "robot.h").write_text(LIBFRANKA)
    (folder / "franka" / "exception.h").write_text("#pragma once\n")
    (folder / FRANKA).write_text(players(PANDA)[FRANKA][0])
    words = [compiler, "-std=c++17", "-Wall", "-Wextra", "-Werror", "-I.", FRANKA, "-o", "play_franka"]
    subprocess.run(words, cwd=folder, check=True)
    t = np.arange(251) / 250
    # from rest to rest, with its derivatives
    s = np.stack([t**3 * (10 - 15 * t + 6 * t**2), 30 * t**2 * (1 - t) ** 2, 60 * t * (1 - t) * (1 - 2 * t)])
    columns = [t, *(np.outer(np.linspace(0.1, 0.7, 7), row) for row in s)]
    head = ["t", *(f"{kind}_{name}" for kind in ("q", "dq", "ddq") for name in PANDA)]
    np.savetxt(folder / "motion.csv", np.vstack(columns).T, delimiter=",", header=",".join(head), comments="")
    return folder


def run(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["./play_franka", *words], cwd=folder, capture_output=True, text=True, check=False)


def test_the_program_plays_and_records_the_motion_on_an_arm_of_franka(franka: Path) -> None:
    done = run(franka, "0.015", "motion.csv", "recorded.csv")
    assert (done.returncode, done.stderr) == (0, "")
    with (franka / "recorded.csv").open() as file:
        head, *rows = csv.reader(file)
    assert head == ["t", *(f"q_{name}" for name in PANDA), *(f"tau_{name}" for name in PANDA)]
    t, q, tau = np.split(np.array(rows, float), [1, 8], axis=1)
    np.testing.assert_allclose(np.diff(t[:, 0]), 0.001, atol=1e-9)
    assert t[-1, 0] == pytest.approx(1.0, abs=0.002)
    before = t - 0.001  # a state is that of the command before
    s = np.clip(before, 0, 1) ** 3 * (10 - 15 * before + 6 * before**2)
    np.testing.assert_allclose(q[1:], (s * np.linspace(0.1, 0.7, 7))[1:], atol=1e-6)
    np.testing.assert_allclose(tau, 10 * q, atol=1e-9)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("0.03", "motion.csv", "recorded.csv"), "panda_joint1 is at 0.03; move it to 0, where the motion starts."),
        (("nan", "motion.csv", "recorded.csv"), "panda_joint1 is at nan"),
        (("0", "missing.csv", "recorded.csv"), "missing.csv: cannot be read."),
        (("0", "motion.csv", "no/folder.csv"), "no/folder.csv: cannot be written."),
        (("0",), "usage:"),
    ],
)
def test_what_stops_the_program_is_said(franka: Path, words: tuple[str, ...], said: str) -> None:
    done = run(franka, *words)
    assert done.returncode == (2 if said == "usage:" else 1)
    assert said in done.stderr


# each message keeps what it is made of; the controller writes the goal that it gets, and answers as the test says
STAND_IN = {
    "rclpy/__init__.py": """
import json, os
SPINS = []
def init(signal_handler_options): assert signal_handler_options == "NO"
def shutdown(): print("shut down")
def create_node(name): return name
def spin_until_future_complete(node, future, timeout_sec=None):
    SPINS.append(future)
    if os.environ["ANSWER"] == "interrupt" and len(SPINS) == 2: raise KeyboardInterrupt
""",
    "rclpy/signals.py": "class SignalHandlerOptions: NO = 'NO'",
    "rclpy/wait_for_message.py": """
import json, os
def wait_for_message(kind, node, topic, time_to_wait):
    assert topic == "/joint_states"
    state = kind(**json.loads(os.environ["STATE"]))
    return bool(state.name), state
""",
    "rclpy/action.py": """
import json, os
from types import SimpleNamespace as Bag
class ActionClient:
    def __init__(self, node, kind, name): self.name = name
    def wait_for_server(self, timeout_sec): return os.environ["ANSWER"] != "absent"
    def send_goal_async(self, goal):
        points = [[list(p.positions), list(p.velocities), list(p.accelerations),
                   p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec] for p in goal.trajectory.points]
        with open("goal.json", "w") as file: json.dump([self.name, goal.trajectory.joint_names, points], file)
        result = Bag(error_code=-4 if os.environ["ANSWER"] == "fail" else 0, error_string="path tolerance violated")
        handle = Bag(accepted=os.environ["ANSWER"] != "reject", cancel_goal_async=lambda: print("cancel sent"),
                     get_result_async=lambda: Bag(result=lambda: Bag(result=result)))
        return Bag(result=lambda: handle)
""",
    "control_msgs/action.py": """
from types import SimpleNamespace as Bag
class FollowJointTrajectory:
    class Goal:
        def __init__(self): self.trajectory = Bag()
""",
    "builtin_interfaces/msg.py": "from types import SimpleNamespace as Duration",
    "trajectory_msgs/msg.py": "from types import SimpleNamespace as JointTrajectoryPoint",
    "sensor_msgs/msg.py": "from types import SimpleNamespace as JointState",
}
NAMES = ("lift", 'odd "$(name)"')


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a motion, its player, and a stand-in for ROS 2."""
    for name, text in STAND_IN.items():
        (tmp_path / "ros" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "ros" / name).write_text(text)
    program, _ = players(NAMES)[ROS]
    for name, content in (trajectory_files(motion(NAMES, 6.0), "motion", 250.0, WIDE) | {ROS: program}).items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return tmp_path


def play_by_ros(folder: Path, answer: str = "reach", **state: object) -> subprocess.CompletedProcess[str]:
    """Type what the file of a motion says, with the controller giving an answer."""
    lines = (folder / "motion.trajectory.yaml").read_text().splitlines()
    (command,) = [line.removeprefix("#   ") for line in lines if line.startswith("#   ")]
    start = motion(NAMES, 6.0).states(np.zeros(1))[0, 0].tolist()
    joint_state = {"name": [*NAMES, "gripper"], "position": [*start, 0.0], **state}
    variables = {"ANSWER": answer, "STATE": json.dumps(joint_state), "PYTHONPATH": str(folder / "ros")}
    # the interpreter of the tests has PyYAML, as that of ROS 2 has
    (folder / "bin").mkdir(exist_ok=True)
    (folder / "bin" / "python3").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (folder / "bin" / "python3").chmod(0o755)
    variables["PATH"] = f"{folder / 'bin'}:{os.environ['PATH']}"
    return subprocess.run(
        command, shell=True, cwd=folder, env=os.environ | variables, capture_output=True, text=True, check=False
    )


def test_the_printed_command_sends_the_motion(folder: Path) -> None:
    done = play_by_ros(folder)
    assert (done.returncode, done.stderr) == (0, "")
    name, joints, points = json.loads((folder / "goal.json").read_text())
    assert (name, joints) == ("/joint_trajectory_controller/follow_joint_trajectory", list(NAMES))
    t = np.array([point[3] for point in points])
    np.testing.assert_allclose(np.diff(t), 0.012, atol=1e-8)
    states = np.array([point[:3] for point in points]).transpose(1, 0, 2)
    np.testing.assert_allclose(states, motion(NAMES, 6.0).states(t)[:3], atol=1e-8)


@pytest.mark.parametrize(
    ("lacking", "words"), [("ros/rclpy/signals.py", "rclpy"), ("motion.trajectory.yaml", "motion")]
)
def test_what_is_lacking_is_said(folder: Path, lacking: str, words: str) -> None:
    (folder / lacking).rename(folder / "elsewhere")
    command = [sys.executable, ROS, "motion.trajectory.yaml"]
    variables = os.environ | {"PYTHONPATH": str(folder / "ros")}
    done = subprocess.run(command, cwd=folder, env=variables, capture_output=True, text=True, check=False)
    assert (done.returncode, "Traceback" in done.stderr, words in done.stderr) == (1, False, True)


@pytest.mark.parametrize(
    ("answer", "state", "words"),
    [
        ("absent", {}, "nothing answers at /joint_trajectory_controller/follow_joint_trajectory"),
        ("reject", {}, "does not accept the motion"),
        ("fail", {}, "error -4: path tolerance violated"),
        ("interrupt", {}, "cancelled."),
        ("reach", {"position": [9.0, 9.0, 0.0]}, "joint 'lift' is at 9.0000; move it to"),
        ("reach", {"position": [float("nan"), 0.0, 0.0]}, "joint 'lift' is at nan"),
        ("reach", {"name": ["bend"], "position": [0.0]}, "does not tell where joint 'lift' is"),
        ("reach", {"name": [], "position": []}, "does not tell where joint 'lift' is"),
    ],
)
def test_what_goes_wrong_is_said(folder: Path, answer: str, state: dict[str, object], words: str) -> None:
    done = play_by_ros(folder, answer, **state)
    assert done.returncode == 1
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert "shut down" in done.stdout
    assert ("cancel sent" in done.stdout) == (answer == "interrupt")
    assert (folder / "goal.json").exists() == (answer in ("reject", "fail", "interrupt"))
