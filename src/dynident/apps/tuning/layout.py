"""Layout of the page: controls on the left, curves in the middle, the result of the fit on the right."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from dash import dcc, html

from dynident.apps.tuning.drawings import SLIDER_RANGE
from dynident.apps.tuning.edit import estimator_words
from dynident.runtime import shorten_names

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from dynident.apps.tuning.bench import Bench

MAX_NAME_LENGTH = 22  # letters of a name of a joint or log
PLOT_CONFIG = {"displaylogo": False, "responsive": True, "doubleClick": "reset"}
PLOT_BUTTONS = {"modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]]}
REACH_CHOICES = {"all": "all joints", "one": "this joint"}
FILTERS = ("none", "low-pass")
STORES = (*("tab", "moved", "told", "rested", "curve-data", "torque-data", "zoomed", "synced", "gone"),)

EMPTY: dict[str, Any] = {
    "layout": {f"{part}_bgcolor": "rgba(0,0,0,0)" for part in ("paper", "plot")}
    | {axis: {"visible": False} for axis in ("xaxis", "yaxis")}
}


def tuning_page(name: str, bench: Bench) -> Any:
    """Return the page of a bench; its controls are set when the server answers to its address."""
    return html.Div(
        [
            dcc.Location(id="address", refresh=False),
            *(dcc.Store(id=store) for store in STORES),
            dcc.Store(id="last", storage_type="session"),  # what was shown before: a reload keeps it
            dcc.Interval(id="tick", interval=400, disabled=True),
            _header(name),
            html.Div(id="gone-words", role="alert"),
            html.Div(id="complaint", role="alert"),
            html.Div(
                [
                    html.Aside(_controls(bench), className="controls", **{"aria-label": "Settings"}),
                    html.Main(_curve_area(), className="curves"),
                    html.Aside(_fit_area(), className="fit", **{"aria-label": "What the fit gives"}),
                ],
                className="bench",
            ),
        ],
        id="tune",
    )


def _header(name: str) -> Any:
    return html.Header(
        [
            html.H1(["Tune ", html.Span(name, className="file")]),
            html.Div(
                [
                    html.Button(
                        "Start again", id={"button": "reset"}, title="Back to what the file says", className="quiet"
                    ),
                    html.Button("Save", id="save", title="As a new file beside this one", className="strong"),
                ],
                className="actions",
            ),
            html.Div(id="saved", role="status"),
        ],
        className="top",
    )


def _controls(bench: Bench) -> list[Any]:
    joints = _short_names(bench.joints)
    estimators = {name: estimator_words(name) for name in bench.estimators}
    slider = {"min": SLIDER_RANGE[0], "max": SLIDER_RANGE[1], "step": 0.02}
    curve_config = {**PLOT_CONFIG, "displayModeBar": False}
    filter_fields = [
        _labelled_field("Keep each k-th sample", _number_input("decimate", min=1, step=1)),
        _labelled_field("Cut-off, Hz", _number_input("cutoff", min=0)),
    ]
    return [
        _section("Joint", _choice_buttons("joint", joints, "Joint")),
        _section("Recording", _choice_buttons("log", _short_names(bench.log_names), "Recording")),
        _section("Changes act on", _choice_buttons("reach", REACH_CHOICES, "Changes act on")),
        html.Section(
            [
                html.Label("Degree of smoothing, S/n", htmlFor="degree", className="title"),
                html.Output(id="degree-words"),
                dcc.Graph(id="curve", figure=EMPTY, config=curve_config, className="plot small"),
                dcc.Input(id="degree", type="range", value=0.0, **slider),
                html.Div(id="marks", className="choices"),
                *_smoother_hint(bench),
            ],
            className="degree",
        ),
        _section("Samples left out", html.Div(id="windows"), _window_inputs()),
        _section(
            "Model",
            _labelled_field("Minimum speed, rad/s or m/s", _number_input("min_speed", min=0)),
            _titled_choice("term", _kind_names(bench.kinds), "Terms")
            if bench.kinds
            else html.P("Terms are switched where the model is of a robot file.", className="muted"),
        ),
        _section(
            "Fit",
            _titled_choice("fitted", joints, "Torque of these joints"),
            _titled_choice("estimator", estimators, "Estimator"),
            _titled_choice("filter", _kind_names(FILTERS), "Parallel filter"),
            html.Div(filter_fields, id="filtering", className="pair", hidden=True),
            _labelled_field("Time offset, ms", _number_input("offset")),
        ),
    ]


def _smoother_hint(bench: Bench) -> list[Any]:
    """Return the hint where the file has another smoother than the one that the slider stands for."""
    if bench.has_degree:
        return []
    hint = "The file has another smoother, which is used until the slider is moved: then it is the smoothing spline."
    return [html.P(hint, className="muted")]


def _window_inputs() -> Any:
    return html.Details(
        [
            html.Summary("by times"),
            html.Div(
                [
                    _labelled_field("from, s", dcc.Input(id="from", type="number", step="any")),
                    _labelled_field("to, s", dcc.Input(id="to", type="number", step="any")),
                    html.Button("Leave out", id="leave", className="quiet"),
                ],
                className="pair",
            ),
        ]
    )


def _curve_area() -> list[Any]:
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


def _fit_area() -> list[Any]:
    return [
        html.Section(html.Div("no verdict yet", className="muted"), id="verdict", className="verdict"),
        html.Div(id="fit-complaint", role="alert"),
        html.Section(id="numbers"),
        html.Section(
            [
                html.H2(id="torque-name"),
                dcc.Graph(id="torque", figure=EMPTY, config={**PLOT_CONFIG, **PLOT_BUTTONS}, className="plot torque"),
            ]
        ),
        html.Section(id="errors"),
        html.Section(id="unsaved"),
        html.Section(id="parameters"),
    ]


def _section(title: str, *children: Any) -> Any:
    return html.Section([html.H2(title), *children])


def _short_names(names: Sequence[str]) -> dict[str, str]:
    return dict(zip(names, shorten_names(names, MAX_NAME_LENGTH), strict=True))


def _choice_buttons(name: str, options: Mapping[str, str], title: str) -> Any:
    """Return buttons that can be pressed; ``options`` are their words by value."""
    buttons = [
        html.Button(words, id={"button": f"{name}:{value}"}, title=value, **{"aria-pressed": "false"})
        for value, words in options.items()
    ]
    return html.Div(buttons, className="choices", role="group", **{"aria-label": title})


def _titled_choice(name: str, options: Mapping[str, str], title: str) -> Any:
    return html.Div([html.Span(title, className="title"), _choice_buttons(name, options, title)])


def _labelled_field(title: str, control: Any) -> Any:
    return html.Label([html.Span(title), control], className="field")


def _number_input(name: str, **how: Any) -> Any:
    return dcc.Input(id={"control": name}, type="number", debounce=True, **{"step": "any", **how})


def _kind_names(kinds: Sequence[str]) -> dict[str, str]:
    return {kind: kind.replace("_", " ") for kind in kinds}
