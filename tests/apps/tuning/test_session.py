"""Where a session saves what was tuned, which is identified the same, and what is not done in vain."""

import threading
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

from dynident.apps.tuning import Bench, Tuning
from dynident.apps.tuning import session as session_module
from dynident.apps.tuning.config import bench_of, tuned_text
from dynident.apps.tuning.session import Latest, Session, Stale, WholeRuns
from dynident.motion.log import Log
from dynident.project.project import Project, read_project
from dynident.regression import ParallelFilter
from dynident.runtime import (
    ConfigError,
    DynidentError,
    InputError,
    Step,
    budget_scope,
    memory_budget,
    report_progress,
    set_budget,
)
from tests.apps.tuning.arms import JOINTS, recording, with_terms
from tests.robots import ARM

pytest.importorskip("dash")

from dynident.apps.tuning.answers import Page


@pytest.fixture
def session(arm: Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Session:
    monkeypatch.setattr(session_module, "tuned_text", lambda _project, _bench, tuning, path: f"{path.name} {tuning}")
    return session_of(tmp_path / "arm.yaml", arm)


def session_of(path: Path, bench: Bench) -> Session:
    return Session(SimpleNamespace(path=path), bench, print)  # type: ignore[arg-type]


def test_a_file_that_the_session_did_not_write_stays(session: Session, arm: Bench) -> None:
    path, start, tuned = session.project.path, arm.start, arm.start.with_degree(1.0)
    path.write_text("mine")
    assert session.save(start) == path.with_name("arm-tuned.yaml")
    assert session.save(tuned) == path.with_name("arm-tuned.yaml")  # its own is replaced
    assert path.with_name("arm-tuned.yaml").read_text() == f"arm-tuned.yaml {tuned}"
    path.with_name("arm-tuned.yaml").write_text("edited by hand")
    assert session.save(start) == path.with_name("arm-tuned-2.yaml")
    other = session_of(path.with_name("arm-tuned-2.yaml"), arm)
    assert other.save(start) == path.with_name("arm-tuned-3.yaml")
    texts = [file.read_text() for file in sorted(path.parent.iterdir())]
    assert texts == [f"arm-tuned-{k}.yaml {start}" for k in (2, 3)] + ["edited by hand", "mine"]


def test_two_tabs_do_not_replace_what_the_other_saved(session: Session, arm: Bench) -> None:
    path, start, tuned = session.project.path, arm.start, arm.start.with_degree(1.0)
    for _ in range(2):
        assert session.save(start, "a") == path.with_name("arm-tuned.yaml")
        assert session.save(tuned, "b") == path.with_name("arm-tuned-2.yaml")
    assert path.with_name("arm-tuned.yaml").read_text() == f"arm-tuned.yaml {start}"
    assert Page(session).save(1, "", "a") == ("Saved in arm-tuned.yaml.", "")
    remark = " arm-tuned.yaml is not of this page, and stays as it is."
    assert Page(session).save(1, "", "b") == (f"Saved in arm-tuned-2.yaml.{remark}", "")


def test_what_cannot_be_fitted_is_not_saved(session: Session, arm: Bench) -> None:
    with pytest.raises(DynidentError, match="0 usable samples"):
        session.save(arm.start.exclude(arm.log_names[0], -1.0, 100.0))
    assert not list(session.project.path.parent.iterdir())


def test_the_thread_has_the_memory_of_the_run() -> None:
    with budget_scope():
        set_budget(2.5)
        runs = WholeRuns(lambda _: memory_budget())  # type: ignore[arg-type,return-value]
        runs.request_run("page", ONE)
    assert wait_for(runs, ONE).result == 2_500_000_000


ONE, TWO, THREE, WRONG = (Tuning((float(k),), ((),), (0.0,), "least_squares") for k in (1, 2, 3, 4))


def wait_for(runs: WholeRuns, tuning: Tuning):
    with runs._changed:
        assert runs._changed.wait_for(lambda: tuning in runs._ended, 10)
    return runs.outcome(tuning)


def test_a_whole_run_that_nobody_waits_for_any_longer_is_given_up():
    begun, go, requests = threading.Event(), threading.Event(), []

    def identify(tuning):
        requests.append(tuning)
        report_progress(Step("smoothing", 1, 4))
        begun.set()
        go.wait(10)
        report_progress("fitting")
        if tuning == THREE:
            raise InputError("nothing is left.")
        if tuning == WRONG:
            raise RuntimeError("no")
        return SimpleNamespace(of=tuning)

    runs = WholeRuns(identify)
    runs.request_run("page", ONE)
    assert begun.wait(10)
    assert runs.step(ONE) == "smoothing (1 of 4)"
    assert runs.step(TWO) == "waits for the fit of another setting, which is at: smoothing"
    runs.request_run("page", TWO)
    go.set()
    runs.request_run("other page", THREE)
    assert wait_for(runs, TWO).result.of == TWO
    assert wait_for(runs, THREE).failed == "nothing is left."
    assert runs.outcome(ONE) is None
    runs.request_run("page", TWO)  # has ended
    runs.request_run("page", WRONG)  # a fault ends a setting and not the runs
    assert "fault of dynident: RuntimeError: no" in wait_for(runs, WRONG).failed
    assert requests == [ONE, TWO, THREE, WRONG]


def test_the_newest_of_the_answers_that_wait_is_made() -> None:
    latest, begun, go = Latest(), threading.Event(), threading.Event()
    done: list[str] = []

    def work() -> None:
        begun.set()
        go.wait(10)
        done.append("first")

    def ask(name: str) -> None:
        try:
            latest("page", lambda: done.append(name))
        except Stale:
            done.append(f"not {name}")

    threads = [threading.Thread(target=lambda: latest("page", work))]
    threads[0].start()
    begun.wait(10)
    for number, name in ((2, "second"), (3, "third")):
        threads.append(threading.Thread(target=ask, args=(name,)))
        threads[-1].start()
        while latest._askers["page"][1][0] < number:
            pass
    assert latest("another page", lambda: "at once") == "at once"
    go.set()
    for thread in threads:
        thread.join(10)
    assert done[0] == "first"
    assert set(done[1:]) == {"not second", "third"}
    with pytest.raises(ZeroDivisionError):
        latest("page", lambda: 1 // 0)
    assert latest("page", lambda: 2) == 2


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
    written(recording(1, 8.0), path, "monday")
    written(recording(2, 5.0), path, "tuesday")
    return path


@pytest.fixture(scope="module")
def project(folder: Path) -> Project:
    return project_of(folder, settings())


@pytest.fixture(scope="module")
def bench(project: Project) -> Bench:
    return bench_of(project)


def test_what_is_saved_is_identified_the_same(project: Project, bench: Bench, tmp_path: Path) -> None:
    start = bench.start
    assert start.windows("monday") == ((1.0, 1.5),)
    tuning = start.with_degree(0.8, 0).with_degree(-0.2, 2).exclude("monday", 4.0, 5.0).exclude("tuesday", 2.0, 3.0)
    tuning = with_terms(with_terms(tuning, 0, ("viscous", "stribeck")), 2, (*start.terms[2], "rotor"))
    tuning = replace(tuning, min_speed=(0.05, 0.0, 0.0), unfitted=("rail",), filter=ParallelFilter(decimate=2))
    here, path = bench.identify(tuning), tmp_path / "elsewhere.yaml"
    path.write_text(tuned_text(project, bench, tuning, path))
    saved = read_project(path)
    there = saved.identify()
    assert there.estimate.names == here.estimate.names
    np.testing.assert_allclose(there.estimate.value, here.estimate.value, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(there.errors.std, here.errors.std, rtol=1e-9)
    for validation, expected in zip(there.validations, here.validations, strict=True):
        assert validation.errors.relative_error == pytest.approx(expected.errors.relative_error, rel=1e-9)
        assert validation.errors.samples == expected.errors.samples
    again = bench_of(saved)
    assert again.start == replace(tuning, degree=again.start.degree)
    assert again.start.degree == pytest.approx(tuning.degree)


def test_the_start_is_saved_with_all_that_was_chosen(project: Project, bench: Bench) -> None:
    text = tuned_text(project, bench, bench.start, project.path)
    assert text.startswith("# robot.yaml, tuned by hand")
    settings = yaml.safe_load(text)
    assert settings["time_offset"] == bench.start.time_offset
    assert settings["train"][0]["exclude"] == [[1.0, 1.5]]
    assert not settings.keys() & {"min_speed", "filter", "unfitted"}
    plain = yaml.safe_load(tuned_text(project, bench, replace(bench.start, excluded=()), project.path))
    assert "exclude" not in plain["train"][0]


def test_a_window_beyond_its_part_of_a_recording_excludes_nothing_of_another(folder: Path) -> None:
    train = [{"file": "monday.npz", "window": [[None, 4.0], [4.5, 7.5]]}]
    project = project_of(
        folder, settings(train=train, time_offset=0, estimator={"kind": "least_squares"}), "parts.yaml"
    )
    bench = bench_of(project)
    first, second = bench.logs["train"]
    tuning = bench.start.exclude(first, 2.0, float(bench.logs["train"][second].t[0]) + 1.0)
    ((start, stop),) = yaml.safe_load(tuned_text(project, bench, tuning, project.path))["train"][0]["exclude"]
    assert start == 2.0
    assert 3.9 < stop < 4.1
    beyond = bench.start.exclude(first, 5.0, 6.0)
    assert "exclude" not in yaml.safe_load(tuned_text(project, bench, beyond, project.path))["train"][0]


def test_training_too_long_for_the_memory_is_refused(project: Project, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Project, "long", True)
    with pytest.raises(ConfigError, match="too long for the memory"):
        bench_of(project)
