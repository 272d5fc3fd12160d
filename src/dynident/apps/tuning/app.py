"""The Dash application of the page: which change of it calls which function, of the server or of its own scripts."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

from dash import ALL, ClientsideFunction, Dash, Input, Output, State, set_props
from dash.exceptions import PreventUpdate
from flask import Response, request
from werkzeug.exceptions import HTTPException

from dynident.apps.tuning.answers import Page
from dynident.apps.tuning.layout import tuning_page
from dynident.apps.tuning.request_fields import is_well_formed
from dynident.apps.tuning.session import Session
from dynident.report.page import stylesheet

FAULT_TEXT = "This is a fault of dynident, which its terminal describes: {}"


def make_app(session: Session, token: str) -> Dash:
    """Return the application of a session, all its paths below a token."""
    app = Dash(
        __name__,
        title=f"Tune {session.project.path.name}",
        update_title="",
        requests_pathname_prefix=f"/{token}/",
        routes_pathname_prefix=f"/{token}/",
        external_stylesheets=[f"/{token}/page.css"],
        prevent_initial_callbacks=True,
        suppress_callback_exceptions=True,
        add_log_handler=False,
        enable_mcp=False,
        on_error=lambda error: _report_fault(session, error),
    )
    app.index_string = app.index_string.replace("<html>", '<html lang="en">')
    page = Page(session)
    app.layout = tuning_page(session.project.path.name, session.bench)
    app.server.add_url_rule(f"/{token}/page.css", "page.css", lambda: Response(stylesheet(), mimetype="text/css"))
    app.server.add_url_rule(f"/{token}/alive", "alive", lambda: ("", 204))
    # these two answer past Dash: slider positions come fast, and their order matters
    for name, answer in (("curves", page.curves), ("act", page.act)):
        app.server.add_url_rule(f"/{token}/{name}", name, _json_view(session, answer), methods=["POST"])
    app.server.before_request(_refuse_malformed)
    app.server.register_error_handler(Exception, lambda error: _handle_error(session, error))
    _register_server_callbacks(app, page)
    _register_page_callbacks(app)
    return app


def _json_view(session: Session, answer: Callable[[Mapping[str, Any]], Any]) -> Callable[[], Any]:
    """Return the view of an answer that the page requests past Dash, which would take longer or mix up the order."""

    def view() -> Any:
        """Answer in JSON, also where an unexpected error occurs."""
        content = request.get_json()
        try:
            return answer(content if isinstance(content, dict) else {})
        except Exception as error:
            session.fault("".join(traceback.format_exception(error)))
            return {"words": FAULT_TEXT.format(error), "wrong": True}

    return view


def _refuse_malformed() -> Response | None:
    """Answer 400 to what the page does not send; the terminal hears nothing of it."""
    with suppress(RecursionError):  # of JSON that is nested too deeply
        if request.method != "POST" or is_well_formed(request.get_json()):
            return None
    return Response("This is no request of the page.", 400, mimetype="text/plain")


def _handle_error(session: Session, error: Exception) -> Any:
    """Answer a request that is not one of the page; the terminal gets a line for errors that are not HTTP's own."""
    if isinstance(error, HTTPException) and error.code is not None:
        return error if error.code < 400 else Response(error.description, error.code, mimetype="text/plain")
    # what a callback raises is reported by Dash; what Dash itself does not understand is not of the page
    if request.path.endswith("/_dash-update-component"):
        return Response("This is no request of the page.", 400, mimetype="text/plain")
    session.fault(f"A request could not be answered: {type(error).__name__}: {error}")
    return Response("The request could not be answered.", 500, mimetype="text/plain")


def _report_fault(session: Session, error: Exception) -> None:
    """Report an unexpected error on the page, and in the terminal."""
    session.fault("".join(traceback.format_exception(error)))
    set_props("complaint", {"children": FAULT_TEXT.format(error)})
    raise PreventUpdate


def _register_server_callbacks(app: Dash, page: Page) -> None:
    """Register what the server answers; what follows from the address is requested when the page loads, too."""
    address, tab, initial_call = Input("address", "search"), State("tab", "data"), {"prevent_initial_call": False}
    # two callbacks write these outputs, which Dash must be told
    saved, complaint = (Output(name, "children", allow_duplicate=True) for name in ("saved", "complaint"))
    shown = [Output(name, "children") for name in ("windows", "drawn-name", "torque-name", "unsaved", "columns")]
    app.callback(
        [Output("synced", "data"), Output("filtering", "hidden"), *shown, saved, complaint],
        address,
        prevent_initial_call="initial_duplicate",
    )(page.sync)
    app.callback([saved, complaint], Input("save", "n_clicks"), State("address", "search"), tab)(page.save)
    shown = [Output(name, "children") for name in ("numbers", "errors", "parameters", "fit-complaint")]
    app.callback([Output("last", "data"), *shown], address, State("last", "data"), tab, **initial_call)(page.fit)
    drawn = [Output(name, "data") for name in ("torque-data", "loop-data")]
    app.callback(drawn, Input("last", "data"), Input("zoomed", "data"), State("address", "search"))(page.torque)
    app.callback([Output("curve-data", "data"), Output("marks", "children")], Input("rested", "data"), tab)(page.curve)
    app.callback(
        [
            Output("verdict", "children"),
            Output("parameters", "children", allow_duplicate=True),
            Output("tick", "disabled"),
        ],
        [Input("rested", "data"), Input("tick", "n_intervals"), State("address", "search"), tab, State("last", "data")],
    )(page.verdict)


def _register_page_callbacks(app: Dash) -> None:
    """Register the functions of assets/tune.js."""

    def by(name: str, outputs: Any, *inputs: Any, **how: Any) -> None:
        app.clientside_callback(ClientsideFunction("tune", name), outputs, *inputs, **how)

    initial_call = {"prevent_initial_call": False}
    by("tab", Output("tab", "data"), Input("tune", "id"), **initial_call)
    slider_inputs = Input("degree", "value"), Input("address", "search"), Input("tab", "data")
    by("moved", Output("moved", "data"), *slider_inputs, **initial_call)
    by("curve", Output("curve", "figure"), Input("curve-data", "data"))
    by("torque", Output("torque", "figure"), Input("torque-data", "data"))
    by("loop", Output("loop", "figure"), Input("loop-data", "data"))
    kept = [Output("last", "data", allow_duplicate=True), Output("keep", "aria-pressed")]
    by("kept", kept, Input("keep", "n_clicks"), State("last", "data"))
    control_inputs = Input({"control": ALL}, "value"), Input({"button": ALL}, "n_clicks"), Input("leave", "n_clicks")
    by("told", Output("told", "data"), *control_inputs, State("from", "value"), State("to", "value"))
    by("applied", Output("synced", "modified_timestamp"), Input("synced", "data"))
    drag_state = State("dragging", "aria-pressed")
    by("leaving", Output("dragging", "aria-pressed"), Input("dragging", "n_clicks"), drag_state)
    by("gone", Output("gone-words", "children"), Input("gone", "data"))
