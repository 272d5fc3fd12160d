"""A damaged file of any kind is read, or refused in a sentence: nothing else is raised."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynident.files.tables import read_columns
from dynident.models.rigid_bodies import read_robot_file
from dynident.project.config import read_config, robot_text
from dynident.project.saved import load
from dynident.runtime import DynidentError
from tests.cli.commands import configure
from tests.laws.test_inputs_kept import ROBOT
from tests.project.files import npz

DATA = Path(__file__).parents[1] / "data"
ROWS = {"t": np.arange(50.0), "q": np.arange(100.0).reshape(50, 2), "gain": np.array(2.5)}


def mat(compress: bool) -> bytes:
    buffer = io.BytesIO()
    scipy.io.savemat(buffer, {**ROWS, "deep": {"tau": np.zeros(3000)}, "long": np.zeros(3000)}, do_compression=compress)
    return buffer.getvalue()


def parquet() -> bytes:
    buffer = io.BytesIO()
    pl.DataFrame({"t": ROWS["t"], "word": ["a"] * 50}).write_parquet(buffer)
    return buffer.getvalue()


def squeezed() -> bytes:
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **ROWS)
    return buffer.getvalue()


def _robot(path: Path) -> Any:
    return read_robot_file(robot_text(path), path.name)


FILES: dict[str, tuple[str, Callable[[], bytes], Callable[[Path], Any]]] = {
    "mat": ("a.mat", lambda: mat(False), read_columns),
    "mat, compressed": ("a.mat", lambda: mat(True), read_columns),
    "npz": ("a.npz", lambda: npz(**ROWS), read_columns),
    "npz, compressed": ("a.npz", squeezed, read_columns),
    "parquet": ("a.parquet", parquet, read_columns),
    "csv": ("a.csv", lambda: b"t,q\n" + b"0.5,1.5\n" * 20, read_columns),
    "urdf": ("a.urdf", ROBOT.encode, _robot),
    "result": ("r.json", (DATA / "result-1.json").read_bytes, load),
}
damage = settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def reads_or_refuses(path: Path, read: Callable[[Path], Any]) -> None:
    try:
        read(path)
    except DynidentError as error:
        assert path.name in str(error)  # noqa: PT017


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("kind", FILES)
@damage
@given(place=st.floats(0, 1, exclude_max=True), junk=st.binary(min_size=1, max_size=8), cut=st.booleans())
def test_a_damaged_file_is_read_or_refused(tmp_path: Path, kind: str, place: float, junk: bytes, cut: bool) -> None:
    name, make, read = FILES[kind]
    data = make()
    at = int(place * len(data))
    (tmp_path / name).write_bytes(data[:at] + junk + (b"" if cut else data[at + len(junk) :]))
    reads_or_refuses(tmp_path / name, read)


@damage
@given(
    place=st.floats(0, 1, exclude_max=True),
    junk=st.text(st.sampled_from("[]{}&*<: ,\n-?!|>%@`'\"#~a1.\t\0\x85"), min_size=1, max_size=8),
)
def test_a_damaged_configuration_is_read_or_refused(tmp_path: Path, place: float, junk: str) -> None:
    text = configure(tmp_path).read_text()
    at = int(place * len(text))
    path = tmp_path / "c.yaml"
    path.write_text(text[:at] + junk + text[at + 1 :])
    reads_or_refuses(path, read_config)
