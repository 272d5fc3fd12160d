"""Well-known arms: recognised by names and limits, and their usual limits offered, never used unasked."""

from pathlib import Path

import pytest
import yaml

from dynident.models.robot_files import RobotJointLimits
from dynident.project import arms
from dynident.project.arms import UNIVERSAL_ROBOTS, find_arm

TABLE = yaml.safe_load(Path(arms.__file__).with_name("arms.yaml").read_text(encoding="utf-8"))


def limits_of(names: list[str], velocities: list[float]) -> dict[str, RobotJointLimits]:
    return {name: RobotJointLimits(velocity=v) for name, v in zip(names, velocities, strict=True)}


def test_an_arm_is_known_by_names_and_velocities() -> None:
    names = [f"arm_panda_joint{k}" for k in range(1, 8)]
    panda = find_arm(limits_of(names, [2.175] * 4 + [2.61] * 3))
    assert panda.name == "Franka Emika Panda"
    assert panda.limits["arm_panda_joint2"] == {"acceleration": 7.5, "jerk": 3750.0}
    assert "libfranka" in panda.source
    ur = find_arm(limits_of([f"left_{name}" for name in UNIVERSAL_ROBOTS], [3.14159] * 6))
    assert ur.name == "Universal Robots UR5e"
    assert set(ur.limits["left_elbow_joint"]) == {"acceleration"}


@pytest.mark.parametrize("entry", TABLE, ids=lambda entry: entry["name"])
def test_each_arm_of_the_table_is_found(entry: dict) -> None:
    count = 7 if entry["joints"] == "numbered" else 6
    names = list(UNIVERSAL_ROBOTS) if count == 6 else [f"lbr_A{k}" for k in range(1, 8)]
    velocity, upper = (
        value if isinstance(value, list) else [value] * count for value in (entry["velocity"], entry.get("upper"))
    )
    limits = {name: RobotJointLimits(velocity=v, upper=x) for name, v, x in zip(names, velocity, upper, strict=True)}
    arm = find_arm(limits)
    assert arm.name == entry["name"]
    assert "/" in arm.source
