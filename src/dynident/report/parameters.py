"""The parameters of an identification in a report: values, base parameters, and what physics demands of them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident import plot
from dynident.report.page import Block, Column, Facts, Figure, Section, Table, number
from dynident.terms.term import INERTIAL

if TYPE_CHECKING:
    from dynident.basis import Basis
    from dynident.identify import Identification

__all__ = [
    "base_section",
    "brief",
    "consistency_section",
    "parameter_blocks",
    "parameter_results",
    "parameter_table",
    "rank_sentence",
    "terminal_parameters",
]

FULL_LIST = 40  # a terminal shows up to this many parameters all
LONGEST = 300  # signs of a warning in a terminal

_CAPTION = (
    "95 % intervals (1.96 standard errors to both sides) in % of the values. Hollow: not determined by these logs. "
    "They assume independent residuals and an exactly known motion: the true uncertainty is larger, especially where "
    "the torque error is large."
)
_VERDICT = (
    "Determined by: data, the measured torques; prior, the nominal values where the data leave a choice; bound, a "
    "limit of physics or of the configuration; unidentifiable, nothing."
)
_BASE = (
    "Base parameters are the combinations of parameters that act on the torque each in its own way; unlike the single "
    "parameters in them, their values follow from the data alone."
)
_EIGENVALUES = (
    "The pseudo-inertia of a body of real mass has no negative eigenvalue (Wensing, Kim and Slotine, 2018). "
    "It is scaled by the body's usual mass and length; a zero lies on the boundary of what is possible."
)


def parameter_blocks(identification: Identification) -> tuple[Block, ...]:
    """Return the table of all parameters and, where there is one, the figure of their standard errors."""
    blocks: list[Block] = [parameter_table(identification)]
    if identification.estimate.verdict:
        blocks.append(_VERDICT)
    if len(identification.estimate.names):
        blocks.append(Figure(plot.parameter_figure(identification), _CAPTION))
    return tuple(blocks)


def parameter_table(identification: Identification, chosen: tuple[int, ...] | None = None) -> Table:
    """Return the table of the ``chosen`` parameters, by default all; columns without content are left out."""
    estimate, parameters = identification.estimate, identification.model.parameters
    shown = range(len(parameters)) if chosen is None else chosen
    relative = plot.relative_std(estimate)
    known = any(parameters[k].value is not None for k in shown)
    meant = any(parameters[k].expression for k in shown)
    verdict = bool(estimate.verdict)
    columns = [Column("parameter", numeric=False), Column("value"), Column("std. error"), Column("%")]
    columns += [Column(plot.reference_word(identification.model))] * known + [Column("unit", numeric=False)]
    columns += [Column("determined by", numeric=False)] * verdict + [Column("meaning", numeric=False)] * meant
    rows = []
    for k in shown:
        row = [estimate.names[k], number(float(estimate.value[k])), number(float(estimate.std[k]), 2)]
        row += [number(float(relative[k]), 2)] + [number(parameters[k].value)] * known + [estimate.units[k]]
        row += list(estimate.verdict[k : k + 1]) + [parameters[k].expression] * meant
        rows.append(tuple(row))
    return Table(tuple(columns), tuple(rows), "Parameters with their standard errors")


def terminal_parameters(identification: Identification) -> tuple[Table, tuple[str, ...]]:
    """Return the table for a terminal, which of a large model shows what is not inertial, and what to say below it."""
    parameters = identification.model.parameters
    shown = tuple(k for k, parameter in enumerate(parameters) if parameter.role not in INERTIAL)
    hidden = len(parameters) - len(shown)
    if len(parameters) <= FULL_LIST or not hidden:
        return parameter_table(identification), rank_sentence(identification)
    table = parameter_table(identification, shown)
    return table, (f"{hidden} inertial parameters are in the report.", *rank_sentence(identification))


def rank_sentence(identification: Identification) -> tuple[str, ...]:
    """Say how many combinations the data show of a robot's standard parameters, which is never all; else nothing."""
    estimate, basis = identification.estimate, identification.basis
    rank, count = basis.rank if basis else estimate.rank, len(estimate.names)
    standard = any(parameter.role in INERTIAL for parameter in identification.model.parameters)
    if rank == count or not standard:
        return ()
    listed = "; the report lists the base parameters" if basis else ""
    return (f"{rank} of {count} parameters act on the torque on their own in these data{listed}.",)


