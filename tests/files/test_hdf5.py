"""HDF5 and MATLAB 7.3: named and shaped as the other readers do; nothing outside the file is opened."""

import builtins

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynident.files.tables import read_columns
from dynident.runtime import InputError
from tests.files.test_tables import reads_or_explains

h5py = pytest.importorskip("h5py", reason='the extra "hdf5" is not installed')

Q = np.arange(6.0).reshape(3, 2)


def write_hdf5(path, **more):
    with h5py.File(path, "w") as file:
        file["t"], file["q"], file["gain"], file["odd"] = np.arange(3), Q, 2.5, "text"
        file["arm/tau"] = np.ones(3)
        for name, value in more.items():
            file[name] = value
    return path


def write_matlab(path):
    """A file as MATLAB writes it: a header of 512 bytes, arrays stored by columns, and their classes as attributes."""
    with h5py.File(path, "w", userblock_size=512) as file:
        variables = {"t": np.arange(3.0)[:, None], "q": Q, "gain": np.array([[2.5]]), "word": np.array([[65, 66]])}
        for name, value in variables.items():
            file[name] = value.T
            file[name].attrs["MATLAB_class"] = np.bytes_("char" if name == "word" else "double")
        file["empty"] = np.array([0, 0], np.uint64)
        file["empty"].attrs.update(MATLAB_class=np.bytes_("double"), MATLAB_empty=1)
        file.create_group("deep").attrs["MATLAB_class"] = np.bytes_("struct")
        file["#refs#/a"] = np.ones(3)
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path


def test_groups_are_read_to_a_depth_of_twenty(tmp_path):
    names = ["/".join([*["g"] * depth, "q"]) for depth in (20, 21)]
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name in names:
            file[name] = np.arange(3.0)
    assert list(read_columns(tmp_path / "a.h5").columns) == names[:1]


def test_matlab_arrays_are_as_matlab_shows_them(tmp_path):
    table = read_columns(write_matlab(tmp_path / "a.mat"))
    assert {name: list(column) for name, column in table.columns.items()} == {
        "q[0]": [0, 2, 4],
        "q[1]": [1, 3, 5],
        "t": [0, 1, 2],
    }
    assert dict(table.constants) == {"gain": 2.5}
    assert {name: words.split(",")[0] for name, words in table.faults.items()} == {
        "deep": "holds a struct",
        "empty": "holds float64 values of shape (0",
        "word": "holds text",
    }


def as_matlab(file, name, value, kind="double"):
    """Write an array as MATLAB does: by columns, with its class."""
    file[name] = np.asarray(value).T
    file[name].attrs["MATLAB_class"] = np.bytes_(kind)


def as_struct(file, name):
    group = file.create_group(name)
    group.attrs["MATLAB_class"] = np.bytes_("struct")
    return group


@pytest.fixture
def structs(tmp_path):
    """Structs, structs in structs, an array of structs, cells, texts and objects, as MATLAB 7.3 keeps them."""
    path = tmp_path / "a.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        log = as_struct(file, "log")
        as_matlab(log, "t", np.arange(3.0)[:, None])
        as_matlab(log, "rate", np.array([[100.0]]), "single")
        as_matlab(log, "name", np.array([[65, 66]], np.uint16), "char")
        arm = as_struct(log, "arm")
        as_matlab(arm, "q", Q)
        as_matlab(arm, "on", np.array([[1], [0], [1]], np.uint8), "logical")
        runs = as_struct(file, "runs")  # 1 x 2: each field is an array of references
        for k in range(2):
            as_matlab(file, f"#refs#/{k}", np.arange(3.0)[:, None])
        runs["q"] = np.array([[file["#refs#/0"].ref], [file["#refs#/1"].ref]], h5py.ref_dtype)
        file["cells"] = np.array([[file["#refs#/0"].ref]], h5py.ref_dtype)
        file["cells"].attrs["MATLAB_class"] = np.bytes_("cell")
        for name in ("timeseries", "timetable", "table", "datetime", "Robot"):
            as_matlab(file, f"a_{name}", np.array([[0xDD000000, 2, 1, 1, 1, 1]], np.uint32), name)
        as_matlab(file, "plain", Q, "int16")
    with open(path, "r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM")
    return path


