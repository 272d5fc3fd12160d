"""The built wheel: all data is in it, and its commands work where there is no checkout."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import sysconfig
import venv
import zipfile
from email.parser import HeaderParser
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from dynident import __version__

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "dynident"
KERNEL = ("kernel.bin", "kernel.bin.sum")  # compiled for the wheel, or for an editable installation
pytestmark = pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling, which builds the wheel, is missing")


def run(*command: object, folder: Path) -> str:
    """What a command prints, run without this environment's variables for Python."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([str(word) for word in command], cwd=folder, env=clean, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder, folder=ROOT)
    (made,) = folder.glob("*.whl")
    return made


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """The folder of the programs of a new environment: the wheel, and this environment's other packages."""
    folder = wheel.parent / "fresh"
    venv.create(folder, with_pip=False)
    paths = {"base": str(folder), "platbase": str(folder)}
    packages, programs = (Path(sysconfig.get_path(name, "venv", paths)) for name in ("purelib", "scripts"))
    pip = [sys.executable, "-m", "pip", "--python", programs / "python", "install", "--no-deps", "--no-index"]
    run(*pip, "--disable-pip-version-check", wheel, folder=folder)
    # sys.path and not site.addsitedir: this environment's editable dynident must not come with its packages
    (packages / "dependencies.pth").write_text("\n".join(path for path in sys.path if path.endswith("-packages")))
    return programs


def test_the_wheel_has_every_file_of_the_package(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        there = set(archive.namelist())
    wanted = {
        path.relative_to(SOURCE.parent).as_posix()
        for path in SOURCE.rglob("*")
        if path.is_file() and path.suffix != ".pyc" and path.name not in KERNEL
    }
    assert {"dynident/py.typed", "dynident/report/templates/page.html"} <= wanted
    assert wanted <= there
    if (ROOT / ".git").exists():
        assert "dynident/commit.txt" in there
    assert {name.partition("/")[0] for name in there} == {"dynident", f"dynident-{__version__}.dist-info"}


def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        text = archive.read(f"dynident-{__version__}.dist-info/METADATA").decode()
        assert f"dynident-{__version__}.dist-info/licenses/LICENSE" in archive.namelist()
    head = HeaderParser().parsestr(text)
    assert head["Version"] == __version__
    assert head["Requires-Python"] == ">=3.11"
    assert head["License-Expression"] == "BSD-3-Clause"


def test_the_installed_package_is_the_wheels(installed: Path, tmp_path: Path) -> None:
    shown = run(installed / "python", "-c", "import dynident; print(dynident.__file__)", folder=tmp_path)
    assert Path(shown.strip()).is_relative_to(installed.parent)
    assert __version__ in run(installed / "python", "-m", "dynident", "--version", folder=tmp_path)


def test_the_installed_command_smooths_a_recording(installed: Path, tmp_path: Path) -> None:
    t = np.arange(200) * 0.01
    rows = np.column_stack([t, np.sin(t) + 1e-4 * np.random.default_rng(0).standard_normal(t.size)])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,q1", comments="")
    run(installed / "dynident", "smooth", "log.csv", "--time", "t", "--out", "out", folder=tmp_path)
    made = {path.name for path in (tmp_path / "out").iterdir()}
    assert any(name.endswith(".html") for name in made), made


def test_the_installed_command_writes_a_report(installed: Path, tmp_path: Path) -> None:
    """The page's templates are read from the wheel."""
    run(installed / "dynident", "reproduce", "--runs", "1", "--methods", "spline", "--out", "out", folder=tmp_path)
    assert "<html" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")


def test_the_installed_demo_goes_the_whole_way(installed: Path, tmp_path: Path) -> None:
    """In a folder whose name has a blank: its data come with the wheel, and the identified robot has its meshes."""
    place = tmp_path / "a first day"
    place.mkdir()
    shown = run(installed / "dynident", "demo", folder=place)
    program = shlex.quote(str(installed / "dynident"))  # which is not on PATH
    commands = [line.split()[2] for line in shown.splitlines() if line.startswith(f"$ {program} ")]
    assert commands == ["init", "check", "identify"]
    assert "1 warning" in shown
    assert "The base is tilted by 1.2" in shown
    assert "Good for control" in shown
    arm = place / "arm-out"
    assert {path.name for path in arm.iterdir()} >= {"arm.urdf", "meshes", "robot.yaml", "controller.yaml", "result"}
    result = arm / "result"
    assert {"result.json", "report.html", "model.py", "parameters.yaml"} <= {path.name for path in result.iterdir()}
    names = re.findall(r'<mesh filename="(.*?)"', (result / "arm.identified.urdf").read_text(encoding="utf-8"))
    assert len(names) == 14
    assert all((result / name).is_file() for name in names)
