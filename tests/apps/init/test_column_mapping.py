"""Channels guessed from names and values, commands by name, and servos by the actuators of an MJCF."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynident.apps.init.column_mapping import map_columns
from dynident.apps.init.match import ColumnFamily, Match, MovableJoint, match_family
from dynident.apps.init.servo_draft import ServoProposal, command_columns, servos_of_file
from dynident.files.tables import DataTable
from dynident.models.robot_files import RobotJointLimits

N = 400
T = np.arange(N) * 0.01
LIMITS = RobotJointLimits(effort=50.0, velocity=2.0, lower=-2.0, upper=2.0)
ARM = tuple(MovableJoint(name, "revolute", LIMITS) for name in ("shoulder", "elbow"))
NUMBERED = tuple(MovableJoint(f"arm_joint{k}", "revolute", LIMITS) for k in (1, 2))


def wave(size: float, phase: float = 0.0) -> np.ndarray:
    return size * np.sin(2 * T + phase)


def table(**columns) -> DataTable:
    named = {"time": T} | columns
    return DataTable(
        {name: np.array(values, float) for name, values in named.items() if values is not None}, {}, "a.csv"
    )


@pytest.mark.parametrize(
    ("joints", "columns", "stated", "matched"),
    [
        (ARM[:1], {None: "q"}, None, {"shoulder": "q"}),
        (ARM[:1], {0: "q"}, None, {"shoulder": "q"}),
        (ARM, {None: "q"}, None, {}),
        (ARM, {"elbow": "e", "other": "o"}, {0: "shoulder"}, {"elbow": "e"}),
        (ARM, {0: "a", 1: "b"}, {0: "elbow", 1: "shoulder"}, {"elbow": "a", "shoulder": "b"}),
        (ARM, {0: "a", 1: "b"}, {0: "elbow", 2: "shoulder"}, {"shoulder": "a", "elbow": "b"}),
        (ARM, {0: "a", 1: "b"}, {}, {"shoulder": "a", "elbow": "b"}),
    ],
)
def test_columns_are_matched_by_name_then_number_then_order(joints, columns, stated, matched) -> None:
    match = match_family(ColumnFamily("position", 0, columns), joints, stated)
    assert (match.columns, bool(match.question)) == (matched, stated is not None and "order" in match.reason)


def signals(position=("q1", "q2"), torque=("tau1", "tau2"), size=1.0, peak=20.0):
    return {
        **{name: wave(size, k) for k, name in enumerate(position)},
        **{name: wave(peak, k) for k, name in enumerate(torque)},
    }


def chosen(mapping):
    return [channel.column for channel in (*mapping.position.values(), *mapping.torque.values())]


def test_measured_columns_are_preferred():
    names = ["pos_des", "pos_filt", "pos_meas", "pos_err"]
    columns = {f"{name}{k}": wave(1.0, k) for name in names for k in (1, 2)}
    torques = {f"{name}{k}": wave(9.0, k) for name in ("tau_cmd", "current", "tau", "tau_fric") for k in (1, 2)}
    mapping = map_columns(table(**columns, **torques), NUMBERED)
    assert chosen(mapping) == ["pos_meas1", "pos_meas2", "tau1", "tau2"]
    assert "pos_des1" in mapping.unused
    assert chosen(map_columns(table(**signals(("q_d1", "q_d2"))), NUMBERED)) == [None, None, "tau1", "tau2"]


def test_positions_in_degrees_are_preferred_to_counts() -> None:
    counts = {f"enc_raw{k}": wave(1e5, k) for k in (1, 2)}
    estimated = map_columns(table(**counts, **signals(position=("angle_est1", "angle_est2"))), ARM)
    assert chosen(estimated)[:2] == ["angle_est1", "angle_est2"]
    mapping = map_columns(table(**counts, **signals(position=("J1[deg]", "J2[deg]"))), ARM)
    assert chosen(mapping) == ["J1[deg]", "J2[deg]", "tau1", "tau2"]
    assert not any("same meaning" in channel.question for channel in mapping.position.values())


def test_each_joint_has_the_unit_of_its_own_column():
    scara = (*ARM, MovableJoint("quill", "prismatic", RobotJointLimits(effort=200.0, lower=0.0, upper=0.2)))
    names = ("shoulder pos [deg]", "elbow pos [deg]", "quill pos [mm]")
    torques = ("shoulder torque [Nm]", "elbow torque [Nm]", "quill force [kN]")
    mapping = map_columns(table(**signals(names, torques)), scara)
    assert [value.unit for value in mapping.position.values()] == ["deg", "deg", "mm"]
    assert [value.unit for value in mapping.torque.values()] == ["N m", "N m", "kN"]
    assert mapping.lock == {}


def test_a_joint_without_position_is_not_in_the_log_and_its_torque_is_not_used() -> None:
    axes = [MovableJoint("X", "prismatic"), MovableJoint("C", "revolute")]
    columns = {"X_act_mm": wave(80.0), "C_act_deg": wave(80.0), "X_Moment_%": wave(9.0, 2), "C_Moment_%": wave(7.0, 3)}
    assert chosen(map_columns(table(**columns), axes)) == list(columns)
    del columns["X_act_mm"]
    draft = map_columns(table(**columns), axes)
    assert (list(draft.lock), draft.unused) == (["X"], ("X_Moment_%",))


def test_lengths_are_positions_of_slides_alone_in_mm_beyond_their_limits() -> None:
    gaps = {f"gap{k}_mm": wave(9.0, k) for k in (1, 2)}
    mapping = map_columns(table(**gaps, **signals()), NUMBERED)
    assert chosen(mapping) == ["q1", "q2", "tau1", "tau2"]
    assert not any(channel.question for channel in mapping.position.values())
    scara = (*ARM, MovableJoint("quill", "prismatic", RobotJointLimits(lower=-0.1, upper=0.1)))
    mapping = map_columns(table(**signals(("q1", "q2"), ("tau1", "tau2")), q3=wave(80.0), tau3=wave(20.0)), scara)
    assert (mapping.position["quill"].column, mapping.position["quill"].unit) == ("q3", "mm")
    assert mapping.position["quill"].question.endswith("is it in mm, or of a motor (then `gain`)?")


@pytest.mark.parametrize(
    ("form", "unit", "gain"),
    [
        ("Torque {} [%]", "N m", "N m at the joint per '%'"),
        ("torque{}_percent", "N m", "N m at the joint per 'percent'"),
        ("torque{} [V]", "N m", "N m at the joint per 'V'"),
        ("M{} load (%)", "N m", "N m at the joint per '%'"),
        ("torque{} [kgf cm]", "kgf cm", ""),
        ("torque{} [N-m]", "N m", ""),
        ("tau[{}]", "N m", ""),
    ],
)
def test_a_torque_in_another_unit_wants_a_gain(form: str, unit: str, gain: str) -> None:
    mapping = map_columns(table(**signals(torque=[form.format(name) for name in ("1", "2")])), NUMBERED)
    channels = mapping.torque.values()
    assert {(channel.unit, channel.question, channel.gain) for channel in channels} == {(unit, "", gain)}
    assert ("judged" in mapping.reasons["torque"]) == form.startswith("tau[")


def test_positions_beyond_two_pi_are_asked_about():
    mapping = map_columns(table(**signals(size=90.0)), NUMBERED)
    assert {value.unit for value in mapping.position.values()} == {"deg"}
    assert all("is it in degrees" in value.question for value in mapping.position.values())
    shifted = map_columns(table(**{**signals(), "q1": 2.5 + wave(1.0)}), NUMBERED).position["arm_joint1"]
    assert (shifted.unit, "another zero" in shifted.question) == ("rad", True)  # its range fits into rad
    turning = map_columns(table(**signals(size=90.0)), NUMBERED, ros=True)
    assert {value.unit for value in turning.position.values()} == {"rad"}
    assert all("exceeds the range of the joint" in value.question for value in turning.position.values())
    wheel = MovableJoint("wheel", "revolute", RobotJointLimits(effort=2.0))
    for size, words in ((9.0, "multi_turn"), (3.5, "multi_turn"), (3.0, "")):
        endless = map_columns(table(q=wave(size), tau=wave(1.0)), [wheel], ros=True).position["wheel"]
        assert (words in endless.question) if words else endless.question == "", size


def test_what_starts_anew_after_360_is_in_degrees() -> None:
    """Whatever the limits say: the joint at 350 degrees stands at -10; so are joints that do not reach the turn."""
    angles = ((350.0 + wave(60.0, 2)) % 360.0, 250.0 + wave(50.0))
    mapping = map_columns(table(**{**signals(), "q1": angles[0], "q2": angles[1]}), NUMBERED)
    channels = [(angle.unit, angle.wraps, angle.question) for angle in mapping.position.values()]
    assert channels == [("deg", 360.0, "")] * 2


def test_torques_of_unknown_names_are_told_by_the_motion() -> None:
    noise = np.random.default_rng(0).normal(size=(2, N))
    torques = {f"m_actual{k}": wave(20.0, k) + np.sign(np.cos(2 * T + k)) for k in (1, 2)}
    volts = {f"bus_volt{k}": noise[k - 1] for k in (1, 2)}
    mapping = map_columns(table(**signals(torque=()), **volts, **torques), NUMBERED)
    assert chosen(mapping) == ["q1", "q2", "m_actual1", "m_actual2"]
    assert all("are they torques of the joints" in channel.question for channel in mapping.torque.values())
    assert chosen(map_columns(table(**signals(torque=()), **volts), NUMBERED))[2:] == [None, None]


def test_torques_are_compared_with_the_limits():
    unlimited = [MovableJoint(joint.name, "revolute") for joint in NUMBERED]
    cases = ((NUMBERED, 20.0, ""), (NUMBERED, 400.0, "exceeds the limit 50"), (NUMBERED, 0.1, "before the gear"),
             (unlimited, 20.0, "N m?"))  # fmt: skip
    for joints, peak, asked in cases:
        for channel in map_columns(table(**signals(peak=peak)), joints).torque.values():
            assert asked in channel.question if asked else channel.question == ""


@pytest.mark.parametrize(
    ("factor", "unit", "asked"),
    [(1.0, "s", False), (1e3, "ms", True), (1e6, "us", True), (1e9, "ns", True), (100.0, "ms", True)],
)
def test_the_unit_of_time_follows_from_the_step(factor, unit, asked):
    mapping = map_columns(table(time=np.round(T * factor, 6), **signals()), NUMBERED)
    assert (mapping.time.unit, bool(mapping.time.question)) == (unit, asked)


@pytest.mark.parametrize(("factor", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
@pytest.mark.parametrize("step", [1 / 8000, 0.01])
def test_stamps_since_1970_tell_their_unit(factor, unit, step):
    stamps = (1.731e9 + step * np.arange(N)) * factor
    time = map_columns(table(time=None, stamp=stamps, **signals()), NUMBERED).time
    assert (time.column, time.unit, time.question) == ("stamp", unit, "")
    assert time.step == pytest.approx(step, rel=0.01)


def test_stamps_that_increase_are_preferred():
    mapping = map_columns(table(**{"header.stamp.sec": np.floor(T), "clock": T + 5}, time=None, **signals()), NUMBERED)
    assert mapping.time.column == "clock"
    assert map_columns(table(time=None, **signals()), NUMBERED).time.column is None
    for times in (np.floor(T), np.full(len(T), np.inf), np.where(T > 1, np.nan, T)):
        assert "is there a better column?" in map_columns(table(time=times, **signals()), NUMBERED).time.question


def test_rows_that_are_evenly_apart_have_a_rate_where_their_stamps_are_rounded_or_late():
    t, rng = np.arange(4000) * 0.004, np.random.default_rng(0)
    late_stamps = np.maximum.accumulate(t + 0.06 * (rng.random(len(t)) < 0.02)) + 1e-7 * np.arange(len(t))
    columns = {name: np.sin(2 * t + k) for k, name in enumerate(("q1", "q2", "tau1", "tau2"))}
    for stamps in (np.floor(100 * t) / 100, np.round(100 * t) / 100, late_stamps):
        time = map_columns(table(time=stamps, **columns), NUMBERED).time
        assert (time.column, time.step) == (None, pytest.approx(0.004, rel=1e-3))
        assert "is this the sampling rate?" in time.question
    for stamps in (t + (t > 8), np.delete(np.append(t, 16 + 0.004 * np.arange(200)), np.s_[500:700]), np.floor(t)):
        assert map_columns(table(time=stamps, **columns), NUMBERED).time.column == "time"  # a pause, lost rows, seconds


def test_rows_of_single_joints_are_named():
    """The long format: one row for each joint and time."""
    columns = {name: np.repeat(wave(1.0), 2) for name in ("position", "effort")}
    mapping = map_columns(table(time=np.repeat(T, 2), **columns), NUMBERED)
    assert "If each row is of another joint" in mapping.time.question
    assert "median step" not in mapping.time.question
    assert not mapping.gaps


def test_columns_of_joints_are_better_than_those_of_motors_which_are_asked_about():
    pairs = [(f"motor_pos_{k}", f"link_pos_{k}", f"motor_torque_{k}", f"joint_torque_{k}") for k in (1, 2)]
    mapping = map_columns(table(**{name: wave(1.0) for pair in pairs for name in pair}), NUMBERED)
    assert chosen(mapping) == ["link_pos_1", "link_pos_2", "joint_torque_1", "joint_torque_2"]
    assert mapping.position["arm_joint1"].question == ""
    motors = map_columns(table(**signals(torque=("motor1 torque [Nm]", "motor2 torque [Nm]"))), NUMBERED).torque
    assert all("before the gear" in channel.question for channel in motors.values())
    geared = map_columns(table(**signals(("pos_rev_1", "pos_rev_2"), size=16.0)), NUMBERED)
    assert "transmission" in geared.position["arm_joint1"].question
    other_zero = {f"pos_rad_{k}": 5.0 + wave(1.0) for k in (1, 2)}
    mapping = map_columns(table(**signals((), ("tau1", "tau2")), **other_zero), NUMBERED)
    assert mapping.position["arm_joint1"].question == ""


def test_signals_with_a_clock_of_their_own_have_the_time():
    clocks = {"time": None, "q_out.time": T, "tau_out.time": T}
    assert map_columns(table(**clocks, **signals()), NUMBERED).time.column == "q_out.time"
    assert map_columns(table(**clocks | {"tau_out.time": T + 1}, **signals()), NUMBERED).time.column is None
    assert map_columns(table(**clocks, tout=T, **signals()), NUMBERED).time.question == ""
    twice = np.sort(np.append(T, T[50:200:50]))  # rows written twice
    columns = {name: np.resize(values, len(twice)) for name, values in signals().items()}
    assert map_columns(table(time=twice, **columns), NUMBERED).time.question == ""
    swapped = np.append(twice[:-2], twice[:-3:-1])
    assert "do not increase" in map_columns(table(time=swapped, **columns), NUMBERED).time.question


FINGER = MovableJoint("finger", "prismatic", RobotJointLimits(lower=0.01, upper=0.04))
NAMED = signals(("shoulder_q", "elbow_q"), ("shoulder_tau", "elbow_tau"))


def test_joints_that_are_not_identified_are_locked():
    tied = MovableJoint("finger_2", "prismatic", RobotJointLimits(), "finger")
    coupler = MovableJoint("coupler", "revolute", LIMITS, "elbow")
    below, free = (MovableJoint(name, "prismatic", RobotJointLimits(upper=x)) for name, x in (("a", -0.1), ("b", None)))
    mapping = map_columns(table(**NAMED), (*ARM, FINGER, tied, coupler, below, free))
    assert list(mapping.position) == ["shoulder", "elbow"]
    assert {name: value for name, (value, _) in mapping.lock.items()} == {
        "finger": 0.01, "coupler": 0.0, "a": -0.1, "b": 0.0,
    }  # fmt: skip
    assert "not in the log" in mapping.lock["finger"][1]
    assert "follows 'elbow'" in mapping.lock["coupler"][1]
    recorded = map_columns(table(**NAMED, finger_q=np.full(N, 0.02)), (*ARM, FINGER, tied))
    assert recorded.lock == {"finger": (0.02, "")}
    moving = map_columns(table(**NAMED, finger_q=0.02 + wave(0.01)), (*ARM, FINGER, tied))
    assert "it moves by 0.02 m" in moving.lock["finger"][1]


def test_recorded_joints_that_do_not_move_in_any_log_are_locked():
    first, later = (table(**NAMED, finger_q=np.full(N, x), finger_tau=wave(1.0)) for x in (0.02, 0.035))
    joints = (*ARM, FINGER)
    for result in (map_columns(first, joints), map_columns(first, joints, other_tables=[first])):
        assert list(result.position) == list(result.torque) == ["shoulder", "elbow"]
        assert (result.lock, result.still_joints) == ({"finger": (0.02, "")}, ("finger",))
    opened = map_columns(first, joints, other_tables=[later])  # at rest, but elsewhere
    assert (opened.lock, opened.still_joints) == ({}, ())
    assert list(opened.position) == ["shoulder", "elbow", "finger"]
    assert map_columns(first, joints, lockable=False).still_joints == ()
    rest = map_columns(table(**dict.fromkeys((*NAMED, "finger_q", "finger_tau"), np.full(N, 0.1))), joints)
    assert rest.still_joints == ()  # a log at rest has no joint to identify at all
    assert len(rest.position) == 3


def test_a_joint_that_its_controller_holds_is_locked():
    wrist = MovableJoint("wrist", "revolute", RobotJointLimits(lower=-2, upper=2))
    for size, still in ((2e-3, ("wrist",)), (0.05, ())):
        mapping = map_columns(table(**NAMED, wrist_tau=wave(1.0), wrist_q=0.7 + wave(size)), (*ARM, wrist))
        assert mapping.still_joints == still
        assert ("wrist" in mapping.position) == (not still)


def test_joints_that_columns_of_text_name_are_not_matched_by_order():
    columns = signals(("field.position0", "field.position1"), ("field.effort0", "field.effort1"))
    named = replace(table(**columns), texts={"field.name0": "elbow", "field.name1": "shoulder", "field.frame": "base"})
    mapping = map_columns(named, ARM)
    assert list(mapping.position) == ["shoulder", "elbow"]
    assert chosen(mapping) == ["field.position1", "field.position0", "field.effort1", "field.effort0"]
    assert not any(value.question for value in mapping.position.values())
    twice = replace(named, texts={"field.name0": "elbow", "field.name1": "elbow"})
    assert "is this order right" in map_columns(twice, ARM).position["elbow"].question


def test_of_more_motors_than_joints_those_that_move_are_taken():
    def motors(*moving, joints=ARM):
        sizes = [1.0 if k in moving else 1e-3 for k in range(5)]
        columns = {f"motor_state[{k}].q": wave(size, k) for k, size in enumerate(sizes)}
        return map_columns(table(**columns, **{f"motor_state[{k}].tau_est": wave(9.0, k) for k in range(5)}), joints)

    three = (*ARM, MovableJoint("wrist", "revolute", LIMITS))  # motors 1, 2, 4 are not successive, so the order counts
    assert list(motors(1, 2, 4, joints=three).position) == ["elbow", "wrist"]
    for mapping, (a, b) in ((motors(2, 3), (2, 3)), (motors(2, 4), (0, 1)), (motors(*range(5)), (0, 1))):
        assert chosen(mapping) == [f"motor_state[{k}].{name}" for name in ("q", "tau_est") for k in (a, b)]
        assert f"numbered 0 to 4 and the joints are called shoulder to elbow: are {a}, {b} theirs" in (
            mapping.torque["elbow"].question
        )


@pytest.mark.parametrize(("name", "size", "turn"), [("{}_q", 2 * np.pi, 2 * np.pi), ("{}_q [deg]", 360.0, 360.0)])
def test_an_angle_that_starts_anew_is_seen(name, size, turn):
    names = tuple(name.format(joint) for joint in ("shoulder", "elbow"))
    columns = signals(names, ("shoulder_tau", "elbow_tau"))
    columns[names[0]] = np.mod(wave(0.2 * size), size)
    position = map_columns(table(**columns), ARM).position
    assert position["shoulder"].wraps == pytest.approx(turn)
    assert (position["shoulder"].question, position["elbow"].wraps) == ("", position["shoulder"].wraps)
    for share in (0.7, 0.95):
        columns[names[0]] = np.mod(wave(0.2 * size), share * size)  # a jump that is no turn
        assert map_columns(table(**columns), ARM).position["shoulder"].wraps is None


def test_gaps_are_seen():
    assert not map_columns(table(**signals()), NUMBERED).gaps
    assert map_columns(table(time=T + (T > 1), **signals()), NUMBERED).gaps
    every_other, at_the_end = np.arange(N) % 2, np.arange(N) < N - 5
    for is_filled, gaps, step in ((every_other, True, 0.02), (at_the_end, False, 0.01)):  # rows of other topics
        columns = {name: np.where(is_filled, values, np.nan) for name, values in signals().items()}
        mapping = map_columns(table(**columns), NUMBERED)
        assert (mapping.gaps, mapping.time.step) == (gaps, pytest.approx(step))


COLUMNS = ["t", "q1", "q2", "tau1", "tau2", "q_d1", "i1", "elbow.position", "0", "1", "2", "3", "4", "x"]


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    names=st.lists(st.sampled_from(COLUMNS), max_size=8, unique=True),
    rows=st.integers(0, 4),
    value=st.floats(allow_nan=True, allow_infinity=True),
    joints=st.sampled_from([ARM, NUMBERED, (*ARM, *NUMBERED), ARM[:1]]),
)
def test_anything_gives_a_mapping(names, rows, value, joints):
    columns = {name: np.full(rows + (name == "x"), value) for name in names}
    mapping = map_columns(DataTable(columns, {}, "a.csv"), joints)
    assert set(mapping.position) == set(mapping.torque) <= {joint.name for joint in joints}
    assert math.isfinite(sum(position for position, _ in mapping.lock.values()))
    assert set(chosen(mapping)) <= {None, *names}


def test_a_clock_of_any_name_is_found_where_it_is_the_only_one():
    time = map_columns(table(time=None, **{"Uhr [ms]": 1000 * T}, **signals()), NUMBERED).time
    assert (time.column, time.unit) == ("Uhr [ms]", "ms")
    assert "is it the time?" in time.question
    assert map_columns(table(time=None, Uhr=T, ticks=T + 1, **signals()), NUMBERED).time.column is None
    dates = DataTable({"Datum": T + 43200, **signals()}, {}, "a.csv", units={"Datum": "s"})
    time = map_columns(dates, NUMBERED).time
    assert (time.column, time.unit, time.question) == ("Datum", "s", "")


JOINTS = [MovableJoint("pan", "revolute"), MovableJoint("lift", "revolute")]
SPELLINGS = {
    "cmd_pan cmd_lift": ("pos_pan", "pos_lift"),
    "action.pan.pos action.lift.pos": ("observation.state.pan.pos", "observation.state.lift.pos"),
    "q_des1 q_des2": ("q1", "q2"),
    "target_position_pan target_position_lift": ("position_pan", "position_lift"),
    "goalLift goalPan": ("pan", "lift"),
}


@pytest.mark.parametrize(("commands", "positions"), SPELLINGS.items())
def test_commands_are_found_by_name(commands: str, positions: tuple[str, str]) -> None:
    names = [*positions, *commands.split(), "dq_cmd_pan", "dq_cmd_lift"]
    table = DataTable({name: np.arange(5.0) for name in names}, {}, "log")
    match = Match(ColumnFamily("position", 0, {}), dict(zip(("pan", "lift"), positions, strict=True)), "")
    result = command_columns(table, JOINTS, match)
    assert set(result.values()) == set(commands.split())
    assert list(result) == (["lift", "pan"] if commands.startswith("goalLift") else ["pan", "lift"])
    few = DataTable({name: np.arange(5.0) for name in (*positions, commands.split()[0])}, {}, "log")
    assert command_columns(few, JOINTS, match) == command_columns(table, JOINTS, None) == {}  # no servo log


def test_servos_are_those_of_the_actuators(tmp_path) -> None:
    (tmp_path / "arm.xml").write_text(
        '<mujoco><default><position kp="5" kv="0.5"/></default><worldbody><body><joint name="pan"/><geom size="0.1"/>'
        '<body><joint name="lift"/><geom size="0.1"/></body></body></worldbody><actuator>'
        '<position name="p" joint="pan" gear="2" forcerange="-3 4"/><motor joint="lift"/></actuator></mujoco>'
    )
    servos = servos_of_file(str(tmp_path / "arm.xml"), JOINTS)
    assert servos == {"pan": ServoProposal(20.0, 2.0, 6.0, "p"), "lift": ServoProposal(torque_unit="N m")}
