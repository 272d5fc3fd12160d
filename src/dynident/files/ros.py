"""Joint states from ROS 1 bags, ROS 2 bags and MCAP files, by the package rosbags.

Only topics of type sensor_msgs/JointState are decoded, with the published definition of that type; all else in a bag,
custom types included, is ignored.
"""

from __future__ import annotations

import sqlite3
from array import array
from bz2 import BZ2Decompressor
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import field
from importlib import import_module
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any, BinaryIO
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from dynident.files.opener import afford, open_input, read_text
from dynident.files.tables import DataTable
from dynident.files.yaml_text import load_yaml
from dynident.runtime import MEMORY_VARIABLE, InputError, Noun, choices, install_command, memory_budget
from dynident.runtime.arrays import Array
from dynident.runtime.families import READERS

_BUDGET_DIVISOR = 32  # of the budget, what chunks hold beyond the usual ratio
_MAX_COMPRESSION_RATIO = 100  # chunks of a recording are compressed less
_MAX_FRAMES = 1000
_READ_SIZE = 1 << 20
_ROSBAGS_LOCK = Lock()  # bags are read in turn: what ``chunks_within_budget`` replaces is one for the whole process
Stamps = NDArray[np.int64]

BAGS = (".bag", ".db3", ".mcap")
_JOINT_STATE = "sensor_msgs/msg/JointState"
_QUANTITIES = ("position", "velocity", "effort")
_COPIES_IN_MEMORY = 4  # of the values, on the way from messages to columns


def examine_files(path: Path) -> None:
    """Raise InputError or ConfigError where a file of a bag is not regular, or would compute its content."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_dir():
            continue
        with open_input(file) as data:
            database = data.read(16) == b"SQLite format 3\0"
        if file.name == "metadata.yaml":
            load_yaml(read_text(file), str(file))
        if database:
            _examine_database(file)


def _examine_database(path: Path) -> None:
    uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(uri, uri=True)) as database:
        # views, triggers and generated columns would run SQL that a recording never has
        for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
            if kind in ("view", "trigger") or any(word in str(sql).upper() for word in (" AS ", " AS(", "VIRTUAL")):
                raise InputError(f"{path}: {name!r} is no plain table; a recording of ROS has no other.")


@contextmanager
def chunks_within_budget(path: Path) -> Iterator[None]:
    """Limit what the library rosbags decompresses.

    The budget is 1/32 of the memory of a file, plus 100 times the compressed size. Only one bag is open at a
    time, as rosbags holds its decompressors in module tables; they are restored afterwards. Raises InputError
    where a chunk holds more, and where a length exceeds the memory.
    """
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    bounded = _BoundedDecompressors(path)
    # each storage plugin looks up its decompressors in a table of its own
    tables: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (ros1.decompressors, {"bz2": bounded.bz2, "lz4": bounded.lz4}),
        (mcap.DECOMPRESSORS, {"lz4": bounded.lz4, "zstd": bounded.zstd}),
        (vars(ros2), {"zstd": SimpleNamespace(decompress=bounded.zstd, open=bounded.open)}),
    ]
    with _ROSBAGS_LOCK:
        originals = [dict(table) for table, _ in tables]
        try:
            for table, replacements in tables:
                table |= {name: replacements[name] for name in replacements if name in table}
            yield
        except MemoryError as error:  # rosbags takes any length that a bag gives for true
            raise InputError(
                f"{path}: a part of it is longer than the memory, as where a length in it is damaged; record again, or "
                "write what you need to another bag."
            ) from error
        finally:
            for (table, replacements), old in zip(tables, originals, strict=True):
                table |= {name: old[name] for name in replacements if name in old}


class _BoundedDecompressors:
    """The decompressors of a bag, which share one budget."""

    def __init__(self, path: Path) -> None:
        self.path, self.left = path, memory_budget() // _BUDGET_DIVISOR

    def bz2(self, data: bytes, *_: object) -> bytes:
        return self._decompress(BZ2Decompressor, data)

    def lz4(self, data: bytes, *_: object) -> bytes:
        return self._decompress(import_module("lz4.frame").LZ4FrameDecompressor, data)

    def zstd(self, data: bytes, *_: object) -> bytes:
        return self._decompress(_zstd().ZstdDecompressor, data)

    @contextmanager
    def open(self, file: BinaryIO, mode: str) -> Iterator[SimpleNamespace]:
        """Open a compressed file, as ``zstd.open``; only ``read`` is needed."""
        self.left += _MAX_COMPRESSION_RATIO * file.seek(0, 2)
        file.seek(0)
        with _zstd().open(file, mode) as inside:

            def read(count: int = _READ_SIZE) -> bytes:
                data: bytes = inside.read(min(count, _READ_SIZE))
                self._spend(len(data))
                return data

            yield SimpleNamespace(read=read)

    def _decompress(self, make: Callable[[], Any], data: bytes) -> bytes:
        # each chunk adds to the budget by its size, so long recordings pass and decompression bombs do not
        self.left += _MAX_COMPRESSION_RATIO * len(data)
        parts: list[bytes] = []
        while data:
            stream = make()
            # one byte beyond the budget is enough to notice an overrun without decompressing all of it
            parts.append(stream.decompress(data, max(self.left, 0) + 1))
            self._spend(len(parts[-1]))
            data = stream.unused_data if stream.eof else b""
            if not stream.eof or len(parts) > _MAX_FRAMES:
                raise ValueError("a compressed chunk is cut off, or is many")
        return b"".join(parts)

    def _spend(self, count: int) -> None:
        self.left -= count
        if self.left < 0:
            raise InputError(
                f"{self.path}: decompressed, it takes {_MAX_COMPRESSION_RATIO} times its size and "
                f"{memory_budget() / _BUDGET_DIVISOR / 1e9:.3g} GB more; raise this by --memory or {MEMORY_VARIABLE} "
                "(in GB), if the file is what it should be."
            )


def _zstd() -> Any:
    """Return the module of zstd: of the standard library, or the one that rosbags takes before Python 3.14."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")


