"""Results of before there were versions: what they lack is said, and what is wrong in them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from dynident.errors import InputError
from dynident.identification import OldResult
from dynident.io.saved import load
from dynident.smoothers import Spline, TimeShifted

DATA = Path(__file__).parents[1] / "data"


def test_a_result_of_version_0_says_what_it_lacks() -> None:
    found = load(DATA / "result-0.json")
    (note,) = found.warnings
    assert isinstance(note, OldResult)
    assert note.version == 0
    assert {"covariances", "validations"} < set(note.lacks)
    assert found.model.names == ("M", "Fv", "Fc", "offset")
    assert found.recipe.smoother == TimeShifted(Spline(factor=4.0), 0.001)
    assert (found.recipe.time_offset, found.recipe.restart) == (0.001, 0.5)
    row = json.loads((DATA / "result-0.json").read_text())["parameters"][0]
    assert (found.estimate.value[0], found.errors.std[0]) == (row["value"], row["std"])
    assert found.provenance.configuration is not None
    assert found.provenance.configuration.path == "/data/slider.yaml"
    assert [file.path for file in found.provenance.logs] == ["/data/swing.csv", "/data/check.csv"]


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("smoother used", "Spline(factor=9)", "is none that its configuration makes now"),
        ("delay used", "late", "not 1 finite numbers"),
    ],
)
def test_what_is_wrong_in_an_old_file_is_named(tmp_path: Path, key: str, value: str, words: str) -> None:
    data = json.loads((DATA / "result-0.json").read_text())
    data["settings"][key] = value
    (tmp_path / "r.json").write_text(json.dumps(data))
    with pytest.raises(InputError, match=words):
        load(tmp_path / "r.json")
