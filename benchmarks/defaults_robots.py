"""The measured robots of benchmarks/defaults.py: what a user must say of each, and what error is aimed at."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

__all__ = ["RAIL", "ROBOTS", "Robot"]

QUARTER = 1.5707963267948966
PENDULUM = ("060143", "060245", "060329", "060440", "061705")


@dataclass(frozen=True)
class Robot:
    """A measured robot: its robot file or the text of one, and its recordings, as ``init`` is given them; what the user
    says beside; the marks.

    Windows (s) are those to fit and to judge by. ``mark`` is the error (%) that is aimed at on the first held-out log,
    ``floor`` what the noise of its torque leaves, ``refit`` what a fit to the held-out log itself leaves.
    """

    title: str
    model: str
    logs: tuple[str, ...]
    mark: float | None
    declared: Mapping[str, Any] = field(default_factory=dict)
    windows: tuple[tuple[float, float | None], tuple[float, float | None]] | None = None
    more: tuple[str, ...] = ()  # further recordings held out
    example: str = ""  # the configuration set by hand
    floor: str = ""
    refit: str = ""


RAIL = """<robot name="emps"><link name="rail"/><link name="carriage"/><joint name="slider" type="prismatic">
<parent link="rail"/><child link="carriage"/><axis xyz="1 0 0"/></joint></robot>"""  # what a user writes of a drive
_PANDA = "+".join(f"panda/exciting_traj_{name}.txt" for name in ("positions", "time", "torques"))
_PENDULUM = "double_pendulum/20220812-{}-PM_measured.csv"
_TX40 = {
    "time": {"rate": 5000},
    "position": {f"joint_{k}": {"column": f"pos_read.Joint_{k}", "unit": "rad"} for k in range(1, 7)},
    "torque": {f"joint_{k}": {"column": f"curr.Joint_{k}", "unit": "N m"} for k in range(1, 7)},
    "transmission": {
        "joint_1": {"joint_1": 32}, "joint_2": {"joint_2": 32}, "joint_3": {"joint_3": 45},
        "joint_4": {"joint_4": -48}, "joint_5": {"joint_5": 45}, "joint_6": {"joint_5": 32, "joint_6": 32},
    },
    "zero": {"joint_2": -QUARTER, "joint_3": QUARTER},
    "model": {"couplings": {"m6": {"joints": {"joint_5": 1, "joint_6": 1}}}},
}  # fmt: skip
_ELBOW = {"joints": {"Joint1": 1, "Joint2": -6}, "terms": ["rotor"]}
ROBOTS: Mapping[str, Robot] = {
    "emps": Robot(
        "EMPS, on its pulses",
        RAIL,
        ("emps/DATA_EMPS.mat", "emps/DATA_EMPS_PULSES.mat"),
        7.3,
        {"torque": {"slider": {"column": "vir", "gain": "gtau", "unit": "N"}}},
        example="emps",
        floor="0.2",
        refit="6.0",
    ),
    "lwr4": Robot(
        "LWR4, on a repeat",
        "lwr4/kuka_lwr4.urdf",
        ("lwr4/measurements_1.npz", "lwr4/measurements_2.npz"),
        2.1,
        example="lwr4",
        floor="about 0",
        refit="0.6",
    ),
    "panda": Robot(
        "Panda, fit 70 %, test 30 %",
        "panda/panda.urdf",
        (_PANDA,),
        2.7,
        windows=((0.0, 14.7), (14.7, None)),
        floor="0.5",
        refit="2.0",
    ),
    "panda_period": Robot(
        "Panda, within one period",
        "panda/panda.urdf",
        (_PANDA,),
        None,
        windows=((0.0, 9.33), (9.33, 13.33)),
        example="panda",
        floor="0.5",
    ),
    "tx40": Robot(
        "TX40, fit 5 s, test 2.4 s",
        "tx40/tx40_mdh_modified.urdf",
        ("tx40/pos_read_data.csv+tx40/curr_data.csv",),
        15.5,
        _TX40,
        ((0.0, 5.0), (5.0, 7.4)),
        example="tx40",
        floor="13.9",
        refit="15.6",
    ),
    "double_pendulum": Robot(
        "Double pendulum, fit 50 s, test 25 s",
        "double_pendulum/double_pendulum.urdf",
        (_PENDULUM.format("061157"),),
        9.5,
        {"model": {"couplings": {"elbow_motor": _ELBOW}}},
        ((0.0, 50.0), (50.0, None)),
        tuple(_PENDULUM.format(name) for name in PENDULUM),
        example="double_pendulum",
        floor="6.4",
        refit="8.2",
    ),
}
