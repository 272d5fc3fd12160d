"""What studies and fleets cost, and how far they scale: python3 benchmarks/scaling.py [PART ...] [--page].

Parts: stages (of a run, by CPU time), spread (the same study here, on processes, on Dask), rows (what the process that
asks does for each), scheduler (a real Dask scheduler under load: its workers only wait), fleet (logs of an arm). Dask
runs on the loopback interface. --page keeps the figures in out/scaling.json and writes the tables of
scaling_measured.md; --draw does without measuring. The load of the machine is beside the figures.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from page_tables import read_figures, write_figures
from scaling_cluster import cluster, cpu_of
from scaling_jobs import Still, Wait
from scaling_page import FIGURES, draw

import dynident
from dynident.apps.article import LEVELS, METHODS, SCENARIOS, ArmScenario, SmoothAndFit, run_study
from dynident.apps.article.article import N_SAMPLES, SAMPLING_PERIOD
from dynident.apps.article.study import KEY, study_table
from dynident.cli.demo import PRELOADED_MODULES
from dynident.estimators import LeastSquares, Problem
from dynident.models.lagrangian import two_link_arm
from dynident.regression import Regression, factorise
from dynident.runtime.jobs import local_workers, run_jobs

ARTICLE = ("raw", "filtered", "spline")
Figures = dict[str, Any]


def cpu() -> float:
    """CPU time (s) of this process."""
    return time.process_time()


def timed(what: Callable[[], Any], repeats: int) -> float:
    """Return CPU seconds of 1000 calls."""
    what()
    began = cpu()
    for _ in range(repeats):
        what()
    return 1000.0 * (cpu() - began) / repeats


def stages(repeats: int = 100) -> Figures:
    """CPU seconds of 1000 runs by stage, for each method of the article; the motion is simulated once for a study."""
    scenario = SCENARIOS["tabulated"]
    anew = ArmScenario("anew", "", scenario.amplitudes, scenario.sigma_tau)
    began = cpu()
    _ = anew.truth
    result: Figures = {"simulate, once": round(cpu() - began, 3), "samples": N_SAMPLES, "period": SAMPLING_PERIOD}
    rng = np.random.default_rng(0)
    record = scenario.record(LEVELS[1], rng)
    shared = {"noise": timed(lambda: scenario.record(LEVELS[1], rng), repeats), "write": written(2000)}
    model = two_link_arm()
    for name in ARTICLE:
        method = METHODS[name]
        assert isinstance(method, SmoothAndFit)
        motions = (method.motion(record),)
        linear = Regression(model, motions)
        problem = Problem(model, motions, linear)
        _ = linear.triangular_factors
        own = {
            "smooth": timed(partial(method.motion, record), repeats),
            "regress": timed(partial(factorised, linear), repeats),
            "fit": timed(partial(LeastSquares(), problem), repeats),
        }
        result[name] = {key: round(value, 3) for key, value in (shared | own).items()}
    likely = METHODS["ml"]
    result["ml"] = {"all": round(timed(lambda: likely.estimate(record), 3), 1)}
    return result


def factorised(linear: Regression) -> Any:
    return factorise(linear.entries(), linear.model.structure)


def written(rows: int) -> float:
    """CPU seconds of 1000 rows, from the store to the merged table."""
    numbers = np.random.default_rng(0).standard_normal((rows, 7))
    began = cpu()
    with TemporaryDirectory() as place, study_table(Path(place) / "study.parquet") as store:
        for k, value in enumerate(numbers):
            key = dict(zip(KEY, ("tabulated", "spline", 1e-6, k, 0, "0.1.0"), strict=True))
            more = {"status": "ok", "reason": "", "seconds": 0.01, "value": value.tolist(), "std": value.tolist()}
            store.add([key | more | {"interval": []}])
    return 1000.0 * (cpu() - began) / rows


@contextmanager
def on_dask() -> Iterator[Executor]:
    """A cluster of this machine with two workers, for as long as it is needed."""
    with cluster(workers=2, threads=1) as two, two.executor(PRELOADED_MODULES) as executor:
        yield executor


PLACES: dict[str, Callable[[], AbstractContextManager[Executor | None]]] = {
    "serial": nullcontext,
    "2 processes": partial(local_workers, 2, PRELOADED_MODULES),
    "Dask, 2 workers": on_dask,
}


def spread(runs: int = 300) -> Figures:
    """The article's study by one process, two, and Dask: seconds, and CPU of all that take part."""
    result: Figures = {"fits": runs * len(LEVELS) * len(ARTICLE), "places": {}}
    arm, methods = [SCENARIOS["tabulated"]], [METHODS[name] for name in ARTICLE]
    _ = arm[0].truth
    for name, place in PLACES.items():
        with TemporaryDirectory() as folder, place() as executor:
            began = time.perf_counter()
            run_study(arm, methods, LEVELS, 60, 1, executor=executor)  # workers are warm
            start, began, load = time.perf_counter() - began, time.perf_counter(), os.getloadavg()[0]
            own, others = cpu(), cpu_of(os.getpid(), children=True)
            run_study(arm, methods, LEVELS, runs, path=Path(folder) / "study.parquet", executor=executor)
            row = {
                "first": start, "seconds": time.perf_counter() - began, "own CPU": cpu() - own,
                "CPU of workers": cpu_of(os.getpid(), children=True) - others, "load": load,
            }  # fmt: skip
        result["places"][name] = {key: round(value, 2) for key, value in row.items()}
        print(name, result["places"][name], flush=True)
    return result


