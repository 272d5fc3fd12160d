"""From `init` or `excite --for servo` to a model of MuJoCo, of positions and of torques; `check` and `predict`."""

import json
import sys
from dataclasses import replace

import mujoco
import numpy as np
import polars as pl
import pytest
from pydantic import ValidationError

import dynident as dy
from dynident.apps.demo.servo_arm import (
    FILE_VALUES,
    KP,
    SERVO_JOINTS,
    TRUE_DELAY,
    TRUE_VALUES,
    play_commands,
    servo_mjcf,
)
from dynident.apps.servo import servo_page
from dynident.apps.servo.commands import command_findings
from dynident.apps.servo.fit import split_into_windows, window_residuals
from dynident.apps.servo.plant import ServoLog, import_mujoco
from dynident.apps.servo.run import nominal_values
from dynident.apps.servo.start import smooth_servo_log
from dynident.apps.servo.values import FRICTION
from dynident.project.drive_settings import ServoSettings
from dynident.runtime import ModelError
from tests.apps.servo.arms import ONES, motor_mjcf, plant, torque_recording, values
from tests.apps.servo.made import identified
from tests.cli.commands import refuse, run, succeed


def test_the_demo_drafts_identifies_and_compares_with_the_truth(demo_output, folder) -> None:
    output = demo_output[1]
    assert "servos: good for simulation" in output
    assert float(output.partition("dry friction are at most ")[2].split()[0]) < 2.0  # %
    assert "kp: 17.8, limit: 3.35" in (folder / "servos.yaml").read_text()
    numbers = json.loads((folder / "servos" / "servo.json").read_text())
    assert (numbers["warnings"], numbers["backlash"]) == ([], [])
    rows = {(row["joint"], row["quantity"]): row for row in numbers["parameters"]}
    assert rows[None, "delay"]["value"] == pytest.approx(TRUE_DELAY, abs=5e-4)
    assert rows[None, "delay"]["file"] is None  # which a robot file does not say
    for k, joint in enumerate(numbers["joints"]):
        assert rows[joint, "armature"]["value"] == pytest.approx(TRUE_VALUES["armature"][k], rel=0.02)
        assert rows[joint, "damping"]["low"] < rows[joint, "damping"]["high"]
    model = mujoco.MjModel.from_xml_path(str(folder / "servos" / "robot.xml"))
    assert model.dof_damping == pytest.approx(TRUE_VALUES["damping"], rel=0.02)
    page = (folder / "servos" / "report.html").read_text()
    assert "armature of elbow" in page
    assert "good for simulation" in page


def test_commands_of_torques_say_what_they_need(folder) -> None:
    refuse("bound", "servos.yaml", says="have no torque, which this needs")
    refuse("watch", "servos/servo.json", "x.csv", says="which only `dynident predict` and `dynident export` read")
    refuse("identify", "servos.yaml", "--write-config", "x.yaml", says="leave it out")


def test_torque_beside_servos_and_neither_are_refused(folder) -> None:
    text = (folder / "servos.yaml").read_text()
    changes = {
        text + "torque: { base: { column: cmd_base, unit: N m } }\n": "`torque` is left out",
        text.partition("simulation:")[0] + "train: [{ file: monday.csv }]\n": "`torque` is missing",
        "\n".join(line for line in text.splitlines() if "elbow: { command" not in line): "simulation.joints",
    }
    for change, words in changes.items():
        (folder / "changed.yaml").write_text(change)
        refuse("identify", "changed.yaml", says=words)


def test_without_mujoco_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"dynident\[mujoco\]"):
        import_mujoco()


