"""MATLAB files: the same arrays as SciPy reads, and words on everything else."""

import io
import struct

import numpy as np
import pytest
import scipy.io
import scipy.sparse

from dynident.files.matlab import parse_mat as parse


def parse_mat(data: bytes) -> dict:
    """Return all arrays, read."""
    return {name: x if isinstance(x, str) else x.read() for name, x in parse(data).items()}


KINDS = ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "?"]


def saved(compress: bool = False, **variables) -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, variables, do_compression=compress)
    return buffer.getvalue()


@pytest.mark.parametrize("compress", [False, True])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (5, 3), (2, 3, 4), (0, 0)])
def test_arrays_are_those_that_scipy_reads(compress, kind, shape):
    values = np.random.default_rng(3).integers(0, 100, shape).astype(kind)
    data = saved(compress, x=values, a_longer_name_than_others=values[:1])
    expected, read = scipy.io.loadmat(io.BytesIO(data)), parse_mat(data)
    assert list(read) == ["x", "a_longer_name_than_others"]
    for name, array in read.items():
        np.testing.assert_array_equal(array, expected[name])


def test_other_variables_are_reported_in_words():
    data = saved(
        text="abc",
        structs=np.array([(1,), (2,)], dtype=[("a", "f8")]),
        cell=np.array([1, "b"], dtype=object),
        sparse=scipy.sparse.eye_array(3, format="csc"),
        complex=np.array([1j, 2]),
        t=np.arange(3.0),
    )
    read = parse_mat(data)
    assert {name: value for name, value in read.items() if isinstance(value, str)} == {
        "text": "text",
        "structs": "a struct",
        "cell": "a cell array",
        "sparse": "a sparse matrix",
        "complex": "complex numbers",
    }
    np.testing.assert_array_equal(read["t"], [[0, 1, 2]])


def test_objects_say_how_their_numbers_become_arrays():
    def element(kind: int, content: bytes) -> bytes:
        return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)

    parts = [element(6, struct.pack("<II", 17, 0)), *(element(1, x) for x in (b"recorded", b"MCOS", b"timeseries"))]
    data = b"MATLAB 5.0".ljust(124) + b"\0\1IM" + element(14, b"".join([*parts, element(14, b"")]))
    result = parse_mat(data)["recorded"]
    assert isinstance(result, str)
    assert "a timeseries object" in result
    assert "t = x.Time;" in result


def test_every_truncation_is_an_error_or_leaves_whole_variables_only():
    data = saved(t=np.arange(20.0), q=np.ones(3))
    full = parse_mat(data)
    for size in range(128, len(data)):
        try:
            read = parse_mat(data[:size])
        except (ValueError, struct.error):
            continue
        for name, array in read.items():
            np.testing.assert_array_equal(array, full[name])


def test_one_name_twice_is_an_error():
    data = saved(t=np.arange(3.0))
    with pytest.raises(ValueError, match="'t' is there twice"):
        parse_mat(data + data[128:])
