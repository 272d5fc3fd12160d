"""A configuration as one noun, the run that command line and Python share, and fingerprints of what it reads."""

from __future__ import annotations

import hashlib
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynident.checks.file_notes import ReversedSign
from dynident.checks.log_notes import SameData
from dynident.identification import SourceFile, judge
from dynident.identification.verdict_reasons import ForbiddingFindings
from dynident.models.lagrangian import slider
from dynident.project.config import fingerprint, parse_config
from dynident.project.project import log_files, parse_project, read_project, run, stamp
from dynident.runtime import ConfigRemark, InputError, ModelError, Remark, Severity, Use, progress_to
from tests.cli.commands import configure, settings, write_log


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    write_log(folder)
    return configure(folder, validation=[{"file": "log.csv", "window": [2, 4]}])


def test_a_project_reads_no_recording_before_it_is_asked(tmp_path: Path) -> None:
    project = parse_project(yaml.safe_dump(settings()), tmp_path / "slider.yaml")
    assert project.model.names == slider().names
    with pytest.raises(InputError, match=r"log\.csv"):
        project.logs()


def test_a_run_says_each_step_what_it_read_and_what_to_doubt(config: Path) -> None:
    steps: list[str] = []
    with progress_to(steps.append):
        outcome = run(str(config))
    assert steps[0] == "building the model"
    assert any(step.startswith("validating") for step in steps)
    np.testing.assert_allclose(outcome.estimate.value, [5.0, 8.0, 3.0, 0.5], rtol=0.01)
    assert outcome.provenance.configuration is not None
    assert outcome.provenance.configuration.text == config.read_text()
    digest = hashlib.sha256((config.parent / "log.csv").read_bytes()).hexdigest()
    assert outcome.provenance.logs == (
        SourceFile(str(config.parent.resolve() / "log.csv"), digest, modified=stamp(config.parent / "log.csv")),
    )
    assert stamp(config.parent / "gone.csv") == ""
    assert stamp() >= outcome.provenance.identified > "2020"
    assert any("overlaps in time" in note.text for note in outcome.warnings if isinstance(note, Remark))


def test_the_three_runs_warn_of_the_same_configuration(config: Path) -> None:
    project = read_project(config)
    (doubt,) = project.warnings
    assert Remark(doubt) in project.bound().identification.warnings
    assert ConfigRemark(doubt) in [finding.message for finding in project.examine().findings]


def test_identify_repeats_what_check_finds_and_judges_by_it(tmp_path: Path) -> None:
    """The gain of the force is negative: least squares fits it perfectly, and the verdict says no."""
    write_log(tmp_path)
    project = read_project(configure(tmp_path, validation=[{"file": "log.csv", "window": [2, 4]}]))
    torque = {joint: channel | {"gain": -1.0} for joint, channel in settings()["torque"].items()}
    turned = read_project(configure(tmp_path, validation=[{"file": "log.csv", "window": [2, 4]}], torque=torque))
    for case in (project, turned):
        result = case.identify()
        examined = [
            x for x in case.examine().findings if x.severity is not Severity.INFO and x.source != case.path.name
        ]
        assert list(result.findings) == examined
    assert [type(finding.message) for finding in result.findings] == [
        SameData,
        ReversedSign,
    ]  # the window is of the training
    assert judge(result).reasons[:2] == (
        ForbiddingFindings(result.findings[:1]),
        ForbiddingFindings(result.findings[1:]),
    )
    assert judge(result).use is Use.DO_NOT_USE


def test_a_folder_has_the_digest_of_all_its_files(tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    bag.mkdir()
    (bag / "metadata.yaml").write_bytes(b"late")
    (bag / "a.db3").write_bytes(b"early, ")
    assert fingerprint(bag) == hashlib.sha256(b"early, late").hexdigest()


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.csv: cannot be read"):
        fingerprint(tmp_path / "gone.csv")


def test_every_recording_is_hashed_once(tmp_path: Path) -> None:
    for name in ("a.csv", "b.csv"):
        (tmp_path / name).write_text(name)
    text = """
model: gallery:slider
time: {rate: 100}
position: {slider: {column: q, unit: m}}
torque: {slider: {column: f, unit: N}}
train: [{file: a.csv, window: [0, 1]}, {file: a.csv, window: [1, 2]}]
validation: [{file: {x: a.csv, y: b.csv}}]
"""
    result = {file.path: file.sha256 for file in log_files(parse_config(text, tmp_path))}
    assert result == {str(tmp_path / name): hashlib.sha256(name.encode()).hexdigest() for name in ("a.csv", "b.csv")}
