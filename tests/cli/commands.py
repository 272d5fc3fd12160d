"""Commands, run on a recording and a configuration of a slider."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import yaml
from click.testing import CliRunner, Result

from dynident.cli import main


def run(*arguments: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in arguments])


def succeed(*arguments: object) -> Result:
    """Run a command that must end well."""
    done = run(*arguments)
    assert done.exit_code == 0, done.output
    return done


def refuse(*arguments: object, says: str | tuple[str, ...], code: int = 1) -> Result:
    """Run a command that must end with an exit code and these words, wherever lines break, and no traceback."""
    done = run(*arguments)
    assert done.exit_code == code, done.output
    for words in ("Error", *([says] if isinstance(says, str) else says)):
        assert " ".join(words.split()) in " ".join(done.output.split()), done.output
    assert "Traceback" not in done.output
    return done


def write_log(folder: Path, name: str = "log.csv", n: int = 2000, rate: float = 3.0, **changes: Any) -> Path:
    """A slider of 5 kg with friction, pushed to and fro at a ``rate`` (rad/s); ``changes`` replace columns."""
    t = np.arange(n) * 0.002
    x, dx, ddx = 0.3 * np.sin(rate * t), 0.3 * rate * np.cos(rate * t), -0.3 * rate**2 * np.sin(rate * t)
    force = 5.0 * ddx + 8.0 * dx + 3.0 * np.sign(dx) + 0.5
    rng = np.random.default_rng(0)
    columns = {"time": t, "pos": x + 1e-5 * rng.standard_normal(n), "force": force + 0.01 * rng.standard_normal(n)}
    pl.DataFrame({**columns, **changes}).write_csv(folder / name)
    return folder / name


def settings(**changes: Any) -> dict[str, Any]:
    """Sections of a configuration; of smoothing and time offset nothing is chosen by the data."""
    return {
        "model": "gallery:slider",
        "time": {"column": "time", "unit": "s"},
        "position": {"slider": {"column": "pos", "unit": "m"}},
        "torque": {"slider": {"column": "force", "unit": "N"}},
        "train": [{"file": "log.csv", "window": [0, 3]}],
        "validation": [{"file": "log.csv", "window": [3, 4]}],
        "smoother": {"kind": "spline"},
        "time_offset": 0,
        **changes,
    }


def configure(folder: Path, **changes: Any) -> Path:
    path = folder / "identify.yaml"
    path.write_text(yaml.safe_dump(settings(**changes)))
    return path
