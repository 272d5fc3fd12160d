"""The parameters of an identification in a report: values, standard errors, and what determined them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dynident.identification import Identification
from dynident.identification.links import DeterminedBy, LinkInertia, determined_by, link_inertias
from dynident.models import INERTIAL, Geometry, Parameter, ShapeSource
from dynident.report.equations import parameter_meanings
from dynident.report.identification.figures import has_nominal_values, interval_figure, relative_std
from dynident.report.page import MEANING, UNIT, Column, Figure, Fold, Gallery, Head, PageBlock, PageSection, PageTable
from dynident.report.words import SOURCES, motion_known
from dynident.runtime import count, join_names, number

MAX_FULL_LIST = 40  # a terminal shows up to this many parameters all
MAX_ONE_FIGURE = 30  # more parameters are drawn group by group
MAX_WARNING_LENGTH = 300  # signs of a warning in a terminal
WELL = 10.0  # a parameter is called well determined up to this standard error, % of its value
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

MIN_SHOWN_VALUE = 1e-9  # of what is mm, kg or kg m^2, below which it is rounding
MAX_LISTED_MESHES = 5  # meshes in a sentence
_LINKS = (
    "The centre of mass is in the frame of the link; the principal moments are about it. ±: standard error. Where the "
    "data alone leave a value open, the prior chose it, and its error is not known: ± is then open. Combinations of "
    "parameters that the data determine have their errors in the table of the parameters."
)
_OPEN = (
    "The data alone leave mass, centre of mass and moments of each link open: only combinations of links act on the "
    "torque, and least squares does not choose among them. `estimator: {kind: consistent}` finds the physical "
    "values that are nearest to the file."
)
_PARTLY = "What the data alone leave open is not shown, as least squares does not choose (-)."


# of tables of links: by caption the heads, in the order of the values of an ``Inertia``, with factors to their units
_QUANTITIES = {
    "Mass and centre of mass": {"mass, kg": 1.0, "centre x, mm": 1e3, "y, mm": 1e3, "z, mm": 1e3},
    "Principal moments about the centre of mass": dict.fromkeys(
        ("smallest, kg m²", "middle, kg m²", "largest, kg m²"), 1.0
    ),
}


def parameter_section(identification: Identification) -> PageSection:
    """Return the section of the parameters: how many are well known, the table, and their intervals by group."""
    parameters = identification.model.parameters
    blocks: list[PageBlock] = [" ".join((_certainty_sentence(identification), *rank_sentence(identification, "below")))]
    blocks += [_ROBUST] if identification.errors.allows_correlation else []
    blocks += [_VERDICT] if identification.estimate.provenance else [_COMBINED] if identification.base.on_data else []
    meanings = dict(parameter_meanings(identification.model))
    determined, undetermined = _split_by_data(identification)
    if len(determined) <= MAX_FULL_LIST:
        blocks += [parameter_table(identification, determined, meanings)] if determined else []
    else:
        not_inertial = tuple(k for k in determined if parameters[k].role not in INERTIAL)
        blocks += [parameter_table(identification, not_inertial, meanings)] if not_inertial else []
        title = f"All {len(determined)} parameters that these data show"
        blocks.append(Fold(title, (parameter_table(identification, determined, meanings),)))
    if undetermined:
        title = f"{count(len(undetermined), 'parameter')} that these data do not show alone"
        blocks.append(Fold(title, (_UNSEEN, parameter_table(identification, undetermined, meanings))))
    # Few parameters are drawn in one figure, many by group
    groups = {name: [k for k in rows if k in determined] for name, rows in _group_parameters(parameters).items()}
    groups = {name: rows for name, rows in groups.items() if rows}
    if len(determined) <= MAX_ONE_FIGURE:
        groups = {"all": list(determined)} if determined else {}
    views = tuple(((group,), (parameter_figure(identification, rows),)) for group, rows in groups.items())
    return PageSection("Parameters", (*blocks, *((Gallery(("group",), views),) if views else ())))


def parameter_table(
    identification: Identification, selected: Sequence[int], meanings: Mapping[str, str] | None = None
) -> PageTable:
    """Return the table of the ``selected`` parameters, by index; columns without content are left out.

    ``meanings`` by name take the place of their expressions.
    """
    estimate, parameters = identification.estimate, identification.model.parameters
    meanings = {parameter.name: parameter.expression for parameter in parameters} | dict(meanings or {})
    errors = identification.errors.std
    relative = relative_std(estimate.value, errors)
    robust = identification.errors.allows_correlation
    # Columns without content are multiplied by False, and so left out
    has_reference = any(parameters[k].value is not None for k in selected)
    has_meaning = any(parameters[k].expression for k in selected) and not any(x.body for x in parameters)
    verdict = tuple(SOURCES[source].state for source in determined_by(identification))
    sized = bool(np.isfinite(errors[list(selected)]).any())
    columns: list[Head] = ["value"]
    columns += ["std. error", "%", *[Column("if independent", muted=True)] * robust] * sized
    reference = "nominal" if has_nominal_values(identification.model) else "true"
    columns += [*[reference] * has_reference, UNIT]
    columns += [Column("determined by", numeric=False)] * bool(verdict) + [MEANING] * has_meaning
    rows = []
    for k in selected:
        row = [estimate.names[k], number(float(estimate.value[k]))]
        if sized:
            row += [number(float(errors[k]), 2), number(float(relative[k]) if estimate.value[k] else None, 2)]
            row += [number(float(identification.errors.std_independent[k]), 2)] * robust
        row += [number(parameters[k].value)] * has_reference + [estimate.units[k]]
        row += list(verdict[k : k + 1]) + [meanings[estimate.names[k]]] * has_meaning
        rows.append(row)
    return PageTable.of(("parameter",), columns, rows, "Parameters with their standard errors")


def _split_by_data(identification: Identification) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return the indices of the parameters that the data determine by themselves, and of the others."""
    is_determined = np.isfinite(identification.errors.std)
    return tuple(map(int, np.flatnonzero(is_determined))), tuple(map(int, np.flatnonzero(~is_determined)))


