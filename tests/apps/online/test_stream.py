"""Samples from lines as they come, of files that grow, are rotated, cut, or read on after a kill."""

import itertools
import json
import os
import sys
import tracemalloc
from collections.abc import Iterable, Iterator
from contextlib import closing, nullcontext
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat

from dynident.apps.online.recorded import RecordedFile
from dynident.apps.online.stream import MAX_LINE_BYTES, FollowedFile, LineReader, SampleReader, StandardInput
from dynident.files.text import unit_row
from dynident.models import Joint
from dynident.project.config import parse_config
from dynident.project.settings import Config
from dynident.runtime import ConfigError, InputError

CONFIG = """\
model: gallery:two_link_arm
time: {{ column: t, unit: ms }}
position: {{ one: {{ column: a, unit: deg }}, two: {{ column: b, unit: rad }} }}
torque: {{ one: {{ column: m.0, unit: N m, gain: 2.0 }}, two: {{ sum: {{ m.1: 1.0, m.0: -1.0 }}, unit: N m }} }}
train: [ {{ file: {file} }} ]
"""
JOINTS = (Joint("one"), Joint("two"))


@cache
def config(folder: Path, file: str, **changes: str) -> Config:
    text = CONFIG.format(file=file)
    for old, new in changes.items():
        text = text.replace(f"{old}:", new)
    return parse_config(text, folder, "arm.yaml")


def reader(tmp_path: Path, file: str = "log.csv", **changes: str) -> SampleReader:
    return SampleReader(config(tmp_path, file, **changes), JOINTS, "arm.csv")


HEAD = "t,a,b,m.0,m.1,more"
ROWS = ["0,180,1.0,1.5,2.0,x", "10,90,1.5,1.0,2.5,"]


def check(case: SampleReader, lines: Iterable[str], bad: int = 0) -> None:
    result = case.push(lines)
    np.testing.assert_allclose(result.t, [0.0, 0.01])
    np.testing.assert_allclose(result.q, [[np.pi, 1.0], [np.pi / 2, 1.5]])
    np.testing.assert_allclose(result.tau, [[3.0, 0.5], [2.0, 1.5]])
    assert (result.bad.count if result.bad else 0) == bad


NESTED = [{"t": 0, "a": 180, "b": 1.0, "m": [1.5, 2.0]}, {"t": 10, "a": 90, "b": 1.5, "m": [1.0, 2.5], "note": None}]


@pytest.mark.parametrize(
    "lines",
    [
        [HEAD, *ROWS],
        [HEAD, ROWS[0], HEAD, ROWS[1]],
        ["# a comment", HEAD.replace(",", ";"), *(row.replace(",", ";").replace(".", ",") for row in ROWS)],
        [HEAD, "[ms],-,-,[A],A,", *ROWS],
        [json.dumps(row) for row in NESTED],
        ['# "a\rb', HEAD, *ROWS],
        [HEAD, '\x01"\rzz' * 60_000, *ROWS],
    ],
    ids=["rows", "names again", "other separators", "units below the names", "objects", "a comment", "a long line"],
)
def test_lines_become_samples_in_si(tmp_path: Path, lines: list[str]) -> None:
    unit = {"column: t, unit": 'column: "t [ms]", unit:'} if lines[1].startswith("[ms]") else {}
    test_reader = reader(tmp_path, **unit)
    assert len(test_reader.push([]).t) == 0
    check(test_reader, lines, bad=lines[1].startswith("\x01"))


def test_a_position_goes_on_where_its_column_starts_anew(tmp_path: Path) -> None:
    test_reader = reader(tmp_path, **{"column: a, unit": "column: a, wraps: 360, unit:"})
    result = [test_reader.push([HEAD, "0,350,1,1,1,"]), test_reader.push(["1,5,1,1,1,", "2,nan,1,1,1,"])]
    other = reader(tmp_path, **{"column: a, unit": "column: a, wraps: 360, unit:"})
    other.restore(json.loads(json.dumps(test_reader.state)))
    result.append(other.push(["3,20,1,1,1,", "4,10,1,1,1,"]))
    degrees = np.rad2deg(np.concatenate([part.q[:, 0] for part in result]))
    np.testing.assert_allclose(degrees, [350, 365, np.nan, 380, 370])


