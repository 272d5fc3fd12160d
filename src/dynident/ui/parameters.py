"""The parameters that the data determine, with error bars: of a quick fit, or of the whole identification."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from dash import html

from dynident.errors import brief, shortened
from dynident.models import INERTIAL
from dynident.report.figures.canvas import Array
from dynident.report.page import number
from dynident.report.typography import cell, unit_text
from dynident.splines import NORMAL_95

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.models import Model
    from dynident.regression import BaseParameters
    from dynident.tuning import QuickFit

__all__ = ["Determined", "determined", "parameter_table"]

LONGEST = 13  # letters of a name
SHORT = 15  # of a value with its error: a longer one is broken
SEEN = 3.0  # standard errors from which on a change of the last setting is marked


@dataclass(frozen=True, eq=False)
class Determined:
    """Combinations of parameters that the data determine (r): their ``names``, ``formulas`` and units, values and
    standard errors, and ``whole``, whether these allow for correlated residuals and errors of the motion."""

    names: tuple[str, ...]
    formulas: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    std: Array
    whole: bool

    __repr__ = brief


def determined(found: QuickFit | Identification) -> Determined:
    """Return what the data determine; friction and other terms first, then the bodies."""
    from dynident.tuning import QuickFit

    if isinstance(found, QuickFit):
        return _ordered(found.model, found.base, found.base_value, found.base_std, whole=False)
    base, errors = found.base.on_data, found.errors.best_base
    if base is None or errors is None:
        estimate = found.estimate
        every = range(len(estimate.names))
        return _picked(found.model, every, estimate.names, estimate.value, found.errors.best, whole=True)
    return _ordered(found.model, base, base.to_base(found.estimate.value), errors, whole=True)


def _ordered(model: Model, base: BaseParameters, value: Array, std: Array, *, whole: bool) -> Determined:
    return _picked(model, base.independent, base.groupings, value, std, whole=whole)


def _picked(model: Model, leads: Any, formulas: Any, value: Array, std: Array, *, whole: bool) -> Determined:
    leading = [model.parameters[k] for k in leads]
    order = sorted(range(len(leading)), key=lambda k: leading[k].role in INERTIAL)
    return Determined(
        tuple(leading[k].name for k in order),
        tuple(formulas[k] for k in order),
        tuple(leading[k].unit for k in order),
        np.asarray(value)[order],
        np.asarray(std)[order],
        whole,
    )


def parameter_table(now: Determined, last: Determined | None = None) -> Any:
    """Return the table; a blue tick in a bar is the value of the ``last`` setting."""
    before = {} if last is None else dict(zip(last.formulas, last.value.tolist(), strict=True))
    rows = [
        _row(name, short, formula, unit, float(value), float(std), before.get(formula))
        for name, short, formula, unit, value, std in zip(
            now.names, shortened(now.names, LONGEST), now.formulas, now.units, now.value, now.std, strict=True
        )
    ]
    titles = html.Th("parameter"), html.Th("95 %"), html.Th("value ± 95 %", className="number"), html.Th("")
    head = html.Thead(html.Tr(list(titles)))
    return html.Div(
        html.Table([html.Caption("Parameters that the data determine", className="hidden"), head, html.Tbody(rows)]),
        className="scroll tall",
        tabIndex=0,
        role="region",
        **{"aria-label": "Parameters that the data determine"},
    )


def _row(name: str, short: str, formula: str, unit: str, value: float, std: float, before: float | None) -> Any:
    half = NORMAL_95 * std / abs(value) if value and np.isfinite(std) else np.inf
    tone = "good" if half <= 0.2 else "fair" if half <= 1.0 else "bad"
    ticks = []
    if before is not None and std > 0 and abs(value - before) > 1e-9 * abs(value):
        moved = float(np.clip(50.0 + 50.0 * (before - value) / max(abs(value), 1e-300), 0.0, 100.0))
        ticks.append(html.I(className="tick", style={"left": f"{moved:.1f}%"}))
    width = float(min(half, 1.0)) * 100.0
    bar = html.Span(
        [html.I(className=f"range {tone}", style={"left": f"{50 - width / 2:.1f}%", "width": f"{width:.1f}%"}), *ticks],
        className="interval",
        title=f"95 % within {number(100 * half, 2)} % of the value",
    )
    named = html.Td(short + (" +" if formula != name else ""), title=formula)
    both = cell(f"{number(value, 3)} ± {number(NORMAL_95 * std, 2)}")
    if len(both) <= SHORT:
        both = both.replace(" ", "\u00a0")
    unit_cell = html.Td(unit_text(unit), className="muted unit")
    return html.Tr([named, html.Td(bar), html.Td(both, className="number"), unit_cell])
