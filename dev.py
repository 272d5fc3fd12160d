#!/usr/bin/env python3
"""Make .venv, install dynident into it and run one task; only the standard library is needed.

python3 dev.py demo [ARGS]   the article's study with its report (dynident reproduce)
python3 dev.py test [ARGS]   the test suite (pytest)
python3 dev.py lint          ruff, mypy, import-linter, the documentation
python3 dev.py docs          the documentation as a site, with the API, in site/ (mkdocs)
python3 dev.py bench [ARGS]  the benchmarks, with the peers they compare with
python3 dev.py mutate [ARGS] the share of small faults, put into the core one by one, that its tests notice (hours)
python3 dev.py robots        the robot files of two packages (300 MB), compared with Pinocchio and MuJoCo
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")
PYTHON = BIN / ("python.exe" if os.name == "nt" else "python")
EXTRAS = {
    "demo": "",
    "test": "dev",
    "lint": "dev,docs",
    "docs": "docs",
    "bench": "bench",
    "mutate": "dev",
    "robots": "dev,mujoco,xacro",
}
MUTANTS = "cosmic-ray==8.7.0"
# for their robot files; robosuite would need an older NumPy to run
ROBOT_FILES = ("example-robot-data==6.0.0", "robosuite==1.5.2")
ROBOT_TESTS = ("tests/laws/test_robot_packages.py", "tests/models/robot_file", "tests/io/test_xacro.py", "tests/export")
# by Python, not by the programs in BIN: those name the folder in which they were installed
IMPORTS = (PYTHON, "-c", "from importlinter.cli import lint_imports_command as lint; lint()", "--no-cache")
DOCS = (PYTHON, "-m", "mkdocs", "build", "--strict", "--quiet")


def run(*command: object) -> None:
    """Run a command from the project's root; end with its exit code where it fails."""
    code = subprocess.run([str(word) for word in command], cwd=ROOT).returncode
    if code:
        sys.exit(code)


def install(extra: str) -> None:
    """Install the package, editable, with one extra; at once if this was done before from the same files."""
    sources = [ROOT / "pyproject.toml", ROOT / "constraints.txt"]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sources) + str(ROOT).encode()).hexdigest()
    stamp = VENV / f"installed-{extra or 'base'}"
    if PYTHON.exists() and stamp.exists() and stamp.read_text() == digest:
        return
    print(f"Installing dynident into {VENV} (once; later calls start at once) ...", flush=True)
    if not PYTHON.exists() or subprocess.run([PYTHON, "-m", "pip", "--version"], capture_output=True).returncode:
        try:
            venv.create(VENV, with_pip=True, clear=True)
        except subprocess.CalledProcessError:
            sys.exit("This Python cannot make an environment with pip; on Debian and Ubuntu: apt install python3-venv")
    target = f".[{extra}]" if extra else "."
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    run(*pip, "--constraint", "constraints.txt", "--editable", target)
    stamp.write_text(digest)


def main(arguments: list[str]) -> None:
    """Run the task named first with the rest as its arguments."""
    if sys.version_info < (3, 11):  # noqa: UP036 - this file runs before pip can check
        sys.exit("dynident needs Python 3.11 or newer; this is " + sys.version.split()[0])
    if arguments[:1] in (["-h"], ["--help"]):
        print(__doc__)
        return
    if not arguments or arguments[0] not in EXTRAS:
        sys.exit(__doc__)
    task, rest = arguments[0], arguments[1:]
    install(EXTRAS[task])
    pip = (PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check")
    if task == "demo":
        run(PYTHON, "-m", "dynident", "reproduce", *(rest or ["--out", "demo-out"]))
    elif task == "test":
        run(PYTHON, "-m", "pytest", *(rest or ["-n", "2", "--dist", "worksteal"]))
    elif task == "lint":
        run(PYTHON, "-m", "ruff", "check", ".")
        run(PYTHON, "-m", "ruff", "format", "--check", ".")
        run(PYTHON, "-m", "mypy")
        run(*IMPORTS)
        run(*DOCS)
    elif task == "docs":
        run(*DOCS)
    elif task == "robots":
        run(*pip, "--no-deps", *ROBOT_FILES)
        run(PYTHON, "-m", "pytest", *ROBOT_TESTS, *rest)
    elif task == "mutate":
        run(*pip, "--constraint", "constraints.txt", MUTANTS)
        run(PYTHON, "benchmarks/mutation.py", *rest)
    else:
        run(PYTHON, "benchmarks/run.py", *rest)


if __name__ == "__main__":
    main(sys.argv[1:])
