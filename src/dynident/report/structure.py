"""What the data show of a model, in a report: base parameters, excitation and condition, and what physics demands."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.estimators import Consistency
from dynident.report import figures
from dynident.report.data import excitation_table
from dynident.report.page import UNIT, Column, Facts, Figure, Fold, PageBlock, PageSection, PageTable, number
from dynident.report.wording import words
from dynident.report.words import huge, motion_known, tiny

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.regression import BaseParameters

__all__ = ["base_errors", "base_section", "condition_section", "consistency_section"]

NOTABLE = 0.1  # standard errors that constraints must move a base parameter by to be shown
MANY = 24  # base parameters from which on they are folded
_BASE = (
    "Base parameters are the combinations of parameters that act on the torque each in its own way; unlike the single "
    "parameters in them, their values follow from the data alone. The standard errors allow for correlated residuals, "
    "those to their right assume independent ones. Where constraints moved a value, what it would be without them is "
    "shown, and the standard errors count the difference as a possible error."
)
_SINGULAR = (
    "Singular values of the regressor with its columns scaled to equal length. A clear step where they become hollow "
    "means a clear rank; filled ones far below 1 are combinations that these motions hardly show."
)
_EIGENVALUES = (
    "The pseudo-inertia of a body of real mass has no negative eigenvalue (Wensing, Kim and Slotine, 2018). "
    "It is scaled by the body's usual mass and length; a zero lies on the boundary of what is possible."
)


def base_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the base parameters where the identification has found them."""
    basis = identification.base.on_data
    if basis is None:
        return
    units = [identification.estimate.units[k] for k in basis.independent]
    figure = figures.interval_figure(
        basis.groupings, units, basis.to_base(identification.estimate.value), base_errors(identification)
    )
    caption = "Base parameters: 95 % intervals (1.96 standard errors to both sides) in % of the values."
    table, drawn = _base_table(identification, basis), Figure(figure, caption)
    said = f"{_BASE} {motion_known(identification)}"
    if basis.rank > MANY:
        yield PageSection("Base parameters", (said, Fold(table.caption, (table,)), Fold("Their intervals", (drawn,))))
    else:
        yield PageSection("Base parameters", (said, table, drawn))


def base_errors(identification: Identification) -> figures.Array:
    """Return the standard errors (r) of the base parameters to believe; nan where there are none."""
    best, basis = identification.errors.best_base, identification.base.on_data
    return np.full(0 if basis is None else basis.rank, np.nan) if best is None else best


def _base_table(identification: Identification, basis: BaseParameters) -> PageTable:
    robust, plain = identification.errors.base_std_hac is not None, identification.errors.base_std
    values, errors = basis.to_base(identification.estimate.value), base_errors(identification)
    heads = [Column("base parameter", numeric=False), Column("value"), Column("std. error"), Column("%")]
    physics = identification.estimate.consistency
    free = physics.unconstrained if physics else None
    unheld = values if free is None else basis.to_base(free)
    held = np.abs(values - unheld) > NOTABLE * errors
    heads += [Column("if independent", muted=True)] * robust + [UNIT]
    heads += [Column("without constraints", muted=True)] * bool(held.any())
    rows = []
    for k, lead in enumerate(basis.independent):
        relative = float(figures.relative_std(values[k : k + 1], errors[k : k + 1])[0])
        cells = [basis.groupings[k], number(float(values[k])), number(float(errors[k]), 2), number(relative, 2)]
        cells += [number(None if plain is None else float(plain[k]), 2)] * robust
        cells += [identification.estimate.units[lead]]
        rows.append((*cells, *[number(float(unheld[k])) if held[k] else ""] * bool(held.any())))
    return PageTable(tuple(heads), tuple(rows), "Base parameters and their values")


def condition_section(identification: Identification) -> PageSection:
    """Return the section of excitation and condition: how the joints moved, and what that shows of the model."""
    basis, estimate = identification.base.on_data, identification.estimate
    meaning, table = excitation_table(identification)
    facts, blocks = [], list[PageBlock]()
    if basis is None:
        facts += [(f"{estimate.determined.rank} of {len(estimate.names)}", "rank on the data")]
        facts += [(number(float(estimate.determined.condition), 3), "condition of the regressor, columns scaled")]
    else:
        values, structural = basis.singular_values, identification.base.structural
        condition = float(values[0] / values[basis.rank - 1]) if basis.rank else float("inf")
        facts += [(f"{basis.rank} of {len(basis.names)}", "rank on the data")]
        facts += [(str(structural.rank), "rank that any motion could show")] if structural else []
        facts += [(number(condition, 3), "condition of the base parameters, columns scaled")]
        facts += [(huge(basis.gap), "gap in the singular values at the rank")]
        blocks.append(Figure(figures.singular_figure(basis), _SINGULAR))
    missing = tuple(words(one) for one in identification.base.unexcited)
    if missing:
        blocks.append(PageSection("What these data do not show", (missing,)))
    return PageSection("Excitation and condition", (Facts(tuple(facts)), meaning, table, *blocks))


def consistency_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section on what physics demands: the mass matrix, the bodies, and what the demands cost."""
    consistency = identification.estimate.consistency or Consistency()
    eigenvalues, costs = consistency.eigenvalues, consistency.costs
    blocks: list[PageBlock] = [words(identification.mass)] if identification.mass else []
    if eigenvalues:
        columns = (Column("body", numeric=False), Column("smallest eigenvalue, scaled"))
        rows = tuple((body, tiny(float(value), 3)) for body, value in eigenvalues.items())
        blocks += [_EIGENVALUES, PageTable(columns, rows, "Smallest eigenvalue of the pseudo-inertia of each body")]
    if costs:
        columns = (Column("constraints", numeric=False), Column("cost, % of the torque"))
        rows = tuple(
            ("all together" if family == "all" else family, number(float(value), 3)) for family, value in costs.items()
        )
        blocks.append(PageTable(columns, rows, "What the constraints add to the weighted error of the training data"))
    if blocks:
        yield PageSection("Physical consistency", tuple(blocks))
