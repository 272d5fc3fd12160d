"""The commands where results cannot be written, and what they warn of beforehand."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_cli import configure, run, write_log


@pytest.fixture
def no_folder(tmp_path: Path) -> Path:
    """A folder that cannot be made, because a file has the name of its parent."""
    (tmp_path / "taken").write_text("mine")
    return tmp_path / "taken" / "out"


class TestFolder:
    """Where nothing can be written, a command says so before its long work."""

    def test_identify(self, tmp_path: Path, no_folder: Path) -> None:
        done = run("identify", tmp_path / "missing.yaml", "--out", no_folder)
        assert done.exit_code == 1
        assert str(no_folder) in done.output
        assert "missing.yaml" not in done.output

    @pytest.mark.parametrize("option", ["--out", "--json"])
    def test_reproduce(self, no_folder: Path, option: str) -> None:
        done = run(
            "reproduce", "--scenario", "unknown", option, no_folder if option == "--out" else no_folder / "r.json"
        )
        assert done.exit_code == 1
        assert str(no_folder) in done.output
        assert "Known" not in done.output

    def test_a_report_that_fails_leaves_no_result(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        write_log(tmp_path)
        monkeypatch.setattr("dynident.report.identification_page", lambda *_: 1 / 0)
        done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
        assert isinstance(done.exception, ZeroDivisionError)
        assert not (tmp_path / "out").exists()


def test_a_log_that_was_fitted_is_warned_of(tmp_path: Path) -> None:
    write_log(tmp_path)
    done = run("identify", configure(tmp_path, validation=[{"file": "log.csv", "window": [2, 4]}]))
    assert done.exit_code == 0, done.output
    assert "overlaps in time" in done.output