def test_the_files_of_the_demo_alone(tmp_path) -> None:
    succeed("demo", "--servo", "--files", "--out", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["monday.csv", "servos.xml", "tuesday.csv"]


def test_a_kp_of_zero_in_the_file_is_none() -> None:
    """So that it is sought, as where the actuator says nothing of it."""
    servo = {"command": {"column": "x", "unit": "rad"}, "kp": "estimate"}
    settings = ServoSettings.model_validate({"kind": "servo", "joints": dict.fromkeys(SERVO_JOINTS, servo)})
    text = servo_mjcf(FILE_VALUES).replace(f'joint="elbow" kp="{KP}"', 'joint="elbow" kp="0"')
    np.testing.assert_array_equal(nominal_values(plant(text), settings).kp, [KP, KP, np.nan])


def test_positions_before_their_commands_are_a_warning(folder) -> None:
    # without damping the digits of the written values grow in the simulation that proves them
    table = pl.read_csv("monday.csv").head(300)
    columns = [pl.col(name).shift(-10).forward_fill() for name in table.columns if name.startswith("pos")]
    table.with_columns(columns).write_csv("early.csv")
    succeed("init", "servos.xml", "early.csv", "-o", "early.yaml")
    output = " ".join(succeed("identify", "early.yaml").output.split())
    assert "commands are interpolated: so the positions are explained better" in output
    assert "ms before their commands" in output


def play(commands: str, out: str) -> None:
    """Record what the demo's arm does by the commands of a file."""
    table = pl.read_csv(commands)
    q = play_commands(table.select([f"cmd_{name}" for name in SERVO_JOINTS]).to_numpy())
    table.with_columns(**{f"pos_{name}": q[:, k] for k, name in enumerate(SERVO_JOINTS)}).write_csv(out)


def test_chirps_keep_their_limits_and_show_the_arm(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(servo_mjcf(FILE_VALUES))
    (tmp_path / "limits.yaml").write_text("limits: { elbow: { lower: 0.3, upper: 1.0, velocity: 0.4 } }\n")
    done = run("excite", "--for", "servo", "arm.xml", "-o", "next", "--settings", "limits.yaml", "--duration", "8")
    assert done.exit_code == 0, done.output
    table = pl.read_csv("next/motion.csv")
    assert len(table) == 800
    elbow = table["cmd_elbow"].to_numpy()
    assert 0.3 < elbow.min() < elbow.max() < 1.0
    for name, fastest in (("elbow", 0.4), ("base", 1.5)):
        speed = np.gradient(table[f"cmd_{name}"].to_numpy(), 0.01)
        assert 0.3 * fastest < np.abs(speed).max() < fastest
        assert np.abs(speed[[0, -1]]).max() < 0.02
    for name in ("motion", "validation"):
        play(f"next/{name}.csv", f"next/{name}_recorded.csv")
    done = run("identify", "next/identify.yaml", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "good for simulation" in done.output
    model = mujoco.MjModel.from_xml_path("out/robot.xml")
    assert model.dof_damping == pytest.approx(TRUE_VALUES["damping"], rel=0.03)
    assert model.dof_armature == pytest.approx(TRUE_VALUES["armature"], rel=0.05)


def test_settings_are_followed_and_what_cannot_be_designed_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(servo_mjcf(FILE_VALUES))
    (tmp_path / "pose.yaml").write_text("start: { elbow: 0.3 }\nlimits: { elbow: { lower: 0.29, upper: 0.3 } }\n")
    (tmp_path / "x.yaml").write_text("model: arm.xml\n")
    refused = run("excite", "--for", "servo", "x.yaml", "-o", "a")
    assert "takes a robot file" in " ".join(refused.output.split())
    refused = run("excite", "--for", "servo", "arm.xml", "-o", "b", "--settings", "pose.yaml")
    assert "joint 'elbow' has no room" in " ".join(refused.output.split())
    (tmp_path / "rate.yaml").write_text("rate: 50\nduration: 5\n")
    assert run("excite", "--for", "servo", "arm.xml", "-o", "c", "--settings", "rate.yaml").exit_code == 0
    assert len(pl.read_csv("c/motion.csv")) == 250
    refused = run("excite", "--for", "servo", "arm.xml", "-o", "d", "--program", "friction", "--file-rate", "50")
    assert "--program, --file-rate: of no use with --for servo" in " ".join(refused.output.split())
    again = run("excite", "--for", "servo", "arm.xml", "-o", "c")
    assert "exists already" in " ".join(again.output.split())


DELAY, GEAR = 0.012, 2.0


def test_the_values_of_motors_are_found_from_commanded_torques(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "motors.xml").write_text(motor_mjcf(FILE_VALUES, GEAR))
    for name, seed in (("monday", 1), ("tuesday", 2)):
        log = torque_recording(seed)
        head = ",".join(["time", *(f"ctrl_cmd_{x}" for x in SERVO_JOINTS), *(f"pos_{x}" for x in SERVO_JOINTS)])
        rows = np.column_stack([log.t, log.command / [1, 1, GEAR], log.q])
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header=head, comments="")
    drafted = run("init", "motors.xml", "monday.csv", "tuesday.csv", "-o", "motors.yaml")
    assert drafted.exit_code == 0, drafted.output
    assert (
        "column: ctrl_cmd_elbow, gain: 2, unit: N m }, limit: 6.7 }  # a torque"
        in (tmp_path / "motors.yaml").read_text()
    )
    done = run("identify", "motors.yaml", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "good for simulation" in done.output
    numbers = json.loads((tmp_path / "out" / "servo.json").read_text())
    result = {(row["joint"], row["quantity"]): row["value"] for row in numbers["parameters"]}
    assert result[None, "delay"] == pytest.approx(DELAY, abs=3e-4)
    truth = values()
    for k, joint in enumerate(SERVO_JOINTS):
        for quantity in FRICTION:
            assert result[joint, str(quantity)] == pytest.approx(getattr(truth, quantity)[k], rel=0.02)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "out" / "robot.xml"))
    assert model.actuator_biastype.tolist() == [0, 0, 0]
    assert model.actuator_gear[2, 0] == GEAR


def test_windows_do_not_see_the_states_that_they_start_from() -> None:
    arm, truth = plant(motor_mjcf(FILE_VALUES)), replace(values(delay=DELAY), kp=0 * ONES)
    motion = smooth_servo_log(torque_recording())
    windows = split_into_windows(arm, motion, truth).windows
    assert windows.starts[1:] == windows.stops[:-1]
    assert windows.stops[-1] == len(motion.log.t)
    exact = np.vstack(window_residuals(arm, motion, windows, truth))
    # a wrong speed at the start moves the arm by mrad, of which next to nothing remains
    hasty = replace(motion, dq=motion.dq + 0.05)
    moved = arm.rollout(truth, motion.log, windows.starts, windows.stops, hasty.speeds)
    assert np.abs(moved[3] - motion.log.q[windows.starts[3] : windows.stops[3]]).max() > 1.5e-3
    assert np.abs(np.vstack(window_residuals(arm, hasty, windows, truth)) - exact).max() < 2e-4


def test_a_commanded_torque_is_not_drawn_as_a_position() -> None:
    angles = identified()
    torques = replace(angles, fit=replace(angles.fit, values=replace(angles.fit.values, kp=0 * ONES)))
    drawn = ['"name":"command"' in servo_page(result) for result in (angles, torques)]
    assert drawn == [True, False]


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"kp": 3.0, "ki": 1.0}, "has no actuator with an integral"),
        ({}, "needs `kp` for a command in rad"),
        ({"kp": 3.0, "command": {"column": "x", "unit": "N m"}}, "leave it out for a command in N m"),
    ],
)
def test_what_no_servo_is_has_a_sentence(settings, words) -> None:
    servo = {"command": {"column": "x", "unit": "rad"}} | settings
    with pytest.raises(ValidationError, match=words):
        ServoSettings.model_validate({"kind": "servo", "joints": {"a": servo}})


