"""What is measured, and what it should cost: the rows and curves of benchmarks/performance_measured.md.

A mark is for each of the two ways, with the kernel and without: so much at the most, or so many times less than a peer.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

from measure import Work

Measured = Mapping[str, Mapping[str, Any]]  # by the key of a work and by way: the fields of a Figure, or a reason


@dataclass(frozen=True)
class Mark:
    """At most so much, in the unit of its table, and at least so many times less than the peer; None for no matter."""

    most: float | None = None
    ratio: float | None = None


@dataclass(frozen=True)
class Row:
    """A row of a table: a work beside one of its peers, with the marks of the two ways."""

    text: str
    work: Work
    peer: str | None = None
    marks: tuple[Mark | None, Mark | None] = (None, None)
    count: float = 1  # by which its figure is divided

    def figure(self, table: Table, measured: Measured, way: str | None) -> float | None:
        """What it costs in one way, in the unit of its table; None where that was not measured."""
        result = measured.get(self.work.key, {}).get(way or "")
        return result[table.quantity] * table.scale / self.count if isinstance(result, Mapping) else None

    def met(self, table: Table, measured: Measured, way: str) -> bool | None:
        """Whether it reaches its mark in one way; None where there is none, or a figure is missing."""
        mark = self.marks[("with", "without").index(way)]
        own, peer = (self.figure(table, measured, x) for x in (way, self.peer))
        if mark is None or own is None or (mark.ratio and peer is None):
            return None
        return (mark.most is None or own <= mark.most) and (not mark.ratio or not peer or peer >= mark.ratio * own)


@dataclass(frozen=True)
class Table:
    """A table: ``quantity`` of a Figure times ``scale`` in ``unit``."""

    title: str
    unit: str
    scale: float
    rows: tuple[Row, ...]
    quantity: str = "cpu"


@dataclass(frozen=True)
class Plot:
    """A picture of curves by way and peer over ``x``; each point is a work with its place and what divides it."""

    title: str
    x: str
    y: str
    scale: float
    points: tuple[tuple[float, Work, float], ...]


def spline(text: str, name: str, n: int, peer: str | None, *marks: Mark | None, series: int = 1) -> Row:
    peers = {"constraint": ("FITPACK",), "fixed": ("csaps", "SciPy", "R"), "gcv": ("SciPy", "R")}[name]
    work = Work("spline", name, (n, series) if series > 1 else (n,), peers if peer else ())
    return Row(text.format(n=f"{n:,}"), work, peer, (marks[0], marks[1]), n * series)


def command(robot: str, title: str, kernel: float, without: float) -> Row:
    return Row(f"{title}: `identify` with report", Work("commands", "identify", (robot,), seconds=15), None,
               (Mark(kernel), Mark(without)))  # fmt: skip


def default(robot: str, title: str, most: float) -> Row:
    return Row(f"{title}, nothing set", Work("commands", "default", (robot,), seconds=20), None,
               (Mark(most), Mark(2 * most)))  # fmt: skip


def online(text: str, name: str, *arguments: str | float) -> Row:
    return Row(text, Work("online", name, (7, *arguments), seconds=4), None, (Mark(200), Mark(200)), 5000)


def start(what: str, title: str, most: float) -> Row:
    work = Work("commands", "start", (what,), ("Python alone",), ("with",), seconds=3)
    return Row(title, work, "Python alone", (Mark(most), None))


FITPACK = spline("S = n, n = {n}", "constraint", 100_000, "FITPACK", Mark(170, 35), Mark(ratio=9))
CSAPS = spline("lam fixed, n = {n}", "fixed", 100_000, "csaps", Mark(ratio=20), Mark(ratio=9))
PINOCCHIO = Row("regressor, 7 joints, 2048 samples (a block of a fit)",
                Work("bodies", "regressor", (7, 2048), ("Pinocchio",), seconds=4), "Pinocchio",
                (Mark(ratio=8), Mark(ratio=1.5)), 2048)  # fmt: skip
AT_ONCE = Row("regressor, 7 joints, 5000 samples (20 MB of new memory)",
              Work("bodies", "regressor", (7, 5000), ("Pinocchio",), seconds=4), "Pinocchio", count=5000)  # fmt: skip
FACTORS = Work("factors", "triangular", (7, 20_000), ("Pinocchio, NumPy",), seconds=4)
TX40, DECIMATED = (
    Row(text, Work("factors", "tx40", (step,), ("figaroh",), seconds=4), "figaroh", (Mark(ratio=25), Mark(ratio=8)))
    for step, text in ((1, "TX40, all samples"), (10, "TX40, every tenth after a low-pass"))
)
MILLION = Row("1e6 samples of 7 joints from Parquet", Work("commands", "parquet", (1_000_000,), seconds=0), None,
              (Mark(15), Mark(30)))  # fmt: skip
LONGEST = spline("S = n, n = {n}", "constraint", 10_000_000, None, None, None)

TABLES = {
    "splines": Table("Smoothing splines", "ns a sample and series", 1e9, (
        spline("S = n, n = {n}", "constraint", 100, "FITPACK", Mark(ratio=3), Mark(ratio=1.3)),
        spline("S = n, n = {n}", "constraint", 1_000, "FITPACK", Mark(ratio=3), Mark(ratio=1.3)),
        spline("S = n, n = {n}", "constraint", 10_000, "FITPACK", Mark(170), None),
        FITPACK,
        spline("S = n, n = {n}", "constraint", 1_000_000, "FITPACK", Mark(170), None),
        LONGEST,
        spline("S = n, 7 series together, n = {n}", "constraint", 100_000, None, Mark(40), None, series=7),
        spline("S = n, 300 series together, n = {n}", "constraint", 4_001, None, None, None, series=300),
        CSAPS,
        spline("lam fixed, n = {n}", "fixed", 100_000, "R", Mark(ratio=15), None),
        spline("lam fixed, n = {n}", "fixed", 100_000, "SciPy", None, None),
        *(spline("GCV, n = {n}", "gcv", n, *rest) for n in (1_000, 10_000, 100_000) for rest in (
            ("R", Mark(ratio=5), Mark(ratio=1)), ("SciPy", Mark(ratio=100), None))),
    )),
    "bodies": Table("Rigid bodies", "µs a sample", 1e6, (
        PINOCCHIO,
        AT_ONCE,
        Row("regressor to triangular factors, 7 joints with friction", FACTORS, "Pinocchio, NumPy", count=20_000),
    )),
    "design": Table("A motion of 7 joints that is designed", "ms of CPU", 1e3, (
        Row("log det of the information of 69 base parameters on 200 points, with its gradient by 77 coefficients",
            Work("design", "gradient", (7, 200), ("differences",)), "differences", (Mark(10, 10), Mark(30, 4))),
        Row("distances of 19 pairs of capsules at 200 points, with their derivatives",
            Work("design", "clearances", (7, 200), ("differences",)), "differences", (Mark(5, 3), Mark(5, 3))),
    )),
    "online": Table("A stream of 7 joints with friction, 91 parameters", "µs a sample", 1e6, (
        online("derivatives with a fixed lag, sample by sample", "smoothed", 1),
        online("recursive least squares, sample by sample", "updated", 1),
        online("all of it, sample by sample", "tracked", 1, "everything kept"),
        online("all of it, 100 samples at a time", "tracked", 100, "everything kept"),
        online("friction and payload forgotten, sample by sample", "tracked", 1, "groups"),
    )),
    "factors": Table("From a log to triangular factors", "s of CPU", 1, (TX40, DECIMATED)),
    "memory": Table("Memory above that of the log", "GiB", 1, tuple(
        replace(row, marks=(None, None)) for row in (TX40, DECIMATED)), "rise"),
    "commands": Table("From the command to the report", "s of CPU", 1, (
        command("lwr4", "LWR4, 7 joints, 5000 samples", 2.5, 3.5),
        command("panda", "Panda, 7 joints, 9300 samples", 4, 6),
        command("tx40", "TX40, 6 joints, 25 000 samples", 5, 8),
        command("emps", "EMPS, 1 joint, 24 800 samples, with free simulation", 2.5, 3),
        default("lwr4", "LWR4", 3.2),
        default("panda", "Panda", 6),
        default("tx40", "TX40", 5),
        default("emps", "EMPS", 1.3),
        default("demo", "the demo's arm, 6 joints, 5000 samples", 3.5),
        MILLION,
    )),
    "peak": Table("Peak of memory", "GiB", 1, (
        *(replace(default(robot, title, 0), marks=(Mark(0.4), None)) for robot, title in (
            ("lwr4", "LWR4"), ("panda", "Panda"))),
        replace(MILLION, marks=(Mark(1), None)), replace(LONGEST, count=1)), "peak"),
    "study": Table("The article's study, on the clock", "s", 1, (
        Row("9000 fits, two workers", Work("commands", "study", (1000, 2), seconds=0), None, (Mark(20), Mark(35))),),
        "wall"),
    "clock": Table("Searches with two workers, on the clock", "s", 1, (
        *(Row(f"`excite`, {title}, 7 joints", Work("commands", "excite", (robot,), seconds=0), None, (Mark(10), None))
          for robot, title in (("lwr4", "LWR4"), ("panda", "Panda"))),
        Row("`compare`, the demo's arm", Work("commands", "compare", (), seconds=0), None, (Mark(75), None)),),
        "wall"),
    "likelihood": Table("Maximum likelihood, the estimator alone", "s of CPU", 1, (
        Row("LWR4", Work("likelihood", "robot", ("lwr4",), seconds=0), None, (Mark(5), None)),
        Row("Panda", Work("likelihood", "robot", ("panda",), seconds=0), None, (Mark(8), None)),
        Row("the article's arm, a run", Work("likelihood", "article", seconds=4), None, (Mark(0.04), None)),
    )),
    "start": Table("Start", "ms of CPU", 1e3, (
        start("dynident", "`import dynident`", 30),
        start("--help", "`--help` of the command", 80),
        start("dynident.motion.splines", "`import dynident.motion.splines`", 330),
    )),
}  # fmt: skip

LENGTHS = (1_000, 3_000, 10_000, 30_000, 100_000, 300_000, 1_000_000)
JOINTS = (2, 4, 7, 12, 20, 30)
PLOTS = {
    "samples": Plot("A smoothing spline with S = n", "samples", "ns of CPU a sample", 1e9, tuple(
        (n, Work("spline", "constraint", (n,), ("FITPACK",), seconds=1), n) for n in LENGTHS)),
    "joints": Plot("The regressor of rigid bodies", "joints", "µs of CPU a sample", 1e6, tuple(
        (n, Work("bodies", "regressor", (n, 2000), ("Pinocchio",), seconds=1), 2000) for n in JOINTS)),
    "parameters": Plot("Regressor and triangular factors", "parameters", "µs of CPU a sample", 1e6, tuple(
        (13 * n, Work("factors", "triangular", (n, 2000), ("Pinocchio, NumPy",), seconds=1), 2000) for n in JOINTS)),
    "fits": Plot("A physically consistent fit, from triangular factors", "parameters", "ms of CPU", 1e3, tuple(
        (13 * n, Work("factors", "consistent", (n, 2000), seconds=1), 1) for n in JOINTS[:-1])),
}  # fmt: skip


def works(names: Collection[str]) -> list[Work]:
    """The works of some tables, and of all plots for "growth", each once; where both have one, that of the table."""
    result = [row.work for name in names if name in TABLES for row in TABLES[name].rows]
    result += [work for plot in PLOTS.values() for _, work, _ in plot.points if "growth" in names]
    return list({work.key: work for work in reversed(result)}.values())[::-1]
