"""An arm from a robot file: record, identify physically consistent, save, load again, predict another motion."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import dynident as dy

URDF = """<robot name="arm"><link name="base"/>
<link name="upper"><inertial><origin xyz="0.15 0.01 0"/><mass value="2.0"/>
<inertia ixx="0.003" iyy="0.02" izz="0.021" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.1 0 0.02"/><mass value="1.1"/>
<inertia ixx="0.001" iyy="0.006" izz="0.0065" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
<limit lower="-2" upper="2" effort="40" velocity="4"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="fore"/><origin xyz="0.3 0 0"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" effort="20" velocity="6"/></joint></robot>"""


def recorded(robot, name, rate, rng):
    """Return what the sensors would show of a robot that is 20 % heavier than its file says, and has friction."""
    friction = {"Fv": 0.4, "Fc": 0.6, "offset": 0.1, "Ia": 0.02}
    truth = [1.2 * one.value if one.body else friction[one.name.partition("_")[0]] for one in robot.parameters]
    t = np.arange(6001) * 0.002
    amplitude, w = np.array([[0.7, 0.5], [0.4, 0.6]]), rate * np.array([[1.0, 1.7], [2.3, 3.1]])
    wave = [np.sum(amplitude * w**k * np.sin(w * t[:, None, None] + k * np.pi / 2), axis=1) for k in range(3)]
    tau = robot.torque(*wave, truth)
    q = wave[0] + 1e-4 * rng.standard_normal(tau.shape)
    return dy.Log(t, q, tau + 0.05 * rng.standard_normal(tau.shape), ("shoulder", "elbow"), name)


with TemporaryDirectory() as folder:
    file = Path(folder, "arm.urdf")
    file.write_text(URDF)
    robot, rng = dy.read_robot(file), np.random.default_rng(0)
    logs = {name: recorded(robot, name, rate, rng) for name, rate in (("mon", 1.0), ("tue", 1.2), ("wed", 0.9))}

    found = dy.identify(file, {"mon": logs["mon"]}, {"tue": logs["tue"]})  # physically consistent: it has bodies
    print(found)
    found.save(Path(folder, "result.json"))

    prediction = dy.load(Path(folder, "result.json")).predict(logs["wed"])
    print(prediction)
    print(*(written.name for written in dy.export_model(found, Path(folder, "model"))))
