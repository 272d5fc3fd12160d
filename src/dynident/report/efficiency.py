"""How near the methods of a study come to the Cramér-Rao bound: a section, a table, a sentence."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.report import figures
from dynident.report.page import Column, Figure, PageSection, PageTable, number

if TYPE_CHECKING:
    from dynident.studies import Case, Reproduction

__all__ = ["efficiency_section", "efficiency_table", "median_efficiency"]

_BOUND = (
    "The Cramér-Rao bound is the least error of any unbiased method that knows the noise, that the motion starts from "
    "rest, and that the torque is linear between samples. Ratios scatter by {scatter} %, one standard error, with the "
    "number of runs. A ratio below 1 is chance, a bias, or a stronger assumption on the torque, which maximum "
    "likelihood makes after a step. Intervals cover the true value in 95 % of the runs where standard errors are right."
)


def median_efficiency(reproduction: Reproduction) -> str:
    """Say how far each method is from the bound: rms error over bound, the median over parameters and levels."""
    ratios: dict[str, list[float]] = {}
    for case in reproduction.cases:
        if len(case.estimates) and case.sigma_q2 in reproduction.bounds:
            ratios.setdefault(case.method, []).extend(_over_bound(case, reproduction).tolist())
    if not ratios:
        return ""
    parts = [
        f"{figures.method_name(method)} {number(float(np.median(found)), 3)} (at most {number(max(found), 3)})"
        for method, found in ratios.items()
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
    yield PageSection(
        "How near to the bound", (words, Figure(figures.efficiency_figure(reproduction), caption), *table)
    )


def efficiency_table(reproduction: Reproduction) -> Iterator[PageTable]:
    """Yield the table of rms errors over the bound, coverage and convergence: one row per method and noise level."""
    if not reproduction.bounds:
        return
    columns = [Column("σq²", numeric=False, unit=True), Column("method", numeric=False)]
    columns += map(Column, reproduction.names)
    columns += [Column("mean", "covered, %"), Column("least", "covered, %"), Column("not converged")]
    rows = []
    for case in reproduction.cases:
        if not len(case.estimates) or case.sigma_q2 not in reproduction.bounds:
            continue
        cells = [number(float(x), 2) for x in _over_bound(case, reproduction)]
        cells += [number(100 * float(x), 3) for x in (np.mean(case.coverage), np.min(case.coverage))]
        rows.append((figures.scientific(case.sigma_q2), figures.method_name(case.method), *cells, str(case.unsettled)))
    yield PageTable(tuple(columns), tuple(rows), "Rms error of each parameter over the bound, and how intervals hold")


def _over_bound(case: Case, reproduction: Reproduction) -> figures.Array:
    error = np.sqrt(np.mean((case.estimates - reproduction.true) ** 2, axis=0))
    return np.asarray(error / np.sqrt(reproduction.bounds[case.sigma_q2]))
