"""Drafted configurations: they say what they guess, can be read, and where all was certain, be used."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.init.column_mapping import map_columns
from dynident.apps.init.config_draft import LogSource, draft_config, read_source
from dynident.apps.init.match import MovableJoint, read_joints
from dynident.cli.identification import draft_from_files
from dynident.files.tables import DataTable
from dynident.models.robot_files import RobotJointLimits
from dynident.project.arms import KnownArm
from dynident.project.config import parse_config
from dynident.project.shortcuts import read_robot
from dynident.runtime import InputError
from tests.apps.excitation.arms import TWO
from tests.cli.commands import refuse, run, succeed
from tests.identification.test_base_tilt import ARM as LINK_ARM
from tests.identification.test_base_tilt import tilted
from tests.kept import check_kept
from tests.robots import joint, link, urdf

LIMIT = '<limit effort="30" velocity="5" lower="-2" upper="2"/>'
TENSOR = np.diag([0.02, 0.02, 0.01])
ARM = urdf(
    link("base", 1.0),
    link("upper", 2.0, (0.1, 0.0, 0.2), tensor=TENSOR),
    link("fore", 1.0, (0.1, 0.0, 0.1), tensor=TENSOR),
    link("left", 0.1, tensor=TENSOR / 100),
    link("right", 0.1, tensor=TENSOR / 100),
    joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0), inside=LIMIT),
    joint("elbow", "revolute", "upper", "fore", (0, 0, 0.4), axis=(0, 1, 0), inside=LIMIT),
    joint("finger", "prismatic", "fore", "left", inside='<limit effort="9" velocity="1" lower="0.01" upper="0.04"/>'),
    joint("other_finger", "prismatic", "fore", "right", inside='<mimic joint="finger"/>'),
)
N = 800
T = np.arange(N) * 0.005
SOUND = {
    "time": T,
    "elbow.position": np.sin(3 * T),
    "shoulder.position": np.cos(2 * T),
    "finger.position": np.full(N, 0.02),
    "elbow.effort": 10 * np.sin(3 * T + 1),
    "shoulder.effort": 15 * np.cos(2 * T + 1),
    "shoulder.command": np.cos(2 * T),
}


def write(path: Path, **changes) -> Path:
    columns = {name: values for name, values in (SOUND | changes).items() if values is not None}
    header = ",".join(f'"{name}"' for name in columns)
    np.savetxt(path, np.column_stack(list(columns.values())), delimiter=",", header=header, comments="")
    return path


@pytest.fixture
def arm(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.urdf").write_text(ARM)
    return tmp_path / "arm.urdf"


def test_what_is_certain_runs_without_an_edit(arm, tmp_path):
    write(tmp_path / "a.csv")
    write(tmp_path / "b.csv", **{"elbow.position": np.sin(2.5 * T)})
    done = succeed("init", "arm.urdf", "a.csv", "b.csv")
    assert "Confirm" not in done.output
    assert "Fill in" not in done.output
    text = (tmp_path / "identify.yaml").read_text()
    check_kept("draft_certain", text)
    assert "# ?" not in text.partition("\n")[2]
    assert parse_config(text, tmp_path).model.lock == {"finger": 0.02}


def test_usual_limits_of_a_known_arm_are_offered_as_comments(arm, tmp_path, monkeypatch):
    limits = {name: {"acceleration": 8.0, "jerk": 100.0} for name in ("shoulder", "elbow")}
    monkeypatch.setattr("dynident.apps.init.config_draft.find_arm", lambda _: KnownArm("Two", "a/b, c.yaml", limits))
    write(tmp_path / "a.csv")
    succeed("init", "arm.urdf", "a.csv")
    text = (tmp_path / "identify.yaml").read_text()
    assert "usual limits of a Two, from a/b, c.yaml" in text
    assert parse_config(text, tmp_path).excitation is None
    uncommented = re.sub("^# (?=excitation:| )", "", text, flags=re.MULTILINE)
    assert yaml.safe_load(uncommented)["excitation"]["limits"] == limits


def test_commanded_torques_beside_commanded_positions_are_asked_about(arm, tmp_path):
    changes = {"shoulder.effort": None, "elbow.effort": None, "finger.command": np.full(N, 0.02)}
    write(tmp_path / "a.csv", **changes, **{"elbow.command": np.sin(3 * T)})
    assert "commanded torques" not in run("init", "arm.urdf", "a.csv").output
    write(tmp_path / "b.csv", **changes, **{"elbow.command": np.sin(3 * T), "elbow.cmd_effort": np.cos(T)})
    assert (
        "simulation: 'elbow.cmd_effort': commanded torques" in run("init", "arm.urdf", "b.csv", "-o", "b.yaml").output
    )


def test_a_single_log_is_cut_in_two_where_it_moves(arm, tmp_path):
    """Rests at its ends, which `identify` leaves out, do not count."""
    write(tmp_path / "a.csv", time=T + 100)
    succeed("init", arm, "a.csv", "-o", "sub/two.yaml")
    config = parse_config((tmp_path / "sub" / "two.yaml").read_text(), tmp_path / "sub")
    assert config.train[0].file[""].resolve() == tmp_path / "a.csv"
    assert (config.train[0].window, config.validation[0].window) == (((None, 102.8),), ((102.8, None),))
    t = np.arange(3 * N) * 0.005
    run_in, run_out = np.clip((t - 2.5) / 0.5, 0, 1), np.clip((9.0 - t) / 0.5, 0, 1)
    noise = 1e-5 * np.random.default_rng(1).standard_normal((2, 3 * N))
    q = run_in * run_out * np.array([np.sin(3 * t), np.cos(2 * t)]) + noise
    moved = {"elbow.position": q[0], "shoulder.position": q[1], "elbow.effort": q[0], "shoulder.effort": q[1]}
    still = {"finger.position": np.full(3 * N, 0.02), "shoulder.command": q[1]}
    write(tmp_path / "b.csv", **{"time": t} | moved | still)
    succeed("init", arm, "b.csv", "-o", "b.yaml")
    ((start, cut),) = parse_config((tmp_path / "b.yaml").read_text(), tmp_path).train[0].window
    assert start is None
    assert cut == pytest.approx(2.5 + 0.7 * 6.5, abs=0.15)


def test_what_is_asked_is_in_the_file_and_on_the_screen(arm, tmp_path):
    doubts = {"finger.position": None, "elbow.effort": 900 * np.sin(3 * T)}
    write(tmp_path / "a.csv", **doubts)
    done = run("init", arm, "a.csv")
    text = (tmp_path / "identify.yaml").read_text()
    for words in ("where does it stand (m)?", "the peak 900 exceeds the limit 30 N m"):
        assert words in done.output
        assert words in text
    assert parse_config(text).model.lock == {"finger": 0.01}


def test_what_cannot_be_guessed_is_to_be_filled_in(arm, tmp_path):
    missing = dict.fromkeys(("elbow.effort", "shoulder.effort", "time"))
    write(tmp_path / "a.csv", **missing, elbow_i_mA=T - 1, shoulder_i_mA=T - 2)
    done = succeed("init", arm, "a.csv")
    assert "Fill in:\n  time: the sampling rate in Hz" in done.output
    assert "torque constant times gear ratio, N m per mA" in done.output
    empty = "torque: a mapping (`key: value` lines) is expected; got None; if all lines are"
    refuse("identify", "identify.yaml", says=("time: is missing", empty))
    text = (tmp_path / "identify.yaml").read_text()
    text = text.replace("    # window: [ , ]", "    window: [0, 2]", 1)
    for blank, filled in (
        ("# time: { rate: }", "time: { rate: 200 }"), ("gain: ,", "gain: 0.01,"),
        ("# window: [ , ]", "window: [2, null]"), ("  # shoulder", "  shoulder"), ("  # elbow", "  elbow"),
    ):  # fmt: skip
        text = text.replace(blank, filled)
    (tmp_path / "identify.yaml").write_text(text)
    parse_config(text, tmp_path)
    succeed("check", "identify.yaml")


def test_without_stamps_the_rate_is_that_at_which_other_columns_are_velocities(arm, tmp_path):
    velocities = {"shoulder.velocity": -2 * np.sin(2 * T), "elbow.velocity": 3 * np.cos(3 * T)}
    write(tmp_path / "a.csv", time=None, **velocities)
    done = succeed("init", arm, "a.csv")
    assert "time: no stamps were found; at 200 Hz other columns are the velocities" in done.output
    config = parse_config((tmp_path / "identify.yaml").read_text())
    assert (config.time.rate, config.train[0].window) == (200, ((None, 2.8),))
    # velocities that do not agree tell no rate
    write(tmp_path / "a.csv", time=None, **velocities | {"elbow.velocity": 9 * np.cos(3 * T)})
    assert "Fill in:\n  time: the sampling rate" in succeed("init", arm, "a.csv", "--force").output


def test_arrays_of_other_lengths_are_reported_and_those_along_rows_a_question(arm, tmp_path):
    np.savez(tmp_path / "a.npz", time=T, q=np.ones((2, N + 1)), tau=np.ones((N, 2)))
    done = run("init", arm, "a.npz")
    assert "Note: 'q' has the shape (2, 801)" in done.output
    assert "the columns of" in done.output
    q, tau = (np.stack([SOUND[f"elbow.{name}"], SOUND[f"shoulder.{name}"]]) for name in ("position", "effort"))
    np.savez(tmp_path / "b.npz", time=T, q=q, tau=tau)
    done = run("init", arm, "b.npz", "-o", "b.yaml")
    assert "  file: 'tau' has the shape (2, 800): it is read as 800 rows" in done.output
    assert "  # ? 'q' has the shape (2, 800): it is read as 800 rows" in (tmp_path / "b.yaml").read_text()


def test_files_that_make_one_log_are_joined(arm, tmp_path):
    for name in ("position", "effort"):
        rows = np.column_stack([SOUND[f"elbow.{name}"], SOUND[f"shoulder.{name}"]])
        np.savetxt(f"run_joint_{name}_log.csv", rows, delimiter=",", header="elbow,shoulder", comments="")
    np.savetxt("run_time_log.csv", T, header="clock", comments="")
    succeed("init", arm, "run_joint_position_log.csv+run_joint_effort_log.csv+run_time_log.csv")
    config = parse_config((tmp_path / "identify.yaml").read_text())
    assert list(config.train[0].file) == ["joint_position", "joint_effort", "time"]
    assert (config.torque["elbow"].column, config.time.column) == ("joint_effort.elbow", "time.clock")


def test_files_of_one_log_that_differ_in_their_rate_are_refused(arm, tmp_path):
    for name, step in (("position", 1), ("effort", 4)):
        rows = np.column_stack([T, SOUND[f"elbow.{name}"], SOUND[f"shoulder.{name}"]])[::step]
        np.savetxt(f"{name}.csv", rows, delimiter=",", header="t,elbow,shoulder", comments="")
    with pytest.raises(InputError, match=r"position\.csv has 800 rows, effort\.csv has 200 rows; .* interpolate"):
        read_source("position.csv+effort.csv")


def test_one_number_a_line_gets_its_width(arm, tmp_path):
    for name in ("position", "effort"):
        np.savetxt(f"{name}.txt", np.column_stack([SOUND[f"elbow.{name}"], SOUND[f"shoulder.{name}"]]).ravel())
    np.savetxt("time.txt", T)
    source = read_source("time.txt+position.txt+effort.txt")
    assert source.widths == {"position": 2, "effort": 2}
    np.testing.assert_allclose(source.table.column("effort.0"), SOUND["elbow.effort"])


def test_an_existing_file_is_kept_and_logs_of_other_columns_are_refused(arm, tmp_path):
    write(tmp_path / "a.csv")
    write(tmp_path / "b.csv", **{"elbow.effort": None})
    (tmp_path / "identify.yaml").write_text("mine")
    refuse("init", arm, "a.csv", says="--force")
    assert (tmp_path / "identify.yaml").read_text() == "mine"
    succeed("init", arm, "a.csv", "--force")
    refuse("init", arm, "a.csv", "b.csv", "-o", "b.yaml", says="b.csv: has no column 'elbow.effort', unlike a.csv")
    assert not (tmp_path / "b.yaml").exists()


def test_what_identify_would_warn_of_is_shown(arm, tmp_path):
    write(tmp_path / "a.csv", **{"elbow.effort": np.zeros(N)})
    assert "the torque is 0 throughout" in run("init", arm, "a.csv").output
    write(tmp_path / "a.csv", **{"elbow.effort": np.where(T == 1, np.inf, 1.0)})
    assert "the configuration cannot be used yet" in run("init", arm, "a.csv", "--force").output


def test_a_robot_that_cannot_move_is_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "still.urdf").write_text(urdf(link("base", 1.0)))
    write(tmp_path / "a.csv")
    refuse("init", "still.urdf", "a.csv", says="no revolute or prismatic joint")
    refuse("init", "no.urdf", "a.csv", says="cannot be read")


def test_joints_that_the_robot_does_not_have_are_reported(arm, tmp_path):
    write(tmp_path / "a.csv", **{"rail.position": 0.1 * T, "rail.effort": T})
    done = run("init", arm, "a.csv")
    assert "recorded, but no joint of the robot file, or one that follows another, so left out: 'rail" in done.output
    assert "or one that follows: 'rail.position'" in (tmp_path / "identify.yaml").read_text()


def test_a_text_in_a_column_of_torques_is_said_though_another_joint_has_one(arm, tmp_path):
    write(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    at = lines[0].split(",").index('"elbow.effort"')
    lines[5] = ",".join("1.014.5" if k == at else cell for k, cell in enumerate(lines[5].split(",")))
    (tmp_path / "a.csv").write_text("\n".join(lines))
    assert "Note: 'elbow.effort' has '1.014.5' at line 6, which is not a number" in run("init", arm, "a.csv").output


def test_joints_of_other_models_are_known(tmp_path):
    assert [(read_joint.name, read_joint.kind) for read_joint in read_joints("gallery:slider")] == [
        ("slider", "prismatic")
    ]


def test_a_bag_is_drafted_with_the_units_of_ros(arm, tmp_path):
    from tests.project.bags import State, write_bag

    arms, stamps = ("elbow", "shoulder"), [5_000_000 * k for k in range(N)]
    q, tau = (list(zip(*(SOUND[f"{name}.{kind}"] for name in arms), strict=True)) for kind in ("position", "effort"))
    states = [State(arms, q[k], (), tau[k], stamp) for k, stamp in enumerate(stamps)]
    states += [State(("finger",), (0.03,), (), (), stamp, topic="/gripper") for stamp in stamps[:10]]
    write_bag(tmp_path, "db3", sorted(states, key=lambda x: x.stamp), "monday")
    succeed("init", arm, "monday/")
    text = (tmp_path / "identify.yaml").read_text()
    assert "the unit is that of ROS" in text
    assert "file: monday" in text
    succeed("check", "identify.yaml")


@given(
    names=st.lists(st.text(min_size=1, max_size=12), min_size=5, max_size=5, unique=True),
    joints=st.lists(st.text(min_size=1, max_size=8), min_size=2, max_size=2, unique=True),
    file=st.text(alphabet=st.characters(exclude_characters="/\0\\", exclude_categories=["Cs"]), min_size=1, max_size=9),
)
@settings(max_examples=40)
def test_any_names_make_valid_yaml(names, joints, file):
    """Names come from files of others: whatever they are, they stay names."""
    facts = [MovableJoint(name, "revolute", RobotJointLimits(9.0, 2.0, -2.0, 2.0)) for name in joints]
    parts = (joints[0], joints[1])
    t = T[:60]
    columns = {"t": t} | {name: np.sin(t) for name in names}
    columns |= {f"{part}_{signal}": np.sin(t) for part in parts for signal in ("pos", "tau")}
    table = DataTable({name: values.copy() for name, values in columns.items()}, {}, "a.csv")
    source = LogSource({"": Path("logs") / f"x{file}"}, {}, table)
    mapping = map_columns(table, facts)
    text = draft_config("arm.urdf", facts, mapping, [source], Path()).text
    data = yaml.safe_load(text)
    assert data["model"]["joints"] == list(mapping.position)
    assert data["train"][0]["file"] == f"logs/x{file}"
    given = {name: x.column for name, x in mapping.position.items() if x.column}
    assert {name: x["column"] for name, x in (data["position"] or {}).items()} == given


def test_a_finger_that_does_not_move_is_locked_where_it_stands(arm, tmp_path):
    """Its column of efforts is no reason to identify it; the model that is fitted has the arm's joints only."""
    columns = {"finger.effort": np.full(N, 0.4), "finger.position": 0.02 + 1e-7 * np.sin(9 * T)}
    logs = [write(tmp_path / f"{name}.csv", **columns) for name in "ab"]
    done = succeed("init", "arm.urdf", *logs, "-o", tmp_path / "drafted.yaml")
    text = (tmp_path / "drafted.yaml").read_text()
    check_kept("draft_finger", text)
    assert "`model.lock`): 'finger'" in done.output
    assert f"dynident check {tmp_path / 'drafted.yaml'}" in done.output.replace("\n", "")
    (tmp_path / "drafted.yaml").write_text(text.replace("terms: auto", "terms: [viscous, coulomb]"))
    succeed("identify", tmp_path / "drafted.yaml", "--out", tmp_path / "out")
    result = json.loads((tmp_path / "out" / "result.json").read_text())
    assert [joint["name"] for joint in result["model"]["joints"]] == ["shoulder", "elbow"]
    notes = [note for part in result["report"]["exports"] for note in part["notes"]]
    assert any("'finger'" in note and "were fixed" in note for note in notes)


