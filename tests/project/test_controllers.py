"""The controller of a recording, as a configuration describes it."""

import numpy as np
import pytest

from dynident.models import Joint
from dynident.project.config import parse_config
from dynident.project.logs import read_logs
from dynident.runtime import ConfigError, InputError
from tests.project.files import npz, written

SLIDER = (Joint("slider", "prismatic"),)
CASCADE = """{kind: cascade, joints: {slider: {reference: {column: r, unit: mm}, kp: kp, kv: 3, gain: -2,
                                               saturation: 10, feedforward: {b: extra}}}}"""


def config_of(folder, simulation: str, head: str = "", **how):
    text = f"""
    model: gallery:slider
    time: {{column: t, unit: s}}
    position: {{slider: {{column: x, unit: m}}}}
    torque: {{slider: {{column: u, unit: N}}}}
    train: [{{file: a.npz}}]
    validation: [{{file: b.npz, window: [[0, 0.4], [0.6, 1]]}}]
    simulation: {simulation}
    {head}
    """
    return parse_config(text, folder, **how)


def recordings(folder, **changes):
    t = np.arange(101) * 0.01
    columns = {"t": t, "x": np.sin(t), "u": np.cos(t), "r": 1000 * np.sin(t), "kp": 20.0, **changes}
    written(folder, "a.npz", npz(**columns))
    written(folder, "b.npz", npz(**columns, extra=np.arange(101.0) / 100))


def test_a_cascade_has_its_gains_and_references_from_the_file(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE)
    (log,) = read_logs(config.train[0], config, SLIDER).logs
    drive = log.controller
    assert drive.joints == ("slider",)
    assert drive(0.5, np.array([np.sin(0.5) - 0.01]), np.zeros(1)) == pytest.approx(-2 * 3 * 20 * 0.01)
    assert drive(0.5, np.array([-9.0]), np.zeros(1)) == pytest.approx(-20.0)


def test_feedforward_is_that_of_the_recording_that_has_one_in_all_its_windows(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE)
    early, delayed = read_logs(config.validation[0], config, SLIDER).logs
    for log, t in ((early, 0.2), (delayed, 0.8)):
        at_rest = log.controller(t, np.array([np.sin(t)]), np.zeros(1))
        assert at_rest == pytest.approx(-2 * t)


def test_a_controller_behind_gears_is_refused(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE, "transmission: {slider: {slider: 5}}")
    with pytest.raises(ConfigError, match="use `kind: measured_torque`"):
        read_logs(config.train[0], config, SLIDER)


PD = """{kind: pd, joints: {slider: {reference: {column: r, unit: mm}, kp: kp, kd: 3, gain: 2, saturation: 10,
                                     velocity_reference: {column: v, unit: mm/s}}}}"""
PID = PD.replace("kind: pd", "kind: pid").replace("kd: 3", "kd: 3, ki: 5")
LAW = """{kind: "law.py:law", settings: {k: 7}, joints: {slider: {reference: {column: r, unit: mm}, gain: 2,
                                                                    saturation: 10}}}"""


def controlled(folder, simulation, **changes):
    recordings(folder, v=1000 * np.cos(np.arange(101) * 0.01), **changes)
    (folder / "law.py").write_text("def law(t, q, dq, reference, k=1.0):\n    return k * (reference - q) - dq\n")
    config = config_of(folder, simulation)
    return read_logs(config.train[0], config, SLIDER).logs[0].controller


def test_a_pid_controller_has_its_integral(tmp_path):
    assert controlled(tmp_path, PID.replace("kp: kp", "kp: 0")) is not None
    drive = controlled(tmp_path, PID)
    q, dq = np.array([np.sin(0.5) - 0.01]), np.array([np.cos(0.5)])
    tau, state = drive.advance(0.5, 0.01, q, dq, np.array([0.1]))
    assert state == pytest.approx(0.1 + 0.01 * 0.01)
    assert tau == pytest.approx(2 * (20 * 0.01 + 5 * state))


def test_a_function_gets_time_state_reference_and_settings(tmp_path):
    drive = controlled(tmp_path, LAW)
    q, dq = np.array([np.sin(0.5) - 0.01]), np.array([0.2])
    assert drive(0.5, q, dq) == pytest.approx(2 * (7 * 0.01 - 0.2))


