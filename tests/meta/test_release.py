"""What is published: the source distribution, the wheels of CI, and one date and version everywhere."""

import importlib.util
import re
import runpy
import subprocess
import sys
import tarfile
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml

from dynident._version import __version__

ROOT = Path(__file__).parents[2]
LARGEST = 1_000_000  # bytes of a file


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout: what belongs to the project is not known")
@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling, which builds, is missing")
def test_a_source_distribution_is_what_git_knows(tmp_path: Path) -> None:
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    words = [sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", tmp_path]
    subprocess.run(words, cwd=ROOT, capture_output=True, check=True)
    (path,) = tmp_path.iterdir()
    with tarfile.open(path) as archive:
        sizes = {member.name.partition("/")[2]: member.size for member in archive if member.isfile()}
    assert sizes.keys() - {"PKG-INFO", "src/dynident/commit.txt"} == {name for name in names if (ROOT / name).is_file()}
    assert {name: size for name, size in sizes.items() if size > LARGEST} == {}


def test_the_wheels_are_tried_with_every_version_of_python() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    versions = re.findall(r"Python :: 3\.(\d+)", "\n".join(settings["project"]["classifiers"]))
    assert settings["tool"]["cibuildwheel"]["build"] == [f"cp3{version}-*" for version in versions]


def test_the_release_has_one_date_and_a_summary() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    heading = re.search(rf"^## \[{re.escape(__version__)}\] - (\S+)\n\n(.)", text, re.MULTILINE)
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    if heading[1] != "unreleased":
        assert heading[1] == str(citation["date-released"])
        assert heading[2].isalpha()  # a paragraph, before the lists


@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling, which builds, is missing")
def test_links_of_the_readme_are_absolute_where_a_repository_is_named() -> None:
    hook = runpy.run_path(str(ROOT / "hatch_build.py"))
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert package_text(hook) == {"readme": {"content-type": "text/markdown", "text": readme}}
    named = package_text(hook, repository="https://example.org/dynident")
    text, place = named["readme"]["text"], "https://example.org/dynident"
    assert f"]({place}/raw/v{__version__}/docs/report.png)" in text
    assert f"]({place}/blob/v{__version__}/docs/tutorial.md)" in text
    assert f"{place}/blob/v{__version__}/docs/maximum_likelihood.md#the-cram" in text
    assert all(target.startswith("https://") for target in re.findall(r"\]\(([^)]+)\)", text))
    assert named["urls"]["Source"] == place


def package_text(hook: dict[str, Any], **config: str) -> dict[str, Any]:
    """What the hook of the project adds to the metadata of the package."""
    metadata: dict[str, Any] = {}
    hook["ReadmeAndAddresses"](str(ROOT), config).update(metadata)
    return metadata
