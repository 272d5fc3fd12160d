"""What mujoco.sysid finds of a servo arm of unknown delay: it is run at each delay of a scan by 10 ms, then
around the best of it, then longer at the best of them.

Needs the extra mujoco[sysid]. Parameters are armature, damping and frictionloss of each joint, from the file's values,
within a thirtieth and thirty times of them; the residual is that of positions, as the tool has it.
"""

from __future__ import annotations

import time
from contextlib import redirect_stdout
from io import StringIO
from typing import Any

import mujoco
import numpy as np
from mujoco import sysid as tool
from mujoco.sysid import ModelSequences, Parameter, ParameterDict, SignalType, TimeSeries
from servo import KINDS, SCAN, Outcome
from servo_arm import NAMES, ServoArm, held_means

ROUGH_STEPS, STEPS = 6, 10
DIFFERENCE = 1e-5


def sysid(arm: ServoArm, seed: int, duration: float) -> Outcome:
    """Return what the tool finds with the best delay of a scan, and the CPU of all its runs."""
    t, command, q, _ = arm.record(seed, duration)
    text = arm.text(nominal=True)
    start = time.process_time()
    rough = {float(delay): _fit(text, t, command, q, float(delay), ROUGH_STEPS) for delay in SCAN}
    # around the best of the scan again by 1 ms, from what was found there
    middle = min(rough, key=lambda delay: rough[delay][1])
    near = rough[middle][0]
    rough |= {
        middle + 1e-3 * k: _fit(text, t, command, q, middle + 1e-3 * k, ROUGH_STEPS, near)
        for k in (-5, -3, -2, -1, 1, 2, 3, 5)
    }
    delay = min(rough, key=lambda delay: rough[delay][1])
    result, _ = _fit(text, t, command, q, delay, STEPS, rough[delay][0])
    values = np.array([[result[f"{kind}_{name}"].value[0] for name in NAMES] for kind in KINDS])
    return Outcome(values, delay, time.process_time() - start)


def _fit(text: str, t: Any, command: Any, q: Any, delay: float, steps: int, start: Any = None) -> tuple[Any, float]:
    """Return the tool's parameters at a delay, from those of ``start`` or of the file, and their squared error."""
    spec = mujoco.MjSpec.from_string(text)  # the tool changes it
    model = spec.compile()
    step = model.opt.timestep
    times = np.arange(0.0, t[-1] + step / 2, step)
    control = held_means(t, command, np.append(times, times[-1] + step) - delay)
    state = tool.create_initial_state(model, q[0], np.zeros(len(NAMES)))
    signals = [(f"{name}_qpos", SignalType.MjStateQPos) for name in NAMES]
    recording = ModelSequences(
        "arm", spec, "recording", state, TimeSeries.from_control_names(times, control, model),
        TimeSeries.from_names(t, q, model, signals), allow_missing_sensors=True,
    )  # fmt: skip
    parameters = ParameterDict()
    for kind in KINDS:
        for name in NAMES:
            value = float(np.atleast_1d(getattr(spec.joint(name), kind))[0])
            parameters.add(Parameter(f"{kind}_{name}", value, value / 30, 30 * value, modifier=_writer(name, kind)))
    if start is not None:
        parameters.update_from_vector(start.as_vector())
    residual = tool.build_residual_fn(models_sequences=[recording], n_threads=1)
    with redirect_stdout(StringIO()):
        result, done = tool.optimize(parameters, residual, "mujoco", max_iters=steps, verbose=False, eps=DIFFERENCE)
    errors = np.concatenate([np.ravel(part) for part in residual(done.x, result)[0]])
    return result, float(errors @ errors)


def _writer(joint: str, kind: str) -> Any:
    def write(spec: mujoco.MjSpec, parameter: Parameter) -> None:
        was = getattr(spec.joint(joint), kind)
        value = parameter.value[0]
        setattr(spec.joint(joint), kind, value if np.ndim(was) == 0 else [value, *was[1:]])

    return write
