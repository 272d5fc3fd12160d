"""A configuration on the bench: what is tuned and then written down is identified the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from dynident.apps.tuning import Bench
from dynident.apps.tuning.config import bench_of, read_bench
from dynident.motion.log import Log
from dynident.project.project import Project, read_project
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError
from dynident.runtime.families import ESTIMATORS, TERMS
from tests.apps.tuning.arms import JOINTS, recording
from tests.robots import ARM


def written(log: Log, folder: Path, name: str) -> None:
    arrays = {"t": log.t} | {f"{key}{j}": getattr(log, key)[:, j] for key in ("q", "tau") for j in range(3)}
    np.savez(folder / f"{name}.npz", **arrays)


def settings(**more: Any) -> dict[str, Any]:
    units = {"shoulder": ("rad", "N m"), "rail": ("m", "N"), "twist": ("rad", "N m")}
    return {
        "model": {"file": "arm.urdf", "terms": ["viscous", "coulomb", "offset"]},
        "time": {"column": "t", "unit": "s"},
        "position": {name: {"column": f"q{j}", "unit": units[name][0]} for j, name in enumerate(JOINTS)},
        "torque": {name: {"column": f"tau{j}", "unit": units[name][1]} for j, name in enumerate(JOINTS)},
        "train": [{"file": "monday.npz", "exclude": [1, 1.5]}],
        "validation": [{"file": "tuesday.npz"}],
        "estimator": {"kind": "consistent"},
        **more,
    }


def project_of(folder: Path, data: dict[str, Any], name: str = "robot.yaml") -> Project:
    (folder / name).write_text(yaml.safe_dump(data))
    return read_project(folder / name)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tuned")
    (path / "arm.urdf").write_text(ARM)
    written(recording(1), path, "monday")
    written(recording(2, 5.0), path, "tuesday")
    return path


@pytest.fixture(scope="module")
def bench(folder: Path) -> Bench:
    project_of(folder, settings())
    project, bench = read_bench(folder / "robot.yaml")
    assert project.path.name == "robot.yaml"
    return bench


def explicit(bench: Bench, tuning: Any) -> dict[str, Any]:
    """The configuration of a tuning, written out."""
    recipe = bench.recipe(tuning)
    factor = {name: 10 ** (one / 2) for name, one in zip(JOINTS, tuning.degree, strict=True)}
    speeds = {name: one for name, one in zip(JOINTS, tuning.min_speed, strict=True) if one}
    data = settings(
        smoother={"kind": "spline", "factor": factor},
        estimator=ESTIMATORS.describe(recipe.estimator),
        time_offset=tuning.time_offset,
        min_speed=speeds,
        unfitted=list(tuning.unfitted),
        filter={"decimate": tuning.filter.decimate},
    )
    data["model"] |= {
        "base_tilt": list(recipe.base_tilt) if isinstance(recipe.base_tilt, tuple) else "none",
        "terms": [TERMS.describe(one) for one in bench.switches.terms(tuning.terms)],
    }
    for role, name in (("train", "monday"), ("validation", "tuesday")):
        data[role][0]["exclude"] = [list(one) for one in tuning.windows(name)]
    return data


def test_what_is_written_down_is_identified_the_same(folder: Path, bench: Bench) -> None:
    start = bench.start
    assert start.windows("monday") == ((1.0, 1.5),)
    tuning = start.with_degree(0.8, 0).with_degree(-0.2, 2).exclude("monday", 4.0, 5.0).exclude("tuesday", 2.0, 3.0)
    tuning = tuning.with_terms(0, ("viscous", "stribeck")).with_terms(2, (*start.terms[2], "rotor"))
    tuning = replace(tuning, min_speed=(0.05, 0.0, 0.0), unfitted=("rail",), filter=ParallelFilter(decimate=2))
    here = bench.identify(tuning)
    project = project_of(folder, explicit(bench, tuning), "explicit.yaml")
    there = project.identify()
    assert there.estimate.names == here.estimate.names
    np.testing.assert_allclose(there.estimate.value, here.estimate.value, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(there.errors.std, here.errors.std, rtol=1e-9)
    for one, other in zip(there.validations, here.validations, strict=True):
        assert one.errors.relative_error == pytest.approx(other.errors.relative_error, rel=1e-9)
        assert one.errors.samples == other.errors.samples
    again = bench_of(project)
    assert again.start == replace(tuning, degree=again.start.degree)
    assert again.start.degree == pytest.approx(tuning.degree)


def test_what_there_is_to_choose_from(bench: Bench) -> None:
    assert bench.estimators == ("consistent", "least_squares")
    assert bench.log_names == ("monday", "tuesday")
    assert {"viscous", "stribeck", "dahl"} <= set(bench.kinds)


def test_an_estimator_goes_by_the_kind_of_the_configuration(folder: Path) -> None:
    data = settings(estimator={"kind": "robust", "loss": "tukey"}, validation=[])
    data["train"] = [{"file": "monday.npz", "window": [2, 4]}]
    on = bench_of(project_of(folder, data, "robust.yaml"))
    assert on.estimators == ("robust", "least_squares", "consistent")
    assert not on.fit(on.start).exact


def test_training_too_long_for_the_memory_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Project, "long", True)
    with pytest.raises(ConfigError, match="too long for the memory"):
        read_bench(folder / "robot.yaml")
