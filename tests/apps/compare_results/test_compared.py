"""Results are read for a comparison without the robot's files, and say which recordings they are of."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.apps.compare_results import compare_results
from dynident.apps.compare_results.config import compared_names, read_compared
from dynident.project.saved import load
from dynident.runtime import InputError, Use
from tests.cli.commands import configure, run, write_log


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A slider that was identified into the folder "out"."""
    place = tmp_path_factory.mktemp("compared")
    write_log(place)
    done = run("identify", configure(place), "--out", place / "out")
    assert done.exit_code == 0, done.output
    return place


def test_a_result_is_read_as_it_was_saved(folder: Path) -> None:
    path = folder / "out" / "result.json"
    compared, full = read_compared(path, "slider"), load(path)
    assert compared.names == full.estimate.names
    np.testing.assert_array_equal(compared.value, full.estimate.value)
    np.testing.assert_array_equal(compared.covariance, full.errors.base_covariance)
    assert compared.together
    assert (compared.joints, compared.use is None or compared.use in list(Use)) == (("slider",), True)
    assert {export.file for export in compared.exports} == {"parameters.yaml", "model.py"}
    assert all(export.proven and export.there for export in compared.exports)
    assert [(log.name, log.role) for log in compared.logs] == [("log 0-3 s", "train"), ("log 3-4 s", "validation")]
    recordings = [log.recording for log in compared.logs]
    assert all(recordings)
    assert recordings[0] != recordings[1]  # windows of one file
    same = compare_results(compared, compared)
    assert same.shared_training == ("log 0-3 s",)
    assert (same.differs, same.worse, same.p_value) == (False, False, 1.0)


def test_files_that_are_gone_are_said_and_not_needed(folder: Path, tmp_path: Path) -> None:
    moved = tmp_path / "moved"
    shutil.copytree(folder / "out", moved)
    (moved / "model.py").write_text("changed")
    (moved / "parameters.yaml").unlink()
    data = json.loads((moved / "result.json").read_text())
    data["provenance"]["configuration"]["path"] = str(tmp_path / "nowhere" / "identify.yaml")
    (moved / "result.json").write_text(json.dumps(data))
    test_compared = read_compared(moved / "result.json", "moved")
    assert [export.there for export in test_compared.exports] == [False, False]
    assert [log.recording for log in test_compared.logs] == ["", ""]  # its recordings are called otherwise there
    compared = read_compared(folder / "out" / "result.json", "known")
    assert [log.is_same_recording for log in compare_results(compared, test_compared).logs] == [None, None]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda data: data.update(version=7), "identify again"),
        (lambda data: data.update(format="another"), "is no result"),
        (lambda data: data["errors"].update(base_covariance=[[1.0]]), r"errors\.base_covariance: has not the shape"),
        (lambda data: data.update(parameters=3), "parameters"),
        (lambda data: data["parameters"][0].update(value=1e308), "a parameter of 1e"),
    ],
)
def test_what_is_no_result_is_refused(folder: Path, tmp_path: Path, change: Any, words: str) -> None:
    data = json.loads((folder / "out" / "result.json").read_text())
    change(data)
    wrong = tmp_path / "result.json"
    wrong.write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        read_compared(wrong, "wrong")


def test_names_are_as_short_as_they_can_be() -> None:
    assert compared_names((Path("/a/monday/result.json"), Path("/a/tuesday/result.json"))) == ("monday", "tuesday")
    assert compared_names((Path("/a/x/result.json"), Path("/b/x/result.json"))) == ("a/x", "b/x")
    assert compared_names((Path("/a/one.json"), Path("/a/two.json"))) == ("one", "two")
    assert compared_names((Path("/a/one.json"), Path("/a/one.json"))) == ("/a/one.json", "/a/one.json")
