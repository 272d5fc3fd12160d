"""A program that is killed at random moments, again and again: ``killed.py SEED TABLE``.

A study grows here by a few runs at a time, so that tables are merged as often as parts are written. What each attempt
finds of those before goes to standard output. The attempts are forked, before Polars has threads: they start at once.
"""

import os
import signal
import sys
import time
from pathlib import Path

import numpy as np

from dynident.apps.article import run_study
from dynident.apps.article.study import study_table
from dynident.estimators import Estimate
from dynident.files import row_store
from dynident.models.simulation import Recording
from dynident.runtime.jobs.cluster import code_version
from tests.apps.article.work import LEVELS, Mean, Still

KILLS, RUNS, STEP = 10, 40, 4


class Slow(Mean):
    """Slow enough for several parts in each step."""

    def estimate(self, recording: Recording) -> Estimate:
        time.sleep(5e-4)
        return super().estimate(recording)


METHODS = (Slow(), Mean("second"))


def attempt(path: Path) -> None:
    row_store.SAVE_EVERY = 0.005
    with study_table(path) as rows:
        os.write(1, f"{len(rows)}\n".encode())
    for runs in range(STEP, RUNS + 1, STEP):
        run_study([Still()], METHODS, LEVELS, runs, path=path)
    os.write(1, b"done\n")


def forked(path: Path) -> int:
    """Start an attempt; return its process when it begins."""
    reader, writer = os.pipe()
    child = os.fork()
    if not child:
        code = 1
        try:
            import polars  # noqa: F401 -- starts threads, so not before the fork

            os.write(writer, b".")
            attempt(path)
            code = 0
        finally:
            os._exit(code)
    os.close(writer)
    os.read(reader, 1)
    os.close(reader)
    return child


def main(seed: int, path: Path) -> None:
    """Take the time of a whole study, kill attempts at another, then let it end."""
    code_version()  # is remembered
    child, began = forked(path.with_name("whole.parquet")), time.monotonic()
    os.waitpid(child, 0)
    full, rng = time.monotonic() - began, np.random.default_rng(seed)
    for _ in range(KILLS):
        child = forked(path)
        time.sleep(rng.uniform(0.0, full / 6))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
    os.waitpid(forked(path), 0)


if __name__ == "__main__":
    main(int(sys.argv[1]), Path(sys.argv[2]))
