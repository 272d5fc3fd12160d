"""Build what is published, check what is in it, and try it where nothing else is: python3 dev.py release [3.X ...]

The wheels are built from the source distribution, all into dist/: one without a compiled kernel, and by tools/wheels.py
one with it for each system. That of this system and the source distribution are installed into a fresh environment of
each Python that pyproject.toml names and that is found here (or of those named, which must be there), and run away from
the checkout. Nothing is published.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Iterable, Iterator
from email.parser import HeaderParser
from pathlib import Path, PurePosixPath
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
LARGEST = 1_000_000  # bytes of one file
COMMIT = "dynident/commit.txt"  # written while it is built, where git knows it
NEEDED = ("py.typed", "report/templates/page.html")  # beside the modules
KERNEL = {f"dynident/runtime/kernel/kernel.bin{end}" for end in ("", ".sum")}  # in the wheel of a system
# what a user does first; each runs where the one before has left its files
COMMANDS = (
    ("--version",),
    ("reproduce", "--runs", "2", "--out", "study-out"),
    ("demo", "--out", "arm-out"),
)
IMPORT = "import dynident; [getattr(dynident, name) for name in dynident.__all__]; print(dynident.__file__)"
VERSION = "import sys, venv, ensurepip; print('%d.%d' % sys.version_info[:2])"
Row = dict[str, str]


class CommandError(Exception):
    """A command that ended with an error; what it printed."""


def output(*command: object, folder: Path = ROOT, home: Path | None = None, **variables: str) -> str:
    """Return what a command prints, without this Python's own variables and with those that are given; ``home`` also
    becomes the user's folder."""
    clean = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "VIRTUAL_ENV"))}
    if home:
        clean |= {"HOME": str(home), "USERPROFILE": str(home)}
    words = [str(word) for word in command]
    done = subprocess.run(
        words, cwd=folder, env=clean | variables, capture_output=True, encoding="utf-8", errors="replace"
    )
    if done.returncode:
        raise CommandError(f"{' '.join(words)}\nends with code {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def build(target: Path) -> tuple[Path, Path]:
    """Build the source distribution, and the wheel without a kernel from it and nothing else; return both."""
    target.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as place:
        made, unpacked = Path(place, "made"), Path(place, "unpacked")
        output(sys.executable, "-m", "hatchling", "build", "--target", "sdist", "--directory", made)
        (sdist,) = made.iterdir()
        with tarfile.open(sdist) as archive:
            archive.extractall(unpacked, filter="data")
        (source,) = unpacked.iterdir()
        words = ("-m", "hatchling", "build", "--target", "wheel", "--directory", made)
        output(sys.executable, *words, folder=source, DYNIDENT_KERNEL="off")
        (wheel,) = made.glob("*.whl")
        return Path(shutil.copy(sdist, target)), Path(shutil.copy(wheel, target))


def contents(path: Path) -> dict[str, int]:
    """Return the files of an archive with their sizes; those of a source distribution below its one folder."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as archive:
            return {one.filename: one.file_size for one in archive.infolist() if not one.is_dir()}
    with tarfile.open(path) as archive:
        return {one.name.partition("/")[2]: one.size for one in archive if one.isfile()}


def tracked() -> set[str]:
    """Return the files that git knows and that are there."""
    names = output("git", "ls-files", "-z").split("\0")
    return {name for name in names if name and (ROOT / name).is_file()}


def sdist_faults(files: dict[str, int], known: set[str]) -> Iterator[str]:
    """Yield what is wrong with the content of the source distribution: it is what git knows."""
    yield from (f"{name} is missing" for name in sorted(known - files.keys()))
    yield from (f"{name} is not known to git" for name in sorted(files.keys() - known - {"PKG-INFO", f"src/{COMMIT}"}))
    yield from too_large(files)


def wheel_faults(files: dict[str, int], known: set[str], version: str) -> Iterator[str]:
    """Yield what is wrong with the content of a wheel: the package, its data and its licence, and no more."""
    package = {name.removeprefix("src/") for name in known if name.startswith("src/dynident/")}
    about = f"dynident-{version}.dist-info"
    package |= KERNEL if "dynident/runtime/kernel/kernel.bin" in files else set()
    wanted = package | {f"dynident/{name}" for name in NEEDED} | {f"{about}/METADATA", f"{about}/licenses/LICENSE"}
    yield from (f"{name} is missing" for name in sorted(wanted - files.keys()))
    more = {name for name in files if PurePosixPath(name).parts[0] != about} - package - {COMMIT}
    # modules compiled from others are no files that git knows
    yield from (f"{name} does not belong there" for name in sorted(more) if not name.endswith((".so", ".pyd")))
    yield from too_large(files)


def too_large(files: dict[str, int]) -> Iterator[str]:
    """Yield the files that nobody wants to download."""
    yield from (f"{name} has {size / 1e6:.1f} MB" for name, size in files.items() if size > LARGEST)


def metadata_faults(wheel: Path, version: str) -> Iterator[str]:
    """Yield what a wheel says of itself that is not so."""
    with zipfile.ZipFile(wheel) as archive:
        head = HeaderParser().parsestr(archive.read(f"dynident-{version}.dist-info/METADATA").decode())
    wanted = {
        "Version": version,
        "Requires-Python": PROJECT["requires-python"],
        "License-Expression": PROJECT["license"],
    }
    for name, value in wanted.items():
        if head[name] != value:
            yield f"{name} is {head[name]}, not {value}"
    if not str(head.get_payload()).startswith("# dynident"):
        yield "the description is not the README"


def supported() -> list[str]:
    """Return the versions of Python that pyproject.toml names."""
    versions = (line.rpartition(" ")[2] for line in PROJECT["classifiers"] if "Python :: 3." in line)
    return sorted(versions, key=lambda version: int(version.partition(".")[2]))


def python(version: str) -> str | None:
    """Return the Python of a version: this one, or one on the path, of pyenv, uv, or the launcher of Windows."""
    return next((one for one in candidates(version) if one and is_version(one, version)), None)


def candidates(version: str) -> Iterator[str | None]:
    """Yield where a Python of this version may be."""
    yield getattr(sys, "_base_executable", sys.executable)
    yield shutil.which(f"python{version}")
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv")
    yield from map(str, sorted(pyenv.glob(f"versions/{version}.*/bin/python"), reverse=True))
    for finder in (
        ("uv", "python", "find", "--system", version),
        ("py", f"-{version}", "-c", "import sys; print(sys.executable)"),
    ):
        if shutil.which(finder[0]):
            found = subprocess.run(finder, capture_output=True, text=True)
            yield found.stdout.strip() if not found.returncode else None


def is_version(path: str, version: str) -> bool:
    """Return whether a program is a Python of this version that can make environments."""
    try:
        return output(path, "-I", "-c", VERSION).strip() == version
    except (OSError, CommandError):
        return False


def tried(version: str, sdist: Path, release: str) -> Iterator[Row]:
    """Yield what happens with the wheel, and then with the source distribution, in a fresh environment of a Python."""
    path = python(version)
    if path is None:
        yield {"Python": version, "installed": "not found"}
        return
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        programs = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
        pip = (programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-compile")
        own = (*pip, "--no-deps", "--no-index", "--find-links", DIST, "--only-binary", "dynident")
        wheel = (
            (path, "-m", "venv", folder / "env"),
            (*own, f"dynident=={release}"),  # pip chooses among the wheels of dist/
            (*pip, "--constraint", ROOT / "constraints.txt", f"dynident=={release}"),
        )
        for what, commands in (("wheel", wheel), ("sdist", ((*pip, "--no-deps", "--force-reinstall", sdist),))):
            row = {"Python": version, "of": what}
            try:
                begun = time.monotonic()
                for command in commands:
                    output(*command, folder=folder)
                row["installed"] = f"{size(folder / 'env') / 1e6:.0f} MB, {time.monotonic() - begun:.0f} s"
                row |= used(programs, folder / what, release)
                if what == "wheel" and row["kernel"] == "NumPy":
                    raise CommandError("the wheel of this system has no kernel")
            except CommandError as failed:
                print(failed, file=sys.stderr)
                row["result"] = "FAILED"
            yield row


def used(programs: Path, folder: Path, release: str) -> Row:
    """Return how long importing and the commands took, away from the checkout; raise CommandError where one fails."""
    folder.mkdir()
    row = {}
    for words in (("import",), *COMMANDS):
        begun = time.monotonic()
        if words == ("import",):
            said = output(programs / "python", "-I", "-c", IMPORT, folder=folder, home=folder)
            right = Path(said.strip()).resolve().is_relative_to(programs.parent.resolve())
        else:
            said = output(programs / "dynident", *words, folder=folder, home=folder)
            right = release in said if words == ("--version",) else any((folder / words[-1]).rglob("report.html"))
        if not right:
            raise CommandError(f"{' '.join(words)} does not do what it should:\n{said}")
        if words == ("--version",):
            row["kernel"] = said.partition("\nkernel: ")[2].partition(" ")[0]
        row[words[0]] = f"{time.monotonic() - begun:.0f} s"
    return row | {"result": "ok"}


def size(folder: Path) -> int:
    """Return the bytes of the files in a folder."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir())


def table(rows: list[Row]) -> str:
    """Return rows as a text table."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    lines = [columns, *([row.get(name, "") for name in columns] for row in rows)]
    widths = [max(len(line[k]) for line in lines) for k in range(len(columns))]
    return "\n".join("  ".join(map(str.ljust, line, widths)).rstrip() for line in lines)


def main(versions: list[str]) -> None:
    """Build, check and try; end with exit code 1 where anything is wrong."""
    if unknown := set(versions) - set(supported()):
        sys.exit(f"Python {', '.join(sorted(unknown))}: not among those of pyproject.toml, {', '.join(supported())}")
    for old in DIST.glob("dynident-*.whl"):
        old.unlink()
    sdist, wheel = build(DIST)
    output(sys.executable, "-P", ROOT / "tools" / "wheels.py", wheel)
    wheels = sorted(DIST.glob("dynident-*.whl"))
    release = wheel.name.split("-")[1]
    known = tracked()
    wrong = [f"{sdist.name}: {fault}" for fault in sdist_faults(contents(sdist), known)]
    for one in wheels:
        wrong += [f"{one.name}: {fault}" for fault in wheel_faults(contents(one), known, release)]
        wrong += [f"{one.name}: {fault}" for fault in metadata_faults(one, release)]
    for path in (sdist, *wheels):
        print(f"{path.relative_to(ROOT)}: {len(contents(path))} files, {path.stat().st_size / 1e6:.2f} MB", flush=True)
    rows = []
    for version in versions or supported():
        for row in tried(version, sdist, release):
            print(", ".join(row.values()), flush=True)
            rows.append(row)
    print(f"\n{table(rows)}\n")
    end(wrong, rows, versions)


def end(wrong: list[str], rows: list[Row], asked: Iterable[str]) -> None:
    """Say what is wrong and what was not tried; exit code 1 where it matters."""
    absent = [row["Python"] for row in rows if row.get("installed") == "not found"]
    if absent:
        print(f"Not tried, because it is not on this machine: Python {', '.join(absent)}.")
    if changed := output("git", "status", "--porcelain").splitlines():
        print(f"Not what is committed: {len(changed)} files differ or are new. Publish from a clean clone.")
    failed = [f"Python {row['Python']}, {row['of']}: see above" for row in rows if row.get("result") == "FAILED"]
    failed += [f"Python {version}: not found" for version in absent if version in asked]
    if wrong or failed:
        sys.exit("\n".join(["Wrong:", *wrong, *failed]))
    print("All that was tried works.")


if __name__ == "__main__":
    main(sys.argv[1:])
