"""A study is a table: one row per fit, resumable, the same wherever it runs; a failure is a row."""

import os
import re
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from polars.testing import assert_frame_equal

from dynident.apps.article import FitOutcome, run_study, statistics
from dynident.apps.article.study import KEY, generator
from dynident.estimators import DataRank, Estimate, Residual
from dynident.estimators.notes import NotConverged, RankDeficient
from dynident.models.simulation import Recording
from dynident.runtime import InputError, ModelError, Step, progress_to
from dynident.runtime.jobs import Limits, local_workers
from dynident.runtime.jobs import cluster as software
from dynident.runtime.jobs.cluster import code_version
from dynident.runtime.kernel import Kernel
from tests.apps.article.work import HANGS, LEVELS, SEEN, TROUBLES, Mean, Still, without_seconds

ROOT = Path(__file__).parents[3]


def test_a_failed_fit_is_a_row() -> None:
    table = run_study([Still()], [Mean(breaks_above=2.0)], LEVELS, 30)
    failed = table.filter(pl.col("status") != "ok")
    assert 0 < len(failed) < 60
    assert set(failed["status"]) == {"failed"}
    assert set(failed["reason"]) == {"ValueError: too large"}
    assert failed["value"].list.len().sum() == 0
    test_statistics = statistics(table, 2)
    assert test_statistics.failed == len(failed)
    assert test_statistics.interval.shape == (60 - len(failed), 2, 2)
    assert len(test_statistics.estimates) == 60 - len(failed)


@dataclass(frozen=True)
class Sure:
    """Knows the position, and an interval for it that is not symmetric."""

    name: str = "sure"

    def estimate(self, recording: Recording) -> Estimate:
        ends = np.array([[1.5, 2.1], [3.1, 3.2]])
        value = np.array([2.0, 3.0])
        return Estimate(
            SEEN, value, np.eye(2), DataRank(2), Residual(np.ones(1), 50), (NotConverged(9, 0.5),), interval=ends
        )


def test_intervals_cover_or_do_not() -> None:
    table = run_study([Still()], [Sure(), Mean()], LEVELS, 4)
    sure, mean = (statistics(table.filter(method=name), 2) for name in ("sure", "mean"))
    assert sure.covered_share(np.array([2.0, 3.0])).tolist() == [1.0, 0.0]
    assert mean.covered_share(np.array([2.0, 3.0])).tolist() == [1.0, 1.0]  # two standard errors of one
    assert (sure.unsettled, mean.unsettled) == (8, 0)
    assert set(table.filter(method="sure")["reason"]) == {"NotConverged"}


@dataclass(frozen=True)
class Tied:
    """Notes that the rank is not full."""

    name: str = "tied"

    def estimate(self, recording: Recording) -> Estimate:
        return replace(Mean().estimate(recording), notes=(RankDeficient(1, 2),))


def test_what_gave_nothing_is_tried_again(tmp_path: Path) -> None:
    methods = [Mean(), Sure(), Tied(), Mean("failing", breaks_above=0.0)]
    first, again = (run_study([Still()], methods, LEVELS, 2, path=tmp_path / "study.parquet") for _ in range(2))
    kept = first.filter(first["seconds"] == again["seconds"])  # not measured again
    assert set(kept["status"]) == {FitOutcome.OK, FitOutcome.NOTED, FitOutcome.UNSETTLED}
    assert len(kept) == len(again.filter(pl.col("status") != FitOutcome.FAILED)) == len(again) - 4


def test_trouble_with_one_fit_leaves_the_others_unharmed(tmp_path: Path) -> None:
    """On the recordings of the higher noise one method raises, one hangs, one eats memory, and one ends its process."""
    methods, path = [Mean(), *TROUBLES], tmp_path / "study.parquet"
    with local_workers(2, ["tests.apps.article.work"]) as executor:
        table = run_study(
            [Still()], methods, LEVELS, 1, path=path, executor=executor, limits=Limits(seconds=1.0, memory=1.0)
        )
    low, high = (table.filter(level=level) for level in LEVELS)
    assert set(low["status"]) == {FitOutcome.OK}
    expected = [FitOutcome.OK, FitOutcome.FAILED, FitOutcome.TIMED_OUT, FitOutcome.OUT_OF_MEMORY, FitOutcome.DIED]
    assert high["status"].to_list() == expected
    assert high["value"].list.len().to_list() == [2, 0, 0, 0, 0]
    assert all(high["reason"][1:])
    assert statistics(high, 2).failed == 4
    well = [Mean(method.name) for method in methods]
    resumed = run_study([Still()], well, LEVELS, 1, path=path)
    assert_frame_equal(without_seconds(resumed), without_seconds(run_study([Still()], well, LEVELS, 1)))
    assert set(table.filter(status="ok")["seconds"]) <= set(resumed["seconds"])  # computed once


