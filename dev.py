#!/usr/bin/env python3
"""Make .venv, install dynident into it and run one task; only the standard library is needed.

python3 dev.py demo [ARGS]   identify a simulated robot arm from its URDF and two logs, into arm-out/ (dynident demo)
python3 dev.py run ...       any command of dynident, where you are: python3 dev.py run --help lists them
python3 dev.py test [ARGS]   the test suite (pytest); without ARGS what computes also without the compiled kernel
python3 dev.py lint          ruff, mypy, import-linter, the documentation
python3 dev.py docs          the documentation as a site, with the API, in site/ (mkdocs)
python3 dev.py bench [ARGS]  the benchmarks, with the peers they compare with
python3 dev.py mutate [ARGS] the share of small faults, put into the source one by one, that tests notice (an hour)
python3 dev.py robots        the robot files of two packages (300 MB), compared with Pinocchio and MuJoCo
python3 dev.py release       source distribution and the wheel without a kernel, in dist/, tried in a fresh environment
"""

from __future__ import annotations

import hashlib
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
import venv
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
EXTRAS = {"reproduce": "symbolic", "tune": "ui"}  # what single commands need, installed when they are called
PEERS = ("figaroh==1.0.2", "mujoco[sysid]==4.0.0")  # with twenty packages of their own
MUTANTS = ("cosmic-ray==8.7.0", "pytest-cov==7.1.0")
KERNEL = ROOT / "src" / "dynident" / "runtime" / "kernel"
# what the kernel computes, for the tests on NumPy and LAPACK
NUMERICAL = (
    *("tests/motion", "tests/models/test_recursion.py", "tests/models/test_rigid_bodies.py"),
    *(f"tests/laws/test_{name}.py" for name in ("certified", "models", "rigid_bodies", "smoothers")),
)
# for their robot files; robosuite would need an older NumPy to run
ROBOT_FILES = ("example-robot-data==6.0.0", "robosuite==1.5.2")
ROBOT_TESTS = (
    "tests/laws/test_robot_packages.py",
    "tests/models/robot_files",
    "tests/files/test_xml_text.py",
    "tests/project/export",
)
# by Python, not by the programs in BIN: those name the folder in which they were installed
IMPORTS = (PYTHON, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache")
DOCS = (PYTHON, "-m", "mkdocs", "build", "--strict", "--quiet")
DYNIDENT = (PYTHON, "-P", "-m", "dynident")  # -P: a numpy.py where the user stands is not imported
NEXT = """
Every command of dynident runs from here:
  {run} --help
Or activate the environment, and type `dynident` instead of `{run}`:
  {activate}"""


def run(*command: object, folder: Path | None = ROOT) -> None:
    """Run a command; end with its exit code where it fails. Ctrl-C, which it gets too, is for it to answer."""
    process = subprocess.Popen([str(word) for word in command], cwd=folder)
    while process.poll() is None:
        try:
            process.wait()
        except KeyboardInterrupt:
            continue
    if code := process.returncode:
        sys.exit(code if code > 0 else 128 - code)


def become(*command: object) -> None:
    """Run a command where the user stands, and end with it; signals and the terminal are its own."""
    if os.name == "nt":  # has no exec
        run(*command, folder=None)
    else:
        os.execv(str(command[0]), [str(word) for word in command])


def quoted(*words: object) -> str:
    """Return a command as the user's shell takes it."""
    texts = [str(word) for word in words]
    return subprocess.list2cmdline(texts) if os.name == "nt" else shlex.join(texts)


def called() -> str:
    """Return what calls this file from where the user stands: ``python3 dev.py``."""
    typed = sys.orig_argv[0]
    if Path(typed).name == typed:
        return quoted(typed, sys.argv[0])
    names = ("py", "python") if os.name == "nt" else ("python3", "python")
    return quoted(next(filter(runs_this, names), sys.executable), sys.argv[0])


def runs_this(name: str) -> bool:
    """Return whether a command is a Python that is new enough."""
    check = "import sys; sys.exit(sys.version_info < (3, 11))"
    return shutil.which(name) is not None and not subprocess.run([name, "-c", check], capture_output=True).returncode


def activation() -> str:
    """Return what activates the environment from where the user stands."""
    script = BIN / "activate"
    near = script.relative_to(ROOT) if Path.cwd() == ROOT else script
    return quoted(near) if os.name == "nt" else quoted("source", near)


def pip(*arguments: object) -> None:
    """Install with pip; what it says is shown where it fails, and line by line on a terminal."""
    # modules are compiled when they are first imported: a minute and 130 MB less
    command = (PYTHON, "-m", "pip", "install", "--no-compile", "--disable-pip-version-check", "--no-input", *arguments)
    said = []
    # for this installation and all later runs: whether the kernel is used is asked each time
    without = {name: value for name, value in os.environ.items() if name != "DYNIDENT_KERNEL"}
    with subprocess.Popen(
        [str(word) for word in command], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8",
        errors="replace", env=without,
    ) as process:  # fmt: skip
        for line in process.stdout or ():
            said.append(line)
            if sys.stderr.isatty():
                print(f"\r  {line.strip()[:74]:74}", end="", file=sys.stderr, flush=True)
    if sys.stderr.isatty():
        print(f"\r{'':76}\r", end="", file=sys.stderr)
    if process.returncode:
        sys.exit("".join(said[-20:]) + "pip could not install this; its errors are above.")


def digest() -> str:
    """Return what tells an installation from the same files in the same place."""
    sources = [ROOT / "pyproject.toml", ROOT / "constraints.txt", ROOT / "hatch_build.py"]
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources) + str(ROOT).encode()).hexdigest()


