"""What is sent to other processes."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from dynident.project.python_file import load_from_file
from dynident.runtime import ConfigError
from dynident.runtime.jobs.job import pack, unpack

CODE = "from dataclasses import dataclass\n\n\n@dataclass(frozen=True)\nclass Mine:\n    gain: float\n"


def mine(path: Path) -> type:
    path.write_text(CODE)
    return load_from_file(path, "Mine", "class", "here", ConfigError)


def test_a_class_of_a_file_reaches_another_process(tmp_path: Path) -> None:
    part = mine(tmp_path / "mine.py")(2.0)
    assert unpack(pack(part)) == part
    code = "import sys; from dynident.runtime.jobs.job import unpack; print(unpack(sys.stdin.buffer.read()))"
    done = subprocess.run([sys.executable, "-c", code], input=pack(part), capture_output=True, check=True)
    assert done.stdout.decode().strip() == "Mine(gain=2.0)"


def test_a_file_that_has_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    sent = pack(mine(path)(2.0))
    path.write_text(CODE + "\n\nother = 1\n")
    with pytest.raises(ConfigError, match="has changed"):
        unpack(sent)
