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

from dynident.splines import smooth

SIGMA = 1e-3


def seconds(call: Callable[[], object], repeat: int) -> float:
    best = np.inf
    for _ in range(repeat):
        began = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - began)
    return best


def batch() -> None:
    t = np.arange(4001) * 1e-3
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
    "batch": batch,
    "memory": memory,
    "reproduce": reproduce,
    "size": size,
}
PARTS |= {name: script(name) for name in ("spline", "consistent", "maximum_likelihood", "closed_loop")}


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
