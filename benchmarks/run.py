"""Speed and memory beside the peers, in one run and with one BLAS thread: python3 dev.py bench [PART ...].

Parts: spline, memory, batch, reproduce, consistent, size, maximum_likelihood (7 minutes), closed_loop. Figures are the
best of several repetitions, so that a busy machine disturbs as little as possible; ratios compare figures taken within
the same seconds.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np

from dynident.splines import GCV, Constraint, Fixed, Rule, smooth

LAM = 1e-6  # in sum((g - y)^2) + lam * integral(g''^2)
SIGMA = 1e-3


def signal(n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """sin t + 0.5 sin 3.1 t at 1 kHz with noise; and its second derivative."""
    t = np.arange(n) * 1e-3
    noise = SIGMA * np.random.default_rng(0).standard_normal(n)
    return t, np.sin(t) + 0.5 * np.sin(3.1 * t) + noise, -np.sin(t) - 0.5 * 3.1**2 * np.sin(3.1 * t)


def seconds(call: Callable[[], object], repeat: int) -> float:
    best = np.inf
    for _ in range(repeat):
        began = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - began)
    return best


def ours(t: np.ndarray, y: np.ndarray, rule: Rule, sigma: float | None = None) -> np.ndarray:
    """Fit with refinement, and both derivatives at the samples."""
    fit = smooth(t, y, rule, sigma=sigma)
    fit.derivative(1)
    return fit.derivative(2)


def fitpack(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    from scipy.interpolate import UnivariateSpline

    fit = UnivariateSpline(t, y, w=np.full(len(t), 1 / SIGMA), s=len(t))
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def scipy_spline(t: np.ndarray, y: np.ndarray, lam: float | None) -> np.ndarray:
    from scipy.interpolate import make_smoothing_spline

    fit = make_smoothing_spline(t, y, lam=lam)
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def csaps_spline(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    from csaps import CubicSmoothingSpline

    fit = CubicSmoothingSpline(t, y, smooth=1 / (1 + LAM)).spline
    fit.derivative(1)(t)
    return np.asarray(fit.derivative(2)(t))


def row(what: str, n: int, own: float, peer: str = "", other: float = np.nan, error: str = "") -> None:
    ratio = f"{other / own:7.1f} x faster than {peer} ({other / n * 1e9:.0f} ns)" if peer else ""
    print(f"{what:<28} n = {n:>8}  {own / n * 1e9:8.1f} ns/sample  {ratio}  {error}", flush=True)


def spline() -> None:
    for n in (4_001, 100_000, 1_000_000):
        t, y, second = signal(n)
        repeat = 3 if n < 1_000_000 else 1
        middle = slice(n // 10, -n // 10)

        def error(found: np.ndarray, middle: slice = middle, second: np.ndarray = second) -> float:
            return float(np.linalg.norm((found - second)[middle]) / np.linalg.norm(second[middle]))

        own = seconds(lambda: ours(t, y, Constraint(), SIGMA), 3)  # noqa: B023
        other = seconds(lambda: fitpack(t, y), repeat)  # noqa: B023
        words = f"error of g'': {error(ours(t, y, Constraint(), SIGMA)):.4f}, FITPACK {error(fitpack(t, y)):.4f}"
        row("S = n", n, own, "FITPACK", other, words)
        own = seconds(lambda: ours(t, y, Fixed(lam=LAM)), 5)  # noqa: B023
        row("lam fixed", n, own, "csaps", seconds(lambda: csaps_spline(t, y), repeat))  # noqa: B023
        row("lam fixed", n, own, "scipy", seconds(lambda: scipy_spline(t, y, LAM), repeat))  # noqa: B023
        own = seconds(lambda: ours(t, y, GCV()), 3)  # noqa: B023
        if n <= 100_000:
            row("GCV", n, own, "scipy", seconds(lambda: scipy_spline(t, y, None), 1))  # noqa: B023
        else:
            row("GCV", n, own)


def batch() -> None:
    t, _, _ = signal(4001)
    y = np.sin(t)[:, None] + SIGMA * np.random.default_rng(1).standard_normal((4001, 300))
    together = seconds(lambda: smooth(t, y, sigma=SIGMA), 3)
    singly = seconds(lambda: [smooth(t, y[:, k], sigma=SIGMA) for k in range(300)], 3)
    print(
        f"batch of 300 x 4001: {together:.3f} s, 300 single calls {singly:.3f} s: {singly / together:.2f} x", flush=True
    )


def memory() -> None:
    """n = 1e7 in a process of its own, for its peak memory."""
    code = (
        "import numpy as np, resource, time\n"
        "from dynident.splines import smooth\n"
        "n = 10_000_000\n"
        "t = np.arange(n) * 1e-3\n"
        "y = np.sin(t) + 0.5 * np.sin(3.1 * t) + 1e-3 * np.random.default_rng(0).standard_normal(n)\n"
        "began = time.perf_counter()\n"
        "fit = smooth(t, y, sigma=1e-3); fit.derivative(1); fit.derivative(2)\n"
        "print(f'n = 1e7: {time.perf_counter() - began:.1f} s, S / n - 1 = {fit.S / n - 1:.1e}, peak memory "
        "{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB')\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def reproduce() -> None:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "dynident", "reproduce"], check=True, stdout=subprocess.DEVNULL)
    print(f"dynident reproduce (30 runs): {time.perf_counter() - began:.2f} s", flush=True)
    began = time.perf_counter()
    subprocess.run([sys.executable, "-m", "dynident", "--help"], check=True, stdout=subprocess.DEVNULL)
    print(f"dynident --help: {time.perf_counter() - began:.2f} s", flush=True)


def script(name: str) -> Callable[[], None]:
    """Return the part that is a file of its own."""

    def run() -> None:
        subprocess.run([sys.executable, Path(__file__).with_name(f"{name}.py")], check=True)

    return run


def size() -> None:
    subprocess.run([sys.executable, Path(__file__).with_name("size.py"), "make"], check=True)


PARTS = {
    "spline": spline,
    "batch": batch,
    "memory": memory,
    "reproduce": reproduce,
    "size": size,
}
PARTS |= {name: script(name) for name in ("consistent", "maximum_likelihood", "closed_loop")}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help="what to run; all, where none is named")
    names = parser.parse_args().parts
    wrong = [name for name in names if name not in PARTS]
    if wrong:
        parser.error(f"unknown part {wrong[0]!r}; known: {', '.join(PARTS)}")
    for name in names or PARTS:
        PARTS[name]()
    print(f"peak memory of this process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.2f} GiB")


if __name__ == "__main__":
    main()
