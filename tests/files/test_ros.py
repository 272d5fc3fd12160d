"""Joint states from bags: each joint's rows are its own, whatever order, topic and clock they come in."""

import builtins
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import storage_mcap

from dynident.files.ros import examine_files
from dynident.files.tables import read_columns
from dynident.models import Joint
from dynident.project.config import parse_config
from dynident.project.logs import read_logs
from dynident.runtime import InputError
from tests.files.test_tables import reads_or_explains
from tests.project.bags import KINDS, State, ramp, write_bag

kinds = pytest.mark.parametrize("kind", KINDS)


@kinds
def test_a_bag_is_read(tmp_path, kind):
    path = write_bag(tmp_path, kind, ramp(5))
    for place in (path,) if kind == "bag" else (path, path.parent):
        table = read_columns(place)
        np.testing.assert_array_equal(table.column("time"), np.arange(5) / 100)
        np.testing.assert_array_equal(table.column("b.position"), np.arange(5) + 10)
        np.testing.assert_array_equal(table.column("b.effort"), 10 * (np.arange(5) + 10))
        assert list(table.columns)[:3] == ["time", "a.position", "b.position"]
        assert (len(table.columns), table.notes) == (7, ())


@kinds
def test_joints_are_matched_by_name_in_every_message(tmp_path, kind):
    states = ramp(20)
    turned = [
        replace(x, names=x.names[::-1], position=x.position[::-1], effort=x.effort[::-1]) if k % 3 else x
        for k, x in enumerate(states)
    ]
    table, straight = (
        read_columns(write_bag(tmp_path, kind, some, name)) for some, name in ((turned, "turned"), (states, "straight"))
    )
    for name, values in straight.columns.items():
        np.testing.assert_array_equal(table.column(name), values)


def test_times_are_exact_to_the_nanosecond(tmp_path):
    stamps = [0, 1, 1_000_000_001, 3_600_000_000_007]
    states = [State(("a",), (1.0 * k,), (), (0.0,), stamp) for k, stamp in enumerate(stamps)]
    table = read_columns(write_bag(tmp_path, "mcap", states))
    np.testing.assert_array_equal(table.column("time"), np.array(stamps) / 1e9)


@kinds
def test_messages_out_of_order_and_twice_are_corrected_and_reported(tmp_path, kind):
    states = ramp(10)
    moved = [*states[:3], states[5], states[4], states[3], *states[6:], states[7]]
    arrived = [replace(x, received=10_000_000 * k) for k, x in enumerate(moved)]
    table = read_columns(write_bag(tmp_path, kind, arrived))
    np.testing.assert_array_equal(table.column("time"), np.arange(10) / 100)
    np.testing.assert_array_equal(table.column("a.position"), np.arange(10))
    assert [note.partition(": ")[2].split(" were")[0] for note in table.notes] == [
        "3 messages out of order",
        "1 duplicate messages",
    ]


def test_two_publishers_of_the_same_joints_are_reported(tmp_path):
    states = [x for entry in ramp(5) for x in (entry, replace(entry, effort=(7.0, 7.0)))][:-3]
    table = read_columns(write_bag(tmp_path, "db3", states))
    assert list(table.column("a.effort")) == [0, 10, 20, 30]
    assert "3 messages repeat the stamp of another one with other values" in table.notes[0]


def test_messages_of_fewer_joints_are_apart_and_reported(tmp_path):
    states = ramp(10)
    states[4] = State(("b",), (1.0,), (), (1.0,), states[4].stamp)
    table = read_columns(write_bag(tmp_path, "bag", states))
    assert len(table.column("a.position")) == len(table.column("b.position")) == 9
    (note,) = table.notes
    assert note.startswith("/joint_states: 1 messages name other joints (b) than the rest (a, b)")
    assert note.endswith("their columns begin with '/joint_states/'.")


def test_headers_without_stamps_give_the_time_of_receipt(tmp_path):
    states = [replace(x, stamp=None, received=x.stamp + 5) for x in ramp(4)]
    table = read_columns(write_bag(tmp_path, "mcap", states))
    np.testing.assert_array_equal(table.column("time"), np.arange(4) / 100)
    assert "4 of 4 headers have no stamp" in table.notes[0]
    states = [replace(x, stamp=1, received=x.stamp) for x in ramp(4)]
    assert "most header stamps repeat" in read_columns(write_bag(tmp_path, "mcap", states, "stuck")).notes[0]


