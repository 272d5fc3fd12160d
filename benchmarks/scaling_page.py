"""The tables of benchmarks/scaling_measured.md, from the figures that benchmarks/scaling.py has measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from page_tables import DOCS, OUT, filled, markdown

from dynident.runtime.jobs.engine import MAX_BATCH_SECONDS, MAX_LOST_SHARE

__all__ = ["FIGURES", "PAGE", "Work", "draw", "page"]

PAGE, FIGURES = DOCS.parent / "benchmarks" / "scaling_measured.md", OUT / "scaling.json"
CORES = (1, 16, 256)
Figures = Mapping[str, Any]


@dataclass(frozen=True)
class Work:
    """Many jobs: CPU seconds of one for a worker, and for the process that asks."""

    name: str
    jobs: int
    worker: float
    own: float

    def seconds(self, cores: int) -> float:
        """Seconds on some cores: those of the workers, who lose a share between jobs, or of who asks if it is more."""
        if cores == 1:
            return self.jobs * (self.worker + self.own)
        return self.jobs * max(self.worker / (1 - MAX_LOST_SHARE) / cores, self.own)

    @property
    def most(self) -> float:
        """The number of cores beyond which more do not help: who asks has no time left."""
        return self.worker / (1 - MAX_LOST_SHARE) / self.own


def draw(kept: Figures) -> None:
    """Write the tables anew."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept), encoding="utf-8")


def page(text: str, kept: Figures) -> str:
    """Return the page with its tables anew, as far as there are figures."""
    return filled(text, {
        name: f"{table(kept)}\n\n{measured(kept[name])}" if name in kept else table(kept)
        for name, table in TABLES.items()
        if set(NEEDED.get(name, (name,))) <= set(kept)
    })  # fmt: skip


def measured(part: Figures) -> str:
    return f"Measured on {part['cores']} cores, at a load of {part['load']:g} by others."


def stages(kept: Figures) -> str:
    """CPU seconds of 1000 runs by stage."""
    result, names = kept["stages"], ("noise", "smooth", "regress", "fit", "write")
    rows = [
        [method, *(f"{own[name]:.2f}" for name in names), f"{sum(own.values()):.2f}"]
        for method, own in result.items()
        if method in ("raw", "filtered", "spline")
    ]
    likely = result["ml"]["all"]
    rows.append(["maximum likelihood", *[""] * len(names), f"{likely:.0f}"])
    return markdown(["CPU s of 1000 runs", *names, "all"], rows)


def spread(kept: Figures) -> str:
    """The same study by one process, two, and Dask."""
    result = kept["spread"]
    alone = result["places"]["serial"]["own CPU"]
    lines = []
    for name, own in result["places"].items():
        full = own["own CPU"] + own["CPU of workers"]
        more = "" if name == "serial" else f"{100 * (full / alone - 1):+.0f} %"
        faster = "" if name == "serial" else f"{2 * alone / full:.2f}"
        times = f"{own['seconds']:.1f}", f"{own['first']:.1f}", f"{own['load']:.1f}"
        lines.append([name, f"{own['own CPU']:.2f}", f"{own['CPU of workers']:.2f}", more, faster, *times])
    head = ["CPU s", "who asks", "workers", "more", "speed-up", "s", "first, s", "load"]
    return markdown([f"{result['fits']} fits, {head[0]}", *head[1:]], lines)


def rows(kept: Figures) -> str:
    """What who asks does for each row, and the scheduler for each task."""
    result, tiny = kept["rows"], kept["scheduler"]["tiny"]
    each = [[f"a row of a study, {name}", f"{1000 * own['own CPU']:.0f}", ""] for name, own in result.items()
            if isinstance(own, Mapping)]  # fmt: skip
    each.append(["a task of Dask by itself", f"{tiny['client']}", f"{tiny['scheduler']}"])
    return markdown(["CPU, microseconds", "who asks", "scheduler"], each)


def scheduler(kept: Figures) -> str:
    """The share of time in jobs where a real scheduler has many workers that wait."""
    lines = [
        [f"{x['slots']}", f"{x['job']:g}", f"{x['jobs']}", f"{100 * x['share']:.0f} %", f"{x['client']:.0f}",
         f"{x['scheduler']:.0f}"]
        for x in kept["scheduler"]["waiting"]
    ]  # fmt: skip
    return markdown(["workers", "s of a job", "jobs", "share in jobs", "client, us of a job", "scheduler"], lines)


def works(kept: Figures) -> list[Work]:
    """The work of the table: studies of the article's arm, and a log of each of many robots."""
    result, own = kept["stages"], kept["rows"]["Dask, 2 workers"]["own CPU"] / 1000
    each = {name: sum(value for key, value in result[name].items() if key != "write") / 1000
            for name in ("raw", "filtered", "spline", "ml")}  # fmt: skip
    three = sum(each[name] for name in ("raw", "filtered", "spline")) - 2 * result["raw"]["noise"] / 1000
    some = [
        Work("10^6 runs, spline and least squares", 10**6, each["spline"], own),
        Work("10^6 runs, three methods each", 10**6, three, 3 * own),
        Work("10^6 runs, maximum likelihood", 10**6, each["ml"], own),
    ]
    for name, words in (("without", "without reports"), ("with reports", "each with its report")):
        if case := kept.get("fleet", {}).get(name):
            some.append(Work(f"10^5 robots, a log each, {words}", 10**5, case["CPU of worker"], case["own CPU"]))
    return some


def cost(kept: Figures) -> str:
    """What much work takes on some cores, and where more do not help."""
    lines = [
        [work.name, f"{work.jobs * work.worker / 3600:.1f}", *(clock(work.seconds(cores)) for cores in CORES),
         f"{work.most:.0f}"]
        for work in works(kept)
    ]  # fmt: skip
    head = ["", "core hours", *(f"{n} core{'s' * (n > 1)}" for n in CORES), "more cores do not help from"]
    tasks = 100 * round(MAX_BATCH_SECONDS / kept["scheduler"]["tiny"]["scheduler"] * 1e4)
    return (
        markdown(head, lines)
        + f"\n\nThe scheduler of Dask would have time for about {tasks} workers with batches of "
        + f"{MAX_BATCH_SECONDS:g} s."
    )


def clock(seconds: float) -> str:
    """Return a time in few digits."""
    for unit, size in (("d", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds:.2g} s"


TABLES = {"stages": stages, "spread": spread, "rows": rows, "scheduler": scheduler, "cost": cost}
NEEDED = {"rows": ("rows", "scheduler"), "cost": ("stages", "rows", "scheduler", "fleet")}
