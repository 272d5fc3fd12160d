"""The report of a reproduction of the article's Monte Carlo study: page, terminal tables, findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.report import figures
from dynident.report.efficiency import efficiency_section, efficiency_table, median_efficiency
from dynident.report.mathml import formula
from dynident.report.page import Column, Figure, PageBlock, PageSection, PageTable, number, pairs, render
from dynident.report.terminal import terminal
from dynident.report.typography import said

if TYPE_CHECKING:
    import rich.console

    from dynident.studies import Case, Reproduction

__all__ = ["findings", "study_page", "study_tables", "study_text"]

TABLES = {1e-8: (2, 3), 1e-6: (4, 5), 1e-4: (6, 7)}  # the article's numbers of the means and of the variances
LOST = 0.5  # a parameter whose mean is off by more than half of its value has been lost


def study_page(reproduction: Reproduction) -> str:
    """Return the study as one HTML page: findings, tables 2 to 7 beside the published ones, figures, settings."""
    found = tuple(_typeset(line) for line in findings(reproduction))
    tables = (replace(table, caption=_typeset(table.caption)) for table in _tables(reproduction))
    sections = [
        PageSection("What was found", (found, _accuracy(reproduction), *_spread(reproduction))),
        *efficiency_section(reproduction),
        PageSection("What was done", _method(reproduction)),
        PageSection("Means and variances of the estimates", (_LEGEND, *tables)),
    ]
    if reproduction.traces:
        sections.append(PageSection("Velocities and accelerations", tuple(_traces(reproduction))))
    sections.append(
        PageSection(
            "Settings", (pairs("setting", [(name, said(text)) for name, text in reproduction.settings.items()]),)
        )
    )
    return render(f"The article's study, scenario {reproduction.scenario}", reproduction.description, sections)


def _typeset(text: str) -> str:
    return text.replace("sigma_q^2", "σq²").replace("rad^2", "rad²")


def study_tables(reproduction: Reproduction) -> list[PageTable]:
    """Return the tables 2 to 7: means, then variances, for each noise level; and the bound's."""
    return [*_tables(reproduction), *efficiency_table(reproduction)]


def study_text(reproduction: Reproduction) -> rich.console.Group:
    """Return the study for a terminal: description, tables, findings; for ``rich.console.Console.print``."""
    from rich.console import Group
    from rich.text import Text

    heading = Text(f"Scenario {reproduction.scenario}: {reproduction.description}")
    lines = (Text(f"* {line}") for line in findings(reproduction))
    return Group(heading, Text(), *map(terminal, study_tables(reproduction)), *lines)


def findings(reproduction: Reproduction) -> list[str]:
    """Return 3 to 6 plain sentences: who is nearest, what is lost or of the wrong sign, article, bound, failures."""
    lines = [_ranking(reproduction), _losses(reproduction), _wrong_signs(reproduction), _agreement(reproduction)]
    return [line for line in (*lines, median_efficiency(reproduction), _failures(reproduction)) if line]


def _ranking(reproduction: Reproduction) -> str:
    parts = []
    for level in _levels(reproduction):
        errors = [(_rms(case, reproduction.true), case) for case in _at(reproduction, level) if len(case.estimates)]
        errors.sort(key=lambda pair: pair[0])
        named = [f"{figures.method_name(case.method)} {number(error, 3)} %" for error, case in errors]
        parts.append(f"{figures.scientific(level)}: {', '.join(named) or 'no run gave an estimate'}")
    rule = (
        "Relative error of a run (rms over the parameters and runs), nearest to the truth first, by sigma_q^2 in rad^2"
    )
    return f"{rule}: {'; '.join(parts)}."


def _losses(reproduction: Reproduction) -> str:
    """Name the method, and the noise level, at which most parameters are lost."""
    count, worst = max(
        ((int(_lost(case, reproduction.true).sum()), case) for case in _estimated(reproduction)),
        key=lambda pair: pair[0],
        default=(0, None),
    )
    if worst is None:
        return ""
    if count == 0:
        return "No method at any noise level is off by more than half of a parameter's value on average."
    lost = np.flatnonzero(_lost(worst, reproduction.true))
    names, first = [reproduction.names[i] for i in lost], lost[0]
    return (
        f"Most is lost by {figures.method_name(worst.method)} at sigma_q^2 = {figures.scientific(worst.sigma_q2)}: the "
        "mean "
        f"is off by more than half for {', '.join(names)}; {names[0]} is {number(float(worst.mean[first]))} instead "
        f"of {number(float(reproduction.true[first]))}."
    )


