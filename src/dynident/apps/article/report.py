"""The report of a reproduction of the article's Monte Carlo study: page, terminal tables, findings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from dynident.apps.article.figures import efficiency_figure, spread_figure, trace_figure
from dynident.report import Array, method_name, scientific
from dynident.report.mathml import formula
from dynident.report.page import Column, Figure, Head, PageBlock, PageSection, PageTable, pair_table, render, typeset
from dynident.report.terminal import TerminalTable
from dynident.runtime import number

if TYPE_CHECKING:
    import rich.console

    from dynident.apps.article.article import Reproduction, StudyCase

_BOUND = (
    "The Cramér-Rao bound is the least error of any unbiased method that knows the noise, that the motion starts from "
    "rest, and that the torque is linear between samples. Ratios scatter by {scatter} %, one standard error, with the "
    "number of runs. A ratio below 1 is chance, a bias, or a stronger assumption on the torque, which maximum "
    "likelihood makes after a step. Intervals cover the true value in 95 % of the runs where standard errors are right."
)

TABLES = {1e-8: (2, 3), 1e-6: (4, 5), 1e-4: (6, 7)}  # the article's numbers of the means and of the variances

_LEGEND = (
    "Means are those of equation 54, variances those of equation 55. Beside each own value stands, in grey, the one "
    'published in the article; "-" where it published none, or only an order of magnitude.'
)


def median_efficiency(reproduction: Reproduction) -> str:
    """Return a sentence on each method's rms error over the bound, the median over parameters and noise levels."""
    ratios: dict[str, list[float]] = {}
    for case in _cases_with_estimates(reproduction):
        if case.sigma_q2 in reproduction.bounds:
            ratios.setdefault(case.method, []).extend(_error_over_bound(case, reproduction).tolist())
    if not ratios:
        return ""
    parts = [
        f"{method_name(method)} {number(float(np.median(values)), 3)} (at most {number(max(values), 3)})"
        for method, values in ratios.items()
    ]
    return f"Median over parameters and noise levels of the rms error over the Cramér-Rao bound: {', '.join(parts)}."


def efficiency_section(reproduction: Reproduction) -> Iterator[PageSection]:
    """Yield the section that compares the methods with the bound, where it is known."""
    table = tuple(efficiency_table(reproduction))
    if not table:
        return
    caption = (
        "Root mean square error of each parameter in % of the true value, logarithmic, over the bound (bars): the "
        "distance of a mark from its bar is what a better method could gain."
    )
    words = _BOUND.format(scatter=number(100 / np.sqrt(2 * reproduction.runs), 2))
    yield PageSection("How near to the bound", (words, Figure(efficiency_figure(reproduction), caption), *table))


def efficiency_table(reproduction: Reproduction) -> Iterator[PageTable]:
    """Yield the table of rms errors over the bound, coverage and convergence: one row per method and noise level."""
    if not reproduction.bounds:
        return
    rows = []
    for case in _cases_with_estimates(reproduction):
        if case.sigma_q2 not in reproduction.bounds:
            continue
        cells = [number(float(x), 2) for x in _error_over_bound(case, reproduction)]
        cells += [number(100 * float(x), 3) for x in (np.mean(case.coverage), np.min(case.coverage))]
        rows.append((scientific(case.sigma_q2), method_name(case.method), *cells, str(case.unsettled)))
    heads: list[Head] = [Column("σq²", numeric=False, unit=True), Column("method", numeric=False), *reproduction.names]
    heads += [("mean", "covered, %"), ("least", "covered, %"), "not converged"]
    yield PageTable.of((), heads, rows, "Rms error of each parameter over the bound, and how intervals hold")


def _error_over_bound(case: StudyCase, reproduction: Reproduction) -> Array:
    error = np.sqrt(np.mean((case.estimates - reproduction.true) ** 2, axis=0))
    return np.asarray(error / np.sqrt(reproduction.bounds[case.sigma_q2]))