def test_a_gain_may_be_a_number_of_the_recording(tmp_path: Path) -> None:
    text = CONFIG.format(file="log.csv").replace("gain: 2.0", "gain: k")
    rows = [row | {"k": k} for row, k in zip(NESTED, (2.0, None), strict=True)]
    check(SampleReader(parse_config(text, tmp_path, "arm.yaml"), JOINTS, "arm"), map(json.dumps, rows))
    first_unknown = SampleReader(parse_config(text, tmp_path, "arm.yaml"), JOINTS, "arm")
    assert np.isnan(first_unknown.push([json.dumps(rows[0] | {"k": None})]).tau).all()
    columns = {name: [row[name] for row in NESTED] for name in ("t", "a", "b")}
    motors = {f"m.{k}": [row["m"][k] for row in NESTED] for k in (0, 1)}  # type: ignore[index]
    savemat(tmp_path / "log.mat", {**{name.replace(".", "_"): x for name, x in (columns | motors).items()}, "k": 2.0})
    matlab = text.replace("m.0", "m_0").replace("m.1", "m_1")
    stream = SampleReader(parse_config(matlab, tmp_path, "arm.yaml"), JOINTS, "arm")
    for scalars in ({"k"}, {"k", "a"}):
        recorded = RecordedFile(tmp_path / "log.mat", stream.needed, "t", scalars=scalars)
        with nullcontext() if scalars == {"k"} else pytest.raises(InputError, match="no scalar 'a'"):
            check(stream, recorded.read()[0].decode().splitlines())


def test_lines_count_once_their_end_is_there() -> None:
    case, text = LineReader(), "".join(f"{row}\r\n" for row in ("\ufeffhead", "grün,1", "last")).encode()
    result = [line for k in range(len(text)) for line in case.push(text[k : k + 1])]
    assert result == ["head", "grün,1", "last"]
    assert case.tail == b""
    assert case.push(b"half") == []
    assert case.tail == b"half"


def test_what_is_no_number_is_a_sensor_that_says_nothing(tmp_path: Path) -> None:
    test_reader = reader(tmp_path)
    result = test_reader.push([HEAD, "0,oops,1.0,nan,2.0,x", "10,,1e999,1,1,"])
    assert np.isnan(result.q).tolist() == [[True, False], [True, True]]
    assert np.isnan(result.tau).tolist() == [[True, True], [False, False]]


def test_lines_that_cannot_be_read_are_counted(tmp_path: Path) -> None:
    test_reader = reader(tmp_path)
    result = test_reader.push([HEAD, "0,1", ROWS[0], '{"t": 0', "[1]", "x,1,1,1,1,1", ROWS[1], ""])
    assert len(result.t) == 2
    assert (result.bad.count, result.bad.line, result.bad.text) == (4, 2, "0,1")


def test_a_missing_column_and_a_recording_of_several_files_are_said_at_once(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="watched by one stream"):
        reader(tmp_path, "{ x: a.csv, y: b.csv }")
    with pytest.raises(ConfigError, match=r"arm.csv: no column 'm.1'"):
        reader(tmp_path).push(["t,a,b,m.0,m1", "0,1,1,1,1"])
    with pytest.raises(ConfigError, match=r"no column 'm.1'"):
        reader(tmp_path).push(['{"t": 0, "a": 1, "b": 1, "m": [1]}'])


def test_the_next_file_may_have_its_names_or_not(tmp_path: Path) -> None:
    for head in ([], [HEAD], ["t,b,a,m.0,m.1"]):
        test_reader = reader(tmp_path)
        check(test_reader, [HEAD, *ROWS])
        test_reader.new_file()
        row = "20,1.0,180,1,1" if head == ["t,b,a,m.0,m.1"] else "20,180,1.0,1,1,"
        result = test_reader.push([*head, row])
        np.testing.assert_allclose(result.q, [[np.pi, 1.0]])
        bad = test_reader.push(["nonsense"]).bad
        assert bad.line == len(head) + 2  # counted in the new file


