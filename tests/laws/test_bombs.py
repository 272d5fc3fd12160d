"""No file takes more memory than its budget, or more than seconds to be refused: small files that claim much."""

import bz2
import io
import struct
import time
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.files.opener import watch_inputs
from dynident.files.ros import chunks_within_budget
from dynident.files.tables import DataTable, read_columns
from dynident.files.yaml_text import MAX_NODES
from dynident.models import RigidBodies
from dynident.models.rigid_bodies import read_robot_file
from dynident.project.config import parse_config
from dynident.project.saved import load
from dynident.runtime import MEMORY_VARIABLE, ConfigError, InputError, ModelError
from tests.project.files import written

BUDGET = 0.01  # GB
COUNT = 5_000_000  # zeros in a bomb, 40 MB of float64


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A budget of 10 MB, and 20 s of processor time; the memory that Python's allocators hold stays below 3 budgets."""
    monkeypatch.setenv(MEMORY_VARIABLE, str(BUDGET))
    tracemalloc.start()
    start = time.process_time()
    yield
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert time.process_time() - start < 20
    assert peak < 3e9 * BUDGET, peak


def squeezed(*parts: bytes) -> bytes:
    stream = zlib.compressobj(9)
    return b"".join([*map(stream.compress, parts), stream.flush()])


def zeros(count: int) -> list[bytes]:
    return [bytes(1 << 16)] * (count >> 16)


def element(kind: int, content: bytes) -> bytes:
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def mat(name: str, claimed: int, held: int) -> bytes:
    """A compressed variable that claims and holds so many numbers."""
    parts = (
        element(6, struct.pack("<II", 6, 0)) + element(5, struct.pack("<ii", claimed, 1)) + element(1, name.encode())
    )
    parts += struct.pack("<II", 9, 8 * claimed)
    data = squeezed(struct.pack("<II", 14, len(parts) + 8 * claimed) + parts, *zeros(8 * held))
    return struct.pack("<II", 15, len(data)) + data


def npz(shape: tuple[int, ...], held: int, name: str = "x") -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(f"{name}.npy", "w") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
        for part in zeros(8 * held):
            file.write(part)
    return buffer.getvalue()


def parquet(rows: int) -> bytes:
    buffer = io.BytesIO()
    pl.select(x=pl.repeat(0, rows, dtype=pl.Int8)).write_parquet(buffer)
    return buffer.getvalue()


MAT5 = b"MATLAB 5.0".ljust(124) + b"\0\1IM"
BOMBS: dict[str, Callable[[], bytes]] = {
    "claims.mat": lambda: MAT5 + mat("x", COUNT, COUNT),
    "lies.mat": lambda: MAT5 + mat("x", 1000, COUNT),
    "claims.npz": lambda: npz((COUNT,), COUNT),
    "lies.npz": lambda: npz((1000,), COUNT),
    "promises.npz": lambda: npz((10**15,), 1000),
    "square.npz": lambda: npz((10**9, 10**9), 1000),
    "rows.parquet": lambda: parquet(COUNT),
    "lines.csv": lambda: b"x\n" + b"1\n" * 100_000,
    "cells.csv": lambda: b"x" + b",1" * 200_000,
}


@pytest.mark.parametrize("name", BOMBS)
def test_no_table_takes_more_than_its_budget(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, name, BOMBS[name]())
    for needed in (None, {"x"}):
        try:
            table = read_columns(path, needed=needed)
        except InputError as error:
            assert len(str(error)) < 500 + len(str(path))  # noqa: PT017
        else:
            assert needed is None
            assert not table.columns
            assert "raise this by --memory" in table.faults["x"]


@pytest.mark.parametrize("name", ["claims.npz", "promises.npz", "square.npz", "rows.parquet", "claims.mat"])
def test_a_column_that_is_not_needed_is_not_read(tmp_path: Path, name: str) -> None:
    table = read_columns(written(tmp_path, name, BOMBS[name]()), needed={"t"})
    assert not table.columns
    assert any(column.startswith("x") for column in table.unread)
    with pytest.raises(InputError, match=r"no column 't'; choose from 'x"):
        table.column("t")


def test_the_budget_is_raised_by_the_option(tmp_path: Path) -> None:
    tracemalloc.stop()
    path = written(tmp_path, "a.npz", npz((1 << 20,), 1 << 20))
    with pytest.raises(InputError, match="more than the 10 MB that a file may take"):
        read_columns(path, needed={"x"})
    with watch_inputs():
        from dynident.files.opener import set_memory

        set_memory(1.0)
        assert len(read_columns(path, needed={"x"}).column("x")) == 1 << 20
    tracemalloc.start()


