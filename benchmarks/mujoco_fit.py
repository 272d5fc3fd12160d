"""What MuJoCo's own identification finds for an arm in closed loop: PYTHON mujoco_fit.py IN.npz OUT.json.

Run by a Python that has mujoco[sysid] 4.0.0, not by that of dynident. IN holds what figaroh_fit.py takes, and
``reference_t`` (M) s, ``reference`` (M, n), ``kp``, ``kv`` and ``limit`` (n) of the drives, and of the row ``first``
the state ``q0``, ``dq0``, which the tool must be told. OUT is as that of figaroh_fit.py.

The drives are its actuators, so it simulates the loop; what it fits are positions and torques of the joints, each
scaled by its size, as its residual has them. Parameters are the pseudo-inertia of each link, armature, damping,
friction loss, and a constant torque; it starts from the robot file.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid
from mujoco.sysid import InertiaType, ModelSequences, Parameter, ParameterDict, SignalType, TimeSeries

STEPS, DIFFERENCE = 20, 1e-5  # at most; step of its derivatives: the solver of friction is iterative
START = {"armature": (0.3, 0.0, 5.0), "damping": (3.0, 0.0, 50.0), "frictionloss": (1.0, 0.0, 20.0)}  # and its limits
OFFSET = (0.0, -5.0, 5.0)


def built(recording: dict[str, Any]) -> mujoco.MjSpec:
    """The robot file with the drives as actuators, and what is measured as sensors."""
    spec = mujoco.MjSpec.from_string(str(recording["urdf"]))
    for mesh in list(spec.meshes):
        for geom in [geom for geom in spec.geoms if geom.meshname == mesh.name]:
            spec.delete(geom)
        spec.delete(mesh)
    for joint in spec.joints:  # given, not those of a geometry
        joint.parent.explicitinertial = True
    spec.option.timestep = float(np.median(np.diff(recording["reference_t"])))
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # the drives hold their force for a step
    spec.option.tolerance = 1e-12
    spec.option.gravity = recording["gravity"]
    spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
    for k, joint in enumerate(spec.joints):
        kp, kv, limit = (float(recording[name][k]) for name in ("kp", "kv", "limit"))
        joint.actfrclimited = False
        drive = spec.add_actuator(name=f"drive_{joint.name}", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        drive.gaintype, drive.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        drive.gainprm[0], drive.biasprm[:3] = kp * kv, [0.0, -kp * kv, -kv]
        drive.forcelimited, drive.forcerange = True, [-limit, limit]
        constant = spec.add_actuator(name=f"offset_{joint.name}", target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        constant.gaintype, constant.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        constant.gainprm[0] = 0.0
    for joint in spec.joints:
        force, drive = mujoco.mjtSensor.mjSENS_ACTUATORFRC, mujoco.mjtObj.mjOBJ_ACTUATOR
        spec.add_sensor(name=f"tau_{joint.name}", type=force, objtype=drive, objname=f"drive_{joint.name}")
    return spec


def parameters(spec: mujoco.MjSpec) -> ParameterDict:
    """What is sought, with what writes it into a model."""
    model, result = spec.compile(), ParameterDict()
    for joint in spec.joints:
        body = joint.parent.name
        result.add(sysid.body_inertia_param(spec, model, body, inertia_type=InertiaType.Pseudo, modifier=of_body(body)))
    for name, (start, low, high) in START.items():
        for joint in spec.joints:
            result.add(Parameter(f"{name}_{joint.name}", start, low, high, modifier=of_joint(joint.name, name)))
    for joint in spec.joints:
        result.add(Parameter(f"offset_{joint.name}", *OFFSET, modifier=of_offset(joint.name)))
    return result


def of_body(body: str) -> Any:
    def write(spec: mujoco.MjSpec, one: Parameter) -> None:
        sysid.apply_body_inertia(spec, body, one)
        spec.body(body).iquat = [1.0, 0.0, 0.0, 0.0]  # its own nan is refused by the compiler of 4.0.0

    return write


def of_joint(joint: str, name: str) -> Any:
    def write(spec: mujoco.MjSpec, one: Parameter) -> None:
        was = getattr(spec.joint(joint), name)
        setattr(spec.joint(joint), name, one.value[0] if np.ndim(was) == 0 else [one.value[0], *was[1:]])

    return write


def of_offset(joint: str) -> Any:
    def write(spec: mujoco.MjSpec, one: Parameter) -> None:
        spec.actuator(f"offset_{joint}").biasprm[0] = -one.value[0]

    return write


def sequences(spec: mujoco.MjSpec, recording: dict[str, Any]) -> ModelSequences:
    """The recording as the tool takes it."""
    model, first = spec.compile(), int(recording["first"])
    t, begin = recording["t"][first:], recording["t"][first]
    used = recording["reference_t"] >= begin - model.opt.timestep / 2
    control = np.zeros((int(used.sum()), model.nu))
    control[:, ::2] = recording["reference"][used]  # drives and offsets take turns
    names = [joint.name for joint in spec.joints]
    # a sensor has the force of the step before its time, a state is that of its time
    torque = np.stack([np.interp(t - model.opt.timestep / 2, recording["t"], x) for x in recording["tau"].T], axis=1)
    measured = np.concatenate([torque, recording["q"][first:]], axis=1)  # the tool wants sensors before states
    signals = [(f"tau_{name}", SignalType.MjSensor) for name in names]
    signals += [(f"{name}_qpos", SignalType.MjStateQPos) for name in names]
    state = sysid.create_initial_state(model, recording["q0"], recording["dq0"])
    return ModelSequences(
        "arm", spec, "recording", state,
        TimeSeries.from_control_names(recording["reference_t"][used] - begin, control, model),
        TimeSeries.from_names(t - begin, measured, model, signals), allow_missing_sensors=True,
    )  # fmt: skip


def values(spec: mujoco.MjSpec, parameter_dict: ParameterDict) -> list[float]:
    """All parameters, in the order of the answer."""
    done = spec.copy()
    sysid.apply_param_modifiers_spec(parameter_dict, done)
    links = []
    for joint in done.joints:
        m, hx, hy, hz, *inertia = sysid.model_modifier.pi_from_body(done, joint.parent.name)
        xx, xy, xz, _, yy, yz, _, _, zz = inertia
        links += [m, hx, hy, hz, xx, xy, yy, xz, yz, zz]
    drives = [parameter_dict[f"{name}_{joint.name}"].value[0] for name in (*START, "offset") for joint in done.joints]
    return [float(x) for x in (*links, *drives)]


def main() -> None:
    recording = dict(np.load(sys.argv[1]))
    spec = built(recording)
    began = time.process_time()
    residual = sysid.build_residual_fn(models_sequences=[sequences(spec, recording)], n_threads=1)
    steps = int(sys.argv[3]) if len(sys.argv) > 3 else STEPS
    result, _ = sysid.optimize(parameters(spec), residual, "mujoco", max_iters=steps, verbose=False, eps=DIFFERENCE)
    seconds = time.process_time() - began
    fit = {"name": "output error in closed loop", "value": values(spec, result), "seconds": seconds}
    Path(sys.argv[2]).write_text(json.dumps([fit]))


if __name__ == "__main__":
    main()