@pytest.fixture
def config(folder) -> str:
    return (folder / "servos.yaml").read_text()


def messages(name: str) -> tuple[int, list[tuple[str, str, str | None]]]:
    """Severity, words and joint of what `check` finds, with its exit code."""
    code = run("check", name, "--json", "check.json").exit_code
    with open("check.json", encoding="utf-8") as file:
        findings = json.load(file)[name]["findings"]
    return code, [(finding["severity"], finding["message"], finding["joint"]) for finding in findings]


def test_a_right_log_has_its_rate_and_delay(folder) -> None:
    code, result = messages("servos.yaml")
    assert code == 0
    assert [severity for severity, *_ in result] == ["info"]
    assert float(result[0][1].split()[6]) == pytest.approx(1e3 * TRUE_DELAY, abs=4)
    (facts, _) = json.loads((folder / "check.json").read_text())["servos.yaml"]["logs"].values()
    assert (facts["samples"], facts["missing"]) == (600, 0)


def test_periodic_motion_is_neither_turned_nor_early() -> None:
    t = np.arange(0.0, 6.0, 0.01)
    q = 0.3 * np.sin(2 * np.pi * np.outer(t, (4.0, 1.0, 0.3)))
    log = ServoLog("sine", t, q, t, 0.3 * np.sin(2 * np.pi * np.outer(t + 0.05, (4.0, 1.0, 0.3))))
    assert not list(command_findings([smooth_servo_log(log)], ("a", "b", "c"), np.zeros(3, dtype=bool)))