def test_dates_count_from_the_first_midnight(tmp_path: Path) -> None:
    test_reader = reader(tmp_path)
    result = test_reader.push(
        [HEAD, *(f"2026-11-22T23:59:{s}+00:00,1,1,1,1," for s in ("59.5", "59.75")), "2026-11-23T00:00:00Z,1,1,1,1,"]
    )
    np.testing.assert_allclose(result.t, [86_399.5, 86_399.75, 86_400.0])


def test_names_stand_below_a_title(tmp_path: Path) -> None:
    check(reader(tmp_path), ["Robot: IRB 1200", "log of Monday", HEAD, *ROWS])
    with pytest.raises(ConfigError, match=r"no column 'a'; choose from 't', 'x'"):
        reader(tmp_path).push(["Robot: IRB 1200", "t,x", "0,1"])


@pytest.mark.parametrize("day", ["", "22.11.2026 ", "2026-11-22 "])
def test_stamps_are_those_of_logs(tmp_path: Path, day: str) -> None:
    result = reader(tmp_path).push([HEAD, *(f"{day}23:59:{s},1,1,1,1," for s in ("59.5", "59.75"))])
    np.testing.assert_allclose(result.t, [86_399.5, 86_399.75])


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(b"head\n1\n2")
    return path


@pytest.fixture
def file(log: Path) -> Iterator[FollowedFile]:
    """The log, read to its end."""
    with closing(FollowedFile(log)) as file:
        assert file.read() == (b"head\n1\n2", True, False)
        assert file.read() == (b"", False, False)
        yield file


def add(path: Path, text: bytes) -> None:
    with open(path, "ab") as file:
        file.write(text)


def test_a_rotated_file_is_read_to_its_end_and_then_the_next(log: Path, file: FollowedFile) -> None:
    log.rename(log.with_name("log.csv.1"))
    assert file.read() == (b"", False, False)  # between two files
    add(log.with_name("log.csv.1"), b"2\n")
    log.write_bytes(b"head\n3\n")
    reads = [file.read() for _ in range(3)]
    assert reads == [(b"2\n", False, False), (b"head\n3\n", True, False), (b"", False, False)]


def test_a_file_that_was_cut_begins_again(log: Path, file: FollowedFile) -> None:
    os.truncate(log, 0)
    assert file.read()[0] == b""
    add(log, b"3\n")
    assert file.read() == (b"3\n", True, False)


@pytest.mark.parametrize("change", ["grown", "rotated", "another"])
def test_a_saved_position_is_read_on_from_where_the_file_is_found(log: Path, file: FollowedFile, change: str) -> None:
    position = json.loads(json.dumps(file.position(1)))  # the last line has no end
    file.close()
    add(log, b"2\n")
    reads = [(b"22\n", False, False)]
    if change == "rotated":
        log.rename(log.with_name("log.csv.1"))
        log.write_bytes(b"head\n3\n")
        reads.append((b"head\n3\n", True, False))
    elif change == "another":
        log.unlink()
        log.write_bytes(b"other head\n")
        reads = [(b"other head\n", True, False)]
    with closing(FollowedFile(log, position)) as other:
        assert other.resumes == (change != "another")
        assert [other.read() for _ in reads] == reads


def test_a_pipe_is_read_while_its_writer_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    with closing(os.fdopen(writer, "wb", buffering=0)) as pipe, os.fdopen(reader, "r") as standard_input:
        monkeypatch.setattr(sys, "stdin", standard_input)
        pipe.write(b"0.0,1.0\n")
        standard_input.buffer.read = None  # type: ignore[method-assign, assignment]  # it would wait for the end
        assert StandardInput().read() == (b"0.0,1.0\n", False, False)


