"""Build a wheel for each system, with its kernel, into dist/: python3 dev.py wheels [WHEEL]

Each is the wheel without a kernel (of the checkout, or the one that is named) and beside its sources the library that
zig compiles for that system, which is looked at first: what it is, what it needs, and that nothing of this machine is
in it. The same sources and the same zig give the same bytes.
"""

from __future__ import annotations

import hashlib
import os
import re
import runpy
import subprocess
import sys
import tempfile
import zipfile
from base64 import urlsafe_b64encode
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
KERNEL = "dynident/runtime/kernel"
BUILD: dict[str, Any] = runpy.run_path(str(ROOT / "src" / KERNEL / "build.py"))
os.environ.setdefault("SOURCE_DATE_EPOCH", "1580601600")  # hatchling's; without it a DLL holds the time
SECONDS = 900.0  # zig first compiles its own libraries for a system
# what a library may need of Windows: both come with Windows 10 and with Python
DLLS = re.compile(rb"(?:kernel32|ntdll|api-ms-win-crt-[a-z]+-l1-1-0)\.dll", re.IGNORECASE)
GLIBC = (2, 17)


@dataclass(frozen=True)
class System:
    """A system: the ``tag`` of its wheel, zig's ``target``, its ``machine``, and how a library of it begins."""

    tag: str
    target: str
    machine: str
    magic: bytes


ELF = b"\x7fELF\x02\x01\x01".ljust(16, b"\0") + b"\x03\x00"
MACHO = b"\xcf\xfa\xed\xfe"
SYSTEMS = (
    System("manylinux_2_17_x86_64.manylinux2014_x86_64", "x86_64-linux-gnu.2.17", "x86_64", ELF + b"\x3e\0"),
    System("manylinux_2_17_aarch64.manylinux2014_aarch64", "aarch64-linux-gnu.2.17", "aarch64", ELF + b"\xb7\0"),
    System("musllinux_1_2_x86_64", "x86_64-linux-musl", "x86_64", ELF + b"\x3e\0"),
    System("macosx_11_0_arm64", "aarch64-macos.11.0", "aarch64", MACHO + b"\x0c\0\0\x01"),
    System("macosx_10_13_x86_64", "x86_64-macos.10.13", "x86_64", MACHO + b"\x07\0\0\x01"),
    System("win_amd64", "x86_64-windows-gnu", "x86_64", b"MZ"),
)


def library(system: System, zig: str) -> bytes:
    """Return the kernel's library for a system."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, BUILD["FILE"])
        BUILD["make"](path, [zig, "cc", "-target", system.target, "-s"], system.machine, SECONDS)
        return path.read_bytes()


def faults(content: bytes, system: System, functions: set[str]) -> Iterator[str]:
    """Yield what is wrong with a library, as far as that can be seen where it does not run; each level of it has the
    same ``functions``."""
    if not content.startswith(system.magic):
        yield f"is no library of {system.target}"
    for level, _, _ in BUILD["LEVELS"][system.machine]:
        found = functions_of(content, level)
        yield from (f"lacks {name} of {level}" for name in sorted(functions - found))
        yield from (f"alone has {name} of {level}" for name in sorted(found - functions))
    for folder in {str(ROOT), str(Path.home()), tempfile.gettempdir()} - {"/"}:
        if folder.encode() in content:
            yield f"names the folder {folder} of this machine"
    for name in set(re.findall(rb"[\w.-]+\.dll", content, re.IGNORECASE)) - {BUILD["FILE"].encode()}:
        if not DLLS.fullmatch(name):
            yield f"needs {name.decode()}, which not every Windows has"
    needed = [tuple(map(int, found)) for found in re.findall(rb"GLIBC_(\d+)\.(\d+)", content)]
    if needed and max(needed) > GLIBC:
        yield "needs glibc {}.{}".format(*max(needed))


def functions_of(content: bytes, level: str) -> set[str]:
    """Return the names of a level's functions in a library, and of those of all levels."""
    names = re.findall(rf"dynident_(\w+)_{level}\0|dynident_(best|compiler)\0".encode(), content)
    return {(own or common).decode() for own, common in names}


def platform_wheel(pure: Path, content: bytes, tag: str, folder: Path) -> Path:
    """Write the wheel of a tag: all that is in the pure one, with a library; return its path."""
    target = folder / pure.name.replace("-any.whl", f"-{tag}.whl")
    library, record = f"{KERNEL}/{BUILD['FILE']}", f"{KERNEL}/{BUILD['RECORD']}"
    rows = []
    with zipfile.ZipFile(pure) as old, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as new:

        def add(info: zipfile.ZipInfo, data: bytes) -> None:
            new.writestr(info, data)
            checksum = urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
            rows.append(f"{info.filename},sha256={checksum},{len(data)}")

        entries = old.infolist()
        (listed,) = (one for one in entries if one.filename.endswith(".dist-info/RECORD"))
        for info in entries:
            if info.filename.endswith(".dist-info/WHEEL"):
                add(info, about(old.read(info).decode(), tag).encode())
            elif info is not listed:
                add(info, old.read(info))
        for name, data in ((library, content), (record, BUILD["record"](content).encode())):
            info = zipfile.ZipInfo(name, listed.date_time)
            info.external_attr, info.compress_type = listed.external_attr, zipfile.ZIP_DEFLATED
            add(info, data)
        new.writestr(listed, "\n".join((*rows, f"{listed.filename},,\n")))
    return target


def about(text: str, tag: str) -> str:
    """Return the file WHEEL of a wheel of some tags, from that of the pure one."""
    lines = [line for line in text.splitlines() if not line.startswith(("Tag:", "Root-Is-Purelib:"))]
    tags = (f"Tag: py3-none-{one}" for one in tag.split("."))
    return "\n".join((*filter(None, lines), "Root-Is-Purelib: false", *tags, ""))


def pure_wheel(folder: Path) -> Path:
    """Build the wheel without a kernel."""
    command = [sys.executable, "-m", "hatchling", "build", "--target", "wheel", "--directory", str(folder)]
    subprocess.run(command, cwd=ROOT, env=os.environ | {"DYNIDENT_KERNEL": "off"}, check=True, capture_output=True)
    (found,) = folder.glob("*-py3-none-any.whl")
    return found


def main(arguments: list[str]) -> None:
    """Build all; end with exit code 1 where a library is wrong."""
    zig = BUILD["zig"]()
    if zig is None:
        sys.exit("the package ziglang is not installed; `python3 dev.py wheels` installs it")
    dist = ROOT / "dist"
    for old in dist.glob("dynident-*.whl") if not arguments else ():
        old.unlink()
    pure = Path(arguments[0]) if arguments else pure_wheel(dist)
    print(f"{pure.name}: {pure.stat().st_size / 1e6:.2f} MB, without a kernel", flush=True)
    wrong, functions = [], set[str]()
    for system in SYSTEMS:
        try:
            content = library(system, zig)
        except BUILD["BuildError"] as error:
            sys.exit(f"{system.target}: {error}")
        functions = functions or functions_of(content, BUILD["LEVELS"][system.machine][0][0])
        wrong += [f"{system.target}: the library {fault}" for fault in faults(content, system, functions)]
        made = platform_wheel(pure, content, system.tag, pure.parent)
        print(f"{made.name}: {made.stat().st_size / 1e6:.2f} MB, library {len(content) / 1e3:.0f} kB", flush=True)
    if wrong:
        sys.exit("\n".join(("Wrong:", *wrong)))


if __name__ == "__main__":
    main(sys.argv[1:])
