"""Tables from files of all kinds: sound, damaged, and random."""

import contextlib
import os

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynident.files.tables import DataTable, read_columns
from dynident.runtime import DynidentError, InputError
from tests.project.files import mat, npz, parquet, written

SCOPE = """\
Name|YT Scope
File|C:\\a.svdx

Name|q|tau|Name|q
SampleTime[ms]|2|2|SampleTime[ms]|2
SymbolName|A1.q|A1.tau|SymbolName|A2.q
Unit|deg|None|Unit|deg

0|1,5|2|0|3
2|1,6|3|2|4
""".replace("|", "\t")
TEXTS = {
    "comma": ("t,q\n0,1.5\n1,-2e-3\n", {"t": [0, 1], "q": [1.5, -2e-3]}),
    "semicolon": ("t;q\n0;1.5\n1;2\n", {"t": [0, 1], "q": [1.5, 2]}),
    "blanks": ("  t    q\n 0   1.5\n 1   2\n", {"t": [0, 1], "q": [1.5, 2]}),
    "no header": ("0,1.5\n1,2\n", {"0": [0, 1], "1": [1.5, 2]}),
    "one column": ("1.5\n2\n", {"0": [1.5, 2]}),
    "decimal comma": ("t;q\n0,5;1,5\n1;-,25e1\n", {"t": [0.5, 1], "q": [1.5, -2.5]}),
    "quotes": ('"t [s]","a, b"\n"0","1.5"\n', {"t [s]": [0], "a, b": [1.5]}),
    "comments": ("# recorded\n# t q\n0 1\n% pause\n1 2\n", {"t": [0, 1], "q": [1, 2]}),
    "blank lines, CRLF, byte order mark": ("\ufefft,q\r\n\r\n0,1\r\n", {"t": [0], "q": [1]}),
    "a separator at the end": ("t,q,\n0,1,\n1,2,\n", {"t": [0, 1], "q": [1, 2]}),
    "an unnamed first column": (",q\n0,1\n", {"0": [0], "q": [1]}),
    "missing cells": ("t,q\n0,\n1,NaN\n2,NA\n3,inf\n", {"t": [0, 1, 2, 3], "q": [np.nan, np.nan, np.nan, np.inf]}),
    "units below the names": (
        "t;q;n;m\n[s];deg;-;[0.1 %]\n0;1.5;2;4\n1;2;3;5\n",
        {"t [s]": [0, 1], "q [deg]": [1.5, 2], "n": [2, 3], "m [0.1 %]": [4, 5]},
    ),
    "names in two lines": (
        "t,q,q,tau,tau\n,pan_joint,lift,pan_joint,lift\n0,1,2,3,4\n",
        {"t": [0], "q.pan_joint": [1], "q.lift": [2], "tau.pan_joint": [3], "tau.lift": [4]},
    ),
    "texts without names": ("5,a,1.5\n6,a,2.5\n", {"0": [5, 6], "2": [1.5, 2.5]}),
    "numbers as names": ("id,1,2\na,1.5,3\nb,2.5,4\n", {"1": [1.5, 2.5], "2": [3, 4]}),
    "a title": (
        "Robot: IRB 1200, No. 17\nTest signals\nSampling\t4 ms\nt\tq\tn\n[s]\tdeg\t-\n0\t1.5\t2\n1\t2\t3\n",
        {"t [s]": [0, 1], "q [deg]": [1.5, 2], "n": [2, 3]},
    ),
    "channels of an oscilloscope, as TwinCAT has them": (
        SCOPE,
        {"time [ms]": [0, 2], "A1.q [deg]": [1.5, 1.6], "A1.tau": [2, 3], "A2.q [deg]": [3, 4]},
    ),
    "channels of an oscilloscope with stamps in parts of a ms": (
        SCOPE.replace("\n0\t1,5\t2\t0\t3", "\n0,0\t1,5\t2\t0,0\t3"),
        {"time [ms]": [0, 2], "A1.q [deg]": [1.5, 1.6], "A1.tau": [2, 3], "A2.q [deg]": [3, 4]},
    ),
    "channels with stamps of their own": (
        "Name,q,Name,tau\n0,1,0.5,2\n1,3,1.5,4\n",
        {"time": [0, 1], "q": [1, 3], "time_2": [0.5, 1.5], "tau": [2, 4]},
    ),
    "a header written again": ("t,q\ns,deg\n0,1\nt,q\ns,deg\n1,2\n", {"t [s]": [0, 1], "q [deg]": [1, 2]}),
    "lists in cells": (
        "t,name,q,effort\n0,\"['a', 'b']\",\"[1, 2.5]\",[]\n1,\"['a', 'b']\",\"[2, 3]\",[]\n",
        {"t": [0, 1], "q[0]": [1, 2], "q[1]": [2.5, 3], "effort[0]": [np.nan, np.nan]},
    ),
    "lists of NumPy": (
        "t;q;x\n0;[1.  2.5];3\n1;[-2. 3.];4\n",
        {"t": [0, 1], "q[0]": [1, -2], "q[1]": [2.5, 3], "x": [3, 4]},
    ),
    "a row for each joint": (
        "t,joint,q\n0,a,1\n0,b,2\n1,a,3\n1,b,4\n",
        {"t": [0, 1], "a.q": [1, 3], "b.q": [2, 4]},
    ),
    "a row for each number": ("t,q,id\n0,5,2\n0,6,1\n1,7,2\n1,8,1\n", {"t": [0, 1], "2.q": [5, 7], "1.q": [6, 8]}),
    "runs of equal length": (
        "run,t,q\n1,0,5\n1,1,6\n1,2,7\n2,0,8\n2,1,9\n2,2,5\n",
        {"run": [1, 1, 1, 2, 2, 2], "t": [0, 1, 2, 0, 1, 2], "q": [5, 6, 7, 8, 9, 5]},
    ),
    "a bit that toggles": ("t,q,bit\n0,5,1\n1,6,0\n", {"t": [0, 1], "q": [5, 6], "bit": [1, 0]}),
    "seconds and nanoseconds": (
        "header.stamp.sec,header.stamp.nanosec,q\n5,999999999,1\n6,1000000,2\n",
        {"header.stamp.sec": [5.999999999, 6.001], "header.stamp.nanosec": [999999999, 1000000], "q": [1, 2]},
    ),
    "an empty column": ("t,q\n0,\n1,\n", {"t": [0, 1], "q": [np.nan, np.nan]}),
}