def test_what_is_no_file_or_closed_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input is closed"):
        StandardInput()
    with pytest.raises(InputError, match="there is no such file"):
        FollowedFile(tmp_path / "none.csv")
    with pytest.raises(InputError, match="it is a folder"):
        FollowedFile(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a named pipe"):
        FollowedFile(tmp_path / "pipe")


NUMBER_TEXTS = st.one_of(
    st.floats().map(repr),
    st.integers(300, 5000).map(lambda digits: "9" * digits),
    st.sampled_from(
        ["1e999", "1_0", "1,5", "true", "null", "2026-11-22T23:59:59Z", "0001-01-01T00:00:00+23:59", "x" * 140_000]
    ),
)
CELLS = st.one_of(NUMBER_TEXTS, st.text(max_size=8), st.text('"\r\0,;\t {[', max_size=6))
KEYS = st.one_of(st.sampled_from(["t", "a", "b", "m", "m.0", "m.1", ""]), st.text(max_size=3))
PLAIN = CELLS | NUMBER_TEXTS.map(json.dumps)
LISTS = st.lists(PLAIN, max_size=3).map(str)
VALUES = PLAIN | LISTS | st.lists(LISTS, max_size=3).map(str)
ANY_LINE = st.one_of(
    st.binary(max_size=60),
    st.lists(CELLS, min_size=1, max_size=8).map(lambda cells: ",".join(cells).encode("utf-8", "replace")),
    st.dictionaries(KEYS, VALUES, max_size=6).map(
        lambda values: (
            f"{{{','.join(f'{json.dumps(key)}:{value}' for key, value in values.items())}}}".encode("utf-8", "replace")
        )
    ),
    st.integers(0, 2000).map(lambda depth: b'{"":' * depth + b"1" + b"}" * depth),
    st.integers(0, MAX_LINE_BYTES + 9).map(lambda length: b'"' * length),
)  # fmt: skip


@settings(max_examples=100, deadline=None)
@given(
    lines=st.lists(ANY_LINE, max_size=4),
    cuts=st.lists(st.integers(0, 10_000), max_size=3),
    wraps=st.sampled_from(["", "wraps: 360, "]),
)
def test_any_bytes_between_two_rows_are_samples_or_counted(lines: list[bytes], cuts: list[int], wraps: str) -> None:
    lines = [line.replace(b"\n", b"") for line in lines]
    samples = reader(Path(), **{"column: a, unit": f"column: a, {wraps}unit:"})
    stream = LineReader()
    data = b"".join(line + b"\n" for line in (HEAD.encode(), ROWS[0].encode(), *lines, ROWS[1].encode()))
    parts = [samples.push(stream.push(data[a:b])) for a, b in itertools.pairwise([0, *sorted(cuts), len(data)])]
    said = sum(len(part.t) + (part.bad.count if part.bad else 0) for part in parts)
    texts = [line.decode("utf-8", "replace").lstrip("\ufeff").strip() for line in lines]
    silent = sum(not text or text[0] in "#%" or is_repetition(text) for text in texts)
    assert said == 2 + len(lines) - silent
    t = np.concatenate([part.t for part in parts])
    assert np.isfinite(t).all()
    assert (t[0], t[-1]) == (0.0, 0.01)  # a line ends where it ends: the row after it is read


def is_repetition(text: str) -> bool:
    """Return whether a line is one of names, or of units."""
    return text == HEAD or unit_row(text, HEAD.split(","), ",") is not None


def test_a_line_of_megabytes_is_counted_once_and_does_not_fill_the_memory() -> None:
    stream, lines = LineReader(), list[str]()
    for _ in range(40):
        lines += stream.push(b"0,1,1,1,1,x" * 10_000)
        assert len(stream.tail) < 2_000_000
    assert len(lines) == 1
    assert stream.push(b"\nlast\n") == ["last"]


def test_objects_of_another_program_in_the_next_file_are_counted(tmp_path: Path) -> None:
    samples = reader(tmp_path)
    samples.push([json.dumps(NESTED[0])])
    samples.new_file()
    part = samples.push(['{"rotated": true}', json.dumps(NESTED[1])])
    assert part.t.tolist() == [0.01]
    assert part.bad.count == 1


def test_names_of_nested_values_do_not_fill_the_memory(tmp_path: Path) -> None:
    line = json.dumps(NESTED[0] | {"x" * 100_000: [0] * 50_000})
    tracemalloc.start()
    try:
        assert len(reader(tmp_path).push([line]).t) == 1
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()