def brief(warning: str) -> str:
    """Return a warning for a terminal, cut at a word where it is long."""
    if len(warning) <= LONGEST:
        return warning
    return f"{warning[:LONGEST].rsplit(' ', 1)[0]} ... (in full in the report)"


def base_section(identification: Identification) -> Iterator[Section]:
    """Yield the section of the base parameters where the identification has found them."""
    basis, structural = identification.basis, identification.structural
    if basis is None:
        return
    facts = [(f"{basis.rank} of {len(basis.names)}", "rank on the data")]
    facts += [(str(structural.rank), "rank that any motion could show")] if structural else []
    facts += [(number(basis.gap, 2), "gap in the singular values at the rank")]
    blocks: list[Block] = [_BASE, Facts(tuple(facts)), _base_table(identification, basis)]
    missing = tuple(one.words for one in identification.missing)
    if missing:
        blocks.append(Section("What these data do not show", (missing,)))
    yield Section("Base parameters", tuple(blocks))


def _base_table(identification: Identification, basis: Basis) -> Table:
    units = [identification.estimate.units[k] for k in basis.independent]
    values = basis.to_base(identification.estimate.value)
    rows = tuple(
        (name, number(float(value)), number(float(std), 2), unit)
        for name, value, std, unit in zip(basis.groupings, values, _base_std(identification, basis), units, strict=True)
    )
    heads = (Column("base parameter", numeric=False), Column("value"), Column("std. error"))
    return Table((*heads, Column("unit", numeric=False)), rows, "Base parameters and their values")


def _base_std(identification: Identification, basis: Basis) -> plot.Array:
    found = identification.base_std
    return np.full(basis.rank, np.nan) if found is None else found


def consistency_section(identification: Identification) -> Iterator[Section]:
    """Yield the section on what physics demands, where the estimator has looked."""
    eigenvalues, costs = identification.estimate.eigenvalues, identification.estimate.costs
    blocks: list[Block] = []
    if eigenvalues:
        columns = (Column("body", numeric=False), Column("smallest eigenvalue, scaled"))
        rows = tuple((body, number(float(value), 3)) for body, value in eigenvalues.items())
        blocks += [_EIGENVALUES, Table(columns, rows, "Smallest eigenvalue of the pseudo-inertia of each body")]
    if costs:
        columns = (Column("constraints", numeric=False), Column("cost, % of the torque"))
        rows = tuple((family, number(float(value), 3)) for family, value in costs.items())
        blocks.append(Table(columns, rows, "What the constraints add to the weighted error of the training data"))
    if blocks:
        yield Section("Consistency", tuple(blocks))


def parameter_results(identification: Identification) -> dict[str, Any]:
    """Return the parameters, and what is known of base parameters and consistency, as plain values."""
    estimate, basis = identification.estimate, identification.basis
    columns = zip(estimate.names, estimate.value, estimate.std, estimate.units, strict=True)
    rows: list[dict[str, Any]] = [
        {"name": name, "value": float(value), "std": float(std), "unit": unit} for name, value, std, unit in columns
    ]
    for row, verdict in zip(rows, estimate.verdict, strict=False):
        row["verdict"] = verdict
    if identification.std_hac is not None:
        for row, std in zip(rows, identification.std_hac, strict=True):
            row["std_hac"] = float(std)
    found: dict[str, Any] = {"parameters": rows}
    if basis:
        values = np.asarray(basis.to_base(estimate.value)).tolist()
        found["base_parameters"] = [
            {"name": name, "value": value, "std": float(std)}
            for name, value, std in zip(basis.groupings, values, _base_std(identification, basis), strict=True)
        ]
        if identification.base_std_hac is not None:
            for row, std in zip(found["base_parameters"], identification.base_std_hac, strict=True):
                row["std_hac"] = float(std)
    for name in ("eigenvalues", "costs"):
        if given := getattr(estimate, name):
            found[name] = {key: float(value) for key, value in given.items()}
    return found
