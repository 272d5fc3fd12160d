"""What stands beside the curves: errors, condition, verdict, and what changed since the last setting."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from dash import html

from dynident.errors import shortened
from dynident.identification import judge
from dynident.report.advice import sentences
from dynident.report.page import number
from dynident.report.verdict import TONES
from dynident.ui.differences import error_words

if TYPE_CHECKING:
    from dynident.errors import Step
    from dynident.identification import Identification
    from dynident.tuning import LogFit, QuickFit
    from dynident.ui.differences import Change

__all__ = ["changed", "errors", "numbers", "pending", "unsaved", "verdict"]

LONGEST = 18  # letters of a joint's name
SAME = 5e-3  # points of an error that are no difference
HELD_OUT = (
    "Choose by the cross-validated error: it is of the training, over what is fitted. Settings that are chosen by the "
    "held-out error make it one of training, too."
)
STAND_IN = (
    "Errors and torque are those of a faster estimator, in place of the one that is chosen; the verdict, and the "
    "parameters that come with it, are by the one chosen."
)


def worst(logs: Sequence[LogFit]) -> LogFit | None:
    """Return the log with the largest error, which a report states."""
    return max(logs, key=lambda one: one.error, default=None)


def judged(fit: QuickFit) -> tuple[LogFit | None, str]:
    """Return the log by which a fit is judged, and what it is: held out, else of the training."""
    held = worst(list(fit.held_out().values()))
    return (held, "held out") if held else (worst(list(fit.logs.values())), "training")


def numbers(fit: QuickFit, last: QuickFit | None) -> Any:
    """Return the few numbers to see first, each with its difference from the last setting."""
    one, what = judged(fit)
    before = None if last is None else judged(last)[0]
    facts = [
        (
            error_words(one.error if one else None),
            f"torque error, {what}",
            _moved(_error(one), _error(before)),
        ),
        (
            error_words(fit.cross_validated),
            "cross-validated",
            _moved(fit.cross_validated, None if last is None else last.cross_validated),
        ),
        (number(fit.condition, 3), "condition", _times(fit.condition, None if last is None else last.condition)),
        (f"{fit.rank} of {len(fit.names)}", "combinations known", ""),
    ]
    shown = html.Dl(
        [
            html.Div([html.Dt(title), html.Dd(value), html.Dd(difference, className="note")])
            for value, title, difference in facts
        ],
        className="facts",
    )
    said = [*([] if fit.exact else [STAND_IN]), *([HELD_OUT] if fit.held_out() else [])]
    return [shown, *(html.P(words, className="muted") for words in said)]


def errors(fit: QuickFit, last: QuickFit | None, joint: str) -> Any:
    """Return the table of the errors by joint: held out, its difference from the last setting, and on the training."""
    one, what = judged(fit)
    train = worst([log for log in fit.logs.values() if log.role == "train"])
    before = None if last is None else judged(last)[0]
    assert one is not None  # noqa: S101 -- there is a log
    names = list(one.by_joint)
    head = ["joint", what, "since last", *(["training"] if one is not train else [])]
    rows = []
    for name, short in zip(names, shortened(names, LONGEST), strict=True):
        size = one.by_joint[name]
        cells = [
            html.Th(short, scope="row", title=name),
            html.Td(_percent(size), className="number"),
            html.Td(_moved(size, None if before is None else before.by_joint.get(name)), className="number"),
        ]
        if one is not train and train is not None:
            cells.append(html.Td(_percent(train.by_joint.get(name)), className="number muted"))
        rows.append(html.Tr(cells, className="here" if name == joint else ""))
    top = [html.Th(text, className="number" if k else "", scope="col") for k, text in enumerate(head)]
    return [html.H2("Torque error by joint, %"), html.Table([html.Thead(html.Tr(top)), html.Tbody(rows)])]


def changed(since: Sequence[Change]) -> Any:
    """Return what was set since the last setting."""
    return [
        html.H2("Since the last setting"),
        _list(since) if since else html.P("Nothing was set yet.", className="muted"),
    ]


def unsaved(found: Sequence[Change]) -> Any:
    """Return what is set and not in the file."""
    count = f"{len(found)} setting{'s' if len(found) > 1 else ''} not in the file"
    return html.Details([html.Summary(count), _list(found)]) if found else ""


def verdict(found: Identification) -> Any:
    """Return the verdict on a whole identification, in words and colour."""
    judgement = judge(found)
    words = list(sentences(judgement))
    badge = html.Span(judgement.use.value, className=f"badge {TONES[judgement.use]}")
    rest = html.Details([html.Summary("why"), *(html.P(text) for text in words[1:])]) if words[1:] else None
    return [html.H2(["Verdict ", badge]), html.P(words[0]), *([rest] if rest else [])]


def pending(step: Step) -> Any:
    """Return the sign that the whole identification runs."""
    share = f"{100 * step.done / step.total:.0f}%" if step.total else None
    bar = html.Div(
        html.Div(style={"width": share} if share else {}), className="progress" if share else "progress running"
    )
    words = html.P(f"The whole identification runs: {step.words}", className="muted")
    return [html.H2("Verdict"), words, bar]


def _list(found: Sequence[Change]) -> Any:
    return html.Ul(
        [
            html.Li([f"{what}: ", html.Span(before, className="muted"), " → ", html.B(now)])
            for what, before, now in found
        ],
        className="changes",
    )


def _error(one: LogFit | None) -> float | None:
    return None if one is None else one.error


def _percent(value: float | None) -> str:
    return number(value, 3)


def _moved(now: float | None, before: float | None) -> Any:
    """Return by how many points an error moved, with a sign as well as a colour."""
    if now is None or before is None or not abs(now - before) > SAME:
        return "" if before is None else html.Span("±0", className="muted")
    sign, tone = ("▼", "less") if now < before else ("▲", "more")
    return html.Span(f"{sign} {number(abs(now - before), 2)}", className=tone)


def _times(now: float, before: float | None) -> str:
    return "" if before is None or abs(now / before - 1) < SAME else f"was {number(before, 3)}"
