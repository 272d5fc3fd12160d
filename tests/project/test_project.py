"""A configuration as one noun, the run that command line and Python share, and fingerprints of what it reads."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from dynident.checks.file_notes import ReversedSign
from dynident.checks.log_notes import SameData
from dynident.identification import SourceFile, judge
from dynident.identification.verdict_reasons import ForbiddingFindings
from dynident.project.config import fingerprint
from dynident.project.project import read_project, run, stamp
from dynident.runtime import ModelError, Remark, Severity, Use, progress_to
from tests.cli.commands import configure, settings, write_log


@pytest.fixture(scope="module")
def config(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("project")
    write_log(folder)
    return configure(folder, validation=[{"file": "log.csv", "window": [2, 4]}])


def test_a_run_says_each_step_what_it_read_and_what_to_doubt(config: Path) -> None:
    steps: list[str] = []
    with progress_to(steps.append):
        outcome = run(str(config))
    assert steps[0] == "building the model"
    assert any(step.startswith("validating") for step in steps)
    np.testing.assert_allclose(outcome.estimate.value, [5.0, 8.0, 3.0, 0.5], rtol=0.01)
    assert outcome.provenance.configuration.text == config.read_text()
    digest = hashlib.sha256((config.parent / "log.csv").read_bytes()).hexdigest()
    assert outcome.provenance.logs == (
        SourceFile(str(config.parent.resolve() / "log.csv"), digest, modified=stamp(config.parent / "log.csv")),
    )
    assert stamp(config.parent / "gone.csv") == ""
    assert stamp() >= outcome.provenance.identified > "2020"
    assert any("overlaps in time" in note.text for note in outcome.warnings if isinstance(note, Remark))


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


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.csv: cannot be read"):
        fingerprint(tmp_path / "gone.csv")
