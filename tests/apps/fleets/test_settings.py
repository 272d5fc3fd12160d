"""The configuration of a fleet, and what is wrong in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.apps.fleets.config import FleetSettings, RobotChanges, fleet_schema, read_fleet_settings
from dynident.runtime import ConfigError

LOGS = "logs: logs/{robot}/{date}.csv\n"


def read(folder: Path, text: str) -> FleetSettings:
    (folder / "fleet.yaml").write_text(text)
    return read_fleet_settings(folder / "fleet.yaml")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (LOGS, "recipe: is missing"),
        ("recipe: r.yaml\n", "either `logs`.*or `table`"),
        (f"recipe: r.yaml\n{LOGS}table: t.csv\n", "either `logs`.*or `table`"),
        (f"recipe: r.yaml\n{LOGS}tabel: t.csv\n", "unknown key 'tabel'; did you mean 'table'"),
        (f"recipe: [1]\n{LOGS}", "recipe: a file name is expected"),
        (f"recipe: r.yaml\n{LOGS}false_alarms: 2\n", "false_alarms: a share from 0.0001 to 0.5"),
        (f"recipe: r.yaml\n{LOGS}robots: {{ a: {{ torqe: {{}} }} }}\n", "robots.a: unknown key 'torqe'; did you mean"),
        (f"recipe: r.yaml\n{LOGS}robots: {{ a: {{ model: {{ terms: auto }} }} }}\n", "robots.a: .*those of the recipe"),
        (f"recipe: r.yaml\n{LOGS}window: [3, 1]\n", "window"),
        ("- 1\n", "a mapping"),
    ],
)
def test_what_is_wrong_is_named(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read(tmp_path, text)


def test_file_names_start_at_the_folder(tmp_path: Path) -> None:
    assert read(tmp_path, f"recipe: r.yaml\n{LOGS}").recipe == tmp_path / "r.yaml"


def test_the_schema_has_all_keys_and_no_others() -> None:
    schema = fleet_schema()
    assert schema["properties"].keys() == FleetSettings.model_fields.keys()
    assert schema["$defs"]["RobotChanges"]["properties"].keys() == RobotChanges.model_fields.keys()
    assert schema["additionalProperties"] is False
