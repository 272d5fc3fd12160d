"""Files that are written for others stay: exports, drafts of configurations, trajectories, schemas, and help."""

import json
import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dynident.apps.fleets.config import fleet_schema
from dynident.cli import main
from dynident.project.export import export
from dynident.project.result_format import config_schema, result_schema
from dynident.runtime.families import EXPORTERS
from tests.kept import check_kept
from tests.project.export.arms import STATES, arm
from tests.robots import ARM_MJCF

ROOT = Path(__file__).parents[2]


def test_exported_files_stay() -> None:
    """All digits but the first six are left out: they are those of a solver."""
    lines = list[str]()
    for identified in (arm(), arm(ARM_MJCF, width=0.05)):
        for name in EXPORTERS.table:
            made = export(identified, EXPORTERS.get(name, "format")(), STATES)
            written = (*made.written.notes, made.written.text) if made.written else ()
            lines += [f"{name}: {made.refusal}", *written]
    check_kept("exports", re.sub(r"(\d\.\d{6})\d+", r"\1", "\n".join(lines)))


@pytest.mark.parametrize(
    ("name", "make"), [("config", config_schema), ("result", result_schema), ("fleet", fleet_schema)]
)
def test_schemas_stay(name: str, make: Any) -> None:
    """Names of keys, their defaults and their limits: what a file of today says, it says tomorrow."""
    check_kept(f"schema_{name}", "\n".join(schema_lines(make())))


def schema_lines(node: Any, path: str = "") -> Iterator[str]:
    """Yield what a schema says of each place, without descriptions."""
    if isinstance(node, dict):
        plain = {key: value for key, value in node.items() if not isinstance(value, dict | list)}
        plain = {key: value for key, value in plain.items() if key not in ("description", "title")}
        if plain:
            yield f"{path}: {json.dumps(plain)}"
        for key, value in node.items():
            if isinstance(value, dict | list):
                yield from schema_lines(value, f"{path}/{key}")
    elif all(not isinstance(value, dict | list) for value in node):
        yield f"{path}: {json.dumps(node)}"
    else:
        for k, value in enumerate(node):
            yield from schema_lines(value, f"{path}/{k}")


def test_the_reference_of_commands_has_each_option() -> None:
    made = runpy.run_path(str(ROOT / "docs" / "commands.py"))["reference"]()
    check_kept("commands", made)
    for name, command in main.commands.items():
        assert f"## dynident {name}\n" in made
        for parameter in command.params:
            assert all(option in made for option in parameter.opts if option.startswith("--"))