class _MessageGroup(Noun):
    """The messages of a topic that name the same set of joints, in the order of arrival; stamps are in ns.

    ``quantities`` are those that at least one message holds.
    """

    topic: str
    joints: tuple[str, ...]
    header: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    values: Mapping[str, array[float]] = field(default_factory=lambda: {name: array("d") for name in _QUANTITIES})
    quantities: set[str] = field(default_factory=set)  # the quantities that at least one message holds

    def add(self, message: Any, received: int) -> None:
        """Append a message, ``received`` at that time (ns), with its joints in the order of the group."""
        stamp = message.header.stamp
        self.header.append(stamp.sec * 10**9 + stamp.nanosec)
        self.received.append(received)
        order = [tuple(message.name).index(name) for name in self.joints]
        for name in _QUANTITIES:
            values = getattr(message, name)
            if len(values):
                self.quantities.add(name)
            # a missing quantity becomes nan, so that all arrays of the group keep their rows
            row = np.asarray(values, dtype=np.float64)[order] if len(values) else np.full(len(order), np.nan)
            self.values[name].frombytes(row.tobytes())

    def matrix(self) -> Array:
        """Return positions, velocities and efforts side by side, (N, 3 n)."""
        return np.hstack([np.frombuffer(self.values[name]).reshape(-1, len(self.joints)) for name in _QUANTITIES])


class _SortedMessages(Noun):
    """The messages of a group sorted by their stamps (ns), without repeated stamps."""

    group: _MessageGroup
    clock: str
    stamps: Stamps
    values: Array
    notes: tuple[str, ...]


