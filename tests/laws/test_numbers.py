"""The numbers stay: article, demo arm and measured robots, held to 12 digits while the code around them is moved.

``python -m tests.laws.test_numbers`` writes the numbers anew, where a change of the method is meant to change them.
Another processor or another version of NumPy rounds otherwise: there 4 digits are asked for, as the search for
physical parameters ends where it may.
"""

import json
import platform
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from threadpoolctl import threadpool_info

import dynident as dy
from dynident.apps.article import reproduce
from dynident.runtime.kernel import kernel
from tests.cli.commands import succeed
from tests.laws.real_robots import identify

ROOT = Path(__file__).parents[2]
NUMBERS = ROOT / "tests" / "data" / "numbers.json"
ROBOTS = ("lwr4", "panda", "tx40", "emps", "double_pendulum")


def machine() -> dict[str, str]:
    """What decides how sums are rounded."""
    blas = sorted({str(library.get("architecture")) for library in threadpool_info() if library["user_api"] == "blas"})
    return {
        "python": platform.python_version(), "numpy": np.__version__, "scipy": scipy.__version__,
        "blas": " ".join(blas), "kernel": str(kernel()),
    }  # fmt: skip


def article() -> dict[str, list[float]]:
    study = reproduce("tabulated", runs=3, seed=7)
    return {f"{case.method} {case.sigma_q2:g}": [*case.mean, *case.variance] for case in study.cases}


def demo(folder: Path) -> dict[str, list[float]]:
    succeed("demo", "--out", folder / "arm")
    return numbers_of(json.loads((folder / "arm" / "result" / "result.json").read_text()))


def numbers_of(result: dict[str, Any]) -> dict[str, list[float]]:
    """The numbers of a ``result.json``."""
    return {
        "value": [row["value"] for row in result["parameters"]],
        "std": np.sqrt(np.diag(np.array(result["estimate"]["covariance"], dtype=float))).tolist(),
        "errors": [validation["errors"]["relative_error"] for validation in result["validations"]],
    }


def cases() -> Mapping[str, Callable[[Path], dict[str, list[float]]]]:
    robots = {name: lambda folder, name=name: numbers_of(identify(folder, name)) for name in ROBOTS}
    return {"article": lambda _: article(), "demo": demo, **robots}


def digits(numbers: list[float], before: list[float]) -> float:
    """Return to how many digits numbers agree, those near zero as parts of the largest."""
    now, then = np.asarray(numbers), np.asarray(before)
    assert np.array_equal(np.isfinite(now), np.isfinite(then))
    now, then = now[np.isfinite(now)], then[np.isfinite(then)]
    scale = np.maximum(np.abs(then), 1e-3 * np.abs(then).max())
    worst = float(np.max(np.abs(now - then) / np.where(scale == 0, 1.0, scale)))
    return 16.0 if worst == 0 else -np.log10(worst)


def check_numbers(name: str, result: Mapping[str, list[float]]) -> None:
    """Compare numbers with those that are kept."""
    written = json.loads(NUMBERS.read_text())
    least = 12 if written["machine"] == machine() else 4
    assert result.keys() == written[name].keys()
    for part, before in written[name].items():
        assert digits(result[part], before) >= least, f"{part} of {name}"


def test_the_numbers_stay() -> None:
    """Those of the article; those of other cases in ``test_real_logs`` and ``test_tutorial``, which identify them
    anyway."""
    check_numbers("article", article())


def write() -> None:
    """Write the numbers of this machine."""
    with tempfile.TemporaryDirectory() as folder:
        made = {name: run(Path(folder)) for name, run in cases().items()}
    NUMBERS.write_text(json.dumps({"machine": machine(), "version": dy.__version__, **made}, indent=1) + "\n")


if __name__ == "__main__":
    write()
