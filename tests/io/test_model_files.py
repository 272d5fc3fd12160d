"""The identified model as files: all formats or one, and what cannot be written."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import dynident as dy
from dynident.errors import ConfigError
from tests.io.test_shortcuts import sliding


@pytest.fixture(scope="module")
def found() -> dy.Identification:
    return dy.identify("gallery:slider", sliding(), recipe=dy.Recipe(dy.Difference("central")))


class TestExportModel:
    def test_all_formats_or_one(self, found: dy.Identification, tmp_path: Path) -> None:
        assert [file.name for file in dy.export_model(found, tmp_path)] == ["parameters.yaml", "model.py"]
        (only,) = dy.export_model(found, tmp_path / "one", "yaml")
        assert yaml.safe_load(only.read_text())["parameters"][0]["name"] == "M"

    def test_mistakes_are_named(self, found: dy.Identification, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="no format 'yml' of this model; did you mean 'yaml'"):
            dy.export_model(found, tmp_path, "yml")