def test_fields_of_structs_are_columns_as_in_older_files(structs):
    table = read_columns(structs)
    assert {name: list(column) for name, column in table.columns.items()} == {
        "log.t": [0, 1, 2],
        "log.arm.q[0]": [0, 2, 4],
        "log.arm.q[1]": [1, 3, 5],
        "log.arm.on": [1, 0, 1],
        "plain[0]": [0, 2, 4],
        "plain[1]": [1, 3, 5],
    }
    assert dict(table.constants) == {"log.rate": 100.0}
    assert set(read_columns(structs, needed={"log.arm.q[1]"}).columns) == {"log.arm.q[0]", "log.arm.q[1]"}


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("log.name", "holds text"),
        ("cells", "holds a cell array"),
        ("runs.q", "an array of structs or cells (in MATLAB, take one: x = s(1).field;"),
        ("a_timeseries", "a timeseries object, which only MATLAB can read (there: t = x.Time; q = squeeze(x.Data);"),
        ("a_timetable", "q = x.Variables; and save those"),
        ("a_table", "table2array(x)"),
        ("a_datetime", "t = seconds(x - x(1));"),
        ("a_Robot", "a Robot object, which only MATLAB can read (there: take its numbers out as arrays, and save"),
    ],
)
def test_what_is_no_array_of_matlab_says_how_to_export_it(structs, name, words):
    with pytest.raises(InputError) as caught:
        read_columns(structs).column(name)
    assert words in str(caught.value)


def test_other_files_are_not_opened(tmp_path):
    write_hdf5(tmp_path / "other.h5")
    (tmp_path / "raw").write_bytes(np.arange(3.0).tobytes())
    path = write_hdf5(tmp_path / "a.h5", away=h5py.ExternalLink(tmp_path / "other.h5", "t"), near=h5py.SoftLink("/t"))
    with h5py.File(path, "a") as file:
        layout = h5py.VirtualLayout((3,), "f8")
        layout[:] = h5py.VirtualSource(tmp_path / "other.h5", "t", (3,))
        file.create_virtual_dataset("virtual", layout)
        file.create_dataset("outside", (3,), "f8", external=[(str(tmp_path / "raw"), 0, 24)])
    faults = read_columns(path).faults
    for name, words in {
        "away": "a link",
        "near": "a link",
        "virtual": "another file",
        "outside": "another file",
    }.items():
        assert words in faults[name]


def test_rings_of_groups_end_and_an_array_larger_than_its_file_can_hold_is_refused(tmp_path):
    path = write_hdf5(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file["arm/self"] = file["arm"]
    assert "arm/tau" in read_columns(path).columns
    with h5py.File(path, "w") as file:
        file.create_dataset("q", (10**11,), "f8", chunks=(1000,))
    with pytest.raises(InputError, match="claims 800000000000 bytes"):
        read_columns(path)


@pytest.mark.parametrize("name", ["a.h5", "a.mat"])
def test_without_the_extra_the_message_says_what_to_install(tmp_path, monkeypatch, name):
    path = write_hdf5(tmp_path / name)
    plain = builtins.__import__

    def without(name, *rest, **more):
        if name == "h5py":
            raise ImportError(name)
        return plain(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r"-m pip install h5py$"):
        read_columns(path)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    matlab=st.booleans(),
    place=st.floats(0, 1, exclude_max=True),
    junk=st.binary(min_size=1, max_size=8),
    cut=st.booleans(),
)
def test_damaged_files_are_explained(tmp_path, matlab, place, junk, cut):
    path = tmp_path / ("fuzz.mat" if matlab else "fuzz.h5")
    data = (write_matlab if matlab else write_hdf5)(path).read_bytes()
    at = int(place * len(data))
    path.write_bytes(data[:at] + junk + (b"" if cut else data[at + len(junk) :]))
    reads_or_explains(path)
