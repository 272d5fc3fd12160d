"""The parameters of an identification in a report: values, standard errors, and what determined them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.estimators import Provenance
from dynident.models import INERTIAL
from dynident.report import figures
from dynident.report.page import MEANING, UNIT, Column, Figure, Fold, Gallery, PageBlock, PageSection, PageTable, number
from dynident.report.term_words import with_formulas
from dynident.report.words import listed, motion_known

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.models import Parameter

__all__ = [
    "brief",
    "parameter_section",
    "parameter_table",
    "rank_sentence",
    "terminal_parameters",
]

FULL_LIST = 40  # a terminal shows up to this many parameters all
ONE_FIGURE = 30  # more parameters are drawn group by group
LONGEST = 300  # signs of a warning in a terminal
WELL = 10.0  # a parameter is called well determined up to this standard error, % of its value
PROVENANCES = {
    Provenance.DATA: "data",
    Provenance.PRIOR: "prior",
    Provenance.BOUND: "at a bound",
    Provenance.UNIDENTIFIABLE: "not identifiable",
}
FRICTION = {"viscous": "viscous friction", "coulomb": "Coulomb friction", "rotor": "rotor inertia"}

_CAPTION = "95 % intervals (1.96 standard errors to both sides) in % of the values. Hollow: not determined, or zero."
_ROBUST = (
    "Standard errors allow for residuals that are correlated in time, for noise left in the motion and for the error "
    "of the time offset; those in grey assume independent residuals and an exact motion, and are then too small."
)
_VERDICT = (
    "Determined by: data, the measured torques; prior, the nominal values where the data leave a choice; at a bound, a "
    "limit of physics or of the configuration; not identifiable, nothing."
)
_COMBINED = (
    "Determined by: data, the measured torques; in combination, only together with others (see the base parameters): "
    "the single value is then one of many, and means nothing by itself; not identifiable, no effect on the torque."
)


def parameter_section(identification: Identification) -> PageSection:
    """Return the section of the parameters: how many are well known, the table, and their intervals by group."""
    parameters = identification.model.parameters
    blocks: list[PageBlock] = [" ".join((_certain(identification), *rank_sentence(identification, "below")))]
    blocks += [_ROBUST] if identification.errors.std_hac is not None else []
    blocks += [_VERDICT] if identification.estimate.provenance else [_COMBINED] if identification.base.on_data else []
    table = with_formulas(parameter_table(identification), identification.model)
    if len(parameters) <= FULL_LIST:
        blocks.append(table)
    else:
        shown = _not_inertial(parameters)
        blocks += [parameter_table(identification, shown)] if shown else []
        blocks.append(Fold(f"Table of all {len(parameters)} parameters", (table,)))
    groups = _groups(parameters)
    if len(parameters) <= ONE_FIGURE:
        groups = {"all": list(range(len(parameters)))} if parameters else {}
    views = tuple(((group,), (_interval(identification, rows),)) for group, rows in groups.items())
    return PageSection("Parameters", (*blocks, *((Gallery(("group",), views),) if views else ())))


def parameter_table(identification: Identification, chosen: tuple[int, ...] | None = None) -> PageTable:
    """Return the table of the ``chosen`` parameters, by default all; columns without content are left out."""
    estimate, parameters = identification.estimate, identification.model.parameters
    shown = range(len(parameters)) if chosen is None else chosen
    errors = identification.errors.best
    relative = figures.relative_std(estimate.value, errors)
    robust = identification.errors.std_hac is not None
    known = any(parameters[k].value is not None for k in shown)
    meant = any(parameters[k].expression for k in shown) and not any(parameter.body for parameter in parameters)
    verdict = _verdicts(identification)
    columns = [Column("parameter", numeric=False), Column("value"), Column("std. error"), Column("%")]
    columns += [Column("if independent", muted=True)] * robust
    reference = "nominal" if figures.only_nominal(identification.model) else "true"
    columns += [Column(reference)] * known + [UNIT]
    columns += [Column("determined by", numeric=False)] * bool(verdict) + [MEANING] * meant
    rows = []
    for k in shown:
        row = [estimate.names[k], number(float(estimate.value[k])), number(float(errors[k]), 2)]
        row += [number(float(relative[k]) if estimate.value[k] else None, 2)] + [
            number(float(estimate.std[k]), 2)
        ] * robust
        row += [number(parameters[k].value)] * known + [estimate.units[k]]
        row += list(verdict[k : k + 1]) + [parameters[k].expression] * meant
        rows.append(tuple(row))
    return PageTable(tuple(columns), tuple(rows), "Parameters with their standard errors")


def _verdicts(identification: Identification) -> tuple[str, ...]:
    """Return what determined each parameter; for an estimator that does not tell, as the base parameters show it."""
    estimate, basis = identification.estimate, identification.base.on_data
    if estimate.provenance or basis is None:
        return tuple(PROVENANCES[one] for one in estimate.provenance)
    alone, none = set(basis.determined), set(basis.without_effect)
    return tuple(
        "data" if name in alone else "not identifiable" if name in none else "in combination" for name in estimate.names
    )


def _certain(identification: Identification) -> str:
    estimate = identification.estimate
    relative = figures.relative_std(estimate.value, identification.errors.best)
    well = int((relative <= WELL).sum())
    unsure = [name for name, value in zip(estimate.names, relative, strict=True) if not value <= WELL]
    rest = f"; less certain: {listed(unsure)}" if unsure and not identification.base.on_data else ""
    return f"{well} of {len(relative)} parameters have a standard error of at most {WELL:g} %{rest}."


def _groups(parameters: tuple[Parameter, ...]) -> dict[str, list[int]]:
    """Return the columns of the parameters by what they are, those of the bodies last."""
    found: dict[str, list[int]] = {}
    for k in sorted(range(len(parameters)), key=lambda k: parameters[k].role in INERTIAL):
        found.setdefault(_group(parameters[k]), []).append(k)
    return found


def _group(parameter: Parameter) -> str:
    role = parameter.role
    if role in INERTIAL:
        return "mass" if role == "mass" else "first moments" if role in INERTIAL[1:4] else "inertia"
    return FRICTION.get(role, "offsets and others" if parameter.unit in ("N m", "N") else "others")


def _interval(identification: Identification, rows: list[int]) -> Figure:
    estimate, model = identification.estimate, identification.model
    figure = figures.interval_figure(
        [estimate.names[k] for k in rows],
        [estimate.units[k] for k in rows],
        np.asarray(estimate.value)[rows],
        identification.errors.best[rows],
        [model.parameters[k].value for k in rows] if not figures.only_nominal(model) else (),
    )
    return Figure(figure, f"{_CAPTION} {motion_known(identification)}")


def terminal_parameters(identification: Identification) -> tuple[PageTable, tuple[str, ...]]:
    """Return the table for a terminal, which of a large model shows what is not inertial, and what to say below it."""
    parameters = identification.model.parameters
    shown = _not_inertial(parameters)
    hidden = len(parameters) - len(shown)
    if len(parameters) <= FULL_LIST or not hidden:
        return parameter_table(identification), rank_sentence(identification)
    table = parameter_table(identification, shown)
    return table, (f"{hidden} inertial parameters are in the report.", *rank_sentence(identification))


def _not_inertial(parameters: tuple[Parameter, ...]) -> tuple[int, ...]:
    return tuple(k for k, parameter in enumerate(parameters) if parameter.role not in INERTIAL)


def rank_sentence(identification: Identification, place: str = "in the report") -> tuple[str, ...]:
    """Say how many combinations the data show of a robot's standard parameters, which is never all, and in which place
    they are listed; else nothing."""
    estimate, basis = identification.estimate, identification.base.on_data
    rank, count = basis.rank if basis else estimate.determined.rank, len(estimate.names)
    standard = any(parameter.role in INERTIAL for parameter in identification.model.parameters)
    if rank == count or not standard:
        return ()
    rest = f", listed {place}" if basis else ""
    return (
        f"In these data the {count} parameters act on the torque in {rank} combinations, the base parameters{rest}.",
    )


def brief(warning: str) -> str:
    """Return a warning for a terminal, cut at a word where it is long."""
    if len(warning) <= LONGEST:
        return warning
    return f"{warning[:LONGEST].rsplit(' ', 1)[0]} ... (in full in the report)"