def _certainty_sentence(identification: Identification) -> str:
    estimate = identification.estimate
    relative = relative_std(estimate.value, identification.errors.std)
    well = int((relative <= WELL).sum())
    unsure = [name for name, value in zip(estimate.names, relative, strict=True) if not value <= WELL]
    suffix = f"; less certain: {join_names(unsure)}" if unsure and not identification.base.on_data else ""
    return f"{well} of {len(relative)} parameters have a standard error of at most {WELL:g} %{suffix}."


def _group_parameters(parameters: tuple[Parameter, ...]) -> dict[str, list[int]]:
    """Return the indices of the parameters by what they are, those of the bodies last."""
    groups: dict[str, list[int]] = {}
    for k in sorted(range(len(parameters)), key=lambda k: parameters[k].role in INERTIAL):
        groups.setdefault(_group_name(parameters[k]), []).append(k)
    return groups


def _group_name(parameter: Parameter) -> str:
    role = parameter.role
    if role in INERTIAL:
        return "mass" if role == "mass" else "first moments" if role in INERTIAL[1:4] else "inertia"
    return FRICTION.get(role, "offsets and others" if parameter.unit in ("N m", "N") else "others")


def parameter_figure(identification: Identification, rows: list[int]) -> Figure:
    """Return the intervals of the parameters at ``rows``, with their true values where these are known."""
    estimate, model = identification.estimate, identification.model
    names, units = ([texts[k] for k in rows] for texts in (estimate.names, estimate.units))
    true_values = () if has_nominal_values(model) else [model.parameters[k].value for k in rows]
    figure = interval_figure(names, units, estimate.value[rows], identification.errors.std[rows], true_values)
    return Figure(figure, f"{_CAPTION} {motion_known(identification)}")


def terminal_parameters(identification: Identification) -> tuple[PageTable, tuple[str, ...]]:
    """Return the table for a terminal, without inertial parameters where the model is large, and the notes below it."""
    parameters, (determined, undetermined) = identification.model.parameters, _split_by_data(identification)
    not_inertial = {k for k, parameter in enumerate(parameters) if parameter.role not in INERTIAL}
    long = len(parameters) > MAX_FULL_LIST and len(not_inertial) < len(parameters)
    table = parameter_table(identification, tuple(k for k in determined if not long or k in not_inertial))
    notes = [f"{len(parameters) - len(not_inertial)} inertial parameters are in the report."] * long
    if names := join_names([parameters[k].name for k in undetermined if not long or k in not_inertial]):
        notes.append(f"The data do not determine these parameters one by one (values in the report): {names}.")
    return table, (*notes, *rank_sentence(identification))


def rank_sentence(identification: Identification, place: str = "in the report") -> tuple[str, ...]:
    """Return how many combinations of a robot's standard parameters the data show, and in which ``place`` they are
    listed; nothing where they show all.
    """
    estimate, basis = identification.estimate, identification.base.on_data
    rank, count = basis.rank if basis else estimate.determined.rank, len(estimate.names)
    standard = any(parameter.role in INERTIAL for parameter in identification.model.parameters)
    if rank == count or not standard:
        return ()
    suffix = f", listed {place}" if basis else ""
    return (f"The data determine {rank} combinations of the {count} parameters, the base parameters{suffix}.",)


