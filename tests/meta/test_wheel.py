"""The built wheel: all data is in it, and its commands work where there is no checkout."""

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

import pytest

from dynident._version import __version__
from dynident.runtime.kernel import LIBRARY, kernel
from dynident.runtime.kernel.build import compilers

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "dynident"
KERNEL = ("kernel.bin", "kernel.bin.sum")  # compiled for the wheel, or for an editable installation
pytestmark = pytest.mark.skipif(find_spec("hatchling") is None, reason="hatchling, which builds the wheel, is missing")


def run(*command: object, folder: Path, **variables: str) -> str:
    """What a command prints, run without this environment's variables for Python, and with some of its own."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "DYNIDENT"))}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=folder, env=clean | variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel. Its compiler copies the kernel that is here (``test_build`` compiles), or else optimises less."""
    folder = tmp_path_factory.mktemp("wheel")
    if os.name == "nt" or not compilers():
        return built(folder)[0]
    quick = folder / "quick"
    compiler = f'exec {shlex.join(compilers()[0])} "$@" -O1'
    copy = f'while [ "$1" != -o ]; do shift; done; exec cp {shlex.quote(str(LIBRARY))} "$2"'
    quick.write_text(f"#!/bin/sh\n{copy if kernel().level else compiler}\n")
    quick.chmod(0o755)
    return built(folder, CC=str(quick))[0]


def built(folder: Path, **variables: str) -> tuple[Path, str]:
    """The wheel built into a folder, and what was said of it."""
    command = (sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", folder)
    said = run(*command, folder=ROOT, **variables)
    (made,) = folder.glob("*.whl")
    return made, said


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
    assert wanted | {"dynident/report/templates/plotly.min.js"} <= there
    if (ROOT / ".git").exists():
        assert "dynident/commit.txt" in there
    assert {name.partition("/")[0] for name in there} == {"dynident", f"dynident-{__version__}.dist-info"}


@pytest.mark.skipif(not compilers(), reason="there is no C compiler")
def test_the_wheel_has_the_kernel_of_this_system(wheel: Path, installed: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        assert {f"dynident/runtime/kernel/{name}" for name in KERNEL} <= set(archive.namelist())
        assert "Root-Is-Purelib: false" in archive.read(f"dynident-{__version__}.dist-info/WHEEL").decode()
    assert re.fullmatch(rf"dynident-{__version__}-py3-none-(linux|macosx|win)\w*\.whl", wheel.name)
    shown = run(installed / "python", "-m", "dynident", "--version", folder=tmp_path)
    assert re.search(r"^kernel: (?!NumPy)\w+ \(", shown, re.MULTILINE)


@pytest.mark.parametrize(
    ("variables", "said"),
    [
        ({"DYNIDENT_KERNEL": "off"}, "DYNIDENT_KERNEL=off"),
        ({"PATH": "", "CC": "no-such-compiler --fast"}, "no-such-compiler --fast: "),
    ],
)
def test_without_a_compiler_the_wheel_is_for_all_systems(
    variables: dict[str, str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if "PATH" in variables and sys.platform == "win32":
        pytest.skip("Windows looks for programs elsewhere, too")
    made, shown = built(tmp_path, **variables)
    assert made.name == f"dynident-{__version__}-py3-none-any.whl"
    assert "The kernel is not compiled" in shown
    assert said in shown
    with zipfile.ZipFile(made) as archive:
        assert [name for name in archive.namelist() if "kernel.bin" in name] == []


def test_the_wheel_says_what_it_is(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        text = archive.read(f"dynident-{__version__}.dist-info/METADATA").decode()
        assert f"dynident-{__version__}.dist-info/licenses/LICENSE" in archive.namelist()
    head = HeaderParser().parsestr(text)
    assert head["Version"] == __version__
    assert head["Requires-Python"] == ">=3.11"
    assert head["License-Expression"] == "BSD-3-Clause"
    assert str(head.get_payload()).startswith("# dynident")


def test_the_installed_package_is_the_wheels(installed: Path, tmp_path: Path) -> None:
    shown = run(installed / "python", "-c", "import dynident; print(dynident.__file__)", folder=tmp_path)
    assert Path(shown.strip()).is_relative_to(installed.parent)


def test_the_installed_commands_go_the_whole_way(installed: Path, tmp_path: Path) -> None:
    """In a folder whose name has a blank: the demo's data and the templates of the report come with the wheel, and the
    identified robot has its meshes. Little is left to choose; ``test_tutorial`` runs the whole demo."""
    place = tmp_path / "a first day"
    place.mkdir()
    run(installed / "dynident", "demo", "--files", folder=place)
    arm = place / "arm-out"
    shown = run(installed / "dynident", "init", "arm.urdf", "monday.parquet", "-o", "robot.yaml", folder=arm)
    assert shlex.quote(str(installed / "dynident")) in shown  # which is not on PATH
    quick = (arm / "robot.yaml").read_text().replace("terms: auto", "base_tilt: none\n  terms: [viscous, coulomb]")
    quick = re.sub(r"window: \[0.*?\]", "window: [0, 5]", quick)
    (arm / "robot.yaml").write_text(f"{quick}time_offset: 0\nsmoother: {{kind: spline}}\n")
    assert "Verdict: " in run(installed / "dynident", "identify", "robot.yaml", "--out", "result", folder=arm)
    result = arm / "result"
    assert {"result.json", "report.html", "model.py", "parameters.yaml"} <= {path.name for path in result.iterdir()}
    assert "<html" in (result / "report.html").read_text(encoding="utf-8")
    names = re.findall(r'<mesh filename="(.*?)"', (result / "arm.identified.urdf").read_text(encoding="utf-8"))
    assert len(names) == 14
    assert all((result / name).is_file() for name in names)
