"""The examples in Python run as they are, without a warning, and print a few lines."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.py"))


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run_and_print(path: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", str(path)],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stderr
    assert 2 <= len(done.stdout.splitlines()) < 60
    assert not list(tmp_path.iterdir())


def test_there_are_five_and_a_walk_through_them() -> None:
    assert {path.stem for path in EXAMPLES} >= {
        "accuracy", "article_arm", "spline", "stribeck", "urdf_arm", "walkthrough",
    }  # fmt: skip
    text = (ROOT / "examples" / "walkthrough.py").read_text(encoding="utf-8")
    assert text.count("# %%") > 10
