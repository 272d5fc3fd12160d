"""HDF5 and MATLAB 7.3: named and shaped as the other readers do; nothing outside the file is opened."""

from __future__ import annotations

import builtins

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynident.errors import InputError
from dynident.io.tables import read_columns
from tests.io.test_tables import reads_or_explains

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


@pytest.mark.parametrize("suffix", ["h5", "hdf5", "mat"])
def test_arrays_are_columns(tmp_path, suffix):
    table = read_columns(write_hdf5(tmp_path / f"a.{suffix}"))
    assert {name: list(column) for name, column in table.columns.items()} == {
        "arm/tau": [1, 1, 1],
        "q[0]": [0, 2, 4],
        "q[1]": [1, 3, 5],
        "t": [0, 1, 2],
    }
    assert dict(table.constants) == {"gain": 2.5}
    with pytest.raises(InputError, match="column 'odd' holds values of type object"):
        table.column("odd")


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


def test_rings_of_groups_end(tmp_path):
    path = write_hdf5(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file["arm/self"] = file["arm"]
    assert "arm/tau" in read_columns(path).columns


def test_an_array_larger_than_its_file_can_hold_is_refused(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("q", (10**11,), "f8", chunks=(1000,))
    with pytest.raises(InputError, match="claims 800000000000 bytes"):
        read_columns(tmp_path / "a.h5")


@pytest.mark.parametrize("name", ["a.h5", "a.mat"])
def test_without_the_extra_the_message_says_what_to_install(tmp_path, monkeypatch, name):
    path = write_hdf5(tmp_path / name)
    plain = builtins.__import__

    def without(name, *rest, **more):
        if name == "h5py":
            raise ImportError(name)
        return plain(name, *rest, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InputError, match=r'pip install "dynident\[hdf5\]"'):
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