def rows(count: int = 20_000) -> Figures:
    """CPU seconds of the process that asks, for 1000 runs of a study of which the fits cost nothing, by place."""
    result: Figures = {}
    for name, place in PLACES.items():
        with TemporaryDirectory() as folder, place() as executor:
            list(run_jobs(Wait(0.0), range(200), executor))
            before = cpu()
            run_study([Still()], [Still()], [1.0], count, path=Path(folder) / "rows.parquet", executor=executor)
            result[name] = {"own CPU": round(1000.0 * (cpu() - before) / count, 3)}
        print(name, result[name], flush=True)
    return result


def scheduler(slots: Sequence[int] = (16, 256), seconds: Sequence[float] = (0.03, 0.3, 3.0)) -> Figures:
    """A real scheduler whose workers wait as long as a fit takes: the share of their time in jobs, CPU for each job."""
    result: Figures = {"tiny": tiny(), "waiting": []}
    for many in slots:
        with cluster(workers=min(2, many), threads=max(1, many // 2)) as some, some.in_threads(many) as executor:
            for second in seconds:
                count = int(many * min(max(8.0 / second, 4.0), 20_000 / many))
                list(run_jobs(Wait(0.0), range(100 * many), executor))  # all workers have answered
                began, before, its = time.perf_counter(), cpu(), some.scheduler_cpu()
                done = sum(1 for _ in run_jobs(Wait(second), range(count), executor))
                took = time.perf_counter() - began
                row = {
                    "slots": many, "job": second, "jobs": done, "share": round(done * second / (many * took), 3),
                    "client": round(1e6 * (cpu() - before) / done, 1),
                    "scheduler": round(1e6 * (some.scheduler_cpu() - its) / done, 1),
                }  # fmt: skip
                result["waiting"].append(row)
                print(row, flush=True)
    return result


def tiny(tasks: int = 4000) -> Figures:
    """Many tasks that do nothing, each by itself, without the batches of run_jobs: CPU (us) for each task."""
    with cluster(workers=2, threads=1) as two, two.in_threads(2) as executor:
        list(executor.map(abs, range(200)))
        began, before, its = time.perf_counter(), cpu(), two.scheduler_cpu()
        for future in [executor.submit(abs, k) for k in range(tasks)]:
            future.result()
        took = time.perf_counter() - began
        return {
            "a second": round(tasks / took),
            "client": round(1e6 * (cpu() - before) / tasks),
            "scheduler": round(1e6 * (two.scheduler_cpu() - its) / tasks),
        }


def fleet() -> Figures:
    """Logs of the arm in the box: CPU seconds of a log, for a worker and for who asks, with reports and without."""
    result: Figures = {}
    with TemporaryDirectory() as place:
        folder = Path(place)
        joints, samples = prepared(folder, 1)
        began = cpu()
        dynident.fleet(folder / "fleet.yaml", folder / "out")
        result |= {"joints": joints, "samples": samples, "choice, once": round(cpu() - began, 2)}
        for name, words in (("with reports", ""), ("without", "reports: false\n")):
            prepared(folder, 1, words)
            result[name] = costs_of_a_log(folder)
            print(name, result[name], flush=True)
    return result


def costs_of_a_log(folder: Path, few: int = 4, more: int = 12) -> Figures:
    """CPU seconds of a log more, so that what is done once for all does not count, and megabytes of its files."""
    costs = []
    for old in (folder / "out" / "runs", folder / "logs"):
        shutil.rmtree(old, ignore_errors=True)
    for count in (few, more):
        prepared(folder, count)
        with local_workers(2, ("dynident.apps.fleets.fit", "dynident.report.identification.report")) as executor:
            before, others = cpu(), cpu_of(os.getpid(), children=True)
            dynident.fleet(folder / "fleet.yaml", folder / "out", executor=executor, rerun=True)
            costs.append((cpu() - before, cpu_of(os.getpid(), children=True) - others))
    own, workers = ((b - a) / (more - few) for a, b in zip(*costs, strict=True))
    size = sum(path.stat().st_size for path in folder.glob("out/runs/**/*") if path.is_file()) / more / 1e6
    return {"own CPU": round(own, 4), "CPU of worker": round(workers, 2), "MB": round(size, 2)}


def prepared(folder: Path, logs: int, settings: str | None = None) -> tuple[int, int]:
    """Write a fleet of some robots with recordings of the arm in the box; return its joints, and samples of a log."""
    from click.testing import CliRunner

    from dynident.cli import main as command

    def typed(*words: str) -> None:
        done = CliRunner().invoke(command, [*words, "--quiet"])
        if done.exit_code:
            raise SystemExit(done.output)

    if not (folder / "arm").exists():
        typed("demo", "--files", "--out", str(folder / "arm"))
        log, config = folder / "arm" / "monday.parquet", folder / "robot.yaml"
        typed("init", str(folder / "arm" / "arm.urdf"), str(log), "--out", str(config))
    if settings is not None or not (folder / "fleet.yaml").exists():
        text = "recipe: robot.yaml\nlogs: logs/{robot}/{date}.parquet\n"
        (folder / "fleet.yaml").write_text(text + (settings or ""), encoding="utf-8")
    for k in range(logs):
        place = folder / "logs" / f"robot{k % 4}"
        place.mkdir(parents=True, exist_ok=True)
        shutil.copy(folder / "arm" / "monday.parquet", place / f"2026-01-{1 + k // 4:02d}.parquet")
    import polars as pl

    table = pl.scan_parquet(folder / "arm" / "monday.parquet")
    joints = len(dynident.read_robot(folder / "arm" / "arm.urdf").joints)
    return joints, int(table.select(pl.len()).collect().item())


PARTS: dict[str, Callable[[], Figures]] = {
    "stages": stages, "spread": spread, "rows": rows, "scheduler": scheduler, "fleet": fleet,
}  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument(
        "--page", action="store_true", help="keep the figures for benchmarks/scaling_measured.md, and write it"
    )
    parser.add_argument(
        "--draw", action="store_true", help="write benchmarks/scaling_measured.md from the figures that it has"
    )
    given = parser.parse_args()
    if wrong := [name for name in given.parts if name not in PARTS]:
        parser.error(f"unknown part {wrong[0]!r}; known: {', '.join(PARTS)}")
    kept = read_figures(FIGURES)
    for name in () if given.draw else given.parts or PARTS:
        load = os.getloadavg()[0]
        kept[name] = PARTS[name]() | {"load": round(load, 1), "cores": os.cpu_count()}
        print(name, json.dumps(kept[name], indent=1), flush=True)
        if given.page:
            write_figures(kept, FIGURES)
    if given.page or given.draw:
        draw(kept)


if __name__ == "__main__":
    main()
