"""The published schemas: what the library reads and writes keeps to them, and mistakes do not."""

import re
from functools import cache
from pathlib import Path
from typing import Any

import pytest

from dynident.apps.fleets.config import fleet_schema
from dynident.files.yaml_text import load_yaml
from dynident.project.result_format import SCHEMAS
from tests.cli.commands import settings
from tests.project.schemas import wrong

ROOT = Path(__file__).parents[2]


@cache
def published(kind: str) -> dict[str, Any]:
    return fleet_schema() if kind == "fleet" else SCHEMAS[kind]()


def as_editors_read(text: str) -> Any:
    """Read YAML 1.2, in which 2e-5 is a number."""

    def numbers(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: numbers(item) for key, item in value.items()}
        if isinstance(value, list):
            return list(map(numbers, value))
        return float(value) if isinstance(value, str) and re.fullmatch(r"-?[\d.]+e-?\d+", value) else value

    return numbers(load_yaml(text, "text"))


CONFIGURATIONS = [
    *((path.name, path.read_text()) for path in sorted((ROOT / "examples").glob("*.yaml")) if path.stem != "fleet"),
    *(
        (f"{path.name} {k}", text)
        for path in [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
        for k, text in enumerate(re.findall(r"```yaml\n(.*?)```", path.read_text(), re.DOTALL))
        if "\ntrain:" in text or text.startswith("recipe:")
    ),
]


@pytest.mark.parametrize("text", [text for _, text in CONFIGURATIONS], ids=[name for name, _ in CONFIGURATIONS])
def test_configurations_of_the_documentation_keep_to_the_schema(text: str) -> None:
    given = as_editors_read(text)
    schema = published("fleet") if "recipe" in given else published("config")
    assert wrong(schema, given) == []


@pytest.mark.parametrize(
    "changes",
    [
        {"modle": "x"},
        {"train": "log.csv"},
        {"train": [{"window": [0, 1]}]},
        {"train": [{"file": "log.csv", "window": [0]}]},
        {"smoother": {"kind": "splin"}},
        {"smoother": {"kind": "spline", "ends": -1}},
        {"estimator": {"kind": "least_squares", "weight": "equal"}},
        {"gaps": "leave"},
        {"filter": {"decimate": 0}},
        {"position": {"slider": {"column": "pos"}}},
        {"model": {"file": "arm.urdf", "terms": ["stiction"]}},
        {"model": {"file": "arm.urdf", "terms": "viscous"}},
    ],
    ids=str,
)
def test_mistakes_break_the_schema(changes: dict[str, Any]) -> None:
    schema = published("config")
    assert wrong(schema, settings()) == []
    assert wrong(schema, settings(**changes)) != []
