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

    def test_a_folder_may_have_a_name_with_an_ending(self, identification: dy.Identification, tmp_path: Path) -> None:
        (tmp_path / "arm.urdf").mkdir()
        assert (
            len(dy.export_model(identification, tmp_path / "arm.urdf"))
            == len(dy.export_model(identification, tmp_path / "v1.2"))
            == 2
        )

    def test_a_saved_result_is_written_without_its_recordings(
        self, identification: dy.Identification, tmp_path: Path
    ) -> None:
        identification.save(tmp_path / "result.json")
        saved = dy.load(tmp_path / "result.json", identification.model)
        pairs = zip(
            dy.export_model(identification, tmp_path / "a"), dy.export_model(saved, tmp_path / "b"), strict=True
        )
        assert all(file.read_bytes() == again.read_bytes() for file, again in pairs)

    def test_mistakes_are_named(self, identification: dy.Identification, tmp_path: Path) -> None:
        with pytest.raises(ConfigError, match="no format 'yml'; did you mean 'yaml'"):
            dy.export_model(identification, tmp_path, "yml")


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
        reference = Sources(model=SourceFile(str(tmp_path / "one.urdf")))
        assert relocate_exports(tmp_path / "out", [urdf], Sources()) == (urdf,)
        assert relocate_exports(tmp_path / "out", [refused, other], reference) == (refused, other)