def study_page(reproduction: Reproduction) -> str:
    """Return the study as one HTML page: findings, tables 2 to 7 beside the published ones, figures, settings."""
    sentences = tuple(_typeset_units(line) for line in findings(reproduction))
    tables = (replace(table, caption=_typeset_units(table.caption)) for table in _moment_tables(reproduction))
    sections = [
        PageSection("What was found", (sentences, _accuracy(reproduction), *_spread(reproduction))),
        *efficiency_section(reproduction),
        PageSection("What was done", _method(reproduction)),
        PageSection("Means and variances of the estimates", (_LEGEND, *tables)),
    ]
    if reproduction.traces:
        sections.append(PageSection("Velocities and accelerations", tuple(_traces(reproduction))))
    settings = [(name, typeset(text)) for name, text in reproduction.settings.items()]
    sections.append(PageSection("Settings", (pair_table("setting", settings),)))
    return render(f"The article's study, scenario {reproduction.scenario}", reproduction.description, sections)


def _typeset_units(text: str) -> str:
    return text.replace("sigma_q^2", "σq²").replace("rad^2", "rad²")


def study_tables(reproduction: Reproduction) -> list[PageTable]:
    """Return the tables 2 to 7: means, then variances, for each noise level; and the bound's."""
    return [*_moment_tables(reproduction), *efficiency_table(reproduction)]


def study_text(reproduction: Reproduction) -> rich.console.Group:
    """Return the study for a terminal: description, tables, findings; for ``rich.console.Console.print``."""
    from rich.console import Group
    from rich.text import Text

    heading = Text(f"Scenario {reproduction.scenario}: {reproduction.description}")
    lines = (Text(f"* {line}") for line in findings(reproduction))
    return Group(heading, Text(), *map(TerminalTable, study_tables(reproduction)), *lines)


def findings(reproduction: Reproduction) -> list[str]:
    """Return 2 to 4 plain sentences: who is nearest, distance from the article and the bound, failures."""
    parts = (_ranking_sentence, _agreement_sentence, median_efficiency, _failure_sentence)
    return [sentence for part in parts if (sentence := part(reproduction))]


def _ranking_sentence(reproduction: Reproduction) -> str:
    parts = []
    for level in _levels(reproduction):
        cases = [case for case in _cases_at(reproduction, level) if len(case.estimates)]
        errors = sorted((_rms(case, reproduction.true), k) for k, case in enumerate(cases))
        methods = [f"{method_name(cases[k].method)} {number(error, 3)} %" for error, k in errors]
        parts.append(f"{scientific(level)}: {', '.join(methods) or 'no run gave an estimate'}")
    rule = (
        "Relative error of a run (rms over the parameters and runs), nearest to the truth first, by sigma_q^2 in rad^2"
    )
    return f"{rule}: {'; '.join(parts)}."


def _agreement_sentence(reproduction: Reproduction) -> str:
    """Return a sentence that compares the means with the published ones, in percent of the true value."""
    gaps: dict[str, list[float]] = {}
    for case in _cases_with_estimates(reproduction):
        for mean, published, true in zip(case.mean, case.published_mean or (), reproduction.true, strict=False):
            if published is not None:
                gaps.setdefault(case.method, []).append(float(100 * abs((mean - published) / true)))
    if not gaps:
        return ""
    parts = [f"{method_name(method)} {number(float(np.median(gap)), 2)} %" for method, gap in gaps.items()]
    return f"Median distance from the article's published means, in percent of the true value: {', '.join(parts)}."


def _failure_sentence(reproduction: Reproduction) -> str:
    failed = sum(case.failed for case in reproduction.cases)
    total = reproduction.runs * len(reproduction.cases)
    if not failed:
        return f"All {total} estimations succeeded."
    parts = [
        f"{case.failed} of {method_name(case.method)} at {scientific(case.sigma_q2)}"
        for case in reproduction.cases
        if case.failed
    ]
    return f"{failed} of {total} estimations failed and are left out of means and variances: {', '.join(parts)}."


