"""The loader: which library it takes, what it refuses, what it says; and all uses of the kernel under sanitizers."""

import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import pytest

import dynident
from dynident.runtime import ConfigError
from dynident.runtime.kernel import Kernel, build, function, kernel
from dynident.runtime.kernel.build import FILE, LEVELS, RECORD, BuildError, architecture, digest, make, record
from tests.robots import ARM

PACKAGE = Path(dynident.__file__).parent
loader = import_module("dynident.runtime.kernel")


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the library: the installed one, such as that of a wheel, else one that is compiled here."""
    folder = tmp_path_factory.mktemp("compiled")
    if loader._load_library()[0] is not None:
        for name in (FILE, RECORD):
            shutil.copy(PACKAGE / "runtime" / "kernel" / name, folder)
        return folder
    try:
        make(folder / FILE)
    except BuildError as error:
        pytest.skip(f"the kernel cannot be compiled here: {error}")
    return folder


@pytest.fixture
def installed(compiled: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder from which the kernel is loaded, as it was installed."""
    shutil.copytree(compiled, tmp_path / "kernel")
    monkeypatch.setattr(loader, "LIBRARY", tmp_path / "kernel" / FILE)
    monkeypatch.delenv(loader.VARIABLE, raising=False)
    forget()
    yield tmp_path / "kernel"
    monkeypatch.undo()
    forget()


def forget() -> None:
    loader._select_kernel.cache_clear()
    function.cache_clear()


