"""Plays a motion of ``dynident excite`` on a robot with ROS 2: sends NAME.trajectory.yaml as one goal, and waits.

Needs a shell in which ROS 2 is set up, and a controller that takes control_msgs/FollowJointTrajectory. It refuses to
start where a joint is away from the first point. Ctrl-C cancels the goal. The exit code is 0 where the goal is reached.
"""

from __future__ import annotations

import argparse
import sys
from typing import Any

import yaml

START_TOLERANCE = 0.02  # rad or m from the first point
PATIENCE = 10.0  # s for the controller, and for the positions of the joints


def read_goal(path: str) -> Any:
    """Return the goal of a file: its joints and points."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from trajectory_msgs.msg import JointTrajectoryPoint

    with open(path, encoding="utf-8") as file:
        message = yaml.load(file, getattr(yaml, "CSafeLoader", yaml.SafeLoader))  # noqa: S506 -- both are safe
    goal = FollowJointTrajectory.Goal()
    goal.trajectory.joint_names = message["joint_names"]
    goal.trajectory.points = [
        JointTrajectoryPoint(**{**point, "time_from_start": Duration(**point["time_from_start"])})
        for point in message["points"]
    ]
    return goal


def start_error(node: Any, goal: Any) -> str:
    """Return why the motion must not start from where the joints are; empty where it may."""
    from rclpy.wait_for_message import wait_for_message
    from sensor_msgs.msg import JointState

    is_there, state = wait_for_message(JointState, node, "/joint_states", time_to_wait=PATIENCE)
    positions = dict(zip(state.name, state.position, strict=False)) if is_there else {}
    starts = goal.trajectory.points[0].positions
    for name, start in zip(goal.trajectory.joint_names, starts, strict=True):
        if name not in positions:
            return f"/joint_states does not tell where joint {name!r} is."
        if not abs(positions[name] - start) <= START_TOLERANCE:
            return f"joint {name!r} is at {positions[name]:.4f}; move it to {start:.4f}, where the motion starts."
    return ""


def play(node: Any, controller: str, goal: Any) -> str:
    """Send a goal and wait for its end; return what went wrong, empty where nothing did."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from rclpy.action import ActionClient

    name = f"/{controller.strip('/')}/follow_joint_trajectory"
    client = ActionClient(node, FollowJointTrajectory, name)
    if not client.wait_for_server(timeout_sec=PATIENCE):
        return f"nothing answers at {name}; name the controller by --controller."
    sending = client.send_goal_async(goal)
    rclpy.spin_until_future_complete(node, sending)
    handle = sending.result()
    if not handle.accepted:
        return f"{name} does not accept the motion; its log says why."
    ending = handle.get_result_async()
    try:
        rclpy.spin_until_future_complete(node, ending)
    except KeyboardInterrupt:
        rclpy.spin_until_future_complete(node, handle.cancel_goal_async(), timeout_sec=PATIENCE)
        return "cancelled."
    result = ending.result().result
    return f"error {result.error_code}: {result.error_string}" if result.error_code else ""


def main() -> None:
    """Read the command line and play the file that it names."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("file", help="NAME.trajectory.yaml")
    parser.add_argument("--controller", default="joint_trajectory_controller", help="its name in ROS 2")
    arguments = parser.parse_args()
    try:
        import rclpy
        from rclpy.signals import SignalHandlerOptions

        goal = read_goal(arguments.file)
    except (ImportError, OSError) as lack:
        sys.exit(f"{lack}. A shell is needed in which ROS 2 is set up, and the file of a motion.")
    # with handlers of its own, rclpy would be shut down by Ctrl-C before it can cancel
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    try:
        node = rclpy.create_node("dynident_player")
        error = start_error(node, goal) or play(node, arguments.controller, goal)
    finally:
        rclpy.shutdown()
    sys.exit(error or 0)


if __name__ == "__main__":
    main()
