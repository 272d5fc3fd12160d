"""Tuned settings are saved into their configuration: it then gives the same numbers, and comes back to the byte."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dynident.apps.tuning import Bench
from dynident.apps.tuning.config import ConfigFile, bench_of, tuned_changes
from dynident.files.opener import watch_inputs
from dynident.files.yaml_edit import REMOVED
from dynident.project.project import Project, parse_project, read_project, run
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError, InputError
from tests.project.test_explicit_config import write

ON, ODD, TERMS = "on", "no: \"#x'", "terms"  # the joints


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Project, Bench]:
    path = write(tmp_path_factory.mktemp("tuned"), ["viscous", "coulomb"], min_speed=0.01)
    text = path.read_text(encoding="utf-8").replace("min_speed: 0.01", "min_speed: 0.01 # rad/s")
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    project = read_project(path)
    return project, bench_of(project)


@pytest.fixture
def file(tuned: tuple[Project, Bench]) -> Any:
    found = ConfigFile.of(tuned[0])
    before = found.path.read_bytes()
    yield found
    found.path.write_bytes(before)


def test_the_saved_file_gives_the_numbers_of_the_tuning(tuned: tuple[Project, Bench], file: ConfigFile) -> None:
    project, bench = tuned
    tuning = bench.start.with_degree(1.0, 1).exclude(bench.log_names[0], 2.0, 3.5).with_terms(0, ["viscous"])
    tuning = replace(tuning, min_speed=(0.1, 0.0, 0.0), unfitted=(TERMS,), filter=ParallelFilter(decimate=2))
    with watch_inputs(project.path):
        saved = file.save(tuned_changes(project, bench, tuning))
    whole, found = bench.identify(tuning), run(project.path)
    assert found.estimate.names == whole.estimate.names
    np.testing.assert_allclose(found.estimate.value, whole.estimate.value, rtol=1e-9)
    np.testing.assert_allclose(found.errors.std, whole.errors.std, rtol=1e-9)
    again = parse_project(saved.text.removeprefix("\ufeff"), project.path)
    assert replace(again.recipe, base_tilt=None) == replace(bench.recipe(tuning), base_tilt=None)
    assert saved.undo() == file
    assert project.path.read_bytes() == file.text.encode()


def test_only_what_differs_is_changed(tuned: tuple[Project, Bench], file: ConfigFile) -> None:
    project, bench = tuned
    assert tuned_changes(project, bench, bench.start) == {}
    changes = tuned_changes(project, bench, replace(bench.start, min_speed=(0.2, 0.2, 0.2)))
    left_open = {("model", "base_tilt"): [0.0, 0.0], ("smoother",): {"kind": "spline"}, ("time_offset",): 0.0}
    assert changes == left_open | {("min_speed",): 0.2}
    assert "min_speed: 0.2 # rad/s\r\n" in file.apply_changes(changes)
    none = tuned_changes(project, bench, replace(bench.start, min_speed=(0.0, 0.0, 0.0)))
    assert none == left_open | {("min_speed",): REMOVED}
    assert "min_speed" not in file.apply_changes(none)
    gone = set(file.text[1:].splitlines()) - set(file.apply_changes(none)[1:].splitlines())
    assert gone == {"min_speed: 0.01 # rad/s"}


def test_each_change_is_one_of_the_start(tuned: tuple[Project, Bench], file: ConfigFile) -> None:
    """What a former change has set is not left behind by the next."""
    project, bench = tuned
    first = file.save(tuned_changes(project, bench, bench.start.exclude(bench.log_names[1], 1.0, 2.0)))
    assert "  exclude: [[1.0, 2.0]]\r\n" in first.text
    second = first.save(tuned_changes(project, bench, replace(bench.start, time_offset=1e-3)))
    assert "exclude" not in second.text
    assert second.save(tuned_changes(project, bench, replace(bench.start, time_offset=1e-3))) is second
    start = second.save(tuned_changes(project, bench, bench.start))
    assert start.text == file.text
    assert start.undo().undo().undo() == file


def test_a_file_that_others_have_changed_is_not_replaced(tuned: tuple[Project, Bench], file: ConfigFile) -> None:
    other = file.text.replace("# rad/s", "# of a colleague").encode()
    file.path.write_bytes(other)
    with pytest.raises(ConfigError, match="has been changed by another program since it was read; nothing"):
        file.save({("time_offset",): 0.0})
    with pytest.raises(ConfigError, match="has been changed by another program"):
        ConfigFile.of(tuned[0])
    assert file.path.read_bytes() == other
    assert not [one for one in file.path.parent.iterdir() if one.name.startswith(".dynident")]


def test_settings_that_are_wrong_are_not_written(file: ConfigFile) -> None:
    with pytest.raises(ConfigError, match="min_speed: a number greater than 0"):
        file.save({("min_speed",): -1.0})
    with pytest.raises(ConfigError, match="nothing has been saved"):
        file.undo()
    assert file.path.read_bytes() == file.text.encode()


def test_mode_and_link_of_the_file_stay(tuned: tuple[Project, Bench], file: ConfigFile, tmp_path: Path) -> None:
    link = tmp_path / "link.yaml"
    link.symlink_to(file.path)
    file.path.chmod(0o640)
    saved = replace(file, path=link).save({("min_speed",): 0.3})
    assert link.is_symlink()
    assert file.path.read_bytes() == saved.text.encode()
    assert file.path.stat().st_mode & 0o777 == 0o640
    saved.undo()


def test_a_window_beyond_its_part_of_a_recording_excludes_nothing_of_another(tmp_path: Path) -> None:
    train = [{"file": "logs/mon: #day.csv", "window": [[None, 9.0], [10.0, 18.0]]}]
    project = read_project(write(tmp_path, ["viscous"], train=train))
    bench = bench_of(project)
    first, second = bench.logs["train"]
    ends = float(bench.logs["train"][second].t[0])
    changes = tuned_changes(project, bench, bench.start.exclude(first, 2.0, ends + 1.0))
    ((start, stop),) = changes["train", 0, "exclude"]
    assert start == pytest.approx(2.0, abs=0.1)
    assert 8.9 < stop < 9.1


def test_a_file_that_may_only_be_read_or_is_gone(file: ConfigFile) -> None:
    before = file.path.read_bytes()
    file.path.chmod(0o444)
    with pytest.raises(InputError, match="may only be read"):
        file.save({("time_offset",): 0.0})
    assert file.path.read_bytes() == before
    file.path.chmod(0o644)
    file.path.unlink()
    with pytest.raises(InputError, match="is there no longer"):
        file.save({("time_offset",): 0.0})
    assert not file.path.exists()


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_that_cannot_be_written(file: ConfigFile) -> None:
    file.path.parent.chmod(0o500)
    try:
        with pytest.raises(InputError, match="cannot be written"):
            file.save({("time_offset",): 0.0})
    finally:
        file.path.parent.chmod(0o700)


def test_a_file_name_alone_becomes_a_mapping_and_terms_keep_their_words(tuned: tuple[Project, Bench]) -> None:
    project, bench = tuned
    assert project.sources.configuration is not None
    text = project.sources.configuration.text
    model = text[text.index("model:") : text.index("outliers:") if "outliers:" in text else text.index("position:")]
    alone = text.replace(model, "model: an arm.urdf # measured\r\n")
    other = parse_project(alone, project.path)
    changes = tuned_changes(other, bench, bench.start.with_terms(0, ["viscous"]))
    terms = ["viscous", {"kind": "coulomb", "on": [ODD, TERMS]}]
    assert changes[("model",)] == {"file": "an arm.urdf", "base_tilt": [0.0, 0.0], "terms": terms}
    made = replace(ConfigFile.of(project), start=alone).apply_changes(changes)
    assert "model: # measured\r\n" in made or "} # measured\r\n" in made


def test_a_tuning_of_another_bench_is_refused(tuned: tuple[Project, Bench]) -> None:
    with pytest.raises(ConfigError, match="degree has 1 entries for 3 joints"):
        tuned_changes(*tuned, replace(tuned[1].start, degree=(1.0,)))
