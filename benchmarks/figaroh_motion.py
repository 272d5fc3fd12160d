"""The motion that FIGAROH's own tool finds for a robot file: PYTHON figaroh_motion.py ROBOT.urdf OUT.npz.

Run by a Python that has figaroh 1.0.2 and cyipopt, not by that of dynident. The robot's limits are those of its file
less 10 % (less 5 % of the range at each end of it), as its example for an arm has them, with friction, drive
inertia and offset, and self-collision where the file has shapes. OUT holds t (s), q, dq, ddq (N, n) and the seconds.
"""

from __future__ import annotations

import argparse
import logging
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from figaroh.optimal.base_optimal_trajectory import BaseOptimalTrajectory, BaseTrajectoryIPOPTProblem
from figaroh.tools.robot import load_robot

WAYPOINTS, FREQUENCY = 5, 50  # in a segment; Hz
SHORTER = 0.98  # steps of a first guess


class Motion(BaseOptimalTrajectory):  # type: ignore[misc]
    def create_ipopt_problem(self, *args: Any) -> BaseTrajectoryIPOPTProblem:
        return BaseTrajectoryIPOPTProblem(self, *args)

    def _limit_waypoint_steps(self, wps: Any) -> Any:
        """Its own rule takes 1.5 for the peak of a quintic, which is 1.875: no start is within the velocity limits."""
        result = super()._limit_waypoint_steps(wps)
        return result[:, :1] + SHORTER * (result - result[:, :1])


def config(model: Any, joints: list[str], step: float, iterations: int) -> dict[str, Any]:
    """Return the unified configuration of FIGAROH for an arm."""
    n, zeros = len(joints), [0.0] * len(joints)
    limits = np.stack([model.lowerPositionLimit, model.upperPositionLimit], axis=1).ravel().tolist()
    parts = {"friction": True, "joint_offset": True, "actuator_inertia": True}
    return {
        "robot": {
            "name": "arm",
            "properties": {
                "joints": {
                    "active_joints": joints,
                    "joint_limits": {
                        "position": limits,
                        "velocity": model.velocityLimit.tolist(),
                        "acceleration": [20.0] * n,
                        "torque": model.effortLimit.tolist(),
                    },
                },
                "mechanics": {
                    "reduction_ratios": [1.0] * n,
                    "ratio_essential": 1.0,
                    "friction_coefficients": {"viscous": zeros, "static": zeros},
                    "actuator_inertias": zeros,
                    "joint_offsets": zeros,
                },
                "coupling": {"has_coupled_wrist": False},
            },
        },
        "tasks": {
            "identification": {
                "enabled": True,
                "problem": {
                    "include_external_forces": False,
                    "use_joint_torques": True,
                    "model_components": {**parts, "static_regressor": True, "inertia_regressor": True},
                },
                "signal_processing": {"sampling_frequency": float(FREQUENCY), "cutoff_frequency": 20.0},
            },
            "optimal_trajectory": {
                "enabled": True,
                "problem": {
                    "soft_lim": 0.05, "max_attempts": 1000, "max_iterations": iterations, "segment_attempts": 3,
                },
                "trajectory": {"waypoints": WAYPOINTS, "frequency": FREQUENCY, "segment_duration": step},
            },
        },
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robot", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--duration", type=float, default=20.0, help="s")
    parser.add_argument("--step", type=float, default=1.0, help="s between waypoints")
    parser.add_argument("--iterations", type=int, default=60, help="of a segment at most")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    logging.getLogger("cyipopt").setLevel(logging.WARNING)
    np.random.seed(given.seed)  # noqa: NPY002
    robot = load_robot(str(given.robot), package_dirs=str(given.robot.parent), load_by_urdf=True)
    joints = list(robot.model.names)[1:]
    began, cpu = time.perf_counter(), time.process_time()
    with TemporaryDirectory() as folder:
        file = Path(folder) / "arm.yaml"
        file.write_text(yaml.safe_dump(config(robot.model, joints, given.step, given.iterations)))
        tool = Motion(robot, joints, str(file))
    chosen = tool.identif_config
    chosen["active_joints"] = joints
    chosen["act_Jid"] = [tool.model.getJointId(name) for name in joints]
    chosen["act_J"] = [tool.model.joints[k] for k in chosen["act_Jid"]]
    chosen["act_idxq"], chosen["act_idxv"] = ([getattr(x, key) for x in chosen["act_J"]] for key in ("idx_q", "idx_v"))
    tool.initialize()
    solution = tool.solve(stack_reps=round(given.duration / given.step / (WAYPOINTS - 1)))
    seconds, used = time.perf_counter() - began, time.process_time() - cpu
    first = [slice(int(k > 0), None) for k in range(len(solution["T_F"]))]  # a segment begins where the last one ends
    names = {"q": "P_F", "dq": "V_F", "ddq": "A_F"}
    states = {key: np.vstack([x[k] for x, k in zip(solution[name], first, strict=True)]) for key, name in names.items()}
    t = np.arange(len(states["q"])) / FREQUENCY  # its own times of segments overlap
    worth = [float(x["obj_values"][-1]) for x in solution["iteration_data"] if len(x["obj_values"])]
    print(f"{len(solution['T_F'])} segments, {t[-1]:.1f} s of motion in {seconds:.0f} s ({used:.0f} s of CPU); {worth}")
    q, dq, ddq = (states[key] for key in names)
    np.savez(given.out, t=t, q=q, dq=dq, ddq=ddq, seconds=seconds, cpu=used, base=len(tool.idx_b))


if __name__ == "__main__":
    main()