class Broken(Still):
    """An experiment that cannot be simulated."""

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        raise ModelError("no motion")


def test_a_recording_that_cannot_be_made_is_rows() -> None:
    table = run_study([Broken("broken"), Still()], [Mean(), Sure()], LEVELS, 1)
    assert set(table.filter(scenario="still")["status"]) == {"ok", "unsettled"}
    assert table.filter(scenario="broken")["status"].to_list() == ["failed"] * 4
    assert set(table.filter(scenario="broken")["reason"]) == {"ModelError: no motion"}


@pytest.mark.skipif(not hasattr(os, "fork"), reason="the system cannot fork")
def test_killed_at_any_moment_nothing_is_lost_and_nothing_computed_twice(tmp_path: Path) -> None:
    path = tmp_path / "study.parquet"
    done = subprocess.run(
        [sys.executable, "-m", "tests.apps.article.killed", "7", path],
        capture_output=True, text=True, timeout=HANGS, check=False, cwd=ROOT,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    full, first, *result, last = done.stdout.split()
    assert (full, first, last) == ("0", "done", "done")
    kept = [int(count) for count in result if count != "done"]
    assert kept == sorted(kept)
    assert kept[-1] > 0
    table, expected = (pl.read_parquet(file).sort(KEY) for file in (path, tmp_path / "whole.parquet"))
    assert_frame_equal(without_seconds(table), without_seconds(expected))
    assert sorted(path.name for path in tmp_path.iterdir()) == ["study.parquet", "whole.parquet"]


def test_noise_depends_on_seed_level_and_run_alone() -> None:
    first = generator(0, 0.1, 0).standard_normal(3)
    np.testing.assert_array_equal(first, generator(0, 0.1, 0).standard_normal(3))
    for other in ((1, 0.1, 0), (0, 0.2, 0), (0, 0.1, 1)):
        assert not np.array_equal(first, generator(*other).standard_normal(3))
    few = run_study([Still()], [Mean()], LEVELS[1:], 2)
    many = run_study([Still()], [Mean("other"), Mean()], LEVELS, 4).filter(level=0.2, method="mean")
    assert few["value"].to_list() == many["value"].to_list()[:2]


def test_rows_say_what_computed_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """The kernel and NumPy differ by rounding: a study does not go on with rows of the other."""
    assert set(run_study([Still()], [Mean()], LEVELS, 2)["version"]) == {code_version()}
    for level, expected in ((None, "numpy"), ("sse2", "kernel"), ("avx2", "kernel")):
        monkeypatch.setattr(software, "kernel", lambda level=level: Kernel(level, ""))
        code_version.cache_clear()
        assert code_version().rpartition(".")[2] == expected
    code_version.cache_clear()


def test_rows_of_another_version_are_computed_again(tmp_path: Path) -> None:
    path = tmp_path / "study.parquet"
    old = run_study([Still()], [Mean()], LEVELS, 2, path=path).with_columns(version=pl.lit("0.0.0"))
    old.write_parquet(path)
    steps: list[str] = []
    with progress_to(steps.append):
        run_study([Still()], [Mean()], LEVELS, 2, path=path)
    assert steps[0] == Step("fitting", 0, 4)
    assert len(pl.read_parquet(path)) == 8


def test_statistics_are_the_published_ones() -> None:
    """Eqs. (54) and (55) on numbers worked by hand."""
    values = [[1.0, 2.0], [3.0, 2.0], []]
    table = pl.DataFrame({"value": values, "std": values, "interval": 3 * [[]], "status": 3 * ["ok"]})
    result = statistics(table, 2)
    np.testing.assert_array_equal(result.mean, [2.0, 2.0])
    np.testing.assert_array_equal(result.variance, [2.0, 0.0])
    assert result.failed == 1
    test_statistics = statistics(table.head(1), 2)
    assert np.isnan(test_statistics.variance).all()
    none = statistics(table.tail(1), 2)
    assert np.isnan(none.mean).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.with_columns(status=pl.lit("good")), "'good' is no status"),
        (lambda table: table.with_columns(value=pl.lit([1.0, 2.0, 3.0])), "lists of 3 numbers in the column 'value'"),
        (lambda table: table.with_columns(interval=pl.lit([1.0])), "lists of 1 numbers in the column 'interval'"),
    ],
)
def test_a_table_that_no_study_wrote_is_refused(tmp_path: Path, change: Any, words: str) -> None:
    path = tmp_path / "study.parquet"
    run_study([Still()], [Mean()], LEVELS, 2, path=path)
    change(pl.read_parquet(path)).write_parquet(path)
    before = path.read_bytes()
    with pytest.raises(InputError, match=re.escape(words)):
        statistics(run_study([Still()], [Mean()], LEVELS, 2, path=path), 2)
    if "lists" not in words:
        assert path.read_bytes() == before
