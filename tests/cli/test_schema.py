"""``dynident schema``."""

from __future__ import annotations

import json
from pathlib import Path

from dynident.apps.fleets.config import fleet_schema
from dynident.project.result_format import config_schema, result_schema
from tests.cli.commands import run, succeed


def test_it_prints_and_writes_the_schemas(tmp_path: Path) -> None:
    done = succeed("schema")
    assert json.loads(done.output) == config_schema()
    done = succeed("schema", "result", "--out", tmp_path / "result.schema.json")
    assert "result.schema.json" in done.output
    assert json.loads((tmp_path / "result.schema.json").read_text()) == result_schema()
    done = run("schema", "fleet")
    assert json.loads(done.output) == fleet_schema()
    assert run("schema", "robot").exit_code == 2
