"""Writes the commit of a clone into what is built from it, for `dynident --version`; nothing without git."""

from __future__ import annotations

import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class CommitHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds commit.txt to the package; a wheel that is built from an sdist takes it from there."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the file to a wheel or an sdist."""
        if version == "editable" or not (Path(self.root) / ".git").exists():
            return
        asked = ["git", "-C", self.root, "describe", "--always", "--dirty", "--exclude=*"]
        try:
            commit = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            return
        self.folder = tempfile.TemporaryDirectory()
        file = Path(self.folder.name) / "commit.txt"
        file.write_text(commit)
        package = "dynident" if self.target_name == "wheel" else "src/dynident"
        build_data["force_include"][str(file)] = f"{package}/commit.txt"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was written for the build."""
        if hasattr(self, "folder"):
            self.folder.cleanup()
