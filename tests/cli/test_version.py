"""What the version says, and how quickly."""

from __future__ import annotations

import platform
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


@pytest.mark.skipif(shutil.which("git") is None, reason="there is no git")
def test_a_clone_says_its_commit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "src" / "dynident"
    (package / "cli").mkdir(parents=True)
    monkeypatch.setattr(version, "__file__", str(package / "cli" / "options.py"))
    who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
    for command in (("init", "-q"), (*who, "commit", "-q", "--allow-empty", "-m", "first")):
        subprocess.run(("git", "-C", str(tmp_path), *command), check=True)
    head = subprocess.run(("git", "-C", str(tmp_path), "rev-parse", "HEAD"), capture_output=True, text=True, check=True)
    assert head.stdout.startswith(version.commit() or "none")
