"""Texts and tables beside the curves: errors, condition, verdict, and the changes since the last setting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from dash import html

from dynident.apps.tuning.edit import Change
from dynident.apps.tuning.quick_fit import LogPrediction, QuickFit
from dynident.identification import Identification, judge
from dynident.models import INERTIAL
from dynident.motion.splines import NORMAL_95
from dynident.report.identification.report import TONES
from dynident.report.page import cell, unit_text
from dynident.report.words import ROLES
from dynident.runtime import Step, number, percent

MIN_ERROR_CHANGE = 5e-3  # points of an error that are no difference
HELD_OUT = "Choose by the cross-validated error. A held-out error by which many settings are chosen becomes too small."
STAND_IN = (
    "Errors and torque are those of a faster estimator, in place of the one that is chosen; the verdict, and the "
    "parameters that come with it, are by the one chosen."
)

MAX_VALUE_LENGTH = 15  # of a value with its error: a longer one is broken


def worst_log(fit: QuickFit, role: str) -> LogPrediction | None:
    """Return the log of a role ("train", "validation") with the largest error, which a report states."""
    return max((log for log in fit.logs.values() if log.role == role), key=lambda log: log.error, default=None)


def judging_log(fit: QuickFit) -> LogPrediction:
    """Return the log by which a fit is judged: held out, else of the training."""
    log = worst_log(fit, "validation") or worst_log(fit, "train")
    assert log is not None  # noqa: S101 -- there is a log
    return log


def numbers(fit: QuickFit, last: QuickFit | None) -> Any:
    """Return the few numbers to see first, each with its difference from the last setting."""
    log, condition_change = judging_log(fit), ""
    error_before, validated_before = (judging_log(last).error, last.cross_validated) if last else (None, None)
    if last and abs(fit.condition / last.condition - 1) >= MIN_ERROR_CHANGE:
        condition_change = f"was {number(last.condition, 3)}"
    validated_change = _error_change(fit.cross_validated, validated_before)
    facts = [
        (percent(log.error), f"torque error, {ROLES[log.role]}", _error_change(log.error, error_before)),
        (percent(fit.cross_validated), "cross-validated", validated_change),
        (number(fit.condition, 3), "condition", condition_change),
        (f"{fit.estimate.determined.rank} of {len(fit.estimate.names)}", "combinations known", ""),
    ]
    cells = ([html.Dt(title), html.Dd(value), html.Dd(change, className="note")] for value, title, change in facts)
    remarks = [STAND_IN] * (not fit.exact) + [HELD_OUT] * (log.role == "validation")
    fact_list = html.Dl([html.Div(cell) for cell in cells], className="facts")
    return [fact_list, *(html.P(words, className="muted") for words in remarks)]


def errors(fit: QuickFit, last: QuickFit | None, joint: str) -> Any:
    """Return the table of the errors by joint: held out, its difference from the last setting, and in training."""
    log, train = judging_log(fit), worst_log(fit, "train")
    before = judging_log(last).by_joint if last else {}
    # the column of the training is left out where the judging log itself is of the training
    train_errors = train.by_joint if train is not None and train is not log else None
    head = ["joint", ROLES[log.role], "since last", *(["training"] if train_errors else [])]
    rows = []
    for name in log.by_joint:
        size = log.by_joint[name]
        cells = [
            html.Th(_breakable(name), scope="row"),
            html.Td(number(size, 3), className="number"),
            html.Td(_error_change(size, before.get(name)), className="number"),
        ]
        if train_errors:
            cells.append(html.Td(number(train_errors[name], 3), className="number muted"))
        rows.append(html.Tr(cells, className="here" if name == joint else ""))
    top = [html.Th(text, className="number" if k else "", scope="col") for k, text in enumerate(head)]
    return [html.H2("Torque error by joint, %"), html.Table([html.Thead(html.Tr(top)), html.Tbody(rows)])]


def unsaved_settings(changes: Sequence[Change]) -> Any:
    """Return the settings that are not as in the file."""
    if not changes:
        return ""
    items = [
        html.Li([f"{quantity}: ", html.Span(before, className="muted"), " → ", html.B(now)])
        for quantity, before, now in changes
    ]
    return [html.H2("Not as in the file"), html.Ul(items, className="changes")]


def verdict(result: Identification) -> Any:
    """Return the verdict on a whole identification, in words and colour."""
    judgement = judge(result)
    words = list(judgement.sentences())
    badge = html.Span(judgement.use.value, className=f"badge {TONES[judgement.use]}")
    details = html.Details([html.Summary("why"), *(html.P(text) for text in words[1:])]) if words[1:] else None
    return [html.H2(["Verdict ", badge]), html.P(words[0]), *([details] if details else [])]


def pending_verdict(step: Step) -> Any:
    """Return the sign that the whole identification runs."""
    share = f"{100 * step.completed / step.total:.0f}%" if step.total else None
    bar = html.Div(
        html.Div(style={"width": share} if share else {}), className="progress" if share else "progress running"
    )
    words = html.P(f"The whole identification runs: {step.words}", className="muted")
    return [html.H2("Verdict"), words, bar]


def _error_change(now: float | None, before: float | None) -> Any:
    """Return by how many points an error changed, with a sign as well as a colour."""
    if now is None or before is None or not abs(now - before) > MIN_ERROR_CHANGE:
        return "" if before is None else html.Span("±0", className="muted")
    sign, tone = ("▼", "less") if now < before else ("▲", "more")
    return html.Span(f"{sign} {number(abs(now - before), 2)}", className=tone)


class ParameterRow(NamedTuple):
    """A combination of parameters that the data determine: its ``name``, ``formula``, ``unit``, value and error."""

    name: str
    formula: str
    unit: str
    value: float
    std: float


def determined_parameters(result: QuickFit | Identification) -> list[ParameterRow]:
    """Return the parameters that the data determine; friction and other terms first, then the bodies."""
    parameters, estimate = result.model.parameters, result.estimate
    if isinstance(result, Identification):
        base, std = result.base.on_data, result.errors.base_std
        columns = estimate.names, estimate.value, result.errors.std  # unless there is a base
    else:
        base, std = result.base, result.base_std
    if base is not None and std is not None:
        parameters = tuple(parameters[k] for k in base.independent)
        columns = base.groupings, base.to_base(estimate.value), std
    rows = sorted(zip(parameters, *columns, strict=True), key=lambda row: row[0].role in INERTIAL)
    return [ParameterRow(leading.name, formula, leading.unit, *map(float, size)) for leading, formula, *size in rows]


def parameter_table(now: QuickFit | Identification, last: QuickFit | Identification | None = None) -> list[Any]:
    """Return the parameters of a fit with their heading; a blue tick in a bar is the value of the ``last`` setting."""
    parameters = determined_parameters(now)
    before = {row.formula: row.value for row in (determined_parameters(last) if last else ())}
    rows = [_row(row, before.get(row.formula)) for row in parameters]
    titles = html.Th("parameter"), html.Th("95 %"), html.Th("value ± 95 %", className="number"), html.Th("")
    head = html.Thead(html.Tr(list(titles)))
    title = "Parameters that the data determine"
    table = html.Table([html.Caption(title, className="hidden"), head, html.Tbody(rows)])
    is_quick = not isinstance(now, Identification)
    words = "Quick: without errors of the motion; the whole identification follows."
    return [
        html.H2("Parameters"),
        *([html.P(words, className="muted")] if is_quick else []),
        html.Div(table, className="scroll tall", tabIndex=0, role="region", **{"aria-label": title}),
    ]


def _breakable(name: str) -> list[Any]:
    """Return a name that may be broken after each underscore, and is never cut."""
    *heads, tail = name.split("_")
    return [*(part for head in heads for part in (f"{head}_", html.Wbr())), tail]


def _row(parameter: ParameterRow, before: float | None) -> Any:
    """Return the row of a parameter, with a tick at its value ``before``."""
    formula, value, std = parameter.formula, parameter.value, parameter.std
    relative_half = NORMAL_95 * std / abs(value) if value and np.isfinite(std) else np.inf
    tone = "good" if relative_half <= 0.2 else "fair" if relative_half <= 1.0 else "bad"
    ticks = []
    if before is not None and std > 0 and abs(value - before) > 1e-9 * abs(value):
        tick_position = float(np.clip(50.0 + 50.0 * (before - value) / max(abs(value), 1e-300), 0.0, 100.0))
        ticks.append(html.I(className="tick", style={"left": f"{tick_position:.1f}%"}))
    width = float(min(relative_half, 1.0)) * 100.0
    bar = html.Span(
        [html.I(className=f"range {tone}", style={"left": f"{50 - width / 2:.1f}%", "width": f"{width:.1f}%"}), *ticks],
        className="interval",
        title=f"95 % within {number(100 * relative_half, 2)} % of the value",
    )
    name_cell = html.Td([*_breakable(parameter.name), " +" if formula != parameter.name else ""], title=formula)
    value_words = cell(f"{number(value, 3)} ± {number(NORMAL_95 * std, 2)}")
    if len(value_words) <= MAX_VALUE_LENGTH:
        value_words = value_words.replace(" ", "\u00a0")
    unit_cell = html.Td(unit_text(parameter.unit), className="muted unit")
    return html.Tr([name_cell, html.Td(bar), html.Td(value_words, className="number"), unit_cell])
