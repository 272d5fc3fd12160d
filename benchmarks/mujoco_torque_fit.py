"""What MuJoCo's own identification finds for an arm whose torques are measured: PYTHON mujoco_torque_fit.py IN OUT.

Run by a Python that has mujoco[sysid] 4.0.0, not by that of dynident. IN holds what figaroh_fit.py takes, ``dq`` and
``ddq``; OUT is as that of figaroh_fit.py. The residual is the torque of ``mj_inverse`` less the measured one, each
joint's over its size; parameters are those of mujoco_fit.py, from the robot file and its starting values.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import mujoco_fit
import numpy as np
from mujoco import sysid

MAX_SAMPLES, STEPS, DIFFERENCE = 600, 20, 1e-5
WIDER = {"armature": (0.3, 0.0, 20.0), "damping": (3.0, 0.0, 500.0), "frictionloss": (1.0, 0.0, 200.0)}


def residual_of(spec: mujoco.MjSpec, recording: dict[str, Any]) -> Any:
    """Return the residual as the tool takes it, of at most so many samples."""
    rows = np.unique(np.linspace(0, len(recording["t"]) - 1, MAX_SAMPLES).astype(int))
    q, dq, ddq, tau = (recording[name][rows] for name in ("q", "dq", "ddq", "tau"))
    size = np.sqrt(np.mean(tau**2, axis=0)) + 1e-9

    def residual(x: np.ndarray, parameters: Any, **_: Any) -> Any:
        if x.ndim == 2:  # its derivatives are asked for together
            return [np.stack([residual(column, parameters)[0][0] for column in x.T], axis=1)], None, None
        parameters.update_from_vector(x)
        trial = spec.copy()
        sysid.apply_param_modifiers_spec(parameters, trial)
        model = trial.compile()
        data, predicted = mujoco.MjData(model), np.empty_like(tau)
        offset = np.array([parameters[f"offset_{joint.name}"].value[0] for joint in spec.joints])
        for k in range(len(q)):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[k], dq[k], ddq[k]
            mujoco.mj_inverse(model, data)
            predicted[k] = data.qfrc_inverse
        return [((predicted + offset - tau) / size).ravel()], None, None

    return residual


def main() -> None:
    recording = dict(np.load(sys.argv[1]))
    n = recording["q"].shape[1]
    recording |= {"reference_t": recording["t"], "kp": np.ones(n), "kv": np.ones(n), "limit": np.full(n, 1e6)}
    mujoco_fit.START.update(WIDER)
    mujoco_fit.OFFSET = (0.0, -50.0, 50.0)
    names = set(recording["joints"].tolist())
    tree = ElementTree.fromstring(str(recording["urdf"]))
    for body in tree.iter("body"):
        for joint in [joint for joint in body.findall("joint") if joint.get("name") not in names]:  # as of a gripper
            body.remove(joint)
    for equality in tree.findall("equality"):
        tree.remove(equality)
    spec = mujoco_fit.built(recording | {"urdf": ElementTree.tostring(tree, encoding="unicode")})
    for joint in spec.joints:  # some files have no masses
        if not joint.parent.mass > 0:
            joint.parent.mass, joint.parent.inertia = 1.0, [0.01, 0.01, 0.01]
    began = time.process_time()
    start = mujoco_fit.parameters(spec)
    parameters, _ = sysid.optimize(
        start, residual_of(spec, recording), "mujoco", max_iters=STEPS, verbose=False, eps=DIFFERENCE
    )
    seconds = time.process_time() - began
    fit = {"name": "torque residuals", "value": mujoco_fit.values(spec, parameters), "seconds": seconds}
    Path(sys.argv[2]).write_text(json.dumps([fit]))


if __name__ == "__main__":
    main()
