"""The example configurations of measured robots, whose recordings are not part of the project."""

import json
from functools import cache
from pathlib import Path
from typing import Any

import yaml

from tests.cli.commands import succeed

ROOT = Path(__file__).parents[2]
DATA = ROOT.parent / "shared" / "data"


def located(text: str) -> str:
    """A configuration whose paths are those of the recordings."""
    return text.replace(": data/", f": {DATA}/")


def configured(folder: Path, example: str, changes: str) -> Path:
    settings = yaml.safe_load((ROOT / "examples" / f"{example}.yaml").read_text()) | yaml.safe_load(changes)
    path = folder / f"{example}.yaml"
    path.write_text(located(yaml.safe_dump(settings)))
    return path


@cache
def identify(folder: Path, example: str) -> dict[str, Any]:
    """What the command finds with an example as it is."""
    path = configured(folder, example, "{}")
    succeed("identify", path, "--out", folder / example)
    return json.loads((folder / example / "result.json").read_text())
