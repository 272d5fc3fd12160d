"""The page as Dash runs it: which change of it asks what, of the server or of its own scripts."""

from __future__ import annotations

import json
import traceback
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from dash import ALL, ClientsideFunction, Dash, Input, Output, State, set_props
from dash.exceptions import PreventUpdate

from dynident.report.page import stylesheet
from dynident.ui.page import Page

if TYPE_CHECKING:
    from dynident.ui.session import Session

__all__ = ["made"]

FAULT = "This is a fault of dynident, which its terminal describes: {}"
FILE = (("unsaved", "children"), ("save", "disabled"), ("undo", "disabled"))  # what follows from the file, too


def made(session: Session, token: str) -> Dash:
    """Return the application of a session, all its paths below a token."""
    app = Dash(
        __name__,
        title=f"Tune {session.path.name}",
        update_title="",
        requests_pathname_prefix=f"/{token}/",
        routes_pathname_prefix=f"/{token}/",
        external_stylesheets=[f"/{token}/page.css"],
        prevent_initial_callbacks=True,
        suppress_callback_exceptions=True,
        add_log_handler=False,
        enable_mcp=False,
        on_error=lambda error: _fault(session, error),
    )
    app.index_string = app.index_string.replace("<html>", '<html lang="en">')
    page = Page(session)
    app.layout = page.layout
    app.server.add_url_rule(f"/{token}/page.css", "page.css", _styles)
    app.server.add_url_rule(f"/{token}/alive", "alive", lambda: ("", 204))
    for name, answer in (("curves", page.curves), ("act", page.act)):
        app.server.add_url_rule(f"/{token}/{name}", name, _answering(session, answer), methods=["POST"])
    app.server.register_error_handler(Exception, lambda error: _refused(session, error))
    _starting(app, page)
    _asked_of_server(app, page)
    _done_by_page(app)
    return app


def _styles() -> Any:
    from flask import Response

    return Response(stylesheet(), mimetype="text/css")


def _answering(session: Session, answer: Callable[[Mapping[str, Any]], Any]) -> Callable[[], Any]:
    """Return the view of an answer that the page asks for past Dash, which would take longer or mix up an order."""

    def view() -> Any:
        """Answer in JSON; what nobody foresaw in words, too."""
        from flask import Response, request

        content = request.get_json()
        try:
            found = answer(content if isinstance(content, dict) else {})
        except PreventUpdate:
            found = {"words": "The logs are still being read.", "wrong": True}
        except Exception as error:
            session.fault("".join(traceback.format_exception(error)))
            found = {"words": FAULT.format(error), "wrong": True}
        return Response(json.dumps(found), mimetype="application/json")

    return view


def _refused(session: Session, error: Exception) -> Any:
    """Answer a request that is none of the page in words; the terminal gets a line of what is not HTTP's own."""
    from flask import Response
    from werkzeug.exceptions import HTTPException

    if isinstance(error, HTTPException) and error.code is not None:
        return error if error.code < 400 else Response(error.description, error.code, mimetype="text/plain")
    session.fault(f"A request could not be answered: {type(error).__name__}: {error}")
    return Response("The request could not be answered.", 500, mimetype="text/plain")


def _fault(session: Session, error: Exception) -> None:
    """Say an error that nobody foresaw on the page, and in the terminal."""
    session.fault("".join(traceback.format_exception(error)))
    set_props("complaint", {"children": FAULT.format(error)})
    raise PreventUpdate


def _starting(app: Dash, page: Page) -> None:
    shown = (("step", "children"), ("bar", "style"), ("failure", "children"), ("again", "hidden"), ("ready", "data"))
    app.callback([Output(*one) for one in shown], [Input("waiting", "n_intervals"), Input("again", "n_clicks")])(
        page.waiting
    )
    app.clientside_callback(ClientsideFunction("tune", "reload"), Output("track", "title"), Input("ready", "data"))


def _asked_of_server(app: Dash, page: Page) -> None:
    """Register what the server answers; what follows from the address is asked for when the page comes, too."""
    address, tab, first = Input("address", "search"), State("tab", "data"), {"prevent_initial_call": False}
    file = [Output(*one, allow_duplicate=True) for one in FILE]
    said = Output("complaint", "children", allow_duplicate=True)
    shown = (("synced", "data"), ("windows", "children"), ("drawn-name", "children"), ("torque-name", "children"))
    app.callback(
        [*(Output(*one) for one in (*shown, ("filtering", "hidden"))), *file, said],
        address,
        prevent_initial_call="initial_duplicate",
    )(page.sync)
    app.callback(
        [Output("saved", "children"), *file, said],
        [Input("save", "n_clicks"), Input("undo", "n_clicks")],
        State("address", "search"),
    )(page.save)
    shown = (("numbers", "children"), ("errors", "children"), ("changed", "children"), ("parameters", "children"))
    more = (("last", "data"), ("fit-complaint", "children"), ("state", "children"))
    app.callback([Output(*one) for one in (*shown, *more)], address, State("last", "data"), tab, **first)(page.fit)
    app.callback(
        Output("torque-data", "data"), Input("last", "data"), Input("zoomed", "data"), State("address", "search")
    )(page.torque)
    app.callback([Output("curve-data", "data"), Output("marks", "children")], Input("rested", "data"), tab)(page.curve)
    app.callback(
        [
            Output("verdict", "children"),
            Output("parameters", "children", allow_duplicate=True),
            Output("tick", "disabled"),
        ],
        [Input("rested", "data"), Input("tick", "n_intervals"), State("address", "search"), tab, State("last", "data")],
    )(page.whole)


def _done_by_page(app: Dash) -> None:
    """Register what the functions in assets/tune.js do."""

    def by(name: str, outputs: Any, *inputs: Any, **how: Any) -> None:
        app.clientside_callback(ClientsideFunction("tune", name), outputs, *inputs, **how)

    first = {"prevent_initial_call": False}
    by("tab", Output("tab", "data"), Input("tune", "id"), **first)
    moved = Input("degree", "value"), Input("address", "search"), Input("tab", "data")
    by("moved", Output("moved", "data"), *moved, **first)
    by("curve", Output("curve", "figure"), Input("curve-data", "data"))
    by("torque", Output("torque", "figure"), Input("torque-data", "data"))
    told = Input({"control": ALL}, "value"), Input({"button": ALL}, "n_clicks"), Input("leave", "n_clicks")
    by("told", Output("told", "data"), *told, State("from", "value"), State("to", "value"))
    by("applied", Output("synced", "modified_timestamp"), Input("synced", "data"))
    pressed = State("dragging", "aria-pressed")
    by("leaving", Output("dragging", "aria-pressed"), Input("dragging", "n_clicks"), pressed)
    by("gone", Output("gone-words", "children"), Input("gone", "data"))
