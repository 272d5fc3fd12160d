"""Writes small bags of joint states, with the writers of rosbags."""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags", reason='the extra "ros" is not installed')

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

KINDS = ("bag", "db3", "mcap")
START = 1_700_000_000_123_456_789  # ns
JOINT_STATE = "sensor_msgs/msg/JointState"


@dataclass(frozen=True)
class State:
    """A joint state; ``stamp`` and ``received`` are in ns after the start, a stamp of None is not set."""

    names: tuple[str, ...]
    position: tuple[float, ...] = ()
    velocity: tuple[float, ...] = ()
    effort: tuple[float, ...] = ()
    stamp: int | None = 0
    received: int | None = None
    topic: str = "/joint_states"


def ramp(n: int, names=("a", "b"), topic: str = "/joint_states", step: int = 10_000_000) -> list[State]:
    """States in which joint j has the position k + 10 j, and ten times that as effort."""
    rows = [tuple(k + 10.0 * j for j in range(len(names))) for k in range(n)]
    return [
        State(names, row, tuple(0 * x for x in row), tuple(10 * x for x in row), k * step, topic=topic)
        for k, row in enumerate(rows)
    ]


@cache
def message_types(release: Stores) -> Typestore:
    store = get_typestore(release)
    store.register(get_types_from_msg("float64 warmth\nstring words", "my_msgs/msg/Oven"))
    return store


def write_bag(folder: Path, kind: str, states: list[State], name: str = "arm") -> Path:
    """Write a bag with the states and a topic of a type that no one else knows; return its file."""
    store = message_types(Stores.ROS1_NOETIC if kind == "bag" else Stores.LATEST)
    types = store.types
    place = folder / (f"{name}.bag" if kind == "bag" else name)
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(place) if kind == "bag" else Writer2(place, version=9, storage_plugin=plugin)
    encode = store.serialize_ros1 if kind == "bag" else store.serialize_cdr
    with writer:
        topics = {state.topic: JOINT_STATE for state in states} | {"/oven": "my_msgs/msg/Oven"}
        to = {topic: writer.add_connection(topic, msgtype, typestore=store) for topic, msgtype in topics.items()}
        oven = types["my_msgs/msg/Oven"](warmth=1.0, words="hot")
        writer.write(to["/oven"], START, encode(oven, "my_msgs/msg/Oven"))
        for state in states:
            stamp = 0 if state.stamp is None else START + state.stamp
            header = types["std_msgs/msg/Header"](
                stamp=types["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9),
                frame_id="",
                **({"seq": 0} if kind == "bag" else {}),
            )
            values = (np.array(x, float) for x in (state.position, state.velocity, state.effort))
            message = types[JOINT_STATE](header, list(state.names), *values)
            received = state.stamp if state.received is None else state.received
            writer.write(to[state.topic], START + (received or 0), encode(message, JOINT_STATE))
    return place if kind == "bag" else place / f"{name}.{kind}"
