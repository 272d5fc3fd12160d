"""The wheels of all systems: what is added to the one without a kernel, and what a library is refused for."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import zipfile
from base64 import urlsafe_b64decode
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
ABOUT = "dynident-1.0.dist-info"
PURE = {
    "dynident/__init__.py": "",
    "dynident/runtime/kernel/build.py": "1",
    f"{ABOUT}/METADATA": "Name: dynident\n",
    f"{ABOUT}/WHEEL": "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n",
    f"{ABOUT}/RECORD": "",
}


@pytest.fixture
def wheels(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    spec = importlib.util.spec_from_file_location("wheels", ROOT / "tools" / "wheels.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    monkeypatch.setitem(sys.modules, "wheels", module)  # where a dataclass looks for its types
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def pure(tmp_path: Path) -> Path:
    path = tmp_path / "dynident-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in PURE.items():
            archive.writestr(zipfile.ZipInfo(name), text)
    return path


def test_a_wheel_is_the_one_without_a_kernel_and_its_library(wheels: ModuleType, pure: Path, tmp_path: Path) -> None:
    made = wheels.platform_wheel(pure, b"library", "manylinux_2_17_x86_64.manylinux2014_x86_64", tmp_path)
    assert made.name == "dynident-1.0-py3-none-manylinux_2_17_x86_64.manylinux2014_x86_64.whl"
    with zipfile.ZipFile(made) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    assert list(files)[-1] == f"{ABOUT}/RECORD"
    assert files.keys() == {*PURE, "dynident/runtime/kernel/kernel.bin", "dynident/runtime/kernel/kernel.bin.sum"}
    assert files["dynident/runtime/kernel/kernel.bin"] == b"library"
    assert hashlib.sha256(b"library").hexdigest() in files["dynident/runtime/kernel/kernel.bin.sum"].decode()
    _, *about = files[f"{ABOUT}/WHEEL"].decode().splitlines()
    tags = ["Tag: py3-none-manylinux_2_17_x86_64", "Tag: py3-none-manylinux2014_x86_64"]
    assert about == ["Root-Is-Purelib: false", *tags]
    rows = [line.split(",") for line in files.pop(f"{ABOUT}/RECORD").decode().splitlines()]
    assert rows.pop() == [f"{ABOUT}/RECORD", "", ""]
    assert [row[0] for row in rows] == list(files)
    for name, checksum, size in rows:
        assert urlsafe_b64decode(checksum.removeprefix("sha256=") + "=") == hashlib.sha256(files[name]).digest()
        assert int(size) == len(files[name])


def test_the_same_library_gives_the_same_wheel(wheels: ModuleType, pure: Path, tmp_path: Path) -> None:
    made = wheels.platform_wheel(pure, b"library", "win_amd64", tmp_path)
    before = made.read_bytes()
    made.unlink()
    assert wheels.platform_wheel(pure, b"library", "win_amd64", tmp_path).read_bytes() == before


FUNCTIONS = {"best", "compiler", "solve", "solve_all"}


def library(wheels: ModuleType, system: Any) -> bytes:
    """What a library holds that is looked for; on macOS with an underscore."""
    levels = [name for name, _, _ in wheels.BUILD["LEVELS"][system.machine]]
    names = [*(f"{name}_{level}" for level in levels for name in ("solve", "solve_all")), "best", "compiler"]
    return bytes(system.magic) + b"".join(f"_dynident_{name}\0".encode() for name in names)


def test_a_library_that_would_not_run_elsewhere_is_refused(wheels: ModuleType) -> None:
    for system in wheels.SYSTEMS:
        right = library(wheels, system)
        level = wheels.BUILD["LEVELS"][system.machine][-1][0]

        def faults(content: bytes, system: Any = system) -> list[str]:
            return list(wheels.faults(content, system, FUNCTIONS))

        assert faults(right) == []
        assert faults(b"?" + right) == [f"is no library of {system.target}"]
        assert f"lacks best of {level}" in faults(right.replace(b"dynident_best", b""))
        assert faults(right.replace(f"solve_{level}".encode(), b"")) == [f"lacks solve of {level}"]
        assert faults(right + f"dynident_more_{level}\0".encode()) == [f"alone has more of {level}"]
        assert f"names the folder {ROOT} of this machine" in faults(right + f"{ROOT}/src".encode())
        assert faults(right + b"GLIBC_2.4\0GLIBC_2.17\0") == []
        assert faults(right + b"GLIBC_2.4\0GLIBC_2.34\0") == ["needs glibc 2.34"]
        assert faults(right + b"KERNEL32.dll\0api-ms-win-crt-heap-l1-1-0.dll\0") == []
        assert faults(right + b"libgcc_s.dll\0") == ["needs libgcc_s.dll, which not every Windows has"]


def test_without_zig_it_says_what_to_type(wheels: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(wheels.BUILD, "zig", lambda: None)
    with pytest.raises(SystemExit, match=r"`python3 dev\.py wheels` installs it"):
        wheels.main([])
