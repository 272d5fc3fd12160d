"""What a designed motion is expected to tell of each base parameter, and what stays open."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import listed
from dynident.excitation import Expected, expected
from dynident.report import figures
from dynident.report.page import Column, Figure, Fold, PageBlock, PageSection, PageTable, number
from dynident.report.words import count, percent

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.io.excitation import ExcitationProject

__all__ = ["before", "expected_section", "label", "told"]

Array = NDArray[np.float64]
WELL, LOST = 10.0, 100.0  # %, of the value: well known, and not even the sign is sure
SHORT = 30  # signs of a formula
SHOWN = 6  # parameters in a sentence
_WHAT = (
    "Standard errors of the base parameters, the combinations that act on the torque each in its own way, from the "
    "information of the motion: the regressor along it, weighted by the noise of the torques. They hold for the model "
    "with which the motion was designed, at the values that it was designed with, and for positions known well; what "
    "the model lacks comes on top."
)


def told(project: ExcitationProject, found: Design) -> Iterator[str]:
    """Yield what the motion is expected to tell, what it adds to what is known, and what stays open."""
    one = found.expected
    relative, total = one.relative, len(one.std)
    known = relative[np.isfinite(relative)]
    if not len(known):
        return
    well, lost = int((relative <= WELL).sum()), int(((relative > LOST) & np.isfinite(one.std)).sum())
    worst = _worst(one)
    yield (
        f"{well} of {count(total, 'base parameter')} are expected within {WELL:g} % (one standard error), the median "
        f"within {percent(float(np.median(known)), 2)}; the least known, {label(one, worst)}, to "
        f"{number(float(one.std[worst]), 2)} of {number(float(one.value[worst]), 3)}."
    )
    if lost:
        yield f"{count(lost, 'base parameter')} cannot be distinguished from zero, which also means: hardly matter."
    if (old := before(project, found)) is not None:
        yield from _added(one, old)
    if one.open:
        yield f"{count(len(one.open), 'base parameter')} stay open: {listed(one.open, SHOWN)}."


def _worst(one: Expected) -> int:
    """Return the parameter that is known worst, of those whose value is not zero where there are any."""
    sizes = np.where(np.isfinite(one.relative) & np.isfinite(one.std), one.relative, -1.0)
    return int(sizes.argmax()) if (sizes >= 0).any() else int(np.where(np.isfinite(one.std), one.std, -1.0).argmax())


def _added(one: Expected, old: Expected) -> Iterator[str]:
    both = np.isfinite(old.std) & np.isfinite(one.std)
    if both.any():
        ratio = old.std[both] / one.std[both]
        best = int(np.flatnonzero(both)[ratio.argmax()])
        yield (
            f"With what is known before, standard errors fall by a factor of {number(float(np.median(ratio)), 2)} in the "
            f"median, at most {number(float(ratio.max()), 3)} ({label(one, best)})."
        )
    if new := int((~np.isfinite(old.std) & np.isfinite(one.std)).sum()):
        yield f"{count(new, 'base parameter')} not known before will be."


def before(project: ExcitationProject, found: Design) -> Expected | None:
    """Return what was known before the motion, None where that is nothing."""
    known = found.request.prior
    return None if known is None else expected(found.model, found.theta, known, found.expected.basis)


def expected_section(project: ExcitationProject, found: Design) -> PageSection:
    """Return the section of the expected standard errors: table, figure, what no motion can show."""
    one, old = found.expected, before(project, found)
    percents = np.where(np.isfinite(one.std), one.relative, np.inf)
    labels = [label(one, k) for k in range(len(one.std))]
    caption = "Expected standard error of each base parameter in % of its value; the dotted line is 1 %."
    figure = figures.expected_figure(labels, percents, None if old is None else old.relative)
    blocks: list[PageBlock] = [_WHAT, Figure(figure, caption), _table(one, old), *_formulas(one), *_never(one)]
    return PageSection("Expected standard errors", tuple(blocks))


def _table(one: Expected, old: Expected | None) -> PageTable:
    columns = [Column("base parameter", numeric=False), Column("value"), Column("expected standard error")]
    columns += [Column("%")] + ([] if old is None else [Column("known before, %")])
    rows = []
    for k in range(len(one.std)):
        shown = np.isfinite(one.std[k])
        cells = [label(one, k), number(float(one.value[k])), number(float(one.std[k]), 2) if shown else "open"]
        cells.append(number(float(one.relative[k]), 2) if shown else "-")
        rows.append((*cells, *(() if old is None else (number(float(old.relative[k]), 2),))))
    title = f"Base parameters; log det of the information {number(one.log_det)}, condition {number(one.condition, 3)}"
    return PageTable(tuple(columns), tuple(rows), title)


def _formulas(one: Expected) -> Iterator[PageBlock]:
    """Yield what the shortened names stand for, where there are any."""
    rows = tuple((label(one, k), name) for k, name in enumerate(one.basis.groupings) if label(one, k) != name)
    if rows:
        columns = (Column("base parameter", numeric=False), Column("formula", numeric=False))
        yield Fold("What the base parameters stand for", (PageTable(columns, rows),))


def _never(one: Expected) -> Iterator[PageBlock]:
    """Yield what no motion of the robot shows."""
    if none := one.basis.without_effect:
        yield f"No motion shows {', '.join(none)}: they have no effect on the torque of this robot."
    if tied := len(one.basis.dependent) - len(none):
        yield f"{count(tied, 'more parameter')} can be known only as part of the combinations above, by whatever motion."


def label(one: Expected, k: int) -> str:
    """Return a base parameter's formula, or, where it is long, its first parameter and how many follow."""
    name = one.basis.groupings[k]
    if len(name) <= SHORT:
        return name
    lead, *rest = name.replace(" - ", " + ").split(" + ")
    return f"{lead} (+{len(rest)} more)" if rest else name
