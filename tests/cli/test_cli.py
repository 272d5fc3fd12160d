"""The command itself."""

from __future__ import annotations

from tests.cli.commands import run


def test_help_and_version() -> None:
    assert "identify" in run("--help").output
    assert run("--version").output.startswith("dynident")
    assert run("identfy").exit_code == 2
