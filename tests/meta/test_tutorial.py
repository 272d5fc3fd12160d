"""docs/tutorial.md can be typed along: its commands and scripts run, in order, and print what it shows.

Numbers may differ by 2 % or by one in their last digit. Words are compared without spaces and rules, since tables and
sentences are as wide as the terminal.
"""

import contextlib
import io
import json
import math
import os
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from dynident.identification import calibration
from dynident.project import project
from tests.cli.commands import succeed
from tests.laws.test_numbers import check_numbers, numbers_of

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## (.+)\n((?:(?!## ).*\n)+)", TEXT, re.MULTILINE))
BLOCK = re.compile(r"^```(console|python|diff)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"-?\d+(?:\.\d+)?(?:e-?\d+)?")
OPTIONAL = "mujoco"  # a script needs it, and is skipped without


@dataclass(frozen=True)
class Step:
    """A command of the page, and what it shows of what the command prints."""

    command: str
    shown: str


def steps(body: str) -> list[Step]:
    """The commands of a console block."""
    return [Step(*x.partition("\n")[::2]) for x in re.split(r"^\$ ", body, flags=re.MULTILINE)[1:]]


def typed(command: str) -> str:
    """Run a command where the process is, and return what it prints."""
    program, *words = shlex.split(command)
    if program == "cd":
        os.chdir(*words)
        return ""
    if program == "dynident":
        return succeed(*words).output
    if program == "python":
        (script,) = words
        with contextlib.redirect_stdout(io.StringIO()) as said, patch.object(sys, "path", sys.path[:]):
            runpy.run_path(script)
        sys.modules.pop("model", None)  # of the result
        return said.getvalue()
    ran = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    return ran.stdout


def edit(difference: str) -> None:
    """Add the lines with a plus to robot.yaml; the others must be there."""
    text = Path("robot.yaml").read_text(encoding="utf-8")
    lines = difference.splitlines(keepends=True)
    old, new = ("".join(line[1:] for line in lines if line[0] in kinds) for kinds in (" ", " +"))
    assert text.count(old) == 1
    Path("robot.yaml").write_text(text.replace(old, new), encoding="utf-8")


def absent(section: str) -> bool:
    """Whether a section needs a package that is not there."""
    return f"import {OPTIONAL}\n" in section and find_spec(OPTIONAL) is None


def remembered(compute: Callable[..., Any], cause: Callable[..., str]) -> Callable[..., Any]:
    """A function that computes once for each cause: that a second command finds the same is tested elsewhere."""
    results: dict[str, Any] = {}

    def recalled(*given: Any, **named: Any) -> Any:
        key = cause(*given)
        if key not in results:
            results[key] = compute(*given, **named)
        return results[key]

    return recalled


def configuration(*_: Any) -> str:
    (config,) = Path().glob("**/robot.yaml")
    return config.read_text(encoding="utf-8")


@contextlib.contextmanager
def computed_once() -> Iterator[None]:
    """Fits and findings are made once for each content of robot.yaml; terms, smoothing and time offset are chosen once
    for each recipe, which says nothing of the controller that the page adds."""
    fits = {name: remembered(getattr(project, name), configuration) for name in ("identify", "with_findings")}
    choice = remembered(calibration.choose_in_rounds, lambda model, data, recipe, *_: repr(recipe))
    checks = patch.object(project.Project, "examine", remembered(project.Project.examine, configuration))
    with patch.multiple(project, **fits), patch.object(calibration, "choose_in_rounds", choice), checks:
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tutorial")


@pytest.fixture(scope="module")
def printed(folder: Path) -> dict[str, list[tuple[Step, str]]]:
    """What each command prints, by section, after all of the page was typed; then the demo, whose fit is the last."""
    done: dict[str, list[tuple[Step, str]]] = {}
    with contextlib.chdir(folder), computed_once():
        for title, section in SECTIONS.items():
            done[title] = []
            for kind, body in BLOCK.findall(section):
                if kind == "python":
                    Path(body.partition("\n")[0].removeprefix("# ")).write_text(body, encoding="utf-8")
                elif kind == "diff":
                    edit(body)
                elif not absent(section):
                    done[title] += [(step, typed(step.command)) for step in steps(body)]
        (folder / "demo").mkdir()
        os.chdir(folder / "demo")
        done["demo"] = [(Step("dynident demo", ""), typed("dynident demo"))]
    return done


def words(text: str) -> list[str]:
    return [word for word in text.split() if word.strip("─")]


def alike(shown: str, word: str) -> bool:
    """Whether two words are the same but for the last digits of their numbers."""
    if NUMBER.sub("#", shown) != NUMBER.sub("#", word):
        return False
    for first, second in zip(NUMBER.findall(shown), NUMBER.findall(word), strict=True):
        mantissa, _, power = first.partition("e")
        last = 10.0 ** (int(power or 0) - len(mantissa.partition(".")[2]))
        if not math.isclose(float(first), float(second), rel_tol=0.02, abs_tol=1.001 * last):
            return False
    return True


def assert_printed(step: Step, text: str) -> None:
    """The parts between lines of three dots follow each other in what was printed."""
    rest = words(text)
    parts = [words(part) for part in re.split(r"^\.\.\.$", step.shown, flags=re.MULTILINE)]
    for k, part in enumerate(parts):
        starts = range(1 if k == 0 else len(rest) - len(part) + 1)
        result = (i for i in starts if len(rest) >= i + len(part) and all(map(alike, part, rest[i:])))
        start = next(result, None)
        assert start is not None, f"$ {step.command}\ndoes not print\n{' '.join(part)}\nin\n{text}"
        rest = rest[start + len(part) :]
    assert not rest or not parts[-1], f"$ {step.command}\nprints more than is shown: {' '.join(rest)}"


@pytest.mark.parametrize("title", [title for title, section in SECTIONS.items() if "```console" in section])
def test_the_commands_print_what_is_shown(title: str, printed: dict[str, list[tuple[Step, str]]]) -> None:
    if absent(SECTIONS[title]):
        pytest.skip(f"{OPTIONAL} is not installed")
    assert printed[title]
    for step, text in printed[title]:
        assert_printed(step, text)


def test_the_numbers_stay(printed: dict[str, list[tuple[Step, str]]], folder: Path) -> None:
    """Parameters and errors of the page, to more digits than it shows."""
    check_numbers("demo", numbers_of(json.loads((folder / "my-arm" / "result" / "result.json").read_text())))


def test_the_demo_goes_the_whole_way(printed: dict[str, list[tuple[Step, str]]], folder: Path) -> None:
    ((_, shown),) = printed["demo"]
    commands = [line.split()[2] for line in shown.splitlines() if line.startswith("$ dynident ")]
    assert commands == ["init", "check", "identify"]
    assert all(words in shown for words in ("No errors and no warnings", "tilt about x", "Good for control"))
    arm = folder / "demo" / "arm-out"
    assert {path.name for path in arm.iterdir()} >= {"arm.urdf", "meshes", "robot.yaml", "controller.yaml", "result"}


def test_a_changed_output_would_be_noticed() -> None:
    text = "Verdict: good, 1.74 %\n───\nelbow  0.0123  N m\nNext: more\n"
    for shown in ("Verdict: good, 1.75 %\n...\n", "...\nelbow 0.0122 N m\n...\n", "...\nNext: more\n"):
        assert_printed(Step("made", shown), text)
    for shown in ("Verdict: bad\n...\n", "...\nelbow 0.0133 N m\n...\n", "...\nelbow 0.0123 N m\n", "elbow\n...\n"):
        with pytest.raises(AssertionError):
            assert_printed(Step("made", shown), text)


@pytest.mark.parametrize("picture", sorted((ROOT / "docs").glob("tutorial_*.png")), ids=lambda path: path.name)
def test_the_pictures_are_shown_and_small(picture: Path) -> None:
    assert f"]({picture.name})" in TEXT
    assert picture.stat().st_size < 100_000
