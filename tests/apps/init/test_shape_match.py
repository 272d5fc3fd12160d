"""Columns without names are matched by their values, in whatever order their blocks are."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.apps.init.column_mapping import ColumnMapping, map_columns
from dynident.apps.init.match import ColumnFamily, Match, MovableJoint
from dynident.apps.init.shape_match import match_by_shape, sampling_step
from dynident.files.tables import DataTable
from dynident.models.robot_files import RobotJointLimits

JOINTS = tuple(
    MovableJoint(f"j{k}", "revolute", RobotJointLimits(lower=-3.0, upper=3.0, effort=60.0)) for k in range(1, 7)
)
T = np.arange(4000) * 0.005
RNG = np.random.default_rng(0)


def _motion() -> tuple[NDArray, NDArray, NDArray]:
    q, dq, ddq = (np.zeros((len(T), 6)) for _ in range(3))
    for j in range(6):
        for k in range(4):
            w, a, phase = 0.6 + 0.5 * k + 0.13 * j, 0.9 / (1 + k), j + 2.0 * k
            q[:, j] += a * np.sin(w * T + phase)
            dq[:, j] += a * w * np.cos(w * T + phase)
            ddq[:, j] -= a * w**2 * np.sin(w * T + phase)
    return q, dq, ddq


def _noise(size: float) -> NDArray:
    return size * RNG.standard_normal((len(T), 6))


Q, DQ, DDQ = _motion()
LOAD = 2.0 * DDQ + 0.5 * np.roll(DDQ, 1, axis=1) + 3.0 * np.tanh(DQ / 0.02) + DQ + 10 * np.sin(np.cumsum(Q, axis=1)) / 2
BLOCKS = {
    "q": Q + _noise(1e-4),
    "dq": DQ + _noise(1e-3),
    "ddq": DDQ + _noise(1e-2),
    "tau": LOAD + _noise(0.3),
    "current": LOAD / np.array([12.0, 11.0, 10.0, 5.0, 4.0, 4.0]) + _noise(0.1),
}


def table(*parts: NDArray, clock: NDArray | None = T) -> DataTable:
    rows = np.column_stack([*(() if clock is None else (clock,)), *parts])
    return DataTable({str(k): rows[:, k].copy() for k in range(rows.shape[1])}, {}, "a.txt")


def places(kinds: tuple[str, ...], wanted: str) -> list[str]:
    return [str(1 + 6 * kinds.index(wanted) + j) for j in range(6)]


def columns_of(mapping: ColumnMapping) -> list[str | None]:
    return [x.column for x in (*mapping.position.values(), *mapping.torque.values())]


ORDERS = [
    *permutations(("q", "dq", "tau")),
    *permutations(("q", "tau")),
    ("current", "tau", "ddq", "dq", "q"),
    ("q", "ddq", "tau"),
]


@pytest.mark.parametrize("kinds", ORDERS, ids="-".join)
def test_blocks_are_found_in_any_order(kinds: tuple[str, ...]) -> None:
    mapping = map_columns(table(*(BLOCKS[kind] for kind in kinds)), JOINTS)
    assert (mapping.time.column, mapping.time.unit) == ("0", "s")
    assert columns_of(mapping) == [*places(kinds, "q"), *places(kinds, "tau")]
    assert all("is this order right?" in x.question for x in (*mapping.position.values(), *mapping.torque.values()))
    if "ddq" not in kinds or "dq" in kinds:  # accelerations without velocities are asked about, too
        assert all(("Why not" in value.question) == ("current" in kinds) for value in mapping.torque.values())


def test_texts_beside_columns_without_names_tell_the_order_of_the_joints() -> None:
    names = {f"text{k}": f"j{j}" for k, j in enumerate((3, 2, 1, 4, 5, 6))}
    mapping = map_columns(replace(table(*(BLOCKS[kind] for kind in ("q", "dq", "tau"))), texts=names), JOINTS)
    assert [mapping.position[f"j{k}"].column for k in (1, 2, 3, 4)] == ["3", "2", "1", "4"]
    assert [mapping.torque[f"j{k}"].column for k in (1, 2, 3, 4)] == ["15", "14", "13", "16"]


@pytest.mark.parametrize(
    "kinds", [("q", "tau"), ("tau", "q"), ("q", "dq", "tau"), ("current", "q", "tau"), ("q", "dq", "ddq", "tau")]
)
def test_a_logger_may_write_joint_by_joint(kinds: tuple[str, ...]) -> None:
    mapping = map_columns(table(np.stack([BLOCKS[kind] for kind in kinds], axis=2).reshape(len(T), -1)), JOINTS)
    expected = [[str(1 + len(kinds) * j + kinds.index(kind)) for j in range(6)] for kind in ("q", "tau")]
    assert columns_of(mapping) == [*expected[0], *expected[1]]
    question = next(iter(mapping.position.values())).question
    assert all(f"'{column}'" in question for column in expected[0])


def test_blocks_stay_blocks_where_another_order_is_hardly_smoother() -> None:
    """A torque of gravity alone is smoother than the position of a faster joint."""
    q = np.column_stack([np.sin(T), np.sin(1.3 * T)])
    position, _ = match_by_shape(table(q, np.column_stack([9 * np.sin(q[:, 0]), 5 * np.sin(3 * q[:, 1])])), JOINTS[:2])
    assert list(position.columns.values()) == ["1", "2"]


@pytest.mark.parametrize("names", [lambda k: f"c{k + 1}", lambda k: f"Spalte {k}"], ids=["c1", "Spalte"])
def test_headers_that_say_nothing(names) -> None:
    full = table(BLOCKS["q"], BLOCKS["dq"], BLOCKS["tau"])
    named = DataTable({names(int(key)): x.copy() for key, x in full.columns.items()}, {}, "a.csv")
    mapping = map_columns(named, JOINTS)
    assert mapping.time.column == names(0)
    assert columns_of(mapping) == [names(k) for k in (*range(1, 7), *range(13, 19))]


@pytest.mark.parametrize("at", [0, 6, 12, 18], ids="a column more at {}".format)
@pytest.mark.parametrize("more", [np.ones(len(T)), np.sin(T)], ids=["constant", "something else"])
def test_a_column_more_shifts_nothing(at: int, more: NDArray) -> None:
    columns = np.insert(np.column_stack([BLOCKS["q"], BLOCKS["dq"], BLOCKS["tau"]]), at, more, axis=1)
    expected = [str(1 + k + (k >= at)) for k in range(18)]
    mapping = map_columns(table(columns), JOINTS)
    assert columns_of(mapping) == expected[:6] + expected[12:]


def test_of_two_clocks_the_one_of_seconds_is_taken_and_asked() -> None:
    mapping = map_columns(table(T, BLOCKS["q"], BLOCKS["tau"], clock=np.arange(len(T))), JOINTS)
    assert (mapping.time.column, mapping.time.unit) == ("1", "s")
    assert "'0'" in mapping.time.question
    assert [value.column for value in mapping.position.values()] == [str(k) for k in range(2, 8)]


def test_commanded_positions_are_a_rival() -> None:
    delayed = np.roll(BLOCKS["q"], 2, axis=0)
    delayed[:2] = BLOCKS["q"][0]
    position, torque = match_by_shape(table(delayed, BLOCKS["q"], BLOCKS["dq"], BLOCKS["tau"]), JOINTS)
    assert "nearly the same" in position.question
    assert list(torque.columns.values()) == [str(k) for k in range(19, 25)]


@pytest.mark.parametrize("finger", [True, False])
def test_fingers_may_be_missing_and_values_too(finger: bool) -> None:
    hand = MovableJoint("finger", "prismatic", RobotJointLimits(lower=0.0, upper=0.04, effort=20.0))
    parts = [BLOCKS[kind].copy() for kind in ("tau", "q", "dq")]
    if not finger:
        parts[0][[7, 900, 901], 2] = np.nan
        parts[1][40, 5] = np.inf
        parts[2] = np.full(len(T), np.nan)
    mapping = map_columns(table(*parts), (*JOINTS, hand) if finger else JOINTS)
    assert columns_of(mapping) == [str(k) for k in (*range(7, 13), *range(1, 7))]
    assert set(mapping.lock) == ({"finger"} if finger else set())


def test_a_gripper_without_velocity_leaves_the_rate_to_the_other_joints() -> None:
    gripper = np.sign(np.sin(T))
    columns = [*BLOCKS["q"].T, gripper, *BLOCKS["dq"].T, 0 * gripper]
    data = DataTable({f"q{k}" if k < 7 else f"x{k}": x for k, x in enumerate(columns)}, {}, "a.csv")
    position = Match(ColumnFamily("position", 0, {}), {f"j{k}": f"q{k}" for k in range(7)}, "")
    assert sampling_step(data, position) == pytest.approx(T[1] - T[0], rel=0.01)
    still = Match(position.family, {f"j{k}": f"q{k}" for k in (5, 6)}, "")
    assert np.isnan(sampling_step(data, still))


@pytest.mark.parametrize("columns", [np.zeros((50, 18)), np.ones((4000, 18)), np.full((4000, 18), np.nan)], ids=str)
def test_columns_that_show_nothing_are_not_matched(columns: NDArray) -> None:
    assert match_by_shape(table(columns, clock=T[: len(columns)]), JOINTS) == (None, None)


@pytest.mark.parametrize("unit", [1e-3, 0.1])
def test_the_smoothest_block_has_the_positions_whatever_the_unit_of_the_others(unit: float) -> None:
    for q in (BLOCKS["q"], np.rad2deg(BLOCKS["q"])):  # in degrees beyond reach in rad, where the others are within it
        position, _ = match_by_shape(table(unit * BLOCKS["tau"], q), JOINTS)
        assert list(position.columns.values()) == [str(k) for k in range(7, 13)]
    position, torque = match_by_shape(table(_noise(5.0), BLOCKS["q"]), JOINTS)
    assert list(position.columns.values()) == [str(k) for k in range(7, 13)]
    assert torque is None


def test_columns_matched_by_their_values_have_the_units_of_their_names() -> None:
    """The leg's columns name no joint of the robot file, but say what they are."""
    parts = ("hip", "thigh", "knee", "shin", "ankle", "foot")
    columns = {f"{part} angle (deg)": np.degrees(q) for part, q in zip(parts, BLOCKS["q"].T, strict=True)}
    columns |= {f"{part} torque (mN·m)": 1e3 * x for part, x in zip(parts, BLOCKS["tau"].T, strict=True)}
    mapping = map_columns(DataTable({"time": T, **columns}, {}, "a.txt"), JOINTS)
    assert columns_of(mapping) == list(columns)
    assert {channel.unit for channel in mapping.position.values()} == {"deg"}
    assert {channel.unit for channel in mapping.torque.values()} == {"mN m"}
    assert not any("degrees" in channel.question for channel in mapping.position.values())


def test_columns_are_of_the_joints_that_they_name_and_what_was_commanded_is_no_torque() -> None:
    names, order = [joint.name for joint in JOINTS], [3, 0, 5, 1, 4, 2]
    columns = {
        f"{word}.{names[j]}": BLOCKS[kind][:, j] for word, kind in (("action", "tau"), ("u", "q")) for j in order
    }
    mapping = map_columns(DataTable({"time": T, **columns}, {}, "a.txt"), JOINTS)
    assert "order" not in mapping.position["j1"].question
    for word, channels in (("u", mapping.position), ("action", mapping.command)):
        assert {name: channels[name].column for name in names} == {name: f"{word}.{name}" for name in names}
