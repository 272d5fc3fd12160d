"""The smoothing spline beside its peers, with the kernel and without: python3 benchmarks/spline.py [N ...].

A row is the CPU time per sample and series, best of several, for fit and both derivatives at the samples, and how many
times that of a peer, which is measured within the same seconds. FITPACK and scipy are in SciPy; csaps is compared where
it is installed. R (smooth.spline with all knots) is not run: its figures, measured on a machine of this class, are in
``R_FIXED`` and ``R_GCV``.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import time
from collections.abc import Callable

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np

from dynident.kernel import kernel
from dynident.splines import GCV, Constraint, Fixed, Rule, smooth

LAM, SIGMA, COLUMNS = 1e-6, 1e-3, 7
R_FIXED, R_GCV = 720e-9, 2000e-9  # s a sample
SIZES = (300, 1_000, 4_001, 100_000, 1_000_000)


def signal(n: int, columns: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """sin t + 0.5 sin 3.1 t at 1 kHz with noise, or several of other speeds."""
    t, rng = np.arange(n) * 1e-3, np.random.default_rng(0)
    speeds = 1 + 0.2 * np.arange(columns)
    y = (
        np.sin(np.outer(t, speeds))
        + 0.5 * np.sin(3.1 * np.outer(t, speeds))
        + SIGMA * rng.standard_normal((n, columns))
    )
    return t, y if columns > 1 else y[:, 0]


def seconds(call: Callable[[], object], least: float = 0.3) -> float:
    """CPU time of a call, the best of at least two, or of those that fit into ``least`` seconds."""
    best, began, count = np.inf, time.process_time(), 0
    while count < 2 or time.process_time() - began < least:
        start = time.process_time()
        call()
        best, count = min(best, time.process_time() - start), count + 1
    return best


def ours(t: np.ndarray, y: np.ndarray, rule: Rule, sigma: float | None = None) -> np.ndarray:
    fit = smooth(t, y, rule, sigma=sigma)
    fit.derivative(1)
    return fit.derivative(2)


def fitpack(t: np.ndarray, y: np.ndarray) -> None:
    from scipy.interpolate import UnivariateSpline

    fit = UnivariateSpline(t, y, w=np.full(len(t), 1 / SIGMA), s=len(t))
    fit.derivative(1)(t)
    fit.derivative(2)(t)


def scipy_spline(t: np.ndarray, y: np.ndarray, lam: float | None) -> None:
    from scipy.interpolate import make_smoothing_spline

    fit = make_smoothing_spline(t, y, lam=lam)
    fit.derivative(1)(t)
    fit.derivative(2)(t)


def csaps_spline(t: np.ndarray, y: np.ndarray) -> None:
    from csaps import CubicSmoothingSpline

    fit = CubicSmoothingSpline(t, y, smooth=1 / (1 + LAM)).spline
    fit.derivative(1)(t)
    fit.derivative(2)(t)


def row(what: str, n: int, own: float, peers: dict[str, float]) -> None:
    """Print a row; all times in s a sample and series."""
    ratios = "  ".join(f"{other / own:7.1f} x {name} ({other * 1e9:.0f} ns)" for name, other in peers.items())
    path = kernel().level or "LAPACK"
    print(f"{path:<8} {what:<12} n = {n:>8}  {own * 1e9:8.1f} ns  {ratios}", flush=True)


def rows(n: int) -> None:
    t, y = signal(n)
    row(
        "S = n",
        n,
        seconds(lambda: ours(t, y, Constraint(), SIGMA)) / n,
        {"FITPACK": seconds(lambda: fitpack(t, y)) / n},
    )
    many, together = signal(n, COLUMNS)
    own = seconds(lambda: ours(many, together, Constraint(), SIGMA)) / n / COLUMNS
    singly = seconds(lambda: [ours(t, np.ascontiguousarray(x), Constraint(), SIGMA) for x in together.T]) / n / COLUMNS
    row(f"S = n, {COLUMNS}", n, own, {"one by one": singly})
    own, peers = seconds(lambda: ours(t, y, Fixed(lam=LAM))) / n, {}
    if importlib.util.find_spec("csaps"):
        peers["csaps"] = seconds(lambda: csaps_spline(t, y)) / n
    peers["scipy"] = seconds(lambda: scipy_spline(t, y, LAM), 0.0) / n
    row("lam fixed", n, own, peers | {"R, stated": R_FIXED})
    own, peers = seconds(lambda: ours(t, y, GCV())) / n, {}
    if n < 10_000:  # 400 us a sample
        peers["scipy"] = seconds(lambda: scipy_spline(t, y, None), 0.0) / n
    row("GCV", n, own, peers | {"R, stated": R_GCV})


def main() -> None:
    sizes = [int(word) for word in sys.argv[1:]] or SIZES
    for n in sizes:
        rows(n)
    if kernel().level:
        environment = {**os.environ, "DYNIDENT_KERNEL": "off"}
        subprocess.run([sys.executable, __file__, *map(str, sizes)], env=environment, check=True)


if __name__ == "__main__":
    main()
