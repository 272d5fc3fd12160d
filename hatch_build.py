"""Adds to what is built from a clone its commit, for `dynident --version`, and to a wheel the compiled kernel.

Neither is needed: without git there is no commit, and without a C compiler no kernel, which NumPy and LAPACK stand in
for. Whatever goes wrong with a compiler is said by `pip install -v`, and is no reason not to install.
"""

from __future__ import annotations

import os
import re
import runpy
import subprocess
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KERNEL = Path("src", "dynident", "runtime", "kernel")


class CommitAndKernel(BuildHookInterface):  # type: ignore[type-arg]
    """Adds commit.txt to wheel and sdist, and kernel.bin to a wheel; an editable one has it beside its sources."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files."""
        self.folder = tempfile.TemporaryDirectory()
        if version != "editable":
            self._add_commit(build_data)
        if self.target_name == "wheel":
            target = Path(self.root, KERNEL) if version == "editable" else Path(self.folder.name)
            files = self._compiled(target)
            if files and version != "editable":
                build_data["force_include"] |= {str(target / name): f"dynident/runtime/kernel/{name}" for name in files}
                build_data["pure_python"] = False
                build_data["tag"] = f"py3-none-{platform_tag()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was written for the build."""
        self.folder.cleanup()

    def _add_commit(self, build_data: dict[str, Any]) -> None:
        """Add commit.txt; a wheel that is built from an sdist takes it from there."""
        if not Path(self.root, ".git").exists():
            return
        asked = ["git", "-C", self.root, "describe", "--always", "--dirty", "--exclude=*"]
        try:
            commit = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
        except (OSError, subprocess.SubprocessError):
            return
        file = Path(self.folder.name) / "commit.txt"
        file.write_text(commit)
        package = "dynident" if self.target_name == "wheel" else "src/dynident"
        build_data["force_include"][str(file)] = f"{package}/commit.txt"

    def _compiled(self, folder: Path) -> tuple[str, ...]:
        """Compile the kernel into a folder; return the names of its files, none where there is no kernel."""
        if os.environ.get("DYNIDENT_KERNEL", "").strip().lower() == "off":
            self.app.display_info("The kernel is not compiled: DYNIDENT_KERNEL=off")
            return ()
        try:
            build = runpy.run_path(str(Path(self.root, KERNEL, "build.py")))
            build["make"](folder / build["FILE"])
        except Exception as error:  # nothing that a compiler does may end an installation
            self.app.display_warning(f"The kernel is not compiled, NumPy and LAPACK are used instead: {error}")
            return ()
        return build["FILE"], build["RECORD"]


def platform_tag() -> str:
    """Return the tag of this machine alone: what is compiled here may not run on older systems.

    On macOS cibuildwheel names the oldest system that it compiles for; its tools find that of a library for Linux.
    """
    from packaging.tags import sys_tags  # hatchling needs it, too

    if oldest := os.environ.get("_PYTHON_HOST_PLATFORM"):
        return re.sub("[.-]", "_", oldest)
    return next(
        tag.platform for tag in sys_tags() if "manylinux" not in tag.platform and "musllinux" not in tag.platform
    )
