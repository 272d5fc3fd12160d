"""The page: controls on the left, curves in the middle, what the fit gives on the right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dash import dcc, html

from dynident.errors import shortened
from dynident.ui.differences import estimator_words
from dynident.ui.drawings import SLIDER

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dynident.tuning import Bench
    from dynident.ui.view import View

__all__ = ["page", "starting"]

LONGEST = 22  # letters of a name of a joint or log
DRAW = {"displaylogo": False, "responsive": True, "doubleClick": "reset"}
BUTTONS = {"modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]]}
REACH = {"all": "all joints", "one": "this joint"}
FILTERS = ("none", "low-pass")


def starting(name: str) -> Any:
    """Return the page while the logs are read and identified for the first time."""
    return html.Main(
        [
            dcc.Interval(id="waiting", interval=300),
            dcc.Store(id="ready"),
            html.H1(f"Tune {name}"),
            html.Div("starting", id="step", className="lead", role="status"),
            html.Div(html.Div(id="bar"), className="progress", id="track"),
            html.Div(id="failure", role="alert"),
            html.Button("Read again", id="again", className="quiet", hidden=True),
        ],
        className="starting",
    )


def page(name: str, bench: Bench, view: View) -> Any:
    """Return the page of a bench, with its controls as the view has them."""
    return html.Div(
        [
            dcc.Location(id="address", refresh=False),
            *(dcc.Store(id=one) for one in STORES),
            dcc.Store(id="last", storage_type="session"),  # what was shown before: a reload keeps it
            dcc.Interval(id="tick", interval=400, disabled=True),
            _head(name),
            html.Div(id="gone-words", role="alert"),
            html.Div(id="complaint", role="alert"),
            html.Div(
                [
                    html.Aside(_controls(bench, view), className="controls", **{"aria-label": "Settings"}),
                    html.Main(_curves(bench), className="curves"),
                    html.Aside(_fit(), className="fit", **{"aria-label": "What the fit gives"}),
                ],
                className="bench",
            ),
        ],
        id="tune",
    )


STORES = (*("tab", "moved", "told", "rested", "curve-data", "torque-data", "zoomed", "synced", "gone"),)


def _head(name: str) -> Any:
    return html.Header(
        [
            html.H1(["Tune ", html.Span(name, className="file")]),
            html.Div(id="state", role="status", **{"aria-live": "polite"}),
            html.Div(
                [
                    html.Button(
                        "Start again", id={"button": "reset"}, title="Back to what the file says", className="quiet"
                    ),
                    html.Button("Undo save", id="undo", className="quiet", disabled=True),
                    html.Button("Save", id="save", className="strong", disabled=True),
                ],
                className="actions",
            ),
            html.Div(id="saved", role="status"),
        ],
        className="top",
    )


def _controls(bench: Bench, view: View) -> list[Any]:
    tuning, filtering = view.tuning, view.tuning.filter
    joint = bench.joints.index(view.joint)
    joints, fitted = _short(bench.joints), [one for one in bench.joints if one not in tuning.unfitted]
    estimators = {one: estimator_words(one) for one in bench.estimators}
    low_pass = "none" if filtering is None else "low-pass"
    return [
        _group("Joint", _choice("joint", joints, [view.joint], "Joint")),
        _group("Recording", _choice("log", _short(bench.log_names), [view.log], "Recording")),
        _group("Changes act on", _choice("reach", REACH, ["one" if view.alone else "all"], "Changes act on")),
        html.Section(
            [
                html.Label("Degree of smoothing, S/n", htmlFor="degree", className="title"),
                html.Output(id="degree-words"),
                dcc.Graph(id="curve", figure=EMPTY, config={**DRAW, "displayModeBar": False}, className="plot small"),
                dcc.Input(
                    id="degree", type="range", min=SLIDER[0], max=SLIDER[1], step=0.02, value=tuning.degree[joint]
                ),
                html.Div(id="marks", className="choices"),
                *_other(bench),
            ],
            className="degree",
        ),
        _group("Samples left out", html.Div(id="windows"), _window()),
        _group(
            "Model",
            _named("Minimum speed, rad/s or m/s", _number("min_speed", tuning.min_speed[joint], min=0)),
            _titled("Terms", _choice("term", _words(bench.kinds), tuning.terms[joint], "Terms"))
            if bench.kinds
            else html.P("Terms are switched where the model is of a robot file.", className="muted"),
        ),
        _group(
            "Fit",
            _titled("Torque of these joints", _choice("fitted", joints, fitted, "Torque of these joints")),
            _titled("Estimator", _choice("estimator", estimators, [tuning.estimator], "Estimator")),
            _titled("Parallel filter", _choice("filter", _words(FILTERS), [low_pass], "Parallel filter")),
            html.Div(
                [
                    _named(
                        "Keep each k-th sample",
                        _number("decimate", None if filtering is None else filtering.decimate, min=1, step=1),
                    ),
                    _named("Cut-off, Hz", _number("cutoff", None if filtering is None else filtering.cutoff, min=0)),
                ],
                id="filtering",
                className="pair",
                hidden=filtering is None,
            ),
            _named("Time offset, ms", _number("offset", 1e3 * tuning.time_offset)),
        ),
    ]


def _other(bench: Bench) -> list[Any]:
    """Return what to say where the file has another smoother than the slider stands for."""
    if bench.has_degree:
        return []
    words = "The file has another smoother, which is used until the slider is moved: then it is the smoothing spline."
    return [html.P(words, className="muted")]


def _window() -> Any:
    return html.Details(
        [
            html.Summary("by times"),
            html.Div(
                [
                    _named("from, s", dcc.Input(id="from", type="number", step="any")),
                    _named("to, s", dcc.Input(id="to", type="number", step="any")),
                    html.Button("Leave out", id="leave", className="quiet"),
                ],
                className="pair",
            ),
        ]
    )


def _curves(bench: Bench) -> list[Any]:  # noqa: ARG001
    return [
        html.Div(
            [
                html.H2(id="drawn-name"),
                html.Button("Drag to leave out samples", id="dragging", className="quiet", **{"aria-pressed": "false"}),
            ],
            className="heading",
        ),
        html.Div(id="motion-words", className="muted"),
        html.Div(id="motion", className="plot motion"),
        html.H2("What the smoothing takes away"),
        html.Div(id="residual", className="plot residual"),
    ]


def _fit() -> list[Any]:
    return [
        html.Section(html.Div("no verdict yet", className="muted"), id="verdict", className="verdict"),
        html.Div(id="fit-complaint", role="alert"),
        html.Section(id="numbers"),
        html.Section(
            [
                html.H2(id="torque-name"),
                dcc.Graph(id="torque", figure=EMPTY, config={**DRAW, **BUTTONS}, className="plot torque"),
            ]
        ),
        html.Section(id="errors"),
        html.Section([html.Div(id="changed"), html.Div(id="unsaved")]),
        html.Section(id="parameters"),
    ]


EMPTY: dict[str, Any] = {
    "data": [],
    "layout": {
        "paper_bgcolor": "rgba(0,0,0,0)",
        "plot_bgcolor": "rgba(0,0,0,0)",
        "xaxis": {"visible": False},
        "yaxis": {"visible": False},
    },
}


def _group(title: str, *children: Any) -> Any:
    return html.Section([html.H2(title), *children])


def _short(names: Sequence[str]) -> dict[str, str]:
    return dict(zip(names, shortened(names, LONGEST), strict=True))


def _choice(name: str, options: Mapping[str, str], chosen: Sequence[str], title: str) -> Any:
    """Return buttons of which those that are ``chosen`` are pressed; ``options`` are their words by value."""
    buttons = [
        html.Button(
            words, id={"button": f"{name}:{one}"}, title=one, **{"aria-pressed": "true" if one in chosen else "false"}
        )
        for one, words in options.items()
    ]
    return html.Div(buttons, className="choices", role="group", **{"aria-label": title})


def _titled(title: str, made: Any) -> Any:
    return html.Div([html.Span(title, className="title"), made])


def _named(title: str, control_of: Any) -> Any:
    return html.Label([html.Span(title), control_of], className="field")


def _number(name: str, value: float | None, **how: Any) -> Any:
    return dcc.Input(id={"control": name}, type="number", value=value, debounce=True, **{"step": "any", **how})


def _words(kinds: Sequence[str]) -> dict[str, str]:
    return {kind: kind.replace("_", " ") for kind in kinds}
