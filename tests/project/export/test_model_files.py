"""The identified model as files: all formats or one, and what cannot be written."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

import dynident as dy
from dynident.identification import SourceFile, Sources
from dynident.project.export import Export, ExportText
from dynident.project.export.proof import relocate_exports
from dynident.runtime import ConfigError
from tests.project.test_shortcuts import sliding


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


class TestMovedTo:
    MESH = '<robot name="one"><link name="a"><visual><geometry><mesh filename="{}"/></geometry></visual></link></robot>'

    @pytest.mark.parametrize(
        ("place", "name"), [("arm", "a.stl"), ("arm/result", "../a.stl"), ("other", "../arm/a.stl")]
    )
    def test_meshes_are_found_from_the_new_folder(self, tmp_path: Path, place: str, name: str) -> None:
        made = Export("urdf", "one.identified.urdf", ExportText(self.MESH.format("a.stl")))
        (moved,) = relocate_exports(
            tmp_path / place, [made], Sources(model=SourceFile(str(tmp_path / "arm" / "one.urdf")))
        )
        assert moved.written is not None
        assert moved.written.text == self.MESH.format(name)

    def test_only_a_robot_file_of_which_the_place_is_known_changes(self, tmp_path: Path) -> None:
        urdf, refused = Export("urdf", "one.urdf", ExportText(self.MESH.format("a.stl"))), Export("urdf", "two.urdf")
        other = Export("yaml", "parameters.yaml", ExportText("text"))
        known = Sources(model=SourceFile(str(tmp_path / "one.urdf")))
        assert relocate_exports(tmp_path / "out", [urdf], Sources()) == (urdf,)
        assert relocate_exports(tmp_path / "out", [refused, other], known) == (refused, other)
