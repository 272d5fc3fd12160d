"""What the documentation says is so: its code runs, its commands, links, keys and names exist."""

import ast
import re
import runpy
import shlex
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pytest
import yaml

from dynident._version import __version__
from dynident.cli import main

ROOT = Path(__file__).parents[2]
SOURCE = ROOT / "src" / "dynident"
PAGES = sorted(path for folder in (ROOT, ROOT / "docs", ROOT / "examples") for path in folder.glob("*.md"))
BLOCK = re.compile(r"^(?P<mark><!-- not run -->\n)?```(?P<kind>\w*)\n(?P<body>.*?)^```$", re.MULTILINE | re.DOTALL)
TYPED = ROOT / "docs" / "tutorial.md"  # whose scripts are run in order by test_tutorial.py
TASKS = runpy.run_path(str(ROOT / "dev.py"))["TASKS"]
NUMBER = re.compile(r"-?\d+\.?\d*(?:e-?\d+)?")


def title(page: Path) -> str:
    return str(page.relative_to(ROOT))


def blocks(page: Path) -> list[re.Match[str]]:
    return list(BLOCK.finditer(page.read_text(encoding="utf-8")))


def prose(page: Path) -> str:
    return BLOCK.sub("", page.read_text(encoding="utf-8"))


def python_blocks() -> Iterator[Any]:
    """Each Python block with the text block that may follow it: what it prints."""
    for page in (page for page in PAGES if page != TYPED):
        result = blocks(page)
        for k, block in enumerate(result):
            if block["kind"] == "python" and not block["mark"]:
                after = result[k + 1] if k + 1 < len(result) else None
                shown = after["body"] if after and after["kind"] == "text" and after.start() - block.end() < 3 else None
                line = block.string.count("\n", 0, block.start()) + 1
                yield pytest.param(block["body"], shown, id=f"{title(page)}:{line}")


def commands(page: Path) -> list[str]:
    """The commands shown in shell blocks and in the text of a page."""
    lines = [line for block in blocks(page) if block["kind"] == "sh" for line in block["body"].splitlines()]
    lines += re.findall(r"`((?:dynident|python3 dev\.py) [^`]+)`", prose(page))
    return [line.split("  #")[0].strip() for line in lines if "[OPTIONS]" not in line]


