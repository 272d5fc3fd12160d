"""Texts and tables beside the curves: errors, condition, verdict, and the changes since the last setting."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from dash import html

from dynident.apps.tuning.edit import error_words
from dynident.identification import judge
from dynident.models import INERTIAL
from dynident.motion.splines import NORMAL_95
from dynident.report import Array
from dynident.report.identification.report import TONES
from dynident.report.page import cell, number, unit_text
from dynident.report.verdict_words import verdict_sentences
from dynident.runtime import brief, shorten_names

if TYPE_CHECKING:
    from dynident.apps.tuning.edit import Change
    from dynident.apps.tuning.quick_fit import LogPrediction, QuickFit
    from dynident.identification import Identification
    from dynident.models import Model, Parameter
    from dynident.regression import BaseParameters
    from dynident.runtime import Step

MAX_JOINT_NAME = 18  # letters of a joint's name
MIN_ERROR_CHANGE = 5e-3  # points of an error that are no difference
HELD_OUT = (
    "Choose by the cross-validated error: it is of the training, over what is fitted. Settings that are chosen by the "
    "held-out error make it one of training, too."
)
STAND_IN = (
    "Errors and torque are those of a faster estimator, in place of the one that is chosen; the verdict, and the "
    "parameters that come with it, are by the one chosen."
)

MAX_PARAMETER_NAME = 13  # letters of a name
MAX_VALUE_LENGTH = 15  # of a value with its error: a longer one is broken
MIN_MARKED_CHANGE = 3.0  # standard errors from which on a change of the last setting is marked


def worst_log(logs: Sequence[LogPrediction]) -> LogPrediction | None:
    """Return the log with the largest error, which a report states."""
    return max(logs, key=lambda log: log.error, default=None)


def judging_log(fit: QuickFit) -> tuple[LogPrediction | None, str]:
    """Return the log by which a fit is judged, and its role: held out, else of the training."""
    held_out_log = worst_log(list(fit.held_out().values()))
    return (held_out_log, "held out") if held_out_log else (worst_log(list(fit.logs.values())), "training")


def numbers(fit: QuickFit, last: QuickFit | None) -> Any:
    """Return the few numbers to see first, each with its difference from the last setting."""
    judged_log, role = judging_log(fit)
    before = None if last is None else judging_log(last)[0]
    facts = [
        (
            error_words(judged_log.error if judged_log else None),
            f"torque error, {role}",
            _error_change(_log_error(judged_log), _log_error(before)),
        ),
        (
            error_words(fit.cross_validated),
            "cross-validated",
            _error_change(fit.cross_validated, None if last is None else last.cross_validated),
        ),
        (
            number(fit.condition, 3),
            "condition",
            _previous_value(fit.condition, None if last is None else last.condition),
        ),
        (f"{fit.rank} of {len(fit.names)}", "combinations known", ""),
    ]
    fact_list = html.Dl(
        [
            html.Div([html.Dt(title), html.Dd(value), html.Dd(difference, className="note")])
            for value, title, difference in facts
        ],
        className="facts",
    )
    remarks = [*([] if fit.exact else [STAND_IN]), *([HELD_OUT] if fit.held_out() else [])]
    return [fact_list, *(html.P(words, className="muted") for words in remarks)]


def errors(fit: QuickFit, last: QuickFit | None, joint: str) -> Any:
    """Return the table of the errors by joint: held out, its difference from the last setting, and on the
    training.
    """
    judged_log, role = judging_log(fit)
    # the column of the training is left out where the judging log itself is of the training
    train = worst_log([log for log in fit.logs.values() if log.role == "train"])
    before = None if last is None else judging_log(last)[0]
    assert judged_log is not None  # noqa: S101 -- there is a log
    names = list(judged_log.by_joint)
    head = ["joint", role, "since last", *(["training"] if judged_log is not train else [])]
    rows = []
    for name, short in zip(names, shorten_names(names, MAX_JOINT_NAME), strict=True):
        size = judged_log.by_joint[name]
        cells = [
            html.Th(short, scope="row", title=name),
            html.Td(_percent(size), className="number"),
            html.Td(_error_change(size, None if before is None else before.by_joint.get(name)), className="number"),
        ]
        if judged_log is not train and train is not None:
            cells.append(html.Td(_percent(train.by_joint.get(name)), className="number muted"))
        rows.append(html.Tr(cells, className="here" if name == joint else ""))
    top = [html.Th(text, className="number" if k else "", scope="col") for k, text in enumerate(head)]
    return [html.H2("Torque error by joint, %"), html.Table([html.Thead(html.Tr(top)), html.Tbody(rows)])]


def change_list(changes: Sequence[Change]) -> Any:
    """Return the changes since the last setting."""
    return [
        html.H2("Since the last setting"),
        _list_changes(changes) if changes else html.P("Nothing was set yet.", className="muted"),
    ]


def unsaved_settings(changes: Sequence[Change]) -> Any:
    """Return the settings that are not in the file."""
    count = f"{len(changes)} setting{'s' if len(changes) > 1 else ''} not in the file"
    return html.Details([html.Summary(count), _list_changes(changes)]) if changes else ""


def verdict(result: Identification) -> Any:
    """Return the verdict on a whole identification, in words and colour."""
    judgement = judge(result)
    words = list(verdict_sentences(judgement))
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


def _list_changes(changes: Sequence[Change]) -> Any:
    return html.Ul(
        [
            html.Li([f"{quantity}: ", html.Span(before, className="muted"), " → ", html.B(now)])
            for quantity, before, now in changes
        ],
        className="changes",
    )


def _log_error(log: LogPrediction | None) -> float | None:
    return None if log is None else log.error


def _percent(value: float | None) -> str:
    return number(value, 3)


def _error_change(now: float | None, before: float | None) -> Any:
    """Return by how many points an error changed, with a sign as well as a colour."""
    if now is None or before is None or not abs(now - before) > MIN_ERROR_CHANGE:
        return "" if before is None else html.Span("±0", className="muted")
    sign, tone = ("▼", "less") if now < before else ("▲", "more")
    return html.Span(f"{sign} {number(abs(now - before), 2)}", className=tone)


def _previous_value(now: float, before: float | None) -> str:
    return "" if before is None or abs(now / before - 1) < MIN_ERROR_CHANGE else f"was {number(before, 3)}"


@dataclass(frozen=True, eq=False)
class DeterminedParameters:
    """Combinations of parameters that the data determine (r): their ``names``, ``formulas`` and units, values
    and errors.

    ``is_full`` tells whether the standard errors allow for correlated residuals and errors of the motion.
    """

    names: tuple[str, ...]
    formulas: tuple[str, ...]
    units: tuple[str, ...]
    value: Array
    std: Array
    is_full: bool

    __repr__ = brief


def determined_parameters(result: QuickFit | Identification) -> DeterminedParameters:
    """Return the parameters that the data determine; friction and other terms first, then the bodies."""
    from dynident.apps.tuning.quick_fit import QuickFit

    if isinstance(result, QuickFit):
        return _base_parameter_rows(result.model, result.base, result.base_value, result.base_std, is_full=False)
    base, errors = result.base.on_data, result.errors.base_std
    # without base parameters on the data the estimate itself is shown
    if base is None or errors is None:
        estimate = result.estimate
        return _sorted_parameters(
            result.model.parameters, estimate.names, estimate.value, result.errors.std, is_full=True
        )
    return _base_parameter_rows(result.model, base, base.to_base(result.estimate.value), errors, is_full=True)


def _base_parameter_rows(
    model: Model, base: BaseParameters, value: Array, std: Array, *, is_full: bool
) -> DeterminedParameters:
    leading = [model.parameters[k] for k in base.independent]
    return _sorted_parameters(leading, base.groupings, value, std, is_full=is_full)


def _sorted_parameters(
    leading: Sequence[Parameter], formulas: Sequence[str], value: Array, std: Array, *, is_full: bool
) -> DeterminedParameters:
    # friction and other terms first: they are read most
    order = sorted(range(len(leading)), key=lambda k: leading[k].role in INERTIAL)
    return DeterminedParameters(
        tuple(leading[k].name for k in order),
        tuple(formulas[k] for k in order),
        tuple(leading[k].unit for k in order),
        np.asarray(value)[order],
        np.asarray(std)[order],
        is_full,
    )


def parameter_table(now: DeterminedParameters, last: DeterminedParameters | None = None) -> Any:
    """Return the table; a blue tick in a bar is the value of the ``last`` setting."""
    before = {} if last is None else dict(zip(last.formulas, last.value.tolist(), strict=True))
    short_names = shorten_names(now.names, MAX_PARAMETER_NAME)
    rows = [_row(now, k, short, before.get(now.formulas[k])) for k, short in enumerate(short_names)]
    titles = html.Th("parameter"), html.Th("95 %"), html.Th("value ± 95 %", className="number"), html.Th("")
    head = html.Thead(html.Tr(list(titles)))
    return html.Div(
        html.Table([html.Caption("Parameters that the data determine", className="hidden"), head, html.Tbody(rows)]),
        className="scroll tall",
        tabIndex=0,
        role="region",
        **{"aria-label": "Parameters that the data determine"},
    )


def _row(parameters: DeterminedParameters, k: int, short: str, before: float | None) -> Any:
    """Return the row of the k-th parameter under its short name, with a tick at its value ``before``."""
    formula, value, std = parameters.formulas[k], float(parameters.value[k]), float(parameters.std[k])
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
    name_cell = html.Td(short + (" +" if formula != parameters.names[k] else ""), title=formula)
    value_words = cell(f"{number(value, 3)} ± {number(NORMAL_95 * std, 2)}")
    if len(value_words) <= MAX_VALUE_LENGTH:
        value_words = value_words.replace(" ", "\u00a0")
    unit_cell = html.Td(unit_text(parameters.units[k]), className="muted unit")
    return html.Tr([name_cell, html.Td(bar), html.Td(value_words, className="number"), unit_cell])
