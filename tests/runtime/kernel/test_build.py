"""The compilation: with each compiler there is, without one, and with those that fail."""

import ctypes
import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

import dynident
from dynident.runtime.kernel import build
from dynident.runtime.kernel.build import FILE, LEVELS, RECORD, BuildError, architecture, compilers, make, record

PACKAGE = Path(dynident.__file__).parent
TINY = """
#include "lanes.h"

/* Sums of products, one a lane of eight, and their sum in a fixed order: the same bits on every level. */
EXPORTED double API(product)(const double *a, const double *b, int64_t n) {
    lanes sums[8 / LANES] = {0};
    double total = 0.0;
    for (int64_t i = 0; i + 8 <= n; i += 8)
        for (int j = 0; j < 8 / LANES; j++) sums[j] += load(a + i + j * LANES) * load(b + i + j * LANES);
    for (int j = 0; j < 8; j++) total += sums[j / LANES][j % LANES];
    return total;
}
"""


@pytest.fixture
def tiny(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A kernel with one function; the folder it is compiled into."""
    sources, target = tmp_path / "sources", tmp_path / "package"
    sources.mkdir()
    target.mkdir()
    for name in ("lanes.h", "cpu.c"):
        shutil.copy(PACKAGE / "runtime" / "kernel" / name, sources)
    (sources / "tiny.c").write_text(TINY)
    monkeypatch.setattr(build, "FOLDER", sources)
    return target


def program(path: Path, lines: str) -> Path:
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)
    return path


def found() -> list[list[str]]:
    """The compilers of this machine, each once, under whichever name."""
    return list({os.path.realpath(command[0]): command for command in compilers()}.values())


posix = pytest.mark.skipif(os.name == "nt", reason="compilers are stood in for by shell scripts")
needs_compiler = pytest.mark.skipif(not found(), reason="there is no C compiler")


@needs_compiler
@pytest.mark.parametrize("command", found(), ids=" ".join)
def test_every_compiler_makes_a_library_whose_levels_give_the_same_bits(command: list[str], tiny: Path) -> None:
    make(tiny / FILE, command)
    assert (tiny / RECORD).read_text() == record((tiny / FILE).read_bytes())
    library = ctypes.CDLL(str(tiny / FILE))
    library.dynident_compiler.restype = ctypes.c_char_p
    assert library.dynident_compiler().startswith((b"GCC ", b"Clang "))
    a, b = np.random.default_rng(0).standard_normal((2, 1000))
    sums = (a * b).reshape(-1, 8).cumsum(axis=0)[-1].cumsum()[-1]
    for name, _, _ in LEVELS[architecture()][: library.dynident_best() + 1]:
        product = library[f"dynident_product_{name}"]
        product.restype, product.argtypes = ctypes.c_double, (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int64)
        assert product(a.ctypes.data, b.ctypes.data, a.size) == sums, name


@needs_compiler
def test_the_same_sources_give_the_same_bytes_wherever_they_are_compiled(tiny: Path, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    make(tiny / FILE)
    make(other / FILE)
    content = (tiny / FILE).read_bytes()
    assert content == (other / FILE).read_bytes()
    assert str(tmp_path).encode() not in content


def test_without_a_compiler_it_says_so(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tiny))
    monkeypatch.delenv("CC", raising=False)
    with pytest.raises(BuildError, match="there is no C compiler"):
        make(tiny / FILE)
    assert list(tiny.iterdir()) == []


@posix
def test_what_a_broken_compiler_says_is_said_and_the_old_library_stays(tiny: Path, tmp_path: Path) -> None:
    (tiny / FILE).write_bytes(b"old")
    broken = program(tmp_path / "broken", "echo 'no such header' >&2; exit 3")
    silent = program(tmp_path / "silent", "exit 3")
    nothing = program(tmp_path / "nothing", "exit 0")
    for command, said in ((broken, "no such header"), (silent, "ends with code 3"), (nothing, FILE), ("absent", "abs")):
        with pytest.raises(BuildError, match=said):
            make(tiny / FILE, [str(command)])
    assert [(path.name, path.read_bytes()) for path in tiny.iterdir()] == [(FILE, b"old")]


@posix
@pytest.mark.parametrize("end", ["wait", "exit 0"])
def test_a_compiler_that_hangs_is_ended_with_what_it_started(tiny: Path, tmp_path: Path, end: str) -> None:
    hanging = program(tmp_path / "hanging", f"sleep 600 & echo $! >> {tmp_path}/started; {end}")
    with pytest.raises(BuildError, match="took too long"):
        make(tiny / FILE, [str(hanging)], seconds=0.5)
    for number in map(int, (tmp_path / "started").read_text().split()):
        until = time.monotonic() + 10
        while runs(number):
            assert time.monotonic() < until, "it still runs"
            time.sleep(0.01)


def runs(number: int) -> bool:
    """Whether a process runs; one that has ended and that nobody waits for does not."""
    state = subprocess.run(["ps", "-o", "stat=", "-p", str(number)], capture_output=True, text=True).stdout
    return state.strip() != "" and not state.startswith("Z")


@posix
@needs_compiler
def test_another_compiler_stands_in_for_one_that_fails(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false --fast")
    make(tiny / FILE)
    assert (tiny / FILE).exists()


def test_a_command_in_cc_that_cannot_be_read_is_said(tiny: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc 'unfinished")
    with pytest.raises(BuildError, match='CC is "gcc \'unfinished": No closing quotation'):
        make(tiny / FILE)
