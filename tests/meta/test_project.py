"""What the project's own files say of each other: versions of Python, commands of CI and hooks, pins."""

import re
import runpy
import shlex
import subprocess
import tomllib
import venv
from pathlib import Path
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
SETTINGS: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT: dict[str, Any] = SETTINGS["project"]
TASKS: dict[str, Any] = runpy.run_path(str(ROOT / "dev.py"))["TASKS"]


def read(path: Path) -> Any:
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def jobs(path: Path) -> list[dict[str, Any]]:
    return list(read(path)["jobs"].values())


def python_versions() -> list[str]:
    matches = re.findall(r"Python :: (3\.\d+)", "\n".join(PROJECT["classifiers"]))
    return sorted(matches, key=lambda version: int(version.partition(".")[2]))


def test_the_tests_run_on_every_version_of_python_that_is_supported() -> None:
    assert PROJECT["requires-python"] == f">={python_versions()[0]}"
    (job,) = jobs(ROOT / ".github" / "workflows" / "test.yml")
    assert job["strategy"]["matrix"]["python"] == python_versions()


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_use_known_actions_and_tasks(path: Path) -> None:
    for step in (step for job in jobs(path) for step in job["steps"]):
        assert re.fullmatch(
            r"(actions/(checkout|setup-python|upload-artifact)|pypa/cibuildwheel)@v[\d.]+",
            step.get("uses", "actions/checkout@v1"),
        )
        for line in step.get("run", "").splitlines():
            words = shlex.split(line)
            assert words[1] != "dev.py" or words[2] in TASKS, line


def test_ci_runs_the_same_tasks_here_and_there() -> None:
    (job,) = jobs(ROOT / ".github" / "workflows" / "test.yml")
    here = re.findall(r"^python3 dev\.py .*$", (ROOT / ".ci" / "run").read_text(encoding="utf-8"), re.MULTILINE)
    assert here == [step["run"] for step in job["steps"] if "run" in step]


def test_help_of_dev_py_lists_every_task_and_installs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    runpy.run_path(str(ROOT / "dev.py"))["main"](["--help"])
    shown = capsys.readouterr().out
    assert re.findall(r"^python3 dev\.py (\w+)", shown, re.MULTILINE) == list(TASKS)


def test_a_run_of_the_tests_that_names_no_path_includes_the_examples_of_docstrings() -> None:
    options = SETTINGS["tool"]["pytest"]["ini_options"]
    assert options["testpaths"] == ["tests", "src"]
    assert "--doctest-modules" in options["addopts"].split()


def test_dev_py_names_what_a_python_without_pip_lacks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Debian and Ubuntu ship the pip of new environments apart."""

    def create(*_: object, **__: object) -> None:
        raise subprocess.CalledProcessError(1, "ensurepip")

    monkeypatch.setattr(venv, "create", create)
    install = runpy.run_path(str(ROOT / "dev.py"))["install"]
    monkeypatch.setitem(install.__globals__, "PYTHON", tmp_path / "python")
    with pytest.raises(SystemExit, match="apt install python3-venv"):
        install("dev")


def test_hooks_run_the_linters_of_this_project() -> None:
    (repository,) = read(ROOT / ".pre-commit-config.yaml")["repos"]
    assert repository["repo"] == "local"
    entries = {hook["id"]: hook["entry"] for hook in repository["hooks"]}
    assert entries["lint"] == "python3 dev.py lint"
    assert all(entry.startswith(".venv/bin/ruff ") for name, entry in entries.items() if name != "lint")


def test_every_dependency_is_pinned_without_an_address() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    assert all(re.fullmatch(r"[a-z0-9-]+==[\w.]+( ; [\w'<>=!. ]+)?", line) for line in lines)
    pinned = {line.partition("==")[0] for line in lines}
    groups = SETTINGS["dependency-groups"].values()
    for wanted in (PROJECT["dependencies"], *PROJECT["optional-dependencies"].values(), *groups):
        assert {re.split(r"[<>=; ]", x)[0].lower() for x in wanted} <= pinned
