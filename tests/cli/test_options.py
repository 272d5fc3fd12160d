"""Completion of files by their kind."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from dynident.cli import main

FILES = ("arm.urdf", "arm.yaml", "arm.csv", "result.json", "notes.md")


def completed(words: list[str], incomplete: str) -> list[tuple[str, str]]:
    found = ShellComplete(main, {}, "dynident", "_DYNIDENT_COMPLETE").get_completions(words, incomplete)
    return [(one.type, str(one.value)) for one in found]


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["identify"], ["arm.yaml"]),
        (["bound"], ["arm.yaml"]),
        (["check"], ["arm.urdf", "arm.yaml"]),
        (["init"], ["arm.urdf"]),
        (["init", "arm.urdf"], ["arm.csv"]),
        (["init", "arm.urdf", "arm.csv"], ["arm.csv"]),
        (["predict", "result.json"], ["arm.csv"]),
        (["smooth"], ["arm.csv"]),
    ],
)
def test_files_are_completed_by_kind(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, words: list[str], names: list[str]
) -> None:
    for name in FILES:
        (tmp_path / name).touch()
    (tmp_path / "arms").mkdir()
    monkeypatch.chdir(tmp_path)
    assert completed(words, "ar") == [("plain", name) for name in (*names, "arms/")]


def test_a_file_in_a_folder_and_what_the_shell_does_better(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    (tmp_path / "arms").mkdir()
    (tmp_path / "arms" / "left.yaml").touch()
    monkeypatch.chdir(tmp_path)
    assert completed(["check"], "arms/l") == [("plain", "arms/left.yaml")]
    assert completed(["check"], "ar") == [("dir", "ar")]
    for name in ("b", "no/such"):
        assert completed(["check"], name) == [("file", name)]
    assert completed(["check", "--json"], "") == [("file", "")]
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
