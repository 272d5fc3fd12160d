"""The pages of the site, a hook of mkdocs: the repository's own, the commands, and the API: the names of ``dynident``.

The site has the folders of the repository, so that a link works in both.
"""

from __future__ import annotations

import ast
import json
import runpy
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pygments.formatters import HtmlFormatter

ROOT = Path(__file__).parents[1]
# in the worker of the search: a word of a title counts more, and a page has all words, where there is one
SEARCH = {
    "this.field('title')": "this.field('title', { boost: 3 })",
    "index.search(query)": "search_all(query)",
}
SEARCH_ALL = """
function search_all (query) {
  var words = query.toLowerCase().split(/\\s+/).filter(lunr.stopWordFilter);
  var found = index.search(words.map(function (word) { return '+' + word; }).join(' '));
  return found.length ? found : index.search(query);
}
"""
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
    "Python": ("python", "spline", "extending"),
    "Methods": (
        "methods",
        "methods_smoothing",
        "methods_choices",
        "methods_model",
        "methods_excitation",
        "methods_estimation",
        "methods_errors",
        "methods_verdict",
        "methods_fleets",
        "maximum_likelihood",
        "estimators",
        "article",
        "notation",
    ),
    "Reference": ("configuration", "cli", "scaling", "performance", "defaults"),
}  # fmt: skip
# the names of `dynident`, each on one page
API = {
    "Identification": ("identify", "check", "run", "load", "Identification", "Recipe", "validate"),
    "Robots and logs": ("read_robot", "read_log", "Log", "Motion"),
    "Models": ("Model", "Joint", "RigidBodies", "Lagrangian", "two_link_arm"),
    "Friction and motors": ("Coulomb", "Viscous", "Offset", "RotorInertia", "CoupledMotor"),
    "Smoothers": (
        "smooth",
        "Spline",
        "KalmanSmoother",
        "SavitzkyGolay",
        "FourierSeries",
        "Butterworth",
        "Difference",
        "ParallelFilter",
    ),
    "Linear estimators": (
        "Estimate",
        "LeastSquares",
        "WeightedLeastSquares",
        "GeneralisedLeastSquares",
        "PhysicallyConsistent",
        "Ridge",
        "RobustLeastSquares",
        "TotalLeastSquares",
        "InstrumentalVariables",
    ),
    "Simulating estimators": ("OutputError", "Didim", "MaximumLikelihood", "AugmentedKalman"),
    "Accuracy": ("accuracy_bound", "cramer_rao_bound", "bootstrap"),
    "Applications": ("excite", "find_payload", "identify_servos", "compare", "fleet", "export_model"),
    "Simulation": ("simulate", "record"),
    "Errors": ("errors",),
}  # fmt: skip


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Replace the files of docs/ by those of the repository, and add the API and the colours of code."""
    for file in [file for file in files if file.src_dir == config.docs_dir]:
        files.remove(file)
    for path in (path for pattern in SHOWN for path in sorted(ROOT.glob(pattern)) if path.is_file()):
        files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    places = name_places()
    if unlisted := set(places) ^ {name for names in API.values() for name in names}:
        raise PluginError(f"docs/pages.py: the API has no page, or a page too many, for {', '.join(sorted(unlisted))}")
    for title, names in API.items():
        text = "\n\n".join(f"::: {places[name]}" for name in names)
        files.append(File.generated(config, api_page(title), content=f"# {title}\n\n{text}\n"))
    commands = runpy.run_path(str(Path(__file__).with_name("commands.py")))["reference"]()
    files.append(File.generated(config, "docs/cli.md", content=commands))
    light, dark = (HtmlFormatter(style=style).get_style_defs(".highlight") for style in ("default", "monokai"))
    colours = f"{light}\n@media (prefers-color-scheme: dark) {{\n{dark}\n}}\n"
    files.append(File.generated(config, "docs/code.css", content=colours))
    config.nav = navigation()
    return files


def on_post_build(config: MkDocsConfig) -> None:
    """Leave the pages of the project out of the search, and let it look for all words of a query."""
    folder = Path(config.site_dir, "search")
    worker, path = folder / "worker.js", folder / "search_index.json"
    code = worker.read_text(encoding="utf-8")
    for old, new in SEARCH.items():
        if code.count(old) != 1:
            raise PluginError(f"docs/pages.py: {worker} has no {old}")
        code = code.replace(old, new)
    worker.write_text(code + SEARCH_ALL, encoding="utf-8")
    index = json.loads(path.read_text(encoding="utf-8"))
    project = {f"{page.stem}.html" for page in ROOT.glob("*.md")} | {KERNEL.replace("README.md", "index.html")}
    index["docs"] = [doc for doc in index["docs"] if doc["location"].partition("#")[0] not in project]
    for doc in index["docs"]:
        if doc["location"].startswith("api/") and "#" in doc["location"]:
            doc["title"] = f"dy.{doc['title']}"  # so that a guide with this word in its title comes first
    path.write_text(json.dumps(index), encoding="utf-8")


def navigation() -> list[Any]:
    """Return the pages as a newcomer needs them; a strict build stops where one of docs/ is missing here."""
    guides = {title: [f"docs/{name}.md" for name in names] for title, names in GUIDES.items()}
    examples = [path.relative_to(ROOT).as_posix() for path in sorted(ROOT.glob("examples/*.md"))]
    project = [path.name for path in sorted(ROOT.glob("*.md")) if path.name != "README.md"]
    api = [{title: api_page(title)} for title in API]
    return [
        {"Home": "README.md"},
        {"Tutorial": "docs/tutorial.md"},
        {"Your robot": guides["Your robot"]},
        *({"Examples": path} for path in examples),
        {"Python": [*guides["Python"], {"API": api}]},
        {"Methods": guides["Methods"]},
        {"Reference": guides["Reference"]},
        {"Project": [*project, {"Kernel": KERNEL}]},
    ]


def api_page(title: str) -> str:
    """Return the page of a topic of the API."""
    return f"api/{title.lower().replace(' ', '_')}.md"


def name_places() -> dict[str, str]:
    """Return where each name of ``dynident`` is defined, read from its source."""
    tree = ast.parse((ROOT / "src" / "dynident" / "__init__.py").read_text(encoding="utf-8"))
    table = next(
        node for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_NAMES"
    )
    modules: dict[str, str] = ast.literal_eval(table.value)
    return {name: place_of(name, module) for module, names in modules.items() for name in names.split()}


def place_of(name: str, module: str) -> str:
    """Return the dotted place of a name, in its own file where that is called like it."""
    place = "dynident.runtime.errors" if name == "errors" else f"{module}.{name}"
    return f"{place}.{name}" if (ROOT / "src" / f"{module.replace('.', '/')}/{name}.py").exists() else place