@pytest.mark.parametrize(("code", "shown"), list(python_blocks()))
def test_python_blocks_run_and_print_what_is_shown(
    code: str, shown: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    module = ModuleType("documentation")  # a real one: classes are pickled by its name
    monkeypatch.setitem(sys.modules, module.__name__, module)
    exec(compile(code, "documentation", "exec"), vars(module))
    printed = capsys.readouterr().out
    assert printed
    if shown is not None:
        assert NUMBER.sub("#", printed) == NUMBER.sub("#", shown)
        numbers = [[float(word) for word in NUMBER.findall(text)] for text in (printed, shown)]
        assert numbers[0] == pytest.approx(numbers[1], rel=1e-3, abs=2e-5)


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_shell_commands_exist(page: Path) -> None:
    for line in commands(page):
        assert_exists(line)


def test_an_unknown_option_would_be_noticed() -> None:
    with pytest.raises(click.NoSuchOption):
        assert_exists("dynident reproduce --run 3 --nonsense")


def assert_exists(line: str) -> None:
    """A command of this project as it is typed, with options that it has."""
    program, *words = shlex.split(line)
    if program == "python3":
        assert words[0] == "dev.py"
        assert words[1] in TASKS
        if words[1] != "run" or words[2:] in ([], ["--help"]):
            return
        words = words[2:]
    elif program == ".venv/bin/python":
        assert (ROOT / words[0]).is_file()
        return
    elif program in ("pip", "pipx"):
        assert_installs(*words)
        return
    elif program == "source":
        assert words == [".venv/bin/activate"]
        return
    else:
        assert program == "dynident"
    command = main.commands.get(words[0])
    assert command is not None, line
    if "--help" not in words and len(words) > 1:
        parent = click.Context(main, **main.context_settings)
        command.make_context(words[0], words[1:], parent=parent)  # raises for an unknown option or a missing value


def assert_installs(command: str, *targets: str) -> None:
    """The clone with extras that there are, or packages that pyproject.toml names: dynident is on no index."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    reference = {re.split(r"[<>=; ]", x)[0] for wanted in (project["dependencies"], *extras.values()) for x in wanted}
    assert command == "install"
    for target in targets:
        own = re.fullmatch(r"\.(?:\[(.+)\])?", target)
        assert set((own[1] or "hdf5").split(",")) <= set(extras) if own else target in reference, target


def test_no_page_and_no_message_installs_dynident_from_an_index() -> None:
    for path in (*PAGES, *SOURCE.rglob("*.py")):
        matches = re.findall(r"install \S*dynident\S*", path.read_text(encoding="utf-8"))
        assert matches == [], path


def test_the_pages_show_the_main_commands() -> None:
    shown = set(commands(ROOT / "README.md"))
    assert len((ROOT / "README.md").read_text(encoding="utf-8").split()) <= 900
    assert {"python3 dev.py demo", "python3 dev.py test", "python3 dev.py run --help"} <= shown
    assert any(line.startswith("dynident identify") for line in shown)


def test_the_figures_of_the_readme_are_those_of_the_defaults() -> None:
    measured = (ROOT / "docs" / "defaults.md").read_text(encoding="utf-8")
    rows = [row for row in table(ROOT / "README.md", "Accuracy") if row[0]]
    for robot, *_, error, noise in rows:
        names = ("EMPS", "LWR4", "Panda, fit", "TX40", "Double")
        name = next(word for word in names if word[:5].lower() in robot.lower())
        (line,) = re.findall(rf"^\| ({name}.*, defaults .*) \|$", measured, re.MULTILINE)
        cells = line.split(" | ")
        assert (cells[1], cells[8]) == (error, noise), robot
    assert len(rows) == 5


def anchors(page: Path) -> set[str]:
    """The targets that a page's headings make."""
    headings = re.findall(r"^#+ (.+)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_links_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if target.startswith(("http://", "https://")):
            continue
        name, _, anchor = target.partition("#")
        file = page.parent / name if name else page
        assert file.exists(), f"{title(page)}: {target}"
        assert not anchor or anchor in anchors(file), f"{title(page)}: {target}"


def test_every_page_and_picture_is_linked() -> None:
    def linked(pages: list[Path]) -> set[Path]:
        return {
            (page.parent / target.partition("#")[0]).resolve()
            for page in pages
            for target in re.findall(r"\]\(([^)\s]+)\)", prose(page))
        }

    first = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", ROOT / "docs" / "methods.md"]
    assert set((ROOT / "docs").glob("*.md")) <= linked(first)
    assert set((ROOT / "docs").glob("*.png")) <= linked(PAGES)
    assert (ROOT / "docs" / "report.png").stat().st_size < 200_000


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_files_named_in_the_text_exist(page: Path) -> None:
    """Paths in backticks start at the root, or in the package."""
    for name in re.findall(r"`((?:[\w.-]+/)+[\w-]+\.(?:py|md|yaml|toml))`", prose(page)):
        assert name.startswith("path/to/") or (ROOT / name).exists() or (SOURCE / name).exists(), name


@pytest.mark.parametrize("page", PAGES, ids=title)
def test_dotted_names_exist(page: Path) -> None:
    """`dynident.x.y` is a module or a name in one; `Class.attribute` belongs to a public class."""
    text = prose(page)
    for name in re.findall(r"`(dynident(?:\.\w+)+)`", text):
        module, _, attribute = name.rpartition(".")
        result = hasattr(import_module(module), attribute) if module else False
        assert result or import_module(name), name
    for owner, attribute in re.findall(r"`([A-Z]\w+)\.([a-z]\w*)`", text):
        assert attribute in members(owner), f"{title(page)}: {owner}.{attribute}"


@cache
def sources() -> tuple[str, ...]:
    return tuple(path.read_text("utf-8") for path in SOURCE.rglob("*.py"))


@cache
def members(owner: str) -> set[str]:
    """The methods and annotated fields of all classes of the package that have a name."""
    texts = [text for text in sources() if re.search(rf"^\s*class {owner}\b", text, re.MULTILINE)]
    classes = (node for text in texts for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ClassDef))
    children = [child for node in classes if node.name == owner for child in ast.walk(node)]
    methods = {child.name for child in children if isinstance(child, ast.FunctionDef)}
    fields = (child.target for child in children if isinstance(child, ast.AnnAssign))
    return methods | {target.id for target in fields if isinstance(target, ast.Name)}


ARCHITECTURE = ROOT / "ARCHITECTURE.md"


def table(page: Path, heading: str) -> list[list[str]]:
    """The cells of the table below a heading, without its head."""
    part = re.split(r"^## ", page.read_text(encoding="utf-8").partition(f"## {heading}\n")[2], flags=re.MULTILINE)[0]
    rows = [line.strip("|").split("|") for line in part.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row] for row in rows[2:]]


def test_architecture_is_short_and_names_every_room_and_application() -> None:
    text = ARCHITECTURE.read_text(encoding="utf-8")
    assert len(text.split()) <= 2500
    contract = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    layers = contract["contracts"][0]["layers"]
    assert layers in [block["body"].splitlines() for block in blocks(ARCHITECTURE)]
    rooms = [room for layer in reversed(layers) for room in layer.split(" | ")]
    told = {room.strip("`"): line for room, line in table(ARCHITECTURE, "The rooms, from below")}
    folders = {path.parent.name for path in SOURCE.glob("*/__init__.py")}
    assert set(told) == set(rooms) == folders
    order = list(told)
    for layer in reversed(layers):
        assert {order.pop(0) for _ in layer.split(" | ")} == set(layer.split(" | "))
    apps = {path.stem for path in (SOURCE / "apps").iterdir() if path.stem[0].isalpha()}
    assert set(re.findall(r"`(\w+)`", told["apps"])) == apps


def test_architecture_answers_where_things_are() -> None:
    """Each name of the map is defined in a file of its row."""
    rows = table(ARCHITECTURE, "Where is what")
    assert len(rows) >= 20
    for question, files, names in rows:
        places = [SOURCE / place for place in re.findall(r"`([^`]+)`", files)]
        assert all(place.exists() for place in places), question
        trees = [ast.parse(place.read_text(encoding="utf-8")) for place in places if place.is_file()]
        defined = {name for tree in trees for node in tree.body for name in defined_names(node)}
        missing = set(re.findall(r"`(\w+)`", names)) - defined
        assert trees, question
        assert names, question
        assert not missing, f"{question}: {files} {missing}"


def defined_names(node: ast.stmt) -> Iterator[str]:
    """The names that a statement of a module defines."""
    if isinstance(node, ast.FunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        yield from (target.id for target in targets if isinstance(target, ast.Name))


def test_citation_names_this_version() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == __version__
    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    for work in (citation, *citation["references"]):
        assert {"title", "authors", "type"} <= work.keys()
