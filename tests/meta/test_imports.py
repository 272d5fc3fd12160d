"""What a command does not need it does not import: of a small log, half of the time would be that."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

CONFIG = """\
model: gallery:slider
time: { column: t, unit: s }
position: { slider: { column: q, unit: m } }
torque: { slider: { column: tau, unit: N } }
train: [ { file: monday.npz } ]
validation: [ { file: tuesday.npz } ]
"""
SLOW = {"scipy.signal", "scipy.stats", "scipy.ndimage", "scipy.interpolate"}  # 70 to 450 ms each
UNUSED = {"sympy", "plotly", "narwhals", "clarabel", "pinocchio"} | SLOW
HEAVY = {"numpy", "scipy", "sympy", "polars", "plotly", "pydantic", "jinja2", "pinocchio", "yaml", "rich"}
COMMANDS = {
    "--help; --version": HEAVY,
    "identify arm.yaml --out out": UNUSED | {"polars"},
    "predict out/result.json monday.npz --out torque.csv": UNUSED | {"scipy.optimize"},
    "check arm.yaml": UNUSED,
    "smooth monday.npz --time t --column q --out smoothed": UNUSED | {"scipy.optimize"},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A configuration with two recordings, and its result."""
    made = tmp_path_factory.mktemp("imports")
    (made / "arm.yaml").write_text(CONFIG)
    rng, t = np.random.default_rng(0), np.arange(800) * 0.0125
    for day, w in (("monday", 2.0), ("tuesday", 3.0)):
        dq, ddq = 0.3 * w * np.cos(w * t), -0.3 * w**2 * np.sin(w * t)
        tau = 5 * ddq + 8 * dq + 3 * np.sign(dq) + 0.5 + 0.1 * rng.standard_normal(len(t))
        np.savez(made / f"{day}.npz", t=t, q=0.3 * np.sin(w * t) + 1e-5 * rng.standard_normal(len(t)), tau=tau)
    return made


@pytest.mark.parametrize("typed", COMMANDS)
def test_a_command_imports_what_it_needs(folder: Path, typed: str) -> None:
    code = (
        "import sys\n"
        "from click.testing import CliRunner\n"
        "from dynident.cli import main\n"
        "for words in ' '.join(sys.argv[1:]).split(';'):\n"
        "    done = CliRunner().invoke(main, words.split())\n"
        "    assert done.exit_code == 0, done.output\n"
        "print(*sys.modules)"
    )
    words = [sys.executable, "-c", code, *typed.split()]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=folder)
    assert done.returncode == 0, done.stderr
    loaded = set(done.stdout.split())
    assert "dynident" in loaded
    assert not loaded & COMMANDS[typed]
