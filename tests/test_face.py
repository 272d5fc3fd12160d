"""The names of ``import dynident``: lazy, complete, seen by type checkers, and what they are."""

from __future__ import annotations

import ast
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import dynident as dy

SOURCE = Path(dy.__file__)
MADE = {"Estimate", "Identification", "Motion", "errors"}  # by other calls: they have no example of their own


def seen_by_type_checkers() -> dict[str, str]:
    """The names of the block that only type checkers run, with their modules."""
    (block,) = (node for node in ast.parse(SOURCE.read_text(encoding="utf-8")).body if isinstance(node, ast.If))
    found = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    assert len(found) == len(block.body)
    return {name.name: str(node.module) for node in found for name in node.names}


def test_the_table_the_list_and_the_type_block_agree() -> None:
    assert seen_by_type_checkers() == dy._MODULES
    assert list(dy._MODULES) == dy.__all__ == sorted(dy.__all__)


@pytest.mark.parametrize("name", dy.__all__)
def test_each_name_is_that_of_its_module(name: str) -> None:
    module = dy._MODULES[name]
    found = import_module("dynident.errors") if name == "errors" else getattr(import_module(module), name)
    assert getattr(dy, name) is found
    assert name in dir(dy)
    assert name in MADE or ">>> " in (found.__doc__ or "")


def test_no_name_is_that_of_a_package() -> None:
    """Importing the package would replace it."""
    folders = {path.stem for path in SOURCE.parent.iterdir()}
    assert set(dy.__all__) & folders == {"errors"}


def test_an_unknown_name_is_no_attribute() -> None:
    with pytest.raises(AttributeError, match="no attribute 'identfy'"):
        _ = dy.identfy  # type: ignore[attr-defined]


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