def test_torn_messages_are_left_out_and_reported(tmp_path):
    states = ramp(5)
    states[1] = replace(states[1], position=(1.0, 2.0, 3.0))
    states[2] = replace(states[2], names=("a", "a"))
    table = read_columns(write_bag(tmp_path, "bag", states))
    assert list(table.column("a.position")) == [0, 3, 4]
    assert table.notes == ("2 messages of /joint_states were left out: names and values differ in number.",)


@kinds
def test_a_bag_without_joint_states_lists_its_topics(tmp_path, kind):
    with pytest.raises(
        InputError, match=r"no topic of type sensor_msgs/JointState; its topics: /oven \(my_msgs/Oven\)"
    ):
        read_columns(write_bag(tmp_path, kind, []))


def test_a_bag_whose_states_are_empty_and_a_folder_that_is_none_are_refused(tmp_path):
    with pytest.raises(InputError, match="has no joint state in /joint_states"):
        read_columns(write_bag(tmp_path, "bag", [State(())]))
    path = write_bag(tmp_path, "mcap", ramp(2))
    (path.parent / "metadata.yaml").unlink()
    with pytest.raises(InputError, match=r"without metadata.yaml, so it is not a ROS 2 bag.*hoose from 'arm.mcap'"):
        read_columns(path.parent)
    with pytest.raises(InputError, match="there is no such file"):
        read_columns(tmp_path / "arm" / "lost.mcap")


def test_without_the_extra_the_message_says_what_to_install(tmp_path, monkeypatch):
    path = write_bag(tmp_path, "mcap", ramp(2))
    plain = builtins.__import__

    def without(name, *rest, **more):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return plain(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"-m pip install rosbags$"):
        read_columns(path)


def test_a_bag_becomes_a_log_and_its_notes_warnings(tmp_path):
    states = [State(("elbow",), (np.sin(0.02 * k),), (), (np.cos(0.03 * k),), 10_000_000 * k) for k in range(200)]
    write_bag(tmp_path, "db3", [*states, replace(states[-1], received=1)])
    text = """
        model: gallery:pendulum
        time: {column: time, unit: s}
        position: {elbow: {column: elbow.position, unit: rad}}
        torque: {elbow: {column: elbow.effort, unit: N m}}
        train: [{file: arm/}]
        """
    config = parse_config(text, tmp_path)
    reading = read_logs(config.train[0], config, (Joint("elbow"),))
    assert (len(reading.logs[0]), reading.logs[0].source) == (200, "arm")
    assert any(warning.startswith("arm: /joint_states: 1 messages") for warning in reading.warnings)


FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    bags = {kind: write_bag(tmp_path_factory.mktemp("bags"), kind, ramp(20)).read_bytes() for kind in KINDS}
    return bags.__getitem__  # Hypothesis shows it with an example that fails


@FUZZ
@given(
    kind=st.sampled_from(KINDS),
    place=st.floats(0, 1, exclude_max=True),
    junk=st.binary(min_size=1, max_size=8),
    cut=st.booleans(),
)
def test_damaged_bags_are_explained(tmp_path, sound, kind, place, junk, cut):
    data = sound(kind)
    at = int(place * len(data))
    path = tmp_path / f"fuzz.{kind}"
    path.write_bytes(data[:at] + junk + (b"" if cut else data[at + len(junk) :]))
    reads_or_explains(path)


def test_a_length_beyond_the_memory_is_damage(tmp_path, sound, monkeypatch):
    path = tmp_path / "arm.mcap"
    path.write_bytes(sound("mcap"))

    def read(*_):
        raise MemoryError  # of bytes that no file of this size holds

    monkeypatch.setattr(storage_mcap, "read_sized", read)
    with pytest.raises(InputError, match=r"arm\.mcap: a part of it is longer than the memory, .* record again"):
        read_columns(path)


def test_a_folder_in_a_bag_hides_no_database_after_it(tmp_path):
    (tmp_path / "a").mkdir()
    with closing(sqlite3.connect(tmp_path / "b.db3")) as database:
        database.execute("CREATE TABLE messages (data BLOB)")
        examine_files(tmp_path)
        database.execute("CREATE VIEW topics AS SELECT data FROM messages")
    with pytest.raises(InputError, match="'topics' is no plain table"):
        examine_files(tmp_path)
