"""The program beside a motion, by the command that its file prints, with a stand-in for ROS 2."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dynident.apps.excitation.files import trajectory_files
from dynident.apps.excitation.players import ROS as PLAYER
from dynident.apps.excitation.players import players
from tests.apps.excitation.test_files import WIDE, motion

# each message keeps what it is made of; the controller writes the goal that it gets, and answers as the test says
ROS = {
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
    for name, text in ROS.items():
        (tmp_path / "ros" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "ros" / name).write_text(text)
    program, _ = players(NAMES)[PLAYER]
    for name, content in (trajectory_files(motion(NAMES, 6.0), "motion", 250.0, WIDE) | {PLAYER: program}).items():
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return tmp_path


def play(folder: Path, answer: str = "reach", **state: object) -> subprocess.CompletedProcess[str]:
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
    done = play(folder)
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
    command = [sys.executable, PLAYER, "motion.trajectory.yaml"]
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
    done = play(folder, answer, **state)
    assert done.returncode == 1
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert "shut down" in done.stdout
    assert ("cancel sent" in done.stdout) == (answer == "interrupt")
    assert (folder / "goal.json").exists() == (answer in ("reject", "fail", "interrupt"))
