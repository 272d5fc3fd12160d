"""A slider that was identified, and what its sensors say afterwards: friction rises by a half at 40 s."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.cli.commands import configure, run, write_log

CHANGE = 40.0  # s
SETTINGS = ("--block", 1, "--baseline", 25)


def result(folder: Path) -> Path:
    """Identify the slider, and return the path of its result."""
    write_log(folder)
    done = run("identify", configure(folder), "--out", folder / "out")
    assert done.exit_code == 0, done.output
    return folder / "out" / "result.json"


def rows(seconds: float = 60.0, rate: float = 100.0) -> list[str]:
    """Return the lines of a text file, the names of the columns first."""
    t = np.arange(0, seconds, 1 / rate)
    x = 0.3 * np.sin(3 * t) + 0.1 * np.sin(1.7 * t)
    dx, ddx = 0.9 * np.cos(3 * t) + 0.17 * np.cos(1.7 * t), -2.7 * np.sin(3 * t) - 0.289 * np.sin(1.7 * t)
    rub = np.where(t < CHANGE, 1.0, 1.5)
    rng = np.random.default_rng(0)
    force = 5.0 * ddx + rub * (8.0 * dx + 3.0 * np.sign(dx)) + 0.5 + 0.3 * rng.standard_normal(len(t))
    x = x + 1e-5 * rng.standard_normal(len(t))
    return [
        "time,pos,force",
        *(f"{a!r},{b!r},{c!r}" for a, b, c in zip(t.tolist(), x.tolist(), force.tolist(), strict=True)),
    ]
