"""Completion at the command line."""

from __future__ import annotations

import pytest
from click.shell_completion import ShellComplete

from dynident.cli import main


def completed(words: list[str], incomplete: str) -> list[tuple[str, str]]:
    found = ShellComplete(main, {}, "dynident", "_DYNIDENT_COMPLETE").get_completions(words, incomplete)
    return [(one.type, str(one.value)) for one in found]


def test_files_and_folders_are_left_to_the_shell() -> None:
    for words in (["check"], ["check", "--json"], ["init"], ["init", "arm.urdf"]):
        assert completed(words, "ar") == [("file", "ar")]
    assert completed(["smooth", "x.csv", "--out"], "") == [("dir", "")]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell_knows_the_program_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], shell: str
) -> None:
    monkeypatch.setattr("sys.argv", ["/opt/tools/bin/dynident"])
    monkeypatch.setenv("_DYNIDENT_COMPLETE", f"{shell}_source")
    monkeypatch.setattr("click.shell_completion.BashComplete._check_version", lambda _: None)  # it asks bash
    with pytest.raises(SystemExit) as end:
        main([])
    assert not end.value.code
    script = capsys.readouterr().out
    assert "_dynident_completion" in script
    assert "/opt" not in script