def _accuracy(reproduction: Reproduction) -> PageTable:
    """Return the table of bias and spread by method and noise level."""
    levels = _levels(reproduction)
    heads = [(title, f"σq² = {scientific(level)}") for level in levels for title in ("rms", "worst bias")]
    rows = []
    for method in dict.fromkeys(case.method for case in reproduction.cases):
        row = [method_name(method)]
        for level in levels:
            case = next((case for case in _cases_at(reproduction, level) if case.method == method), None)
            row += _accuracy_cells(case, reproduction) if case is not None and len(case.estimates) else ["-", "-"]
        rows.append(row)
    return PageTable.of(("method",), heads, rows, "Relative error in percent of the true value")


def _accuracy_cells(case: StudyCase, reproduction: Reproduction) -> list[str]:
    bias = 100 * (case.mean - reproduction.true) / np.abs(reproduction.true)
    worst = int(np.abs(bias).argmax())
    return [number(_rms(case, reproduction.true), 3), f"{number(bias[worst], 3)} ({reproduction.names[worst]})"]


def _spread(reproduction: Reproduction) -> Iterator[PageBlock]:
    if _cases_with_estimates(reproduction):
        yield Figure(
            spread_figure(reproduction),
            "Relative error of each run's estimate: one dot a run, the box holds the middle half of the runs, the blue "
            "line is the true value. The axis is linear within 1 % and logarithmic beyond: the distance of a box from "
            "the line is the bias, its height the spread.",
        )


def _method(reproduction: Reproduction) -> tuple[PageBlock, ...]:
    methods = [method_name(method) for method in dict.fromkeys(case.method for case in reproduction.cases)]
    levels = ", ".join(f"{scientific(level)}" for level in _levels(reproduction))
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
    return setup, runs, PageTable.of(("parameter", "meaning"), ("true value",), rows, "Parameters (equation 40)")


def _moment_tables(reproduction: Reproduction) -> Iterator[PageTable]:
    for level in _levels(reproduction):
        yield _moment_table(reproduction, level, variance=False)
        yield _moment_table(reproduction, level, variance=True)


def _moment_table(reproduction: Reproduction, level: float, variance: bool) -> PageTable:
    """Return a table as in the article: one row per parameter, one pair of columns per method."""
    columns = [Column("par.", numeric=False)]
    cells: list[Sequence[str]] = [reproduction.names]
    if not variance:
        columns.append(Column("true"))
        cells.append(_numbers(reproduction.true))
    for case in _cases_at(reproduction, level):
        published = case.published_variance if variance else case.published_mean
        columns.append(Column("own", case.method))
        cells.append(_numbers(case.variance if variance else case.mean))
        if published is not None:
            columns.append(Column("published", case.method, muted=True))
            cells.append([_as_printed(value, variance) for value in published])
    if variance and level in reproduction.bounds:
        columns.append(Column("least", "bound"))
        cells.append(_numbers(reproduction.bounds[level]))
    statistic = "variance" if variance else "mean"
    numbers = TABLES.get(level)
    label = f"Table {numbers[variance]}: sample" if numbers else "Sample"
    caption = f"{label} {statistic} of {reproduction.runs} estimates, sigma_q^2 = {scientific(level)} rad^2"
    return PageTable(tuple(columns), tuple(zip(*cells, strict=True)), caption)


def _numbers(values: Array) -> list[str]:
    return [number(float(value)) for value in values]


def _as_printed(value: float | None, variance: bool) -> str:
    """Format a published value with the article's decimals, which are fewer than those of own values."""
    if value is None:
        return "-"
    return scientific(value) if variance else f"{value:.4f}"


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
            yield Figure(trace_figure(reproduction.traces, j, quantity), caption)


def _levels(reproduction: Reproduction) -> list[float]:
    return sorted({case.sigma_q2 for case in reproduction.cases})


def _cases_at(reproduction: Reproduction, level: float) -> list[StudyCase]:
    return [case for case in reproduction.cases if case.sigma_q2 == level]


def _cases_with_estimates(reproduction: Reproduction) -> list[StudyCase]:
    return [case for case in reproduction.cases if len(case.estimates)]


def _rms(case: StudyCase, true: Array) -> float:
    return float(100 * np.sqrt(np.mean(((case.estimates - true) / true) ** 2)))