def read_bag(path: Path, needed: Collection[str] | None = None) -> DataTable:  # noqa: ARG001
    """Read the joint states of a ROS bag (file, or folder of a ROS 2 bag).

    A group is the messages of a topic that name the same joints, in any order. The first group has the columns
    ``time`` and ``<joint>.position``, ``.velocity`` (rad or m, and per s), ``.effort`` (N m or N); the columns of
    all others begin with ``<topic>/``, so that columns of one prefix share their rows. The first group is one
    with positions and efforts, of the most joints. Times are in s since the first message, exact to 1 ns before
    they become floats; they are header stamps, or receipt times where headers are not stamped. Raises InputError
    where the bag has no joint states or rosbags is not installed, and almost any exception where it is damaged.
    """
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        names = sorted(file.name for file in path.iterdir() if file.suffix.lower() in READERS.kinds())
        raise InputError(
            f"{path}: is a folder without metadata.yaml, so it is not a ROS 2 bag; "
            + (f"name a file in it: {choices('', names)}" if names else "nor does it hold a file that can be read.")
        )
    examine_files(path)
    groups, notes = _read_groups(path)
    rows = sorted(map(_sort_messages, groups), key=_sort_key)
    # one zero per clock, so that the groups of a bag have a common time
    start_stamps = {
        clock: min(int(messages.stamps[0]) for messages in rows if messages.clock == clock)
        for clock in {x.clock for x in rows}
    }
    columns: dict[str, Array] = {}
    faults: dict[str, str] = {}
    for messages, prefix in zip(rows, _column_prefixes(rows), strict=True):
        notes += messages.notes
        columns[f"{prefix}time"] = (messages.stamps - start_stamps[messages.clock]) / 1e9
        names = [f"{prefix}{joint}.{quantity}" for quantity in _QUANTITIES for joint in messages.group.joints]
        for k, name in enumerate(names):
            quantity = name.rpartition(".")[2]
            if quantity in messages.group.quantities:
                columns[name] = messages.values[:, k].copy()
            else:
                faults[name] = (
                    f"is empty in every message of {messages.group.topic}: its publisher sends no {quantity}."
                )
    return DataTable(columns, {}, str(path), faults, notes=(*notes, *_overlap_notes(rows)))


def _read_groups(path: Path) -> tuple[list[_MessageGroup], list[str]]:
    """Return the groups of all messages, and notes on messages that were left out."""
    reader, decode = _make_reader(path)
    groups: dict[tuple[str, frozenset[str]], _MessageGroup] = {}
    inconsistent: dict[str, int] = {}
    budget = memory_budget()
    memory_used = 0
    with chunks_within_budget(path), reader:
        connections = _joint_state_connections(path, reader)
        for connection, received, data in reader.messages(connections=connections):
            message = decode(data, _JOINT_STATE)
            count = len(message.name)
            # each joint is named once, and each list of values is empty or as long as the names
            sizes = {len(getattr(message, name)) for name in _QUANTITIES}
            if not len(set(message.name)) == count > 0 or not sizes <= {0, count}:
                inconsistent[connection.topic] = inconsistent.get(connection.topic, 0) + 1
                continue
            key = connection.topic, frozenset(message.name)
            group = groups.setdefault(key, _MessageGroup(connection.topic, tuple(message.name)))
            group.add(message, received)
            # checked while reading, as only the messages tell how many joints they have
            memory_used += _COPIES_IN_MEMORY * 8 * (2 + len(_QUANTITIES) * len(message.name))
            if memory_used > budget:
                afford(memory_used, f"{path}: its messages would take at least")
    notes = [
        f"{n} messages of {topic} were left out: names and values differ in number."
        for topic, n in inconsistent.items()
    ]
    if not groups:
        topics = sorted({source.topic for source in connections})
        raise InputError(f"{path}: has no joint state in {', '.join(topics)}. {' '.join(notes)}".rstrip())
    return list(groups.values()), notes


def _joint_state_connections(path: Path, reader: Any) -> list[Any]:
    """Return the connections that carry joint states; InputError where there is none."""
    connections = [connection for connection in reader.connections if connection.msgtype == _JOINT_STATE]
    if not connections:
        topics = sorted(
            {f"{connection.topic} ({connection.msgtype.replace('/msg/', '/')})" for connection in reader.connections}
        )
        raise InputError(
            f"{path}: has no topic of type sensor_msgs/JointState; its topics: {', '.join(topics) or 'none'}."
        )
    return connections


