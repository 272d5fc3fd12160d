"""What the commands print of a small robot stays, with the tables and notes that ``-v`` adds."""

import re
from pathlib import Path

import numpy as np
import pytest

from dynident.runtime.kernel import kernel
from tests.cli.commands import configure, run, write_log
from tests.kept import check_kept

COMMANDS = (
    ("-v", "check", "robot.yaml"),
    ("check", "dead.yaml"),
    ("-v", "identify", "robot.yaml", "--out", "out"),
    ("predict", "out/result.json", "b.csv", "--out", "predicted.csv"),
    ("bound", "robot.yaml"),
    ("smooth", "a.csv", "--out", "smooth.csv"),
    ("export", "out/result.json", "--format", "numpy", "--out", "model.py"),
    ("compare-results", "out/result.json", "out/result.json"),
    ("identify", "none.yaml"),
    ("check",),
)


def test_what_commands_print_stays(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    write_log(tmp_path, "a.csv")
    write_log(tmp_path, "b.csv", rate=4.0)
    write_log(tmp_path, "dead.csv", force=np.zeros(2000))
    chosen = {"smoother": {"kind": "spline", "rule": "torque"}, "time_offset": "estimate"}  # as by default
    configure(tmp_path, train=[{"file": "a.csv"}], validation=[{"file": "b.csv"}], **chosen).rename("robot.yaml")
    configure(tmp_path, train=[{"file": "a.csv"}, {"file": "dead.csv"}], validation=[], **chosen).rename("dead.yaml")
    lines = list[str]()
    for words in COMMANDS:
        done = run(*words)
        text = done.output.replace(str(tmp_path), "FOLDER").replace(str(kernel()), "KERNEL")
        lines += [f"$ dynident {' '.join(words)}", *map(str.rstrip, text.splitlines()), f"exit code {done.exit_code}"]
    text = re.sub(r"\b[0-9a-f]{8}\b", "HASH", "\n".join(lines))
    check_kept("printed", re.sub(r"\d+(\.\d+)? (s|ms|min)\b", "# \\2", text))
