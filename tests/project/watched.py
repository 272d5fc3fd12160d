"""A slider that was identified, and what its sensors say afterwards: friction rises by a half at 40 s."""

from pathlib import Path

import numpy as np

from tests.cli.commands import configure, run, write_log

CHANGE, RATE = 40.0, 100.0  # s, Hz
SETTINGS = ("--block", 1, "--baseline", 25)


def result(folder: Path) -> Path:
    """Identify the slider, and return the path of its result."""
    write_log(folder)
    done = run("identify", configure(folder), "--out", folder / "out")
    assert done.exit_code == 0, done.output
    return folder / "out" / "result.json"


def samples(
    start: float, stop: float, rub: float | np.ndarray = 1.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return t (N) in s, positions (N, 1) and forces (N, 1) of the slider, to and fro without a period."""
    t = np.arange(round(start * RATE), round(stop * RATE)) / RATE
    x = 0.3 * np.sin(3 * t) + 0.1 * np.sin(1.7 * t)
    dx, ddx = 0.9 * np.cos(3 * t) + 0.17 * np.cos(1.7 * t), -2.7 * np.sin(3 * t) - 0.289 * np.sin(1.7 * t)
    rng = np.random.default_rng(seed)
    force = 5.0 * ddx + rub * (8.0 * dx + 3.0 * np.sign(dx)) + 0.5 + 0.3 * rng.standard_normal(len(t))
    return t, (x + 1e-5 * rng.standard_normal(len(t)))[:, None], force[:, None]


def rows(seconds: float = 60.0) -> list[str]:
    """Return the lines of a text file, the names of the columns first."""
    n = round(seconds * RATE)
    signals = samples(0.0, seconds, np.where(np.arange(n) < CHANGE * RATE, 1.0, 1.5))
    columns = zip(*(signal.ravel().tolist() for signal in signals), strict=True)
    return ["time,pos,force", *(f"{a!r},{b!r},{c!r}" for a, b, c in columns)]
