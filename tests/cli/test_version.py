"""What the version says, and how quickly."""

from __future__ import annotations

import platform
import re
import shutil
import subprocess
from importlib import metadata
from pathlib import Path

import pytest

import dynident
from dynident.cli import options as version
from dynident.runtime.kernel import kernel
from tests.cli.commands import run


def test_the_version_says_what_it_runs_with() -> None:
    shown = run("--version").output
    assert shown.startswith(f"dynident {dynident.__version__}")
    assert platform.python_version() in shown
    assert f"numpy {metadata.version('numpy')}" in shown
    assert f"\nkernel: {kernel()}\n" in shown


def test_only_a_clone_has_a_commit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "lib" / "site-packages" / "dynident"
    monkeypatch.setattr(version, "__file__", str(package / "cli" / "version.py"))
    assert version.commit() is None  # even where the environment lies in somebody else's clone
    (tmp_path / "lib" / ".git").mkdir(parents=True)
    assert version.commit() is None
    package.mkdir(parents=True)
    (package / "commit.txt").write_text("1234abc\n")
    assert version.commit() == "1234abc"
    clone = tmp_path / "clone"
    (clone / "src" / "dynident").mkdir(parents=True)
    monkeypatch.setattr(version, "__file__", str(clone / "src" / "dynident" / "cli" / "version.py"))
    git = [shutil.which("git") or pytest.skip("there is no git"), "-C", str(clone)]
    author = ("-c", "user.name=a", "-c", "user.email=a@b")
    for words in (("init",), (*author, "commit", "--allow-empty", "--message=first")):
        subprocess.run([*git, *words], check=True, capture_output=True)
    assert re.fullmatch("[0-9a-f]{7,40}", version.commit() or "")
