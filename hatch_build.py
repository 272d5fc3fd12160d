"""Adds to what is built from a clone its commit, for `dynident --version`, and the README with links that work on a
package index; to a wheel the compiled kernel, and plotly's JavaScript, which draws the figures of reports.

Without git there is no commit, and without a C compiler no kernel, which NumPy and LAPACK stand in for. Whatever goes
wrong with a compiler is said by `pip install -v`, and is no reason not to install. The script is one file of 5 MB out
of the package plotly, which takes 70 MB where it is installed.
"""

from __future__ import annotations

import os
import re
import runpy
import shutil
import subprocess
import tempfile
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

KERNEL = Path("src", "dynident", "runtime", "kernel")
SCRIPT = Path("dynident", "report", "templates", "plotly.min.js")
LINK = re.compile(r"(!?)(\[[^\]]*\])\((?!\w+:|#)([^)\s]+)\)")  # image or not, text, target in the repository


class CommitAndKernel(BuildHookInterface):  # type: ignore[type-arg]
    """Adds commit.txt to wheel and sdist, and kernel.bin to a wheel; an editable one has it beside its sources."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the files."""
        self.folder = tempfile.TemporaryDirectory()
        if version != "editable":
            self._add_commit(build_data)
        if self.target_name == "wheel":
            self._add_script(version, build_data)
            target = Path(self.root, KERNEL) if version == "editable" else Path(self.folder.name)
            files = self._compiled(target)
            if files and version != "editable":
                build_data["force_include"] |= {str(target / name): f"dynident/runtime/kernel/{name}" for name in files}
                build_data["pure_python"] = False
                build_data["tag"] = f"py3-none-{platform_tag()}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what was written for the build."""
        self.folder.cleanup()

    def _add_script(self, version: str, build_data: dict[str, Any]) -> None:
        """Add plotly's JavaScript, where plotly is installed: pip does so for the build."""
        spec = find_spec("plotly")
        if spec is None or spec.origin is None:
            self.app.display_warning("Without plotly no script is added: reports need plotly to be installed")
            return
        script = Path(spec.origin).parent / "package_data" / SCRIPT.name
        if version == "editable":
            shutil.copyfile(script, Path(self.root, "src", SCRIPT))
        else:
            build_data["force_include"][str(script)] = SCRIPT.as_posix()

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


class ReadmeAndAddresses(MetadataHookInterface):
    """Gives the package its README and addresses, by the setting ``repository`` of the hook in pyproject.toml."""

    PLUGIN_NAME = "custom"

    def update(self, metadata: dict[str, Any]) -> None:
        """Add readme and urls; without a repository links stay relative, and there are no addresses."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        repository = str(self.config.get("repository", ""))
        source = Path(self.root, "src", "dynident", "_version.py").read_text(encoding="utf-8")
        version = re.search(r'__version__ = "(.+)"', source)
        if repository and version:
            text = absolute_links(text, repository, f"v{version[1]}")
            changes = f"{repository}/blob/v{version[1]}/CHANGELOG.md"
            metadata["urls"] = {"Source": repository, "Issues": f"{repository}/issues", "Changelog": changes}
        metadata["readme"] = {"content-type": "text/markdown", "text": text}


def absolute_links(text: str, repository: str, tag: str) -> str:
    """Return Markdown whose relative links and pictures are those of a tag of the repository."""

    def absolute(link: re.Match[str]) -> str:
        kind = "raw" if link[1] else "blob"  # the addresses of a picture and of a page
        return f"{link[1]}{link[2]}({repository}/{kind}/{tag}/{link[3]})"

    return LINK.sub(absolute, text)


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
