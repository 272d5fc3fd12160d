"""The identified model as files: all formats or one, and what cannot be written."""

from pathlib import Path

import pytest
import yaml

import dynident as dy
from dynident.runtime import ConfigError
from tests.project.test_shortcuts import sliding


@pytest.fixture(scope="module")
def identification() -> dy.Identification:
    return dy.identify("gallery:slider", sliding(), recipe=dy.Recipe(dy.Difference("central")))


class TestExportModel:
    def test_all_formats_or_one(self, identification: dy.Identification, tmp_path: Path) -> None:
        assert [file.name for file in dy.export_model(identification, tmp_path)] == ["parameters.yaml", "model.py"]
        (only,) = dy.export_model(identification, tmp_path / "one", "yaml")
        assert yaml.safe_load(only.read_text())["parameters"][0]["name"] == "M"

    @pytest.mark.parametrize("name", ["arm.yaml", "drag.PY", "deep/arm.yaml"])
    def test_a_file_has_the_name_that_is_given(
        self, identification: dy.Identification, tmp_path: Path, name: str
    ) -> None:
        assert dy.export_model(identification, tmp_path / name) == (tmp_path / name,)
        assert [file for file in tmp_path.rglob("*") if file.is_file()] == [tmp_path / name]

    @pytest.mark.parametrize(("name", "kind"), [("arm.urdf", None), ("arm.yml", None), ("arm.yaml", "numpy")])
    def test_an_ending_that_does_not_fit_is_refused(
        self, identification: dy.Identification, tmp_path: Path, name: str, kind: str | None
    ) -> None:
        with pytest.raises(ConfigError, match=rf"'{name}' is no file of .*: it ends in .*\.py"):
            dy.export_model(identification, tmp_path / name, kind)
        assert not list(tmp_path.iterdir())

    def test_mistakes_are_named(self, identification: dy.Identification, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="no format 'yml'; did you mean 'yaml'"):
            dy.export_model(identification, tmp_path, "yml")
