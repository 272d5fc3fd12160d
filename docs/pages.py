"""The pages of the site, a hook of mkdocs: the repository's own, and one for each public module of the package.

The site has the folders of the repository, so that a link works in both. What is public is read from the source:
a module without a leading underscore, and in a folder what its ``__init__`` imports from the package.
"""

from __future__ import annotations

import ast
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from pygments.formatters import HtmlFormatter

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src"
KERNEL = "src/dynident/runtime/kernel/README.md"
SHOWN = ("*.md", "LICENSE", "CITATION.cff", "docs/*.md", "docs/*.png", "docs/*.svg", "docs/*.css", "examples/*", KERNEL)
GUIDES = {
    "Your robot": (
        "experiment",
        "gains",
        "servo",
        "recipes",
        "robots",
        "symptoms",
        "choosing",
        "tuning",
        "export",
        "payload",
        "watching",
        "fleets",
        "comparing",
        "comparing_methods",
        "online",
        "supported",
    ),
    "Methods": ("methods", "estimators", "maximum_likelihood", "article", "notation"),
    "Reference": ("configuration", "cli", "extending", "scaling", "performance", "defaults"),
}  # fmt: skip


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replace the files of docs/ by those of the repository, and add the reference and the colours of code."""
    for file in [file for file in files if file.src_dir == config.docs_dir]:
        files.remove(file)
    for path in (path for pattern in SHOWN for path in sorted(ROOT.glob(pattern)) if path.is_file()):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    for name, path in modules():
        files.append(File.generated(config, uri(name), content=page(name, path)))
    files.append(File.generated(config, "docs/code.css", content=HtmlFormatter().get_style_defs(".highlight")))
    config.nav = navigation()
    return files


def navigation() -> list[Any]:
    """Return the pages as a newcomer needs them; a strict build stops where one of docs/ is missing here."""
    guides = {title: [f"docs/{name}.md" for name in names] for title, names in GUIDES.items()}
    examples = [path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("examples/*.md"))]
    project = [path.name for path in sorted(ROOT.glob("*.md")) if path.name != "README.md"]
    return [
        {"Home": "README.md"},
        {"Tutorial": "docs/tutorial.md"},
        {"Your robot": guides["Your robot"]},
        *({"Examples": path} for path in examples),
        {"Methods": guides["Methods"]},
        {"Reference": [*guides["Reference"], {"API": list(reference())}]},
        {"Project": [*project, {"Kernel": KERNEL}]},
    ]


def reference() -> Iterator[dict[str, Any]]:
    """Yield the package, then its rooms with the pages of their modules, from below: in the order of the method."""
    names = [name for name, _ in modules() if name != "dynident"]
    yield {"dynident": uri("dynident")}
    for room in rooms():
        yield {room: [{name.removeprefix("dynident."): uri(name)} for name in names if name.split(".")[1] == room]}


def rooms() -> list[str]:
    """Return the rooms of the package in the order of the import contract, the lowest first."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    return [room for layer in reversed(settings["contracts"][0]["layers"]) for room in layer.split(" | ")]


def modules() -> Iterator[tuple[str, Path]]:
    """Yield name and file of each public module, folders before what is in them."""
    for path in sorted(SOURCE.rglob("*.py"), key=parts):
        if not any(part.startswith("_") for part in parts(path)):
            yield ".".join(parts(path)), path


def parts(path: Path) -> tuple[str, ...]:
    """Return the dotted name of a file's module, split."""
    names = path.relative_to(SOURCE).with_suffix("").parts
    return names[:-1] if names[-1] == "__init__" else names


def uri(name: str) -> str:
    """Return the page of a module."""
    return f"api/{name}.md"


def page(name: str, path: Path) -> str:
    """Return a module's page: what it defines, and where it is a folder the names that it gathers from its modules."""
    lines = [f"# {name}", "", f"::: {name}"]
    if path.name == "__init__.py":
        tree = ast.parse(path.read_text(encoding="utf-8"))
        own = [node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        lines += ["    options:", f"      members: {[one for one in own if not one.startswith('_')]}"]
        lines += ["", *gathered(tree)]
    return "\n".join(lines) + "\n"


def gathered(tree: ast.Module) -> Iterator[str]:
    """Yield the table of the names that an ``__init__`` imports from the package."""
    public = {name for name, _ in modules()}
    for node in (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module in public):
        for name in (alias.asname or alias.name for alias in node.names):
            yield f"* `{name}`, from [{node.module}]({node.module}.md)"
