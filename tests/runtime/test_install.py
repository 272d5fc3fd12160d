"""What a message says to type to install what is missing."""

from __future__ import annotations

import importlib.util
import os
import shlex
import sys

import pytest

from dynident.runtime import install_command


@pytest.mark.skipif(os.name == "nt", reason="shlex splits as POSIX shells do")
def test_a_folder_with_spaces_is_quoted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/home/a b/python")
    assert shlex.split(install_command("h5py")) == ["/home/a b/python", "-m", "pip", "install", "h5py"]


def test_an_environment_without_pip_is_one_of_uv(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "executable", "/python")
    assert install_command("h5py") == "uv pip install --python /python h5py"