def test_a_level_that_this_cpu_does_not_have_is_refused(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In place of this one, a CPU whose best level is the least."""
    least = loader._levels(loader._select_kernel()[0])[0]
    monkeypatch.setattr(loader, "_levels", lambda library: [least])
    for asked in ("avx512", "fast", "0"):
        monkeypatch.setenv(loader.VARIABLE, asked)
        forget()
        words = (
            f"the environment variable DYNIDENT_KERNEL is {asked!r}, but this CPU has {least}; unset it, or give off"
        )
        with pytest.raises(ConfigError, match=words):
            kernel()
        with pytest.raises(ConfigError):
            function("anything")


def test_off_is_numpy(installed: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(loader.VARIABLE, "OFF")
    forget()
    assert kernel() == Kernel(None, "DYNIDENT_KERNEL=off")
    assert str(kernel()) == "NumPy and LAPACK (DYNIDENT_KERNEL=off)"
    assert function("anything") is None


def replaced(folder: Path, content: bytes) -> None:
    (folder / FILE).write_bytes(content)


def of_other_sources(folder: Path) -> None:
    (folder / RECORD).write_text(record((folder / FILE).read_bytes()).replace(digest(), "0" * len(digest())))


def of_another_machine(folder: Path) -> None:
    """The file is what was compiled, but for something else."""
    replaced(folder, b"MZ and more")
    (folder / RECORD).write_text(record(b"MZ and more"))


DAMAGES = {
    "cut off": (lambda folder: replaced(folder, (folder / FILE).read_bytes()[:-4000]), "damaged"),
    "one bit": (lambda folder: replaced(folder, (folder / FILE).read_bytes()[:-1] + b"!"), "damaged"),
    "empty": (lambda folder: replaced(folder, b""), "damaged"),
    "other sources": (of_other_sources, "out of date: its sources have changed"),
    "another machine": (of_another_machine, "not to be loaded: "),
    "no library": (lambda folder: (folder / FILE).unlink(), "not compiled at installation"),
    "no record": (lambda folder: (folder / RECORD).unlink(), "not compiled at installation"),
    "a record of something else": (lambda folder: (folder / RECORD).write_bytes(b"\xff\0"), "out of date"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_numpy_serves_where_the_library_cannot_be_trusted(
    damage: str, installed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done, said = DAMAGES[damage]
    done(installed)  # type: ignore[no-untyped-call]
    assert kernel().level is None
    assert kernel().about.startswith(said)
    assert function("anything") is None
    monkeypatch.setenv(loader.VARIABLE, "avx2")
    forget()
    with pytest.raises(ConfigError, match=f"'avx2', but the kernel is {said}"):
        kernel()


def test_the_library_is_that_of_the_package_alone(tmp_path: Path) -> None:
    """Neither the folder where one stands nor a path of the system's loader has a say."""
    program = "from dynident.runtime import kernel; print(kernel.LIBRARY)"
    (tmp_path / FILE).write_bytes(b"")
    variables = os.environ | {"PYTHONPATH": str(PACKAGE.parent), "LD_LIBRARY_PATH": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, env=variables, capture_output=True, text=True, check=True
    )
    assert Path(done.stdout.strip()) == PACKAGE / "runtime" / "kernel" / FILE


def test_a_wrong_variable_ends_a_command_with_one_line() -> None:
    for words in (["--version"], ["schema", "config"]):
        done = subprocess.run(
            [sys.executable, "-m", "dynident", *words], env=os.environ | {"DYNIDENT_KERNEL": "fast"},
            capture_output=True, text=True,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (1, "")
        assert done.stderr.startswith("Error: the environment variable DYNIDENT_KERNEL is 'fast', but ")
        assert done.stderr.count("\n") == 1


USES = f"""
import os
import sys
from pathlib import Path

import numpy as np

empty = np.empty

def unset(shape, dtype=float, **how):
    # memory that was used before may hold anything
    array = empty(shape, dtype, **how)
    if array.dtype == float:
        array.fill(np.nan)
    return array

np.empty = unset
import dynident as dy
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.models.simulation.trace import Machine
from dynident.motion.splines import GCV, REML, Fixed
from dynident.runtime import kernel

bodies, rng = RigidBodies({ARM!r}), np.random.default_rng(0)
rusty = Model((bodies, Coulomb(bodies.joints), Viscous(bodies.joints)))
kernel.LIBRARY = Path(sys.argv[1])
for level in sys.argv[2:]:
    os.environ["DYNIDENT_KERNEL"] = level.replace("best", "")
    kernel._select_kernel.cache_clear()
    kernel.function.cache_clear()
    for n in (5, 7, 8, 9, 17, 300):
        t = np.cumsum(rng.uniform(0.5, 1.5, n)) * 0.01
        for k in (1, 2, 3, 5, 8, 9):
            y = np.sin(t)[:, None] + 0.01 * rng.standard_normal((n, k))
            for rule in (None, Fixed(lam=1e-9), GCV(), REML()):
                dy.smooth(t, y if k > 1 else y[:, 0], rule, sigma=0.01)(t[0], order=2)
    for n in (1, 2, 3, 5, 8, 9, 17):
        q, dq, ddq = rng.standard_normal((3, n, len(bodies.joints)))
        theta = np.ones(len(bodies.parameters))
        bodies.weighted_gradient(q, dq, ddq, bodies.regressor(q, dq, ddq))
        bodies.torque(q, dq, ddq, theta), bodies.partials(q, dq, ddq, theta)
        bodies.entries(q, dq, ddq, *np.nonzero(bodies.support))
        states = rng.standard_normal((2, 4, *q.shape))
        Machine(rusty, np.ones(len(rusty.parameters))).take_steps(*states, ddq, q, np.full(3, 1e-3))
        assert np.isfinite(states).all()
    print(kernel.kernel().level)
"""
LEAST = LEVELS[architecture()][0][0]


def use_all(library: Path, **variables: str) -> None:
    """Use the least level and the best of this CPU, in a process of their own."""
    variables["PYTHONPATH"] = str(PACKAGE.parent)
    words = [sys.executable, "-c", USES, str(library), LEAST, "best"]
    done = subprocess.run(words, env=os.environ | variables, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    least, best = done.stdout.split()
    assert least == LEAST
    assert best != "None"


def sanitizers() -> list[str]:
    """The libraries of GCC that must be loaded first; none where there are none."""
    if sys.platform != "linux" or shutil.which("gcc") is None:
        return []
    asked = (["gcc", f"-print-file-name={name}"] for name in ("libasan.so", "libubsan.so", "libstdc++.so.6"))
    result = [subprocess.run(words, capture_output=True, text=True).stdout.strip() for words in asked]
    return result if all(Path(path).is_absolute() for path in result) else []


# the addresses are looked at once, where they are used; what is wrong ends the process, by calls, which compile fast
SANITIZE = (
    "-fsanitize=address,undefined", "-fno-sanitize=null,object-size,pointer-overflow",
    "-fsanitize-undefined-trap-on-error", "--param", "asan-instrumentation-with-call-threshold=0",
)  # fmt: skip


def levels() -> list[tuple[str, int, tuple[str, ...]]]:
    """The levels that are run here: the least, and the best of this CPU; all where that is not known."""
    library, _ = loader._load_library()
    least, *others = LEVELS[architecture()]
    best = loader._levels(library)[-1] if library is not None else ""
    return [least, *([level for level in others if level[0] == best] or others)]


@pytest.mark.skipif(not sanitizers(), reason="there is no GCC with sanitizers, on Linux")
def test_sanitizers_find_nothing_in_all_uses(tmp_path: Path) -> None:
    """By a kernel that looks after its memory and its arithmetic."""
    with pytest.MonkeyPatch.context() as patch:  # a sixth of the time
        patch.setattr(build, "FLAGS", [flag.replace("-O3", "-O1") for flag in build.FLAGS])
        patch.setattr(build, "LEVELS", {architecture(): levels()})
        make(tmp_path / FILE, ["gcc", *SANITIZE])
    use_all(tmp_path / FILE, LD_PRELOAD=" ".join(sanitizers()), ASAN_OPTIONS="detect_leaks=0")
