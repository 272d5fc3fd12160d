"""Joint states from ROS 1 bags, ROS 2 bags and MCAP files, by the package rosbags.

Only topics of type sensor_msgs/JointState are decoded, with the published definition of that type; all else in a bag,
custom types included, is ignored.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, install_command, memory
from dynident.io.bag_files import chunks_within_budget, examine_files
from dynident.io.opener import afford

__all__ = ["BAGS", "parse_bag"]

Array = NDArray[np.float64]
Stamps = NDArray[np.int64]

BAGS = (".bag", ".db3", ".mcap")
_TYPE = "sensor_msgs/msg/JointState"
_QUANTITIES = ("position", "velocity", "effort")
_COPIES = 4  # of the values, on the way from messages to columns


@dataclass(frozen=True, eq=False)
class _Group:
    """The messages of a topic that name the same set of joints, in the order of arrival; stamps are in ns."""

    topic: str
    joints: tuple[str, ...]
    header: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    values: Mapping[str, array[float]] = field(default_factory=lambda: {name: array("d") for name in _QUANTITIES})
    sent: set[str] = field(default_factory=set)  # the quantities that at least one message holds

    def add(self, message: Any, received: int) -> None:
        """Append a message, ``received`` at that time (ns), with its joints in the order of the group."""
        stamp = message.header.stamp
        self.header.append(stamp.sec * 10**9 + stamp.nanosec)
        self.received.append(received)
        order = _order(tuple(message.name), self.joints)
        for name in _QUANTITIES:
            values = getattr(message, name)
            if len(values):
                self.sent.add(name)
            row = np.asarray(values, dtype=np.float64)[order] if len(values) else np.full(len(order), np.nan)
            self.values[name].frombytes(row.tobytes())

    def matrix(self) -> Array:
        """Return positions, velocities and efforts side by side, (N, 3 n)."""
        return np.hstack([np.frombuffer(self.values[name]).reshape(-1, len(self.joints)) for name in _QUANTITIES])


@dataclass(frozen=True, eq=False)
class _Rows:
    """A group in the order of its stamps (ns), each of which is there once."""

    group: _Group
    clock: str
    stamps: Stamps
    values: Array
    notes: tuple[str, ...]


def parse_bag(path: Path) -> tuple[dict[str, Array], dict[str, str], tuple[str, ...]]:
    """Return columns, faults of columns, and notes on corrections of a bag (file, or folder of a ROS 2 bag).

    A group is the messages of a topic that name the same joints, in any order. The first group has the columns
    ``time`` and ``<joint>.position``, ``.velocity`` (rad or m, and per s), ``.effort`` (N m or N); those of every
    other group begin with ``<topic>/``, so that columns of one prefix share their rows. The first group is one with
    positions and efforts, of the most joints. Times are in s since the first message, exact to 1 ns before they
    become floats: of the header stamps, or of the receipt where headers are not stamped. Raises InputError where the
    bag has no joint states or rosbags is not installed, and almost any exception where it is damaged.
    """
    examine_files(path)
    groups, notes = _groups(path)
    rows = sorted(map(_sorted, groups), key=_rank)
    zero = {clock: min(int(one.stamps[0]) for one in rows if one.clock == clock) for clock in {x.clock for x in rows}}
    columns: dict[str, Array] = {}
    faults: dict[str, str] = {}
    for one, prefix in zip(rows, _prefixes(rows), strict=True):
        notes += one.notes
        columns[f"{prefix}time"] = (one.stamps - zero[one.clock]) / 1e9
        names = [f"{prefix}{joint}.{quantity}" for quantity in _QUANTITIES for joint in one.group.joints]
        for k, name in enumerate(names):
            quantity = name.rpartition(".")[2]
            if quantity in one.group.sent:
                columns[name] = one.values[:, k].copy()
            else:
                faults[name] = f"is empty in every message of {one.group.topic}: its publisher sends no {quantity}."
    return columns, faults, (*notes, *_overlaps(rows))


def _groups(path: Path) -> tuple[list[_Group], list[str]]:
    """Return the groups of all messages, and notes on messages left out."""
    reader, decode = _opened(path)
    groups: dict[tuple[str, frozenset[str]], _Group] = {}
    torn: dict[str, int] = {}
    most = memory()
    taken = 0
    with chunks_within_budget(path), reader:
        wanted = _joint_states(path, reader)
        for connection, received, data in reader.messages(connections=wanted):
            message = decode(data, _TYPE)
            if not _whole(message):
                torn[connection.topic] = torn.get(connection.topic, 0) + 1
                continue
            key = connection.topic, frozenset(message.name)
            group = groups.setdefault(key, _Group(connection.topic, tuple(message.name)))
            group.add(message, received)
            taken += _COPIES * 8 * (2 + len(_QUANTITIES) * len(message.name))
            if taken > most:
                afford(taken, f"{path}: its messages would take at least")
    notes = [f"{n} messages of {topic} were left out: names and values differ in number." for topic, n in torn.items()]
    if not groups:
        topics = sorted({one.topic for one in wanted})
        raise InputError(f"{path}: has no joint state in {', '.join(topics)}. {' '.join(notes)}".rstrip())
    return list(groups.values()), notes


def _joint_states(path: Path, reader: Any) -> list[Any]:
    """Return the connections that carry joint states; InputError where there is none."""
    wanted = [one for one in reader.connections if one.msgtype == _TYPE]
    if not wanted:
        topics = sorted({f"{one.topic} ({one.msgtype.replace('/msg/', '/')})" for one in reader.connections})
        raise InputError(
            f"{path}: has no topic of type sensor_msgs/JointState; its topics: {', '.join(topics) or 'none'}."
        )
    return wanted


def _opened(path: Path) -> tuple[Any, Callable[[bytes, str], Any]]:
    """Return a reader of the bag, still to be entered, and the function that decodes a message."""
    try:
        from rosbags.rosbag1 import Reader as Reader1
        from rosbags.rosbag2 import Reader as Reader2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: bags are read by rosbags; install it by: {install_command('rosbags')}") from error
    if path.suffix.lower() == ".bag" and not path.is_dir():
        return Reader1(path), get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
    return Reader2(path), get_typestore(Stores.LATEST).deserialize_cdr


def _whole(message: Any) -> bool:
    """Whether each joint is named once, and each list of values is empty or as long as the names."""
    count = len(message.name)
    return len(set(message.name)) == count > 0 and all(
        len(getattr(message, name)) in (0, count) for name in _QUANTITIES
    )


def _order(names: tuple[str, ...], wanted: tuple[str, ...]) -> list[int]:
    """Return where the wanted joints stand in a message: publishers may change their order."""
    return [names.index(name) for name in wanted]


def _sorted(group: _Group) -> _Rows:
    """Return the rows of a group by their stamps; of equal stamps the first message is kept."""
    clock, stamps, notes = _clock(group)
    back = int(np.count_nonzero(np.diff(stamps) < 0))
    if back:
        notes.append(f"{group.topic}: {back} messages out of order were sorted by their stamp.")
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], group.matrix()[order]
    first = np.diff(stamps, prepend=stamps[0] - 1) > 0
    kept = np.maximum.accumulate(np.where(first, np.arange(len(stamps)), 0))
    equal = ((values == values[kept]) | (np.isnan(values) & np.isnan(values[kept]))).all(axis=1)
    twice, other = int(np.count_nonzero(~first & equal)), int(np.count_nonzero(~first & ~equal))
    if twice:
        notes.append(f"{group.topic}: {twice} duplicate messages were dropped.")
    if other:
        notes.append(
            f"{group.topic}: {other} messages repeat the stamp of another one with other values, as two publishers "
            "of the same joints would send; the first of each stamp is kept."
        )
    return _Rows(group, clock, stamps[first], values[first], tuple(notes))


def _clock(group: _Group) -> tuple[str, Stamps, list[str]]:
    """Return the clock of the group, its stamps in ns, and a note where it is not the header's."""
    header = np.frombuffer(group.header, np.int64)
    unset = int(np.count_nonzero(header == 0))
    if not unset and 2 * len(np.unique(header)) > len(header):
        return "header", header, []
    reason = f"{unset} of {len(header)} headers have no stamp" if unset else "most header stamps repeat"
    note = f"{group.topic}: {reason}; the times are those at which the messages were received."
    return "receipt", np.frombuffer(group.received, np.int64), [note]


