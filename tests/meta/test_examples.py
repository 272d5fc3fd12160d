"""The examples run in a clone and print what they show; configurations of public recordings say where these are."""

import ast
import re
import runpy
from pathlib import Path
from typing import Any

import nbclient
import nbformat
import pytest
import yaml

from tests.meta.test_docs import NUMBER

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(EXAMPLES.glob("*.py"))
CONFIGURATIONS = sorted(EXAMPLES.glob("*.yaml"))
PUBLIC = [path for path in CONFIGURATIONS if path.stem not in ("arm", "fleet")]
USES = ("do not use", "good for control", "good for simulation")


def named(path: Path) -> str:
    return path.name


@pytest.mark.parametrize("path", SCRIPTS, ids=named)
def test_a_script_prints_what_its_docstring_shows(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    text = path.read_text(encoding="utf-8")
    _, command, shown = (ast.get_docstring(ast.parse(text)) or "").partition(
        f"\n\n$ .venv/bin/python examples/{path.name}\n"
    )
    assert command
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(path), run_name="__main__")  # pytest makes errors of warnings
    printed = capsys.readouterr().out.strip()
    assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)
    numbers = [[float(word) for word in NUMBER.findall(x)] for x in (printed, shown)]
    assert numbers[0] == pytest.approx(numbers[1], rel=0.02)
    assert len(text.splitlines()) < 40
    assert all(x.name.endswith("-out") for x in tmp_path.iterdir())  # which git ignores


def test_every_example_is_listed() -> None:
    """Five scripts and a notebook, and the configurations."""
    listed = re.findall(r"^\| \[(.+?)\]\(\1\)", (EXAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    files = {path.name for path in EXAMPLES.iterdir() if path.is_file()} - {"README.md"}
    assert len(SCRIPTS) == 5
    assert sorted(listed) == sorted(files)


def test_the_notebook_runs_and_its_configuration_does_as_its_first_lines_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In a copy of the clone, without a warning: one test, as it takes long. Smoother and time offset are those that
    the data choose (``test_tutorial``), which takes as long again."""
    folder = tmp_path / "examples"
    folder.mkdir()
    text = (EXAMPLES / "arm.yaml").read_text(encoding="utf-8")
    (folder / "arm.yaml").write_text(f"{text}\nsmoother: {{ kind: spline }}\ntime_offset: -0.003\n", encoding="utf-8")
    (tmp_path / "src").symlink_to(ROOT / "src")
    for name in ("JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR", "IPYTHONDIR"):
        monkeypatch.setenv(name, str(tmp_path / "jupyter"))
    outputs = executed(folder)
    kinds = [kind for output in outputs for kind in output.get("data", ())]
    assert kinds.count("application/vnd.plotly.v1+json") == 5
    assert kinds.count("text/html") == 2
    shown = [output.get("text") or output.data.get("text/plain", "") for output in outputs]
    assert float(re.findall(r"is ([\d.]+) % from the true one", shown[-1])[0]) < 0.5
    said = head(EXAMPLES / "arm.yaml")
    first, _, held_out, *_ = next(text for text in shown if text.startswith("<Identification")).splitlines()
    error, use = re.findall(r"held-out torque error ([\d.]+) %; (.+)", said["Result"])[0]
    assert use in USES
    assert first.endswith(use)
    assert float(held_out.split()[-2]) == pytest.approx(float(error), rel=0.02)
    assert said["Type"].startswith("python3 dev.py run identify examples/arm.yaml --out ")


def executed(folder: Path) -> list[Any]:
    """What the cells of the notebook show, run in a folder; a warning in one of them is an error."""
    notebook = nbformat.read(EXAMPLES / "walkthrough.ipynb", nbformat.current_nbformat)
    strict, mild = (f"import warnings; warnings.simplefilter('{action}')" for action in ("error", "default"))
    cells = notebook.cells
    notebook.cells = [
        nbformat.v4.new_code_cell(strict),
        *cells,
        nbformat.v4.new_code_cell(mild),
    ]  # the kernel warns, too
    nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [output for cell in cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in outputs if output.get("name") == "stderr"]
    return outputs


def test_the_notebook_is_kept_without_outputs() -> None:
    read = nbformat.read(EXAMPLES / "walkthrough.ipynb", nbformat.current_nbformat)
    nbformat.validate(read)
    assert all(not cell.outputs and cell.execution_count is None for cell in read.cells if cell.cell_type == "code")


def head(path: Path) -> dict[str, str]:
    """The first lines of a configuration: the robot, and what follows each word with a colon."""
    lines = re.match(r"(?:#.*\n)+", path.read_text(encoding="utf-8"))
    assert lines
    text = re.sub(r"(?m)^# ?", "", lines[0])
    robot, *parts = re.split(r"(?m)^(Data|Type|Result): ", text)
    return {"Robot": robot} | dict(zip(parts[::2], parts[1::2], strict=True))


@pytest.mark.parametrize("path", PUBLIC, ids=named)
def test_a_configuration_says_whence_its_recordings_come_and_what_comes_out(path: Path) -> None:
    """Each file that it reads is named, and the folder to put it into; its errors are those measured."""
    said, config = head(path), yaml.safe_load(path.read_text(encoding="utf-8"))
    assert re.search(r"GitHub repository\s+[\w-]+/\w+|nonlinearbenchmark\.org", said["Data"])
    files = re.findall(r"data/[\w./-]+", yaml.safe_dump(config))
    assert files
    for file in files:
        assert f"examples/{Path(file).parent.as_posix()}" in said["Data"]
        assert Path(file).name in said["Data"]
    assert re.fullmatch(rf"python3 dev\.py run identify examples/{path.name} --out [\w-]+-out\n", said["Type"])
    errors = re.findall(r"[\d.]+(?= %)", said["Result"].partition(";")[0])
    lines = (ROOT / "benchmarks" / "choosing_measured.md").read_text(encoding="utf-8").splitlines()
    own = f"(../examples/{path.name})" if path.stem != "emps" else "| spline, S = n | 95.04"
    (measured,) = (line for line in lines if own in line)
    assert errors
    assert set(errors) <= {cell.strip() for cell in measured.split("|")}
    assert said["Result"].partition("; ")[2].startswith(USES)
