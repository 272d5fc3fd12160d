"""What a designed motion is expected to tell of each base parameter, and what stays open."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import listed
from dynident.excitation import Expected, Program, expected
from dynident.regression import UnexcitedParameters
from dynident.report import figures
from dynident.report.page import Column, Figure, Fold, PageBlock, PageSection, PageTable, number
from dynident.report.words import count

if TYPE_CHECKING:
    from dynident.excitation import Design

__all__ = ["WELL", "expected_section", "told", "valued_of"]

Array = NDArray[np.float64]
WELL, FAIR = 10.0, 30.0  # %, of the value: standard errors of what is known well, and fairly
LONGER = 4.0  # times the duration
ROUNDING = 1e-9  # of the largest value
SHORT = 30  # signs of a formula
SHOWN = 6  # parameters in a sentence
WHOLE = (Program.MOTION, Program.ALL)
_WHAT = (
    "Standard errors of the base parameters, the combinations that act on the torque each in its own way, from the "
    "information of the motion: the regressor along it, weighted by the noise of the torques. They hold for the model "
    "with which the motion was designed, at the values that it was designed with, and for positions known well; what "
    "the model lacks comes on top."
)


def told(found: Design) -> Iterator[str]:
    """Yield what the motion is expected to tell, what it adds to what is known, and what stays open."""
    one = found.expected
    if not np.isfinite(one.std).any():
        yield "The motion tells nothing: it shows no base parameter."
        return
    shares = one.relative[valued_of(one)]
    if len(shares):
        yield (
            f"The torque depends on {count(len(one.std), 'combination')} of masses, inertias and friction (base "
            f"parameters), {len(shares)} of which have a nominal value. Of these {_grades(shares)}, by one standard "
            "error."
        )
        longer = shares / np.sqrt(LONGER)
        yield (
            f"Errors fall with the root of the time: moving {LONGER:g} times as long would halve them, and "
            f"{_grades(longer)}."
        )
        worst = _worst(one)
        if np.isfinite(one.std[worst]):
            yield (
                f"The least known is {_label(one, worst)}: {number(float(one.value[worst]), 3)} +- "
                f"{number(float(one.std[worst]), 2)}; what is poorly known hardly acts on the torque of this motion."
            )
    if unsized := len(one.std) - len(shares):
        yield (
            f"Of the other {unsized}, such as friction that the robot file does not say, there are standard errors in "
            "their units alone."
        )
    if (old := _before(found)) is not None:
        yield from _added(one, old)
    if one.open:
        stay = "stays" if len(one.open) == 1 else "stay"
        other = (
            "" if found.request.program in WHOLE else "; the optimised motion shows more (`--program motion`, `all`)"
        )
        yield f"{count(len(one.open), 'base parameter')} {stay} open: {listed(one.open, SHOWN)}{other}."


def _grades(shares: Array) -> str:
    """Return how many are known well, fairly and poorly, by their standard errors in %."""
    good, poor = int((shares <= WELL).sum()), int((~(shares <= FAIR)).sum())
    fair = len(shares) - good - poor
    return f"{good} will be known well (to {WELL:g} %), {fair} fairly (to {FAIR:g} %) and {poor} poorly"


def valued_of(one: Expected) -> NDArray[np.bool_]:
    """Return which base parameters (r) have a value, no rounding error, so that their errors are a share of it."""
    size = np.abs(one.value)
    return np.asarray(size > ROUNDING * size.max(initial=0.0))


def _worst(one: Expected) -> int:
    """Return the parameter that is known worst, of those that have a value."""
    return int(np.where(valued_of(one) & np.isfinite(one.std), one.relative, -1.0).argmax())


def _added(one: Expected, old: Expected) -> Iterator[str]:
    both = np.isfinite(old.std) & np.isfinite(one.std)
    if both.any():
        ratio = old.std[both] / one.std[both]
        best = int(np.flatnonzero(both)[ratio.argmax()])
        yield (
            "Together with what was recorded before, standard errors are smaller than now by a factor of "
            f"{number(float(np.median(ratio)), 2)} in the median, at most {number(float(ratio.max()), 3)} "
            f"({_label(one, best)})."
        )
    if new := int((~np.isfinite(old.std) & np.isfinite(one.std)).sum()):
        yield f"{count(new, 'base parameter')} that are open now will be known."


def _before(found: Design) -> Expected | None:
    """Return what was known before the motion, None where that is nothing."""
    known = found.request.prior
    return None if known is None else expected(found.model, found.theta, known, found.expected.basis)


def expected_section(found: Design) -> PageSection:
    """Return the section of the expected standard errors: table, figure, what no motion can show."""
    one, old = found.expected, _before(found)
    rows = np.flatnonzero(valued_of(one))
    labels = [_label(one, k) for k in rows.tolist()]
    caption = (
        f"Expected standard error of the base parameters that have a value, in % of it; the line is at {WELL:g} %."
    )
    known = None if old is None else old.relative[rows]
    blocks: list[PageBlock] = [_WHAT]
    if len(rows):
        blocks.append(Figure(figures.expected_figure(labels, one.relative[rows], WELL, known), caption))
    table = Fold("All numbers", (_table(one, old),))
    return PageSection("Expected standard errors", (*blocks, *_open(found), table, *_formulas(one), *_never(one)))


def _table(one: Expected, old: Expected | None) -> PageTable:
    columns = [Column("base parameter", numeric=False), Column("value"), Column("expected standard error")]
    columns += [Column("%")] + ([] if old is None else [Column("now, %")])
    valued = valued_of(one)
    rows = []
    for k in range(len(one.std)):
        cells = [_label(one, k), number(float(one.value[k])) if valued[k] else "-"]
        cells.append(number(float(one.std[k]), 2) if np.isfinite(one.std[k]) else "open")
        shares = (one.relative[k], *(() if old is None else (old.relative[k],)))
        rows.append((*cells, *(number(float(share), 2) if valued[k] else "-" for share in shares)))
    title = f"Base parameters; log det of the information {number(one.log_det)}, condition {number(one.condition, 3)}"
    return PageTable(tuple(columns), tuple(rows), title)


def _open(found: Design) -> Iterator[PageBlock]:
    """Yield what stays open, with the motion that would show it."""
    rows = []
    for note in (one for one in found.notes if isinstance(one, UnexcitedParameters)):
        how = "" if len(note.joints) == 1 else " at the same time" if note.together else ", each by itself"
        rows += [(_short(name), f"it takes motion of {', '.join(note.joints)}{how}") for name in note.groupings]
    if rows:
        columns = (Column("base parameter", numeric=False), Column("why", numeric=False))
        yield PageTable(columns, tuple(rows), "What stays open, and why")


def _formulas(one: Expected) -> Iterator[PageBlock]:
    """Yield what the shortened names stand for, where there are any."""
    rows = tuple((_label(one, k), name) for k, name in enumerate(one.basis.groupings) if _label(one, k) != name)
    if rows:
        columns = (Column("base parameter", numeric=False), Column("formula", numeric=False))
        yield Fold("What the base parameters stand for", (PageTable(columns, rows),))


def _never(one: Expected) -> Iterator[PageBlock]:
    """Yield what no motion of the robot shows."""
    if none := one.basis.without_effect:
        yield f"No motion shows {', '.join(none)}: they have no effect on the torque of this robot."
    if tied := len(one.basis.dependent) - len(none):
        yield f"{count(tied, 'more parameter')} can be known, by whatever motion, only within the combinations above."


def _label(one: Expected, k: int) -> str:
    """Return what a base parameter is called."""
    return _short(one.basis.groupings[k])


def _short(name: str) -> str:
    """Return a base parameter's formula, or, where it is long, its first parameter and how many follow."""
    if len(name) <= SHORT:
        return name
    lead, *rest = name.replace(" - ", " + ").split(" + ")
    return f"{lead} (+{len(rest)} more)" if rest else name