def shorten_warning(warning: str) -> str:
    """Return a warning for a terminal, cut at a word where it is long."""
    if len(warning) <= MAX_WARNING_LENGTH:
        return warning
    return f"{warning[:MAX_WARNING_LENGTH].rsplit(' ', 1)[0]} ... (in full in the report)"


def link_section(identification: Identification, geometry: Geometry | None = None) -> Iterator[PageSection]:
    """Yield the section of the links: mass, centre of mass and moments of each, file and found, and what determined
    them. A model without a robot file has none.
    """
    links = link_inertias(identification)
    if not links:
        return
    has_estimates = any(link.identified is not None for link in links)
    complete = all(link.sure.all() for link in links) or bool(identification.estimate.provenance)
    note = _LINKS if complete else f"{_LINKS} {_PARTLY}" if has_estimates else _OPEN
    tables = (_inertia_table(links, *table, has_estimates) for table in zip(_QUANTITIES, (0, 4), strict=True))
    notes = tuple(_shape_notes(links, geometry))
    yield PageSection("Links", (note, *tables, _source_table(links), *((notes,) if notes else ())))


def link_title(links: Sequence[str]) -> str:
    """Return the name of links that are one body: the first, and how many more there are."""
    return links[0] if len(links) == 1 else f"{links[0]} (+{len(links) - 1})"


def _inertia_table(links: Sequence[LinkInertia], caption: str, first: int, has_estimates: bool) -> PageTable:
    """Return the table of quantities of the links from the ``first`` value of an inertia on: of each in the file and,
    where any is known, found."""
    titles = ("file", "found", "±") if has_estimates else ("file",)
    rows = []
    for link in links:
        file = np.full(7, np.nan) if link.file is None else link.file.values
        value = np.full(7, np.nan) if link.identified is None else link.identified.values
        cells = [link_title(link.links)]
        for k, unit in enumerate(_QUANTITIES[caption].values(), start=first):
            cells.append(_value_cell(unit * file[k]))
            if has_estimates:
                error = _error_cell(unit * link.std[k], bool(link.sure[k]), unit * value[k])
                cells += [_value_cell(unit * value[k]), error]
        rows.append(cells)
    heads = ((title, head) for head in _QUANTITIES[caption] for title in titles)
    return PageTable.of(("link",), heads, rows, caption)


def _value_cell(value: float) -> str:
    return number(0.0 if abs(value) < MIN_SHOWN_VALUE else float(value), 3)


def _error_cell(std: float, sure: bool, value: float) -> str:
    """Return the standard error of a value that the data alone determine."""
    if not np.isfinite(value) or not np.isfinite(std):
        return "-"
    return number(float(std), 2) if sure else "open"


def _source_table(links: Sequence[LinkInertia]) -> PageTable:
    """Return how many parameters of each link were determined by what; only sources that occur have a column."""
    kinds = [source for source in DeterminedBy if any(source in link.by for link in links)]
    heads = ((SOURCES[source].name, "parameters determined by") for source in kinds)
    rows = ((link_title(link.links), *(str(link.by.get(source, 0)) for source in kinds)) for link in links)
    return PageTable.of(("link",), heads, rows, "What determined the parameters that act on the torque")


def _shape_notes(links: Sequence[LinkInertia], geometry: Geometry | None) -> Iterator[str]:
    """Yield which bodies have no ellipsoid, how the links are drawn, and which meshes are missing."""
    for field, where in (("file", "in the file"), ("identified", "as identified")):
        bodies = [(link.name, getattr(link, field)) for link in links]
        complete = [(name, x) for name, x in bodies if x is not None and np.isfinite(x.values).all()]
        if wrong := [name for name, inertia in complete if inertia.ellipsoid is None]:
            yield f"No body has this inertia, so that it has no ellipsoid, {where}: {join_names(wrong)}."
    if geometry is not None:
        yield from drawing_notes(geometry)


def drawing_notes(geometry: Geometry) -> Iterator[str]:
    """Yield which links are drawn without their shapes, and which meshes could not be read."""
    rods = [geometry.link(body) for body, kind in geometry.sources.items() if kind is ShapeSource.JOINTS]
    if rods:
        yield f"Drawn as rods between the joints, as their shapes are not known: {join_names(rods)}."
    yield from missing_mesh_notes(geometry)


def missing_mesh_notes(geometry: Geometry) -> Iterator[str]:
    """Yield which meshes could not be read."""
    if files := [f"{file} ({reason.rstrip('.')})" for file, reason in geometry.missing.items()]:
        yield f"Meshes that could not be read: {join_names(files, MAX_LISTED_MESHES)}."
