"""The links in a report: mass, centre of mass and principal moments, file and found, and what determined them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dynident.excitation import Geometry, Made
from dynident.identification.links import DeterminedBy, LinkInertia, link_inertias
from dynident.report.page import Column, PageSection, PageTable, number
from dynident.report.words import listed

if TYPE_CHECKING:
    from dynident.identification import Identification

__all__ = ["WORDS", "link_section", "missing_words", "shape_words", "title_of"]

ZERO = 1e-9  # of what is mm, kg or kg m^2, below which it is rounding
FEW = 5  # meshes in a sentence
WORDS = {
    DeterminedBy.DATA: "the data",
    DeterminedBy.COMBINATION: "the data, with other links",
    DeterminedBy.PRIOR: "the prior",
    DeterminedBy.BOUND: "a bound",
    DeterminedBy.NOTHING: "nothing",
}
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
_MASS = ("Mass and centre of mass", ("mass, kg", "centre x, mm", "y, mm", "z, mm"), slice(0, 4), (1.0, 1e3, 1e3, 1e3))
_MOMENTS = ("Principal moments about the centre of mass", ("smallest, kg m²", "middle, kg m²", "largest, kg m²"),
            slice(4, 7), (1.0, 1.0, 1.0))  # fmt: skip


def link_section(identification: Identification, geometry: Geometry | None = None) -> Iterator[PageSection]:
    """Yield the section of the links: mass, centre of mass and moments of each, file and found, and what determined
    them; of a model without a robot file nothing."""
    links = link_inertias(identification)
    if not links:
        return
    found = any(one.found is not None for one in links)
    complete = all(one.sure.all() for one in links) or bool(identification.estimate.provenance)
    said = _LINKS if complete else f"{_LINKS} {_PARTLY}" if found else _OPEN
    tables = (_table(links, found, *_MASS), _table(links, found, *_MOMENTS), _determined(links))
    notes = tuple(_notes(links, geometry))
    yield PageSection("Links", (said, *tables, *((notes,) if notes else ())))


def title_of(links: Sequence[str]) -> str:
    """Return the name of links that are one body: the first, and how many more there are."""
    return links[0] if len(links) == 1 else f"{links[0]} (+{len(links) - 1})"


def _table(
    links: Sequence[LinkInertia], found: bool, caption: str, heads: Sequence[str], part: slice, units: Sequence[float]
) -> PageTable:
    """Return the table of some quantities of the links: of each in the file and, where any is known, found."""
    titles = ("file", "found", "±") if found else ("file",)
    columns = (Column("link", numeric=False), *(Column(one, head) for head in heads for one in titles))
    rows = []
    for one in links:
        file = np.full(7, np.nan) if one.file is None else one.file.values
        value = np.full(7, np.nan) if one.found is None else one.found.values
        cells = [title_of(one.links)]
        for k, unit in zip(range(*part.indices(7)), units, strict=True):
            cells.append(_cell(unit * file[k]))
            if found:
                cells += [_cell(unit * value[k]), _error(unit * one.std[k], bool(one.sure[k]), unit * value[k])]
        rows.append(tuple(cells))
    return PageTable(columns, tuple(rows), caption)


def _cell(value: float) -> str:
    return number(0.0 if abs(value) < ZERO else float(value), 3)


def _error(std: float, sure: bool, value: float) -> str:
    """Return the standard error of a value that the data alone determine."""
    if not np.isfinite(value) or not np.isfinite(std):
        return "-"
    return number(float(std), 2) if sure else "open"


def _determined(links: Sequence[LinkInertia]) -> PageTable:
    """Return what determined the parameters of the links that act on the torque, those kinds that there are."""
    kinds = [one for one in DeterminedBy if any(one in link.by for link in links)]
    columns = (Column("link", numeric=False), *(Column(WORDS[one], "parameters determined by") for one in kinds))
    rows = tuple((title_of(link.links), *(str(link.by.get(one, 0)) for one in kinds)) for link in links)
    return PageTable(columns, rows, "What determined the parameters that act on the torque")


def _notes(links: Sequence[LinkInertia], geometry: Geometry | None) -> Iterator[str]:
    """Yield which bodies have no ellipsoid, how the links are drawn, and which meshes are missing."""
    for what, where in (("file", "in the file"), ("found", "as found")):
        known = [(link.name, getattr(link, what)) for link in links]
        whole = [(name, one) for name, one in known if one is not None and np.isfinite(one.values).all()]
        if wrong := [name for name, one in whole if one.ellipsoid is None]:
            yield f"No body has this inertia, so that it has no ellipsoid, {where}: {listed(wrong)}."
    if geometry is not None:
        yield from shape_words(geometry)


def shape_words(geometry: Geometry) -> Iterator[str]:
    """Yield which links are drawn without their shapes, and which meshes could not be read."""
    rods = [geometry.link(body) for body, made in geometry.made.items() if made is Made.JOINTS]
    if rods:
        yield f"Drawn as rods between the joints, as their shapes are not known: {listed(rods)}."
    yield from missing_words(geometry)


def missing_words(geometry: Geometry) -> Iterator[str]:
    """Yield which meshes could not be read."""
    if geometry.missing:
        names = listed((f"{file} ({reason.rstrip('.')})" for file, reason in geometry.missing.items()), FEW)
        yield f"Meshes that could not be read: {names}."