REFERENCE = "the reference of the controller is not one valid number"


@pytest.mark.parametrize(
    ("simulation", "old", "new", "words"),
    [
        ("{kind: other}", "", "", "simulation: 'other' is not a choice"),
        ("{restart: 1}", "", "", "simulation: needs a `kind`: cascade"),
        ("3", "", "", "simulation: a mapping"),
        ("{kind: measured_torque, restart: 0}", "", "", "simulation.restart: a number greater than 0"),
        (CASCADE, "slider: {reference", "sledge: {reference", "no joint 'sledge'; did you mean 'slider'"),
        (CASCADE, "unit: mm", "unit: deg", "simulation.joints.slider.reference.unit"),
        (CASCADE, "{b: extra}", "{c: extra}", "there is no recording 'c'"),
        (CASCADE, "{b: extra}", "extra", "no column 'extra'"),
        (CASCADE, "saturation: 10", "saturation: -1", "saturation is -1; give a positive number"),
        (CASCADE, "kp: kp", "kp: kq", "simulation.joints.slider.kp: no scalar 'kq'"),
        (CASCADE, "column: r", "column: s", "no column 's'"),
        (CASCADE, "column: r", "column: short", f"{REFERENCE} per time stamp"),
        (CASCADE, "column: r", "column: nothing", REFERENCE),
        (CASCADE, "kv: 3", "kv: 0", "simulation.joints.slider: with these gains"),
        (PD, "kp: kp", "kp: 0", "simulation.joints.slider: with these gains, of which one is 0, the joint does not"),
        (PD, "mm/s", "rad/s", "velocity_reference.unit: 'rad/s' is a unit of angular velocity, not of velocity"),
        (PD, "column: v", "column: w", "simulation.joints.slider.velocity_reference|no column 'w'"),
        (PD, "kd: 3, ", "", "simulation.joints.slider.kd: "),
        (PD, "kd: 3", "kd: 3, ki: 1", "unknown key 'ki'"),
        (PD, "saturation: 10", "saturation: 0", "joints.slider.saturation: saturation is 0; give a positive"),
        (LAW, "law.py:law", "law.py:low", "has no function 'low'; did you mean 'law'"),
        (LAW, "law.py:law", "low.py:law", "simulation"),
        (LAW, "law.py:law", "law:law", "'law:law' is not a choice"),
    ],
)
def test_what_cannot_be_a_controller_names_place_and_cure(tmp_path, simulation, old, new, words):
    with pytest.raises((ConfigError, InputError), match=words):
        controlled(tmp_path, simulation.replace(old, new), short=np.arange(100.0), nothing=np.full(101, np.nan))


def test_a_result_does_not_run_the_file_of_a_function_unasked(tmp_path):
    with pytest.raises(ConfigError, match=r"law.py:law' is of a Python file, which a result does not run"):
        config_of(tmp_path, LAW, allow_code=False)


def test_a_drive_may_be_faster_than_its_log_and_see_another_velocity(tmp_path):
    recordings(tmp_path)
    config = config_of(tmp_path, CASCADE.replace("cascade,", "cascade, period: 0.0025, velocity_steps: 2,"))
    (log,) = read_logs(config.train[0], config, SLIDER).logs
    drive = log.controller
    assert drive.steps == 2
    assert len(drive.t) == 401
    between = 0.5 * (np.sin(0.5) + np.sin(0.51))
    assert drive(0.505, np.array([between - 0.01]), np.zeros(1)) == pytest.approx(-2 * 3 * 20 * 0.01)
    config = config_of(tmp_path, CASCADE.replace("cascade,", "cascade, period: 0.004,"))
    with pytest.raises(ConfigError, match=r"simulation.period: .*a.npz: period = 0.004 s does not fit the 0.01 s"):
        read_logs(config.train[0], config, SLIDER)
    for wrong in ("period: 0", "period: fast", "velocity_steps: 0", "velocity_steps: 1.5"):
        with pytest.raises(ConfigError, match=wrong.partition(":")[0]):
            config_of(tmp_path, CASCADE.replace("cascade,", f"cascade, {wrong},"))
