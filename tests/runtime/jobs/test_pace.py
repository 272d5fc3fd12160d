"""Sizes of batches, by what jobs take and what a batch costs besides."""

from __future__ import annotations

import pytest

from dynident.runtime.jobs import engine as pace
from dynident.runtime.jobs.engine import Pace


def run(jobs: int, seconds: float, lost: float, workers: int = 2) -> list[int]:
    """The sizes of all batches of equal jobs, one after the other."""
    found, sizes = Pace(workers), []
    while jobs:
        size = found.size(jobs)
        sizes.append(size)
        jobs -= size
        found.record_batch(len(sizes) % workers, size, size * seconds, lost if len(sizes) > workers else None)
    return sizes


@pytest.mark.parametrize("seconds", [1e-3, 0.02, 0.1])
@pytest.mark.parametrize("lost", [1e-4, 0.01, 0.1, 0.4])
def test_little_is_lost(seconds: float, lost: float) -> None:
    sizes = run(100_000, seconds, lost)
    work = sum(sizes) * seconds
    expected = max(0.2, 19 * lost)
    most = max(sizes)
    assert most <= pace.MAX_BATCH_JOBS
    assert most == pace.MAX_BATCH_JOBS or most * seconds == pytest.approx(expected, abs=seconds)
    if most < pace.MAX_BATCH_JOBS:
        assert len(sizes) * lost < 0.06 * work


def test_sizes_begin_with_one_and_double() -> None:
    assert run(10_000, 1e-3, 1e-3)[:8] == [1, 2, 4, 8, 16, 32, 64, 128]


def test_workers_end_at_about_the_same_time() -> None:
    sizes = run(1000, 0.01, 0.5)
    assert sum(sizes) == 1000
    assert sizes[-1] == 1
    assert all(size <= 1 + sum(sizes[number:]) / 4 for number, size in enumerate(sizes))


def test_long_jobs_go_alone() -> None:
    assert run(20, 30.0, 5.0) == [1] * 20


def test_one_slow_answer_changes_nothing() -> None:
    found = Pace(1)
    for number in range(40):
        found.record_batch(0, 10, 0.1, 60.0 if number == 20 else 1e-3)
    assert found.size() == 20


def test_more_workers_than_expected() -> None:
    found = Pace(2)
    assert found.ahead == 4
    for number in range(50):
        found.record_batch(number, 1, 1.0, None)
    assert found.ahead == 100