def _wrong_signs(reproduction: Reproduction) -> str:
    found: dict[str, list[str]] = {}
    for case in _estimated(reproduction):
        for i in np.flatnonzero(case.mean * reproduction.true < 0):
            value = f"{number(float(case.mean[i]), 3)} at {figures.scientific(case.sigma_q2)}"
            found.setdefault(f"{reproduction.names[i]} of {figures.method_name(case.method)}", []).append(value)
    if not found:
        return "Every mean has the sign of the true value."
    parts = [f"{name} ({', '.join(values)})" for name, values in found.items()]
    return f"Means of the wrong sign, which for an inertia is not physical: {'; '.join(parts)}."


def _agreement(reproduction: Reproduction) -> str:
    """Compare the means with the published ones, in percent of the true value."""
    gaps: dict[str, list[float]] = {}
    for case in _estimated(reproduction):
        for own, published, true in zip(case.mean, case.published_mean or (), reproduction.true, strict=False):
            if published is not None:
                gaps.setdefault(case.method, []).append(float(100 * abs((own - published) / true)))
    if not gaps:
        return ""
    parts = [f"{figures.method_name(method)} {number(float(np.median(gap)), 2)} %" for method, gap in gaps.items()]
    return f"Median distance from the article's published means, in percent of the true value: {', '.join(parts)}."


def _failures(reproduction: Reproduction) -> str:
    failed = sum(case.failed for case in reproduction.cases)
    total = reproduction.runs * len(reproduction.cases)
    if not failed:
        return f"All {total} estimations succeeded."
    parts = [
        f"{case.failed} of {figures.method_name(case.method)} at {figures.scientific(case.sigma_q2)}"
        for case in reproduction.cases
        if case.failed
    ]
    return f"{failed} of {total} estimations failed and are left out of means and variances: {', '.join(parts)}."


def _accuracy(reproduction: Reproduction) -> PageTable:
    """Tabulate bias and spread by method and noise level."""
    levels = _levels(reproduction)
    columns = [Column("method", numeric=False)]
    columns += [
        Column(title, f"σq² = {figures.scientific(level)}") for level in levels for title in ("rms", "worst bias")
    ]
    rows = []
    for method in dict.fromkeys(case.method for case in reproduction.cases):
        row = [figures.method_name(method)]
        for level in levels:
            case = next((case for case in _at(reproduction, level) if case.method == method), None)
            row += _accuracy_cells(case, reproduction) if case is not None and len(case.estimates) else ["-", "-"]
        rows.append(tuple(row))
    return PageTable(tuple(columns), tuple(rows), "Relative error in percent of the true value")


def _accuracy_cells(case: Case, reproduction: Reproduction) -> list[str]:
    bias = 100 * (case.mean - reproduction.true) / np.abs(reproduction.true)
    worst = int(np.abs(bias).argmax())
    return [number(_rms(case, reproduction.true), 3), f"{number(bias[worst], 3)} ({reproduction.names[worst]})"]


def _spread(reproduction: Reproduction) -> Iterator[PageBlock]:
    if any(len(case.estimates) for case in reproduction.cases):
        yield Figure(
            figures.spread_figure(reproduction),
            "Relative error of each run's estimate: one dot a run, the box holds the middle half of the runs, the blue "
            "line is the true value. The axis is linear within 1 % and logarithmic beyond: the distance of a box from "
            "the line is the bias, its height the spread.",
        )


