"""The study as a user meets it."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import polars as pl
import pytest

from dynident.apps.article.study import study_table
from dynident.files.row_store import parts_folder
from tests.cli.commands import refuse, run, succeed

HANGS = 600.0  # s: nothing takes as long, even on a busy machine


class TestReproduce:
    def test_prints_writes_and_resumes(self, tmp_path: Path) -> None:
        words = ("reproduce", "--runs", 1, "--workers", 1, "--out", tmp_path, "--json", tmp_path / "deep" / "r.json")
        done = succeed(*words)
        for table in range(2, 8):
            assert f"Table {table}" in done.output
        assert f"Files in {tmp_path.resolve()}: report.html" in done.output.replace("\n", "")
        first = json.loads((tmp_path / "deep" / "r.json").read_text())
        rows = pl.read_parquet(tmp_path / "study.parquet")
        assert len(rows) == 9
        succeed(*words)
        assert json.loads((tmp_path / "deep" / "r.json").read_text()) == first
        assert pl.read_parquet(tmp_path / "study.parquet")["seconds"].sum() == rows["seconds"].sum()

    @pytest.mark.parametrize(
        ("options", "words"),
        [
            (("--scenario", "week"), "did you mean 'weak'"),
            (("--methods", "raw,splin"), "did you mean 'spline'"),
            (("--methods", ","), "no method"),
            (("--runs", "0"), "runs is 0"),
        ],
    )
    def test_bad_options(self, options: tuple[str, str], words: str) -> None:
        refuse("reproduce", *options, says=words)

    @pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")
    def test_ctrl_c_while_workers_start(self, tmp_path: Path) -> None:
        """A terminal sends it to all processes, and those that start have not yet said that they ignore it."""
        script = (
            "import os, signal, threading\nfrom concurrent.futures import ThreadPoolExecutor\n"
            "from dynident.cli import main\nsubmit = ThreadPoolExecutor.submit\n"
            "def early(*given):\n"
            "    ThreadPoolExecutor.submit = submit\n"
            "    threading.Timer(0.1, os.killpg, (os.getpid(), signal.SIGINT)).start()\n"
            "    return submit(*given)\n"
            "ThreadPoolExecutor.submit = early\n"
            f"main(['reproduce', '--workers', '2', '--out', {str(tmp_path)!r}])\n"
        )
        words = [sys.executable, "-c", script]
        done = subprocess.run(words, capture_output=True, text=True, start_new_session=True, timeout=HANGS, check=False)
        assert done.returncode == 130, done.stderr
        assert "Traceback" not in done.stderr
        assert done.stderr.startswith("Interrupted: ")

    @pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")
    @pytest.mark.parametrize(("number", "code"), [("SIGTERM", 143), ("SIGKILL", -9)])
    def test_stopping_loses_nothing_and_leaves_no_process(self, tmp_path: Path, number: str, code: int) -> None:
        script = (
            "from dynident.cli import main\nfrom dynident.files import row_store\nrow_store.SAVE_EVERY = 0.01\n"
            f"main(['reproduce', '--runs', '1000', '--workers', '2', '--out', {str(tmp_path)!r}])\n"
        )
        command = [sys.executable, "-c", script]
        # the pipe of standard error ends when the last process that holds it does, workers included
        with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
            deadline = time.monotonic() + HANGS
            table = tmp_path / "study.parquet"
            while not list(parts_folder(table).glob("*.parquet")) and time.monotonic() < deadline:
                time.sleep(0.02)
            process.send_signal(getattr(signal, number))
            _, told = process.communicate(timeout=HANGS)
        assert process.returncode == code
        if code > 0:
            assert told == f"Interrupted: Finished rows are kept in {table}; run the same command again to go on.\n"
            assert [path.name for path in tmp_path.iterdir()] == ["study.parquet"]
        with study_table(table) as rows:
            assert len(rows) > 0

    def test_with_rerun_all_is_computed_anew(self, tmp_path: Path) -> None:
        words = ("reproduce", "--runs", 1, "--methods", "raw", "--workers", 1, "--out", tmp_path)
        assert run(*words).exit_code == 0
        first = pl.read_parquet(tmp_path / "study.parquet")
        assert run(*words, "--rerun").exit_code == 0
        second = pl.read_parquet(tmp_path / "study.parquet")
        assert second.drop("seconds").equals(first.drop("seconds"))
        assert not second.equals(first)

    @pytest.mark.parametrize("option", ["--out", "--json"])
    def test_a_folder_that_cannot_be_made_is_said_first(self, tmp_path: Path, option: str) -> None:
        (tmp_path / "taken").write_text("mine")
        no_folder = tmp_path / "taken" / "out"
        path = no_folder if option == "--out" else no_folder / "r.json"
        done = refuse("reproduce", "--scenario", "unknown", option, path, says=str(no_folder))
        assert "Known" not in done.output