GAINS = np.array([9.0, -5.0])


def write_current_arm(folder: Path, mass: float = 1.0) -> Path:
    pattern = '(mass value|i[xyz]{2})="([^"]*)"'
    text = re.sub(pattern, lambda match: f'{match[1]}="{mass * float(match[2])!r}"', TWO)
    (folder / "arm.urdf").write_text(text)
    return folder / "arm.urdf"


def record_currents(folder: Path, name: str, phase: float) -> Path:
    t = np.arange(3000) * 0.005
    w, a = np.array([[1.1, 0.9], [2.7, 2.3]]), np.array([[0.8, 0.9], [0.4, 0.35]])
    angle = w[None] * t[:, None, None] + phase + np.array([0.0, 1.0])
    q, dq, ddq = ((a * wave).sum(axis=1) for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    model = read_robot(write_current_arm(folder), terms=["viscous", "coulomb"])
    theta = np.array([parameter.value if parameter.value is not None else 1.2 for parameter in model.parameters])
    rng = np.random.default_rng(int(10 * phase))
    tau = model.torque(q, dq, ddq, theta) + 0.1 * rng.standard_normal(q.shape)
    rows = np.column_stack([t, q + 1e-4 * rng.standard_normal(q.shape), tau / GAINS])
    header = "t,lift_pos,bend_pos,lift_current,bend_current"
    np.savetxt(folder / name, rows, delimiter=",", header=header, comments="")
    return folder / name


@pytest.mark.parametrize("mass", [1.0, 2.0])
def test_gains_are_proposed_with_a_question(tmp_path: Path, mass: float) -> None:
    """The assumption is what it says: gains go with the masses."""
    logs = [record_currents(tmp_path, name, phase) for name, phase in (("a.csv", 0.0), ("b.csv", 1.3))]
    done = succeed("init", write_current_arm(tmp_path, mass), *logs, "-o", tmp_path / "c.yaml")
    text = (tmp_path / "c.yaml").read_text()
    torque = parse_config(text, tmp_path / "c.yaml").torque
    assert [torque["lift"].gain, torque["bend"].gain] == pytest.approx(mass * GAINS, rel=0.05)
    assert "are its masses right?" in done.output
    assert text.count("from the robot file") == 2


@pytest.mark.parametrize(("scale", "is_taken"), [(1.0, True), (1e3, False)], ids=["same unit", "other unit"])
def test_gains_that_the_controller_commands_are_taken(tmp_path: Path, scale: float, is_taken: bool) -> None:
    rows = np.loadtxt(record_currents(tmp_path, "a.csv", 0.0), delimiter=",", skiprows=1)
    names = ["t", *(f"{k}_{j}" for k in ("q", "current", "target_current", "target_torque") for j in ("lift", "bend"))]
    rows = np.hstack([rows, scale * rows[:, 3:], 1.1 * GAINS * rows[:, 3:]])
    np.savetxt(tmp_path / "b.csv", rows, delimiter=",", header=",".join(names), comments="")
    done = succeed("init", write_current_arm(tmp_path), tmp_path / "b.csv", "-o", tmp_path / "c.yaml")
    torque = parse_config((tmp_path / "c.yaml").read_text(), tmp_path / "c.yaml").torque
    assert ([torque["lift"].gain, torque["bend"].gain] == pytest.approx(1.1 * GAINS, rel=1e-3)) is is_taken
    assert ("'target_torque_lift' over 'target_current_lift'" in done.output) is is_taken


def test_without_masses_the_gains_are_to_be_filled_in(tmp_path: Path) -> None:
    log = record_currents(tmp_path, "a.csv", 0.0)
    text = write_current_arm(tmp_path).read_text()
    bare = tmp_path / "bare.urdf"
    bare.write_text("".join(part.rpartition("</inertial>")[2] for part in text.split("<inertial>")))
    done = succeed("init", bare, log, "-o", tmp_path / "c.yaml")
    assert re.search(r"the gains: torque constant times gear ratio.*\(gravity and inertia", done.output)
    assert "# lift: { column: lift_current, gain: ," in (tmp_path / "c.yaml").read_text()


WIDE_LIMIT = '<limit lower="-3" upper="3" velocity="20" effort="100"/>'


@pytest.mark.parametrize(("turn", "gravity"), [(0.0, None), (np.pi / 2, (0.0, -9.81, 0.0))], ids=["floor", "wall"])
def test_gravity_is_drafted_with_a_question_where_the_torques_decide_it(
    tmp_path: Path, turn: float, gravity: tuple[float, float, float] | None
) -> None:
    # limits that the motion keeps, so that units are certain
    (tmp_path / "arm.urdf").write_text(re.sub(r"<limit[^>]*>", WIDE_LIMIT, LINK_ARM))
    _, motion = tilted(turn, 0.0)
    names = [f"{kind}_{name}" for kind in ("pos", "torque") for name in motion.joints]
    rows = np.column_stack([motion.t, motion.q, motion.tau])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=",".join(["t", *names]), comments="")
    draft, _ = draft_from_files(str(tmp_path / "arm.urdf"), [str(tmp_path / "run.csv")], tmp_path)
    written = yaml.safe_load(draft.text)["model"].get("gravity")
    asked = [question for question in draft.questions if question.startswith("model.gravity")]
    if gravity is None:
        assert written is None
        assert not asked
    else:
        assert written == list(gravity)
        (question,) = asked
        assert "Is the robot on a wall or ceiling" in question
        (tmp_path / "arm.yaml").write_text(draft.text.replace("terms: auto", "terms: [viscous]"))
        assert "mounted" not in succeed("identify", tmp_path / "arm.yaml").output