@pytest.mark.parametrize(("text", "expected"), TEXTS.values(), ids=TEXTS)
def test_texts_are_read(tmp_path, text, expected):
    table = read_columns(written(tmp_path, "a.csv", text))
    assert list(table.columns) == list(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(table.column(name), values)
        assert not table.column(name).flags.writeable


def test_a_faulty_number_is_not_lost_where_rows_are_of_one_joint_each(tmp_path):
    table = read_columns(written(tmp_path, "a.csv", "t,joint,q,tau\n0,a,1,1\n0,b,oops,2\n1,a,3,3\n1,b,4,4\n"))
    assert list(table.columns) == ["t", "a.tau", "b.tau"]
    assert list(table.faults) == ["a.q", "b.q"]
    assert all("line 3" in fault and "oops" in fault for fault in table.faults.values())
    assert list(table.lines) == [2, 4]


def test_a_header_is_read_behind_a_sign_of_comments_and_in_other_encodings(tmp_path):
    table = read_columns(written(tmp_path, "a.csv", "%time,name0,q0,q1\n0,elbow,0.0,0.0\n1,elbow,0.5,0.1\n"))
    assert list(table.columns) == ["time", "q0", "q1"]
    assert "elbow" in table.faults["name0"]
    assert dict(table.texts) == {"name0": "elbow"}
    assert list(read_columns(written(tmp_path, "b.csv", "# a,b\nt,state\n0,up\n")).columns) == ["t"]
    assert "α" in read_columns(written(tmp_path, "a.txt", "t\tα\n0\t1\n".encode("utf-16"))).columns
    assert "q [°]" in read_columns(written(tmp_path, "b.txt", "t;q [°]\n0;1\n".encode("latin-1"))).columns


BINARIES = {
    ".npz": npz(t=np.arange(3), q=np.arange(6.0).reshape(3, 2), gain=2.5, odd=np.array(["a"]), deep=np.ones((2, 2, 2))),
    ".mat": mat(t=np.arange(3), q=np.arange(6.0).reshape(3, 2), gain=2.5, odd="text", deep=np.ones((2, 2, 2))),
    ".parquet": parquet(
        t=[0, 1, 2], odd=["a", "b", "c"], deep=[[1], [2, 3], [3]], **{"q[0]": [0, 2, 4], "q[1]": [1, 3, 5]}
    ),
}


@pytest.mark.parametrize("kind", BINARIES)
def test_binary_files_are_read(tmp_path, kind):
    table = read_columns(written(tmp_path, f"a{kind}", BINARIES[kind]))
    assert {name: list(column) for name, column in table.columns.items()} == {
        "t": [0, 1, 2],
        "q[0]": [0, 2, 4],
        "q[1]": [1, 3, 5],
    }
    assert dict(table.constants) == ({} if kind == ".parquet" else {"gain": 2.5})
    for name in ("odd", "deep"):
        with pytest.raises(InputError, match=f"column {name!r} (holds|has the shape)"):
            table.column(name)


def test_pickled_objects_are_not_loaded(tmp_path):
    path = written(tmp_path, "a.npz", npz(t=np.arange(3), x=np.array([{}], dtype=object)))
    with pytest.raises(InputError, match="column 'x' holds Python objects, which are not read"):
        read_columns(path).column("x")


DAMAGED = {
    "empty": ("a.csv", b" \n", ("the file is empty",)),
    "only comments": ("a.csv", b"# t\n", ("no numbers",)),
    "cut off": ("a.csv", b"t,q,tau\n0,1,2\n1,2", ("line 3 has 2 fields where 3 are expected", "cut off: delete")),
    "short row": ("a.csv", b"t,q\n0,1\n1\n2,3\n", ("line 3 has 1 field where 2", "Complete or delete")),
    "decimal comma": ("a.csv", b"t,q\n0,5,1,5\n", ("line 2 has 4 fields where 2", "separate the columns with ';'")),
    "lists of two lengths": ("a.csv", b't,q\n0,"[1, 2]"\n1,"[2]"\n', ("line 3 has 2 fields where 3",)),
    "title": (
        "a.csv",
        b"Log of Monday\n0,1\n1,2\n",
        ("line 2 has 2 fields where 1", "Begin the lines of a title with #"),
    ),
    "both decimal marks": ("a.csv", b"t;q\n1,234;1.5\n", ("decimal comma and others a decimal point",)),
    "binary": ("a.csv", b"t,q\n\0\1", ("not a text but a binary file",)),
    "one name twice": ("a.csv", b"t,q,t\n0,1,2\n", ("columns 1 and 3 are both named 't'",)),
    "extension": ("a.xlsx", b"PK", ("'.xlsx' cannot be read", "'.csv'", "'.mat'")),
    "packed": ("a.csv.gz", b"\x1f\x8b", ("'.gz' cannot be read; unpack it first",)),
    "parquet": ("a.parquet", b"PAR1PAR1", ("not a readable .parquet file (ComputeError: ",)),
    "npz": ("a.npz", b"PK nothing", ("not a readable .npz file",)),
    "npy": ("a.npy", b"x" * 20, ("not a readable .npy file",)),
    "npz cut off": ("a.npz", npz(t=np.arange(100))[:300], ("not a readable .npz file",)),
    "mat": ("a.mat", b"nothing of MATLAB" * 20, ("not a readable .mat file",)),
    "mat 7.3": ("a.mat", b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM", ("of version 7.3", "-v7")),
}


@pytest.mark.parametrize(("name", "data", "fragments"), DAMAGED.values(), ids=DAMAGED)
def test_damaged_files_are_worded(tmp_path, name, data, fragments):
    with pytest.raises(InputError) as caught:
        read_columns(written(tmp_path, name, data))
    assert all(fragment in str(caught.value) for fragment in (name, *fragments)), caught.value


@pytest.mark.parametrize(
    ("data", "width", "fragment"),
    [("1\n2\n3\n", 2, "3 numbers do not fill rows of 2"), ("1,2\n", 2, "has 2 columns; `width` is for files")],
)
def test_a_width_that_does_not_fit_is_worded(tmp_path, data, width, fragment):
    with pytest.raises(InputError, match=fragment):
        read_columns(written(tmp_path, "a.txt", data), width)


def test_columns_and_scalars_are_matched_by_name():
    table = DataTable({"q_meas": np.ones(2)}, {"gtau": 3.0, "bad": np.nan}, "a.mat", {"x": "is odd."})
    assert table.constant("gtau") == 3
    for read, fragment in (
        (
            lambda: table.column("q_mes", "position.a"),
            r"a.mat: position.a: no column 'q_mes'; did you mean 'q_meas'\?",
        ),
        (lambda: table.column("gtau"), "'gtau' is a single number"),
        (lambda: table.column("x"), "column 'x' is odd"),
        (lambda: table.constant("gtua"), "no scalar 'gtua'; did you mean 'gtau'"),
        (lambda: table.constant("bad"), "the scalar 'bad' is nan"),
    ):
        with pytest.raises(InputError, match=fragment):
            read()


FUZZ = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def reads_or_explains(path, width=None):
    """Read a file; the only exceptions allowed are those meant for the user."""
    with contextlib.suppress(DynidentError):
        table = read_columns(path, width)
        assert all(column.dtype == np.float64 and column.ndim == 1 for column in table.columns.values())


@FUZZ
@given(data=st.binary(max_size=300), kind=st.sampled_from([".csv", ".npz", ".npy", ".mat", ".parquet", ".dat"]))
def test_any_bytes_give_a_table_or_an_explanation(tmp_path, data, kind):
    reads_or_explains(written(tmp_path, f"fuzz{kind}", data))


@FUZZ
@given(
    text=st.text(max_size=200) | st.text(alphabet="0123456789.,;\t \n\r\"'eE+-#%nai_\ufeff", max_size=200),
    width=st.none() | st.integers(1, 3),
)
def test_any_text_gives_a_table_or_an_explanation(tmp_path, text, width):
    reads_or_explains(written(tmp_path, "fuzz.csv", text.encode("utf-8", "surrogatepass")), width)


def test_where_nothing_is_to_choose_from_none_is_offered(tmp_path):
    with pytest.raises(InputError, match=r"there is no such file\.$"):
        read_columns(tmp_path / "arm.csv")
    with pytest.raises(InputError, match=r"not a ROS 2 bag; nor does it hold a file that can be read\.$"):
        read_columns(tmp_path)
    with pytest.raises(InputError, match=r"no scalar 'K'; there is none to choose from\.$"):
        DataTable({"t": np.zeros(2)}, {}, "log.csv").constant("K")


def test_time_along_the_rows_is_seen_by_the_length_of_other_columns(tmp_path):
    q = np.arange(12.0).reshape(2, 6)
    np.savez(tmp_path / "a.npz", t=np.arange(6.0), q=q, square=np.eye(6), other=np.ones((2, 5)))
    table = read_columns(tmp_path / "a.npz")
    np.testing.assert_array_equal([table.columns["q[0]"], table.columns["q[1]"]], q)
    assert "transpose" in table.faults["other"]
    assert table.notes == table.guesses
    assert table.guesses == (
        "'q' has the shape (2, 6): it is read as 6 rows of 2 columns, as other columns have 6 values.",
    )


@pytest.mark.parametrize("shape", [(6, 300), (300, 6), (6, 1, 300), (1, 300, 6)])
def test_without_a_column_of_time_the_far_longer_side_is_the_time(shape, tmp_path):
    rows = np.arange(1800.0).reshape(300, 6)
    full = (rows if shape.index(300) < shape.index(6) else rows.T).reshape(shape)
    np.savez(tmp_path / "a.npz", q=full, mass=3.0)
    table = read_columns(tmp_path / "a.npz")
    np.testing.assert_array_equal(np.stack([table.columns[f"q[{k}]"] for k in range(6)], axis=1), rows)
    assert bool(table.guesses) == (shape.index(6) < shape.index(300))
    np.save(tmp_path / "q.npy", full)
    alone = read_columns(tmp_path / "q.npy")
    assert alone.guesses == table.guesses
    assert {name: list(x) for name, x in alone.columns.items()} == {name: list(x) for name, x in table.columns.items()}


def test_sides_of_about_one_length_are_not_guessed(tmp_path):
    np.savez(tmp_path / "a.npz", q=np.ones((6, 40)))
    assert "transpose" in read_columns(tmp_path / "a.npz").faults["q"]


def test_a_damaged_parquet_leaves_no_trace(tmp_path, capfd):
    """Polars panics at some of these: the trace that Rust writes to file descriptor 2 by itself must not be seen."""
    columns = {"a": np.arange(50.0), "b": np.arange(50), "c": [str(k % 3) for k in range(50)]}
    sound, rng = parquet(**columns), np.random.default_rng(1)
    for _ in range(100):
        data = np.frombuffer(sound, np.uint8).copy()
        data[rng.integers(4, len(data) - 8, 3)] = rng.integers(0, 256, 3)
        with contextlib.suppress(InputError):
            read_columns(written(tmp_path, "a.parquet", data.tobytes()))
    os.write(2, b"end\n")
    assert capfd.readouterr().err == "end\n"


@pytest.mark.parametrize(
    ("name", "data", "words"),
    [
        ("a.parquet", parquet(t=np.zeros(0), q=np.zeros(0)), "a.parquet: holds columns without rows"),
        ("a.parquet", parquet(), "a.parquet: holds no columns"),
        ("a.npz", npz(), "a.npz: holds no columns"),
        ("a.csv", b'"\n"\n"\n', "a.csv: holds no row of numbers"),
        ("a.csv", b"t,q\n", "a.csv: holds a header, but no row of numbers"),
    ],
)
def test_tables_without_content_are_refused(tmp_path, name, data, words):
    with pytest.raises(InputError, match=words):
        read_columns(written(tmp_path, name, data))