def test_an_array_twice_is_an_error(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("t.npy", b"")
        with pytest.warns(UserWarning, match="Duplicate name"):
            archive.writestr("t.npy", b"")
    with pytest.raises(InputError, match="the array 't' is there twice"):
        read_columns(written(tmp_path, "a.npz", buffer.getvalue()))


def test_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py", reason='the extra "hdf5" is not installed')
    full = squeezed(*zeros(8 << 16))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = np.arange(3.0)
        for name in ("images", "lies"):
            shape = (100 << 16,) if name == "images" else (1000,)
            data = file.create_dataset(name, shape, "f8", chunks=(min(1 << 16, *shape),), compression="gzip")
            data.id.write_direct_chunk((0,), full if name == "images" else squeezed(*zeros(8 * COUNT)))
        data = file.create_dataset("chunk", (10,), "f8", chunks=(COUNT,), maxshape=(None,), compression="gzip")
        data.id.write_direct_chunk((0,), squeezed(*zeros(8 * COUNT)))
        groups = [file.create_group(f"g{k}") for k in range(12)]
        for group in groups:
            for k, other in enumerate(groups):
                group[str(k)] = other
    tracemalloc.reset_peak()
    table = read_columns(tmp_path / "a.h5", needed={"t"})
    assert list(table.columns) == ["t"]
    assert set(table.unread) == {"images", "lies", "chunk"}
    for name, words in (("images", "--memory"), ("chunk", "--memory"), ("lies", "holds more than the 8000 it should")):
        with pytest.raises(InputError, match=words):
            read_columns(tmp_path / "a.h5", needed={name})


@pytest.mark.parametrize("kind", ["bz2", "lz4", "zstd"])
def test_a_chunk_of_a_bag_holds_no_more_than_its_share(kind: str) -> None:
    pytest.importorskip("rosbags", reason='the extra "ros" is not installed')
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import storage_mcap as mcap

    tables = {**mcap.DECOMPRESSORS, **ros1.decompressors}
    full = b"".join(zeros(8 * COUNT))
    data = {"bz2": bz2.compress, "lz4": _lz4, "zstd": _zstd}[kind](full)
    short = {"bz2": bz2.compress, "lz4": _lz4, "zstd": _zstd}[kind](b"abc")
    del full
    tracemalloc.clear_traces()
    tracemalloc.reset_peak()
    with chunks_within_budget(Path("a.bag")):
        tables = {**mcap.DECOMPRESSORS, **ros1.decompressors}
        assert tables[kind](*[short, 3][: 1 + (kind == "zstd")]) == b"abc"
        if kind != "lz4":  # which compresses 255 times at most
            with pytest.raises(InputError, match=r"a\.bag: decompressed, it takes 100 times its size"):
                tables[kind](*[data, len(data)][: 1 + (kind == "zstd")])
    again = {**mcap.DECOMPRESSORS, **ros1.decompressors}
    assert again[kind](*[short, 3][: 1 + (kind == "zstd")]) == b"abc"


def _lz4(data: bytes) -> bytes:
    from lz4.frame import compress

    return bytes(compress(data))


def _zstd(data: bytes) -> bytes:
    from dynident.files.ros import _zstd as module

    return bytes(module().compress(data))


def laughs(row: str, depth: int = 40) -> str:
    return "\n".join(["a0: &a0 [x]", *(row.replace("J", str(k)).replace("I", str(k - 1)) for k in range(1, depth))])


YAMLS = {
    "values": laughs("aJ: &aJ [*aI, *aI]"),
    "keys": laughs("? &aJ [*aI, *aI]\n: 1"),
    "merges": laughs("aJ: &aJ {<<: [*aI, *aI]}").replace("[x]", "{x: 1}"),
    "ring": "a: &a [*a]",
    "flow": "[" * 100_000,
    "block": "\n".join(" " * k + "a:" for k in range(1300)),
    "many": "[" + "1," * (MAX_NODES + 1) + "]",
    "long": "a: " + "x" * 2_000_000,
    "number": "a: 0x" + "f" * 500_000,
}


@pytest.mark.parametrize("text", YAMLS.values(), ids=YAMLS)
def test_no_configuration_grows(text: str) -> None:
    tracemalloc.stop()  # parsing is slow enough without
    with pytest.raises(ConfigError) as raised:
        parse_config(text)
    assert len(str(raised.value)) < 2000
    tracemalloc.start()


def test_an_alias_is_read() -> None:
    from dynident.files.yaml_text import load_yaml

    text = "a: &a {x: 1}\nb: *a\nc: {<<: *a, y: 2}"
    assert load_yaml(text, "c.yaml") == {"a": {"x": 1}, "b": {"x": 1}, "c": {"x": 1, "y": 2}}


@pytest.mark.parametrize("text", ["[" * 200_000, '{"a":' * 200_000, "[" + "[]," * 400_000 + "[]]", "9" * 300_000])
def test_no_result_grows(tmp_path: Path, text: str) -> None:
    with pytest.raises(InputError, match=r"is not a result.json|would take"):
        load(written(tmp_path, "r.json", text))


ENTITIES = '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;">]><robot name="&b;"/>'


@pytest.mark.parametrize("text", [ENTITIES, "<robot>" + "<a>" * 100_000, "<robot " + 'a="1" ' * 1000 + "/>"])
def test_no_robot_file_grows(text: str) -> None:
    with pytest.raises(ModelError):
        read_robot_file(text, "arm.urdf")


def chain(count: int) -> str:
    joints = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/></joint>'
        for k in range(1, count + 1)
    )
    return f'<robot name="r"><link name="l0"/>{joints}</robot>'


def test_a_robot_of_ten_thousand_joints_is_refused_or_held_still() -> None:
    tracemalloc.stop()
    text = chain(10_000)
    with pytest.raises(ModelError, match="10000 joints would move, and 500 are the most"):
        RigidBodies(text)
    assert len(RigidBodies(text, joints_used=("j5", "j10000")).joints) == 2
    loop = text.replace('<parent link="l0"/>', '<parent link="l10000"/>')
    with pytest.raises(ModelError, match="form a cycle"):
        read_robot_file(loop, "arm.urdf")
    tracemalloc.start()


def test_a_table_of_fifty_thousand_columns_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tracemalloc.stop()
    monkeypatch.setenv(MEMORY_VARIABLE, "1")
    names = ",".join(f"c{k}" for k in range(50_000))
    row = ",".join(["1.5"] * 49_999)
    result: DataTable = read_columns(written(tmp_path, "a.csv", f"{names}\n{row},2\n{row},x\n"))
    assert len(result.columns) == 49_999
    assert list(result.faults) == ["c49999"]
    tracemalloc.start()