def _rank(rows: _Rows) -> tuple[bool, int, int, str]:
    """Order the groups: those to identify from first, then by the number of joints and of messages."""
    incomplete = not {"position", "effort"} <= rows.group.sent
    return incomplete, -len(rows.group.joints), -len(rows.stamps), rows.group.topic


def _prefixes(rows: Iterable[_Rows]) -> list[str]:
    """Return what the columns of each group begin with: nothing for the first, else its topic, numbered if need be."""
    prefixes: list[str] = []
    for one in rows:
        names = [f"{one.group.topic}/", *(f"{one.group.topic}#{k}/" for k in range(2, len(prefixes) + 2))]
        prefixes.append(next(name for name in names if name not in prefixes) if prefixes else "")
    return prefixes


def _overlaps(rows: Sequence[_Rows]) -> list[str]:
    """Yield notes where messages of a topic share only some joints with the first group."""
    first, prefixes = rows[0].group, _prefixes(rows)
    return [
        f"{first.topic}: {len(one.stamps)} messages name other joints ({', '.join(one.group.joints)}) than the rest "
        f"({', '.join(first.joints)}); their columns begin with {prefix!r}."
        for one, prefix in zip(rows[1:], prefixes[1:], strict=True)
        if one.group.topic == first.topic and set(one.group.joints) & set(first.joints)
    ]