def test_what_is_wrong_with_a_log_is_said(config, folder) -> None:
    table, degrees = pl.read_csv("monday.csv"), 180 / np.pi
    later = [pl.col(f"pos_{joint}").shift(-10).forward_fill() for joint in ("base", "shoulder", "elbow")]
    still = pl.lit(0.3) + 0 * pl.col("pos_elbow")
    logs = {
        "swapped": (table.rename({"cmd_base": "cmd_elbow", "cmd_elbow": "cmd_base"}), "it follows that of 'elbow'"),
        "degrees": (table.with_columns(pl.col("cmd_base") * degrees), "the command spans 55.8 times"),
        "turned": (table.with_columns(-pl.col("cmd_base")), "goes against its command"),
        "constant": (table.with_columns(cmd_base=pl.lit(0.1)), "its command hardly changes"),
        "early": (table.with_columns(later), "ms before their commands"),
        "clocks": (table.with_columns(later), "are both stamped by one clock?"),
        "slow": (table[::5], "20 Hz shows little"),
        "missing": (table.drop("cmd_base"), "simulation.joints.base.command: no column 'cmd_base'"),
        "still": (table.with_columns(pos_elbow=still), "elbow"),
    }
    cases = [(name, config.replace("monday.csv", f"{name}.csv"), words) for name, (_, words) in logs.items()]
    for name, (data, _) in logs.items():
        data.write_csv(f"{name}.csv")
    cases.append(("weak", config.replace("limit: 3.35", "limit: 0.5"), "the servo is at its limit of 0.5"))
    cases.append(("alone", config.partition("validation:")[0], "no recording is held out"))
    for name, text, words in cases:
        (folder / "wrong.yaml").write_text(text)
        code, result = messages("wrong.yaml")
        severity = "error" if name in ("missing", "still") else "warning"
        assert any(kind == severity and words in message for kind, message, _ in result), (name, result)
        assert code == (severity == "error")


def test_servos_at_their_limits_are_named_and_python_has_the_same_result(config, folder) -> None:
    text = config.replace("limit: 3.35", "limit: 0.5").replace("commands: estimate", "commands: held")
    text = text.partition("validation:")[0].replace("delay: estimate", f"delay: {TRUE_DELAY}")
    (folder / "weak.yaml").write_text(text.replace("monday.csv", "monday.csv\n    window: [0, 1.5]"))
    result = dy.identify_servos("weak.yaml", "weak")
    assert any("the servo is at its limit of 0.5" in words for words in result.warnings)
    assert repr(result).startswith("<ServoIdentification of 'servos': not judged: no recording is held out")
    saved = json.loads((folder / "weak" / "servo.json").read_text())
    assert result.frame()["value"].to_list() == [row["value"] for row in saved["parameters"]]


def test_a_rollout_of_another_recording_is_that_of_the_report(folder) -> None:
    succeed("predict", "servos/servo.json", "tuesday.csv", "--out", "positions.csv")
    table = pl.read_csv("positions.csv")
    result = json.loads((folder / "servos" / "servo.json").read_text())
    error = (table["simulated_elbow"] - table["measured_elbow"]).to_numpy()[table["t"].to_numpy() > 0.5]
    assert np.sqrt((error**2).mean()) == pytest.approx(result["rollouts"][1]["whole"][2], rel=0.01)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"parameters": [{"quantity": "colour", "joint": None, "value": 1.0}]}, "is no result of servos"),
        ({"parameters": [{"quantity": "armature", "joint": "tail", "value": 1.0}]}, "is no result of servos"),
        ({"parameters": [{"quantity": "damping", "joint": "elbow", "value": "nan"}]}, "not finite"),
        ({"configuration": {"path": "arm.yaml"}}, "is no result of servos"),
        ({"version": 2}, "is of version 2"),
        ({"joints": ["elbow", "base", "shoulder"]}, "are not the joints of the robot file"),
    ],
)
def test_a_damaged_result_is_refused(config, folder, change, words) -> None:
    right = {
        "format": "dynident servos", "version": 1, "joints": ["base", "shoulder", "elbow"], "parameters": [],
        "configuration": {"path": str(folder / "arm.yaml"), "text": config}, "files": {}, "commands_held": True,
    }  # fmt: skip
    (folder / "torn.json").write_text(json.dumps({**right, **change}))
    refuse("predict", "torn.json", "tuesday.csv", says=words)
