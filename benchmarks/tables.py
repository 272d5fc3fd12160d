"""The tables of benchmarks/performance_measured.md as Markdown, from what a run has measured."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

from marks import CSAPS, FITPACK, MILLION, PINOCCHIO, PLOTS, TABLES, TX40, Mark, Measured, Row, Table
from page_tables import DOCS, OUT, filled
from plot import curves

ROOT = Path(__file__).resolve().parents[1]
PAGE, FIGURES = DOCS.parent / "benchmarks" / "performance_measured.md", OUT / "performance.json"
HEAD = "| | peer | with the kernel | mark | without | mark |\n|---|---|---|---|---|---|"
COLOURS = {"with": "#3584e4", "without": "#2ec27e"}
NAMES = {"with": "dynident with the kernel", "without": "dynident without"}
PEER = "#e5484d"


def shown(value: float | None) -> str:
    """A figure with three digits."""
    if value is None:
        return "..."
    return f"{value:,.0f}" if value >= 999.5 else f"{value:.3g}" if value >= 0.001 else "less than 0.001"


def table(case: Table, measured: Measured) -> str:
    """A table as Markdown."""
    rows = ["| " + " | ".join(cells(row, case, measured)) + " |" for row in case.rows]
    return "\n".join([f"{case.title}, {case.unit}:", "", HEAD, *rows])


def cells(row: Row, table: Table, measured: Measured) -> list[str]:
    peer = row.figure(table, measured, row.peer)
    said = f"{row.peer} {shown(peer)}" if peer is not None else f"{row.peer} not measured" if row.peer else ""
    result = [row.text, said]
    for way, mark in zip(("with", "without"), row.marks, strict=True):
        if way not in row.work.ways:
            result += ["", ""]
            continue
        own = row.figure(table, measured, way)
        ratio = f" ({shown(peer / own)} x)" if own and own >= 0.001 and peer and row.peer != "Python alone" else ""
        result += [shown(own) + ratio, wanted(mark, row.met(table, measured, way))]
    return result


def wanted(mark: Mark | None, met: bool | None) -> str:
    """A mark, and whether it is met."""
    if mark is None:
        return ""
    parts = [f"{shown(mark.ratio)} x"] if mark.ratio else []
    parts += [shown(mark.most)] if mark.most is not None else []
    said = {True: "met", False: "**not met**", None: "not measured"}[met]
    return f"{', '.join(parts)}: {said}"


def summary(names: Collection[str], measured: Measured) -> str:
    """How many marks of some tables are met."""
    every = [
        row.met(TABLES[name], measured, way)
        for name in names if name in TABLES for row in TABLES[name].rows
        for way, mark in zip(("with", "without"), row.marks, strict=True) if mark
    ]  # fmt: skip
    return f"Marks: {every.count(True)} met, {every.count(False)} not met, {every.count(None)} not measured."


def absent(measured: Measured) -> list[str]:
    """Why figures are missing, each reason once."""
    every = (pair for value in measured.values() for pair in value.items())
    return sorted({f"{way}: {why}" for way, why in every if isinstance(why, str)})


def machine(facts: Mapping[str, Any]) -> str:
    """What the figures were taken on."""
    return (
        f"Measured on {facts['date']} with dynident {facts['dynident']}: {facts['processor']}, {facts['cores']} cores, "
        f"{facts['system']}, Python {facts['python']}, NumPy {facts['numpy']}, SciPy {facts['scipy']}; "
        f"kernel: {facts['kernel']}; load of the machine at the start {facts['load']}."
    )


def pictures(measured: Measured) -> dict[str, str]:
    """The plots as SVG, by their names; those of which points are missing stay as they are."""
    result = {}
    for name, plot in PLOTS.items():
        if any(work.key not in measured for _, work, _ in plot.points):
            continue
        lines: dict[str, list[tuple[float, float]]] = {}
        for x, work, count in plot.points:
            for way in (*work.ways, *work.peers):
                figure = measured.get(work.key, {}).get(way)
                if isinstance(figure, Mapping):
                    lines.setdefault(way, []).append((x, figure["cpu"] * plot.scale / count))
        styled = [(NAMES.get(way, way), COLOURS.get(way, PEER), points) for way, points in lines.items()]
        result[name] = curves(plot.title, plot.x, plot.y, styled)
    return result


def speed(measured: Measured) -> str:
    """The first figures of the page."""

    def times(name: str, row: Row) -> str:
        peer, *own = (row.figure(TABLES[name], measured, way) for way in (row.peer, "with", "without"))
        ratios = [shown(peer / x) if x and peer else "..." for x in own]
        return f"{ratios[0]} times ({ratios[1]} without the kernel)"

    seconds, memory = (shown(MILLION.figure(TABLES[name], measured, "with")) for name in ("commands", "peak"))
    return (
        "Speed, one BLAS thread, from `python3 dev.py bench`:\n"
        f"`S = n` is {times('splines', FITPACK)} as fast as FITPACK at 1e5 samples;\n"
        f"with fixed `lam` {times('splines', CSAPS)} csaps;\n"
        f"a regressor of seven joints {times('bodies', PINOCCHIO)} Pinocchio's, a sample at a call;\n"
        f"from a log to triangular factors {times('factors', TX40)} FIGAROH. A million samples of seven\n"
        f"joints go from Parquet to the report in {seconds} s of CPU and {memory} GiB."
    )


def page(text: str, facts: Mapping[str, Any], measured: Measured) -> str:
    """The page with its tables of these figures."""
    keys = measured.keys()
    parts = {name: table(x, measured) for name, x in TABLES.items() if all(row.work.key in keys for row in x.rows)}
    if all(row.work.key in keys for row in (FITPACK, CSAPS, PINOCCHIO, TX40, MILLION)):
        parts["speed"] = speed(measured)
    why = "; ".join(absent(measured))
    parts["machine"] = machine(facts) + (f" Not measured: {why}." if why else "")
    return filled(text, parts)