def requirements(words: list[str]) -> list[str]:
    """Return what pip is to install for extras and groups: the groups are read here, as only pip 25.1 knows them."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    groups = settings["dependency-groups"]
    extras = ",".join(word for word in words if word not in groups)
    grouped = [requirement for word in words for requirement in groups.get(word, ())]
    return ["--editable", f".[{extras}]" if extras else ".", *grouped]


def install(needs: str) -> None:
    """Install the package, editable, with extras and groups; at once if this was done before from the same files."""
    words = [word for word in needs.split(",") if word]
    stamp = VENV / f"installed-{needs or 'base'}"
    if PYTHON.exists() and stamp.exists() and stamp.read_text() == digest():
        return
    size = "once" if words else "about 0.4 GB, once"
    print(f"Installing dynident into {VENV} ({size}) ...", file=sys.stderr, flush=True)
    if not PYTHON.exists() or subprocess.run([PYTHON, "-m", "pip", "--version"], capture_output=True).returncode:
        try:
            venv.create(VENV, with_pip=True, clear=True)
        except subprocess.CalledProcessError:
            sys.exit("This Python cannot make an environment with pip; on Debian and Ubuntu: apt install python3-venv")
    pip("--constraint", "constraints.txt", *requirements(words))
    stamp.write_text(digest())


def kernel_digest() -> str:
    """Return what tells the sources of the kernel from others."""
    sources = sorted(path for path in KERNEL.glob("*") if path.suffix in (".c", ".h") or path.name == "build.py")
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()


def compile_kernel() -> None:
    """Compile the kernel, if its sources have changed since; where that fails, say so once: NumPy serves."""
    stamp, now = VENV / "kernel", kernel_digest()
    if not (stamp.exists() and stamp.read_text() == now):
        subprocess.run([PYTHON, KERNEL / "build.py"])
        stamp.write_text(now)


def install_extra(arguments: list[str]) -> None:
    """Install what a command needs beyond others: servos are simulated in MuJoCo."""
    if extra := "mujoco" if "--servo" in arguments else EXTRAS.get(arguments[0] if arguments else ""):
        install(extra)


def demo(arguments: list[str]) -> None:
    """Identify the arm that comes with dynident, where the user stands; say what to type next."""
    install_extra(arguments)
    os.environ["DYNIDENT_COMMAND"] = f"{called()} run"
    run(*DYNIDENT, "demo", *arguments, folder=None)
    if {"-h", "--help"} & set(arguments):
        return
    print(NEXT.format(run=f"{called()} run", activate=activation()))


def dynident(arguments: list[str]) -> None:
    """Run a command of dynident where the user stands, with what it needs beyond others."""
    install_extra(arguments)
    os.environ["DYNIDENT_COMMAND"] = f"{called()} run"
    become(*DYNIDENT, *arguments)


def test(arguments: list[str]) -> None:
    """Run the tests that are named; else all of them, in two processes, and what computes again without the kernel."""
    if os.environ.pop("PYTHONDONTWRITEBYTECODE", ""):  # the tests start some hundred processes: compile for them once
        os.environ["PYTHONPYCACHEPREFIX"] = str(VENV / "bytecode")
    if arguments:
        return run(PYTHON, "-m", "pytest", *arguments)
    # by file, so that what the tests of one share is made once; in their order, the longest of which are not the last
    two = ("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder")
    run(PYTHON, "-m", "pytest", *two)
    asked = "import sys; from dynident.runtime.kernel import kernel; sys.exit(not kernel().level)"
    if subprocess.run([PYTHON, "-c", asked]).returncode:
        return print("All of this ran on NumPy and LAPACK: the compiled kernel was not tested.")
    os.environ["DYNIDENT_KERNEL"] = "off"
    return run(PYTHON, "-m", "pytest", *two, *NUMERICAL)


def lint(_: list[str]) -> None:
    """Run the linters, and build the documentation strictly."""
    run(PYTHON, "-m", "ruff", "check", ".")
    run(PYTHON, "-m", "ruff", "format", "--check", ".")
    run(PYTHON, "-m", "mypy")
    run(*IMPORTS)
    run(*DOCS)


def docs(_: list[str]) -> None:
    """Build the documentation as a site."""
    run(*DOCS)


def bench(arguments: list[str]) -> None:
    """Run the benchmarks, with the peers where they install."""
    try:
        pip("--constraint", "constraints.txt", *PEERS)
    except SystemExit as error:
        print(error, file=sys.stderr)
    run(PYTHON, "benchmarks/run.py", *arguments)


def mutate(arguments: list[str]) -> None:
    """Try whether the tests notice small faults."""
    pip("--constraint", "constraints.txt", *MUTANTS)
    run(PYTHON, "benchmarks/mutation.py", *arguments)


def robots(arguments: list[str]) -> None:
    """Compare the robot files of two packages with Pinocchio and MuJoCo."""
    pip("--no-deps", *ROBOT_FILES)
    run(PYTHON, "-m", "pytest", *ROBOT_TESTS, *arguments)


def release(_: list[str]) -> None:
    """Build the source distribution, and from it the wheel without a kernel; try that in a fresh environment."""
    dist = ROOT / "dist"
    shutil.rmtree(dist, ignore_errors=True)
    os.environ["DYNIDENT_KERNEL"] = "off"
    run(PYTHON, "-m", "hatchling", "build", "--target", "sdist")
    (sdist,) = dist.glob("*.tar.gz")
    run(PYTHON, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", dist, sdist)
    (wheel,) = dist.glob("*.whl")
    with tempfile.TemporaryDirectory() as place:
        venv.create(place, with_pip=True)
        python = Path(place, BIN.name, PYTHON.name)
        pip_install = (python, "-m", "pip", "install", "--quiet", "--constraint", ROOT / "constraints.txt")
        run(*pip_install, wheel)
        for words in (("--version",), ("demo",)):
            run(python, "-P", "-m", "dynident", *words, folder=Path(place))
        run(*pip_install, f"{wheel}[symbolic]")
        run(python, "-P", "-m", "dynident", "reproduce", "--runs", "2", "--out", "study-out", folder=Path(place))
    print(f"{sdist.name} and {wheel.name} are in {dist}, and work.")


# each with its extras and groups
TASKS: dict[str, tuple[str, Callable[[list[str]], None]]] = {
    "demo": ("", demo),
    "run": ("", dynident),
    "test": ("dev", test),
    "lint": ("dev,docs", lint),
    "docs": ("docs", docs),
    "bench": ("bench", bench),
    "mutate": ("dev", mutate),
    "robots": ("dev,xacro", robots),
    "release": ("dev", release),
}


def main(arguments: list[str]) -> None:
    """Run the task named first with the rest as its arguments."""
    if sys.version_info < (3, 11):  # noqa: UP036 - this file runs before pip can check
        sys.exit("dynident needs Python 3.11 or newer; this is " + sys.version.split()[0])
    if arguments[:1] in (["-h"], ["--help"]):
        print(__doc__)
        return
    if not arguments or arguments[0] not in TASKS:
        sys.exit(__doc__)
    extras, task = TASKS[arguments[0]]
    install(extras)
    compile_kernel()
    task(arguments[1:])


if __name__ == "__main__":
    try:
        main(sys.argv[1:])
    except KeyboardInterrupt:  # while something is installed; the next call goes on
        sys.exit(130)
