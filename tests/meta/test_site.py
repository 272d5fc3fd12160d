"""The documentation as a site: its search finds for what users ask the page that answers."""

import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(
    find_spec("mkdocs") is None or shutil.which("node") is None, reason="mkdocs or node is missing"
)


def test_the_search_finds_the_right_page_first(tmp_path: Path) -> None:
    words = [sys.executable, "-m", "mkdocs", "build", "--quiet", "--site-dir", tmp_path]
    subprocess.run(words, cwd=ROOT, check=True)
    done = subprocess.run(
        ["node", "docs/questions.js", tmp_path], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout
    assert done.stdout.endswith("20 of 20 questions have the right page first.\n")