def _method(reproduction: Reproduction) -> tuple[PageBlock, ...]:
    methods = [figures.method_name(method) for method in dict.fromkeys(case.method for case in reproduction.cases)]
    levels = ", ".join(f"{figures.scientific(level)}" for level in _levels(reproduction))
    columns = (Column("parameter", numeric=False), Column("meaning", numeric=False), Column("true value"))
    rows = zip(reproduction.names, map(formula, reproduction.expressions), map(number, reproduction.true), strict=True)
    setup = (
        "The article's two-link arm was simulated under open-loop torques. White noise was added to the joint "
        "positions and torques; from these alone, velocities and accelerations were computed by each method, and the "
        "parameters estimated by linear least squares (equation 11); maximum likelihood (equation 7) seeks motion and "
        "parameters together."
    )
    runs = (
        f"This was repeated {reproduction.runs} times from the random seed {reproduction.seed}, for position-noise "
        f"variances σq² of {levels} rad², with these methods: {', '.join(methods)}. It took "
        f"{number(reproduction.seconds, 3)} s."
    )
    return setup, runs, PageTable(columns, tuple(rows), "Parameters (equation 40)")


_LEGEND = (
    "Means are those of equation 54, variances those of equation 55. Beside each own value stands, in grey, the one "
    'published in the article; "-" where it published none, or only an order of magnitude.'
)


def _tables(reproduction: Reproduction) -> Iterator[PageTable]:
    for level in _levels(reproduction):
        yield _table(reproduction, level, variance=False)
        yield _table(reproduction, level, variance=True)


def _table(reproduction: Reproduction, level: float, variance: bool) -> PageTable:
    """Lay a table out as in the article: one row per parameter, one pair of columns per method."""
    columns = [Column("par.", numeric=False)]
    cells: list[Sequence[str]] = [reproduction.names]
    if not variance:
        columns.append(Column("true"))
        cells.append(_numbers(reproduction.true))
    for case in _at(reproduction, level):
        published = case.published_variance if variance else case.published_mean
        columns.append(Column("own", case.method))
        cells.append(_numbers(case.variance if variance else case.mean))
        if published is not None:
            columns.append(Column("published", case.method, muted=True))
            cells.append([_as_printed(value, variance) for value in published])
    if variance and level in reproduction.bounds:
        columns.append(Column("least", "bound"))
        cells.append(_numbers(reproduction.bounds[level]))
    what = "variance" if variance else "mean"
    numbers = TABLES.get(level)
    label = f"Table {numbers[variance]}: sample" if numbers else "Sample"
    caption = f"{label} {what} of {reproduction.runs} estimates, sigma_q^2 = {figures.scientific(level)} rad^2"
    return PageTable(tuple(columns), tuple(zip(*cells, strict=True)), caption)


def _numbers(values: figures.Array) -> list[str]:
    return [number(float(value)) for value in values]


def _as_printed(value: float | None, variance: bool) -> str:
    """Show a published value with the article's decimals, which are fewer than the own ones."""
    if value is None:
        return "-"
    return figures.scientific(value) if variance else f"{value:.4f}"


def _traces(reproduction: Reproduction) -> Iterator[PageBlock]:
    yield (
        "One run at σq² = 1e-6. The vertical range is that of the samples which all methods may use, as the distortion "
        "at the ends of the filtered signal is far larger; double-click a figure to see all of it, and click in the "
        "legend to show the raw differences where they are given."
    )
    joints = next(iter(reproduction.traces.values())).joints
    for quantity, word, offset in (("ddq", "acceleration", 2), ("dq", "velocity", None)):
        for j, joint in enumerate(joints):
            source = f" (the article's figure {offset + j})" if offset is not None and j < 2 else ""
            caption = f"Angular {word} of {joint}{source}."
            yield Figure(figures.trace_figure(reproduction.traces, j, quantity), caption)


def _levels(reproduction: Reproduction) -> list[float]:
    return sorted({case.sigma_q2 for case in reproduction.cases})


def _at(reproduction: Reproduction, level: float) -> list[Case]:
    return [case for case in reproduction.cases if case.sigma_q2 == level]


def _estimated(reproduction: Reproduction) -> list[Case]:
    return [case for case in reproduction.cases if len(case.estimates)]


def _rms(case: Case, true: figures.Array) -> float:
    return float(100 * np.sqrt(np.mean(((case.estimates - true) / true) ** 2)))


def _lost(case: Case, true: figures.Array) -> NDArray[np.bool_]:
    lost: NDArray[np.bool_] = np.abs(case.mean - true) > LOST * np.abs(true)
    return lost