def _make_reader(path: Path) -> tuple[Any, Callable[[bytes, str], Any]]:
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


def _sort_messages(group: _MessageGroup) -> _SortedMessages:
    """Return the messages of a group sorted by stamp; of equal stamps the first message is kept."""
    clock, stamps, notes = _choose_clock(group)
    backward_steps = int(np.count_nonzero(np.diff(stamps) < 0))
    if backward_steps:
        notes.append(f"{group.topic}: {backward_steps} messages out of order were sorted by their stamp.")
    # a stable sort keeps the order of arrival among equal stamps
    order = np.argsort(stamps, kind="stable")
    stamps, values = stamps[order], group.matrix()[order]
    is_first = np.diff(stamps, prepend=stamps[0] - 1) > 0
    # for each message the index of the first one with its stamp, to tell duplicates from conflicts
    first_index = np.maximum.accumulate(np.where(is_first, np.arange(len(stamps)), 0))
    same_values = ((values == values[first_index]) | (np.isnan(values) & np.isnan(values[first_index]))).all(axis=1)
    duplicates, conflicts = (
        int(np.count_nonzero(~is_first & same_values)),
        int(np.count_nonzero(~is_first & ~same_values)),
    )
    if duplicates:
        notes.append(f"{group.topic}: {duplicates} duplicate messages were dropped.")
    if conflicts:
        notes.append(
            f"{group.topic}: {conflicts} messages repeat the stamp of another one with other values, as two publishers "
            "of the same joints would send; the first of each stamp is kept."
        )
    return _SortedMessages(group, clock, stamps[is_first], values[is_first], tuple(notes))


def _choose_clock(group: _MessageGroup) -> tuple[str, Stamps, list[str]]:
    """Return the clock of the group, its stamps in ns, and a note where these are receipt times."""
    header = np.frombuffer(group.header, np.int64)
    unset = int(np.count_nonzero(header == 0))
    # stamps that mostly repeat are no times of measurement
    if not unset and 2 * len(np.unique(header)) > len(header):
        return "header", header, []
    reason = f"{unset} of {len(header)} headers have no stamp" if unset else "most header stamps repeat"
    note = f"{group.topic}: {reason}; the times are those at which the messages were received."
    return "receipt", np.frombuffer(group.received, np.int64), [note]


def _sort_key(rows: _SortedMessages) -> tuple[bool, int, int, str]:
    """Return the sort key of a group: groups to identify from first, then by numbers of joints and messages."""
    incomplete = not {"position", "effort"} <= rows.group.quantities
    return incomplete, -len(rows.group.joints), -len(rows.stamps), rows.group.topic


def _column_prefixes(rows: Iterable[_SortedMessages]) -> list[str]:
    """Return the column prefix of each group: none for the first, else its topic, numbered if needed."""
    # numbered from 2 where several groups are of one topic
    prefixes: list[str] = []
    for messages in rows:
        names = [f"{messages.group.topic}/", *(f"{messages.group.topic}#{k}/" for k in range(2, len(prefixes) + 2))]
        prefixes.append(next(name for name in names if name not in prefixes) if prefixes else "")
    return prefixes


def _overlap_notes(rows: Sequence[_SortedMessages]) -> list[str]:
    """Return notes on messages of a topic that share only some joints with the first group."""
    main_group, prefixes = rows[0].group, _column_prefixes(rows)
    return [
        f"{main_group.topic}: {len(messages.stamps)} messages name other joints ({', '.join(messages.group.joints)}) "
        f"than the rest ({', '.join(main_group.joints)}); their columns begin with {prefix!r}."
        for messages, prefix in zip(rows[1:], prefixes[1:], strict=True)
        if messages.group.topic == main_group.topic and set(messages.group.joints) & set(main_group.joints)
    ]
