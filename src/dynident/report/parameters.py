"""The parameters of an identification in a report: values, standard errors, and what determined them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from dynident.identification.links import DeterminedBy, determined_by
from dynident.models import INERTIAL
from dynident.report import figures
from dynident.report.page import MEANING, UNIT, Column, Figure, Fold, Gallery, PageBlock, PageSection, PageTable, number
from dynident.report.term_words import with_formulas
from dynident.report.words import count, listed, motion_known

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
DETERMINED = {
    DeterminedBy.DATA: "data",
    DeterminedBy.COMBINATION: "in combination",
    DeterminedBy.PRIOR: "prior",
    DeterminedBy.BOUND: "at a bound",
    DeterminedBy.NOTHING: "not identifiable",
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


_UNSEEN = (
    "No standard error can be given: the torques of these recordings change with them only together with others, or "
    "not at all. The values are those of the prior, or one choice of many."
)


def parameter_section(identification: Identification) -> PageSection:
    """Return the section of the parameters: how many are well known, the table, and their intervals by group."""
    parameters = identification.model.parameters
    blocks: list[PageBlock] = [" ".join((_certain(identification), *rank_sentence(identification, "below")))]
    blocks += [_ROBUST] if identification.errors.std_hac is not None else []
    blocks += [_VERDICT] if identification.estimate.provenance else [_COMBINED] if identification.base.on_data else []
    seen, unseen = _by_data(identification)
    if len(seen) <= FULL_LIST:
        blocks += [_table(identification, seen)] if seen else []
    else:
        first = tuple(k for k in seen if parameters[k].role not in INERTIAL)
        blocks += [_table(identification, first)] if first else []
        blocks.append(Fold(f"All {len(seen)} parameters that these data show", (_table(identification, seen),)))
    if unseen:
        title = f"{count(len(unseen), 'parameter')} that these data do not show alone"
        blocks.append(Fold(title, (_UNSEEN, _table(identification, unseen))))
    groups = {name: [k for k in rows if k in seen] for name, rows in _groups(parameters).items()}
    groups = {name: rows for name, rows in groups.items() if rows}
    if len(seen) <= ONE_FIGURE:
        groups = {"all": list(seen)} if seen else {}
    views = tuple(((group,), (_interval(identification, rows),)) for group, rows in groups.items())
    return PageSection("Parameters", (*blocks, *((Gallery(("group",), views),) if views else ())))


def _table(identification: Identification, chosen: tuple[int, ...]) -> PageTable:
    return with_formulas(parameter_table(identification, chosen), identification.model)


def parameter_table(identification: Identification, chosen: tuple[int, ...] | None = None) -> PageTable:
    """Return the table of the ``chosen`` parameters, by default all; columns without content are left out."""
    estimate, parameters = identification.estimate, identification.model.parameters
    shown = range(len(parameters)) if chosen is None else chosen
    errors = identification.errors.best
    relative = figures.relative_std(estimate.value, errors)
    robust = identification.errors.std_hac is not None
    known = any(parameters[k].value is not None for k in shown)
    meant = any(parameters[k].expression for k in shown) and not any(parameter.body for parameter in parameters)
    verdict = tuple(DETERMINED[one] for one in determined_by(identification))
    sized = bool(np.isfinite(errors[list(shown)]).any())
    columns = [Column("parameter", numeric=False), Column("value")]
    columns += [Column("std. error"), Column("%"), *[Column("if independent", muted=True)] * robust] * sized
    reference = "nominal" if figures.only_nominal(identification.model) else "true"
    columns += [Column(reference)] * known + [UNIT]
    columns += [Column("determined by", numeric=False)] * bool(verdict) + [MEANING] * meant
    rows = []
    for k in shown:
        row = [estimate.names[k], number(float(estimate.value[k]))]
        if sized:
            row += [number(float(errors[k]), 2), number(float(relative[k]) if estimate.value[k] else None, 2)]
            row += [number(float(estimate.std[k]), 2)] * robust
        row += [number(parameters[k].value)] * known + [estimate.units[k]]
        row += list(verdict[k : k + 1]) + [parameters[k].expression] * meant
        rows.append(tuple(row))
    return PageTable(tuple(columns), tuple(rows), "Parameters with their standard errors")


def _by_data(identification: Identification) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the places of the parameters that the data show by themselves, and of the others."""
    known = np.isfinite(identification.errors.best)
    return tuple(map(int, np.flatnonzero(known))), tuple(map(int, np.flatnonzero(~known)))


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
    parameters, (seen, unseen) = identification.model.parameters, _by_data(identification)
    other = {k for k, parameter in enumerate(parameters) if parameter.role not in INERTIAL}
    long = len(parameters) > FULL_LIST and len(other) < len(parameters)
    table = parameter_table(identification, tuple(k for k in seen if not long or k in other))
    said = [f"{len(parameters) - len(other)} inertial parameters are in the report."] * long
    if names := [parameters[k].name for k in unseen if not long or k in other]:
        said.append(f"Not shown alone by these data (values in the report): {listed(names)}.")
    return table, (*said, *rank_sentence(identification))


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
