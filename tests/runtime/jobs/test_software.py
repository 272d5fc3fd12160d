"""What must be the same where jobs run."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

from dynident._version import __version__
from dynident.runtime.jobs import cluster as module
from dynident.runtime.jobs.cluster import software, software_differences


def test_what_decides_the_numbers_is_named() -> None:
    found = software()
    assert found["numpy"] == np.__version__
    assert found["Python"] == f"{sys.version_info[0]}.{sys.version_info[1]}"
    assert found["dynident"] == __version__
    assert re.fullmatch("[0-9a-f]{12}", found["the code of dynident"])
    assert software_differences(found, {"there": found}) == []


def test_the_code_is_that_of_all_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PACKAGE_FOLDER", tmp_path)
    (tmp_path / "a.py").write_bytes(b"x = 1\ny = 2\n")
    (tmp_path / "b").mkdir()
    first = module.code_digest()
    (tmp_path / "a.py").write_bytes(b"x = 1\r\ny = 2\r\n")
    (tmp_path / "notes.txt").touch()
    assert module.code_digest() == first
    (tmp_path / "b" / "c.py").touch()
    second = module.code_digest()
    (tmp_path / "b" / "c.py").rename(tmp_path / "b" / "d.py")
    assert len({first, second, module.code_digest()}) == 3


def test_each_difference_is_said_with_its_places() -> None:
    here = {"Python": "3.11", "numpy": "2.4.6", "dynident": "0.1.0"}
    many = {f"tcp://10.0.0.{number}:4000": {**here, "numpy": "2.4.5"} for number in range(9)}
    odd = {"tcp://10.0.1.1:4000": {**here, "numpy": "missing"}, "the scheduler": {"Python": "3.12"}}
    few = "tcp://10.0.0.0:4000, tcp://10.0.0.1:4000, tcp://10.0.0.2:4000 and 6 more"
    assert software_differences(here, many | odd) == [
        "Python is 3.11 here, 3.12 on the scheduler",
        f"numpy is 2.4.6 here, 2.4.5 on {few}, missing on tcp://10.0.1.1:4000",
    ]
