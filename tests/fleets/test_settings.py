"""The configuration of a fleet, and what is wrong in it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.errors import ConfigError
from dynident.fleets.settings import read_fleet_settings

LOGS = "logs: logs/{robot}/{date}.csv\n"


def read(folder: Path, text: str) -> object:
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
    found = read_fleet_settings_of(tmp_path)
    assert found == tmp_path / "r.yaml"


def read_fleet_settings_of(folder: Path) -> Path:
    (folder / "fleet.yaml").write_text(f"recipe: r.yaml\n{LOGS}")
    return read_fleet_settings(folder / "fleet.yaml").recipe
