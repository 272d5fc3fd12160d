"""The names of ``import dynident``: lazy, complete, seen by type checkers, and what they are."""

import ast
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dynident as dy
from tests.cli.commands import succeed
from tests.project.test_shortcuts import two_link_file

SOURCE = Path(dy.__file__)
MADE = {"Estimate", "Identification", "Motion", "errors"}  # by other calls: they have no example of their own


def seen_by_type_checkers() -> dict[str, str]:
    """The names of the block that only type checkers run, with their modules."""
    (block,) = (node for node in ast.parse(SOURCE.read_text(encoding="utf-8")).body if isinstance(node, ast.If))
    result = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert len(result) == len(block.body)
    return {str(name.asname): str(node.module) for node in result for name in node.names}


def test_the_table_and_the_type_block_agree() -> None:
    assert seen_by_type_checkers() == dy._MODULES
    assert list(dy._MODULES) == dy.__all__ == sorted(dy.__all__)


@pytest.mark.parametrize("name", dy.__all__)
def test_each_name_is_that_of_its_module(name: str) -> None:
    module = dy._MODULES[name]
    result = import_module("dynident.runtime") if name == "errors" else getattr(import_module(module), name)
    assert getattr(dy, name) is result
    assert name in dir(dy)
    assert name in MADE or ">>> " in (result.__doc__ or "")


def test_no_name_is_that_of_a_package() -> None:
    """Importing the package would replace it. Only what a user calls is listed."""
    folders = {path.stem for path in SOURCE.parent.iterdir()}
    assert not set(dy.__all__) & folders
    assert [name for name in dir(dy) if not name.startswith("__")] == dy.__all__


def test_python_suggests_the_name_that_is_meant() -> None:
    done = subprocess.run([sys.executable, "-c", "import dynident as dy; dy.identfy"], capture_output=True, text=True)
    assert "Did you mean: 'identify'?" in done.stderr


def test_the_import_loads_nothing_heavy_and_is_fast() -> None:
    code = (
        "import sys, time\n"
        "start = time.process_time()\n"
        "import dynident\n"
        "spent = time.process_time() - start\n"
        "loaded = {name.partition('.')[0] for name in sys.modules}\n"
        "print(spent, *loaded & {'numpy', 'scipy', 'sympy', 'polars', 'plotly', 'pydantic', 'click', 'yaml'})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    spent, *heavy = done.stdout.split()
    assert float(spent) < 0.1
    assert heavy == []


def first_block(page: str, start: str) -> str:
    """The code of a page after the first line that starts so."""
    text = (SOURCE.parents[2] / page).read_text(encoding="utf-8")
    return re.split(r"^```", text.partition(start)[2].partition("\n")[2], maxsplit=1, flags=re.MULTILINE)[0]


TRUTH = {"Ia": 0.05, "Fv": 0.8, "Fc": 0.5, "of": 0.1}  # by the first two letters of their names


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a robot file, and recordings in ms, degrees and mA."""
    robot, t, rng = dy.read_robot(two_link_file(tmp_path)), np.arange(2001) * 0.005, np.random.default_rng(0)
    theta = [TRUTH[x.name[:2]] if x.value is None else x.value for x in robot.parameters]
    for name, rate in (("monday", 1.0), ("tuesday", 1.2), ("wednesday", 0.9)):
        w, size = rate * np.array([[1.0, 2.3, 3.7], [1.3, 2.9, 4.1]]), np.array([[0.8, 0.4, 0.2], [0.9, 0.4, 0.3]])
        angle = w * t[:, None, None]
        q, dq, ddq = ((size * x).sum(axis=2) for x in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
        current = (robot.torque(q, dq, ddq, theta) + 0.02 * rng.standard_normal(q.shape)) / [0.0105, 0.0062]
        table = np.column_stack([1e3 * t, np.degrees(q + 2e-5 * rng.standard_normal(q.shape)), current])
        np.savetxt(tmp_path / f"{name}.csv", table, delimiter=",", header="time_ms,pos1,pos2,cur1,cur2", comments="")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_block_of_the_readme_runs_on_such_files(folder: Path) -> None:
    namespace: dict[str, Any] = {}
    exec(compile(first_block("README.md", "<!-- not run -->\n```python"), "README", "exec"), namespace)
    assert namespace["identification"].validations[1].errors.relative_error < 2
    (folder / "arm.urdf").unlink()  # the result holds its text
    again = dy.load("result.json")
    np.testing.assert_array_equal(again.estimate.value, namespace["identification"].estimate.value)
    assert again.predict(namespace["logs"]["wednesday"]).errors.relative_error < 2


def test_the_first_configuration_of_the_guide_identifies_the_arm(folder: Path) -> None:
    (folder / "robot.yaml").write_text(first_block("docs/robots.md", "```yaml"), encoding="utf-8")
    succeed("identify", "robot.yaml", "--out", "out")
    result = dy.load("out/result.json")
    assert result.validations[1].errors.relative_error < 1.0
    values = dict(zip(result.model.names, result.estimate.value, strict=True))
    friction = {name: value for name, value in values.items() if name[:2] in TRUTH and not name.startswith("Ia")}
    assert friction == pytest.approx({name: TRUTH[name[:2]] for name in friction}, abs=0.02)
    assert values["Ia_elbow"] + values["fore.Iyy"] == pytest.approx(0.05 + 0.02 + 0.1**2, rel=0.02)
