"""Layout of the page: controls on the left, curves in the middle, the result of the fit on the right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from dash import dcc, html

from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.drawings import SLIDER_RANGE
from dynident.apps.tuning.edit import estimator_words

PLOT_CONFIG = {"displaylogo": False, "responsive": True, "doubleClick": "reset"}
PLOT_BUTTONS = {"modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]]}
REACH_CHOICES = {"all": "all joints", "one": "this joint"}
FILTERS = ("none", "low-pass")
STORES = (*("tab", "moved", "told", "rested", "curve-data", "torque-data", "loop-data", "zoomed", "synced", "gone"),)

LOOP_TITLE = "Friction: torque over velocity"
OTHER_SMOOTHER = (
    "The file has another smoother, which is used until the slider is moved: then it is the smoothing spline."
)
HELP = {  # by the title of a control
    "Joint": "The joint that is drawn. The fit is always of all joints.",
    "Recording": "The recording that is drawn. All are smoothed and fitted alike.",
    "Changes act on": "Whether smoothing, minimum speed and terms change for all joints or for the one that is drawn.",
    "Degree of smoothing": (
        "What the smoothing takes away, squared, over what noise would be (S/n): 1 takes away as much as noise, less "
        "follows the noise, more flattens the motion. Marks are what rules would choose."
    ),
    "Another column": "Draws a column that is not fitted below the motion, such as a reference or a temperature.",
    "Samples left out": "Windows that are neither fitted nor judged, such as contacts or stops.",
    "Minimum speed, rad/s or m/s": "Slower samples are not fitted: there the friction is not what the terms say.",
    "Terms": "Effects beside the bodies: friction, rotor inertia, offsets. Watch the cross-validated error.",
    "Torque of these joints": "Joints whose torque is fitted; leave one out where its torque was not measured well.",
    "Estimator": "How parameters follow from the samples. The physically consistent one has bodies that can exist.",
    "Parallel filter": "Filters torque and regressor alike before the fit, and keeps each k-th sample.",
    "Time offset, ms": "How much later than the torques the positions are stamped.",
    LOOP_TITLE: (
        "The torque less that of bodies and rotors, over the velocity: viscous friction is a slope, Coulomb friction a "
        "step, and a loop means that time or temperature plays a part."
    ),
}
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
    again = html.Button("Start again", id={"button": "reset"}, title="Back to what the file says", className="quiet")
    save = html.Button("Save", id="save", title="As a new file beside this one", className="strong")
    return html.Header(
        [
            html.H1(["Tune ", html.Span(name, className="file")]),
            html.Div([again, save], className="actions"),
            html.Div(id="saved", role="status"),
        ],
        className="top",
    )


def _controls(bench: Bench) -> list[Any]:
    joints = {name: name for name in bench.joints}
    estimators = {name: estimator_words(name) for name in bench.estimators}
    slider = {"min": SLIDER_RANGE[0], "max": SLIDER_RANGE[1], "step": 0.02}
    curve_config = {**PLOT_CONFIG, "displayModeBar": False}
    filter_fields = [
        _labelled_field("Keep each k-th sample", _number_input("decimate", min=1, step=1)),
        _labelled_field("Cut-off, Hz", _number_input("cutoff", min=0)),
    ]
    return [
        _section("Joint", _choice_buttons("joint", joints, "Joint")),
        _section("Recording", _choice_buttons("log", {name: name for name in bench.log_names}, "Recording")),
        _section("Changes act on", _choice_buttons("reach", REACH_CHOICES, "Changes act on")),
        html.Section(
            [
                html.Label("Degree of smoothing, S/n", htmlFor="degree", className="title"),
                _help("Degree of smoothing"),
                html.Output(id="degree-words"),
                dcc.Graph(id="curve", figure=EMPTY, config=curve_config, className="plot small"),
                dcc.Input(id="degree", type="range", value=0.0, **slider),
                html.Div(id="marks", className="choices"),
                *([] if bench.has_degree else [html.P(OTHER_SMOOTHER, className="muted")]),
            ],
            className="degree",
        ),
        _section(
            "Another column",
            dcc.Input(id={"control": "column"}, type="text", list="columns", debounce=True, placeholder="its name"),
            html.Datalist(id="columns"),
        ),
        _section("Samples left out", html.Div(id="windows"), _window_inputs()),
        _section(
            "Model",
            _labelled_field("Minimum speed, rad/s or m/s", _number_input("min_speed", min=0)),
            _titled_choice("term", _kind_names(bench.switches.kinds), "Terms")
            if bench.switches.kinds
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


def _window_inputs() -> Any:
    fields = [_labelled_field(f"{end}, s", dcc.Input(id=end, type="number", step="any")) for end in ("from", "to")]
    leave = html.Button("Leave out", id="leave", className="quiet")
    return html.Details([html.Summary("by times"), html.Div([*fields, leave], className="pair")])


def _curve_area() -> list[Any]:
    drag = html.Button("Drag to leave out samples", id="dragging", className="quiet", **{"aria-pressed": "false"})
    return [
        html.Div([html.H2(id="drawn-name"), drag], className="heading"),
        html.Div(id="motion-words", className="muted"),
        html.Div(id="motion", className="plot motion"),
        html.H2("What the smoothing takes away"),
        html.Div(id="residual", className="plot residual"),
    ]


def _fit_area() -> list[Any]:
    keep = html.Button("Keep for comparison", id="keep", className="quiet", **{"aria-pressed": "false"})
    return [
        html.Section(html.Div("no verdict yet", className="muted"), id="verdict", className="verdict"),
        html.Div(id="fit-complaint", role="alert"),
        html.Section(id="numbers"),
        html.Section(
            [
                html.Div([html.H2(id="torque-name"), keep], className="heading"),
                dcc.Graph(id="torque", figure=EMPTY, config={**PLOT_CONFIG, **PLOT_BUTTONS}, className="plot torque"),
                html.H2(LOOP_TITLE),
                _help(LOOP_TITLE),
                dcc.Graph(id="loop", figure=EMPTY, config={**PLOT_CONFIG, **PLOT_BUTTONS}, className="plot loop"),
            ]
        ),
        html.Section(id="errors"),
        html.Section(id="unsaved"),
        html.Section(id="parameters"),
    ]


def _section(title: str, *children: Any) -> Any:
    return html.Section([html.H2(title), _help(title), *children])


def _help(title: str) -> Any:
    """Return what a control does, behind a question mark."""
    if title not in HELP:
        return None
    mark = html.Summary("?", **{"aria-label": f"Help: {title}"})
    return html.Details([mark, html.P(HELP[title], className="muted")], className="help")


def _choice_buttons(name: str, options: Mapping[str, str], title: str) -> Any:
    """Return buttons that can be pressed; ``options`` are their words by value."""
    buttons = [
        html.Button(words, id={"button": f"{name}:{value}"}, title=value, **{"aria-pressed": "false"})
        for value, words in options.items()
    ]
    return html.Div(buttons, className="choices", role="group", **{"aria-label": title})


def _titled_choice(name: str, options: Mapping[str, str], title: str) -> Any:
    return html.Div([html.Span(title, className="title"), _help(title), _choice_buttons(name, options, title)])


def _labelled_field(title: str, control: Any) -> Any:
    return html.Div([html.Label([html.Span(title), control]), _help(title)], className="field")


def _number_input(name: str, **how: Any) -> Any:
    return dcc.Input(id={"control": name}, type="number", debounce=True, **{"step": "any", **how})


def _kind_names(kinds: Sequence[str]) -> dict[str, str]:
    return {kind: kind.replace("_", " ") for kind in kinds}
