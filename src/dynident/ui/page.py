"""What the server answers to a page: curves, fit, verdict; each answer follows from the address alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from dash import ctx, html, no_update
from dash.exceptions import PreventUpdate

from dynident.errors import DynidentError, listed
from dynident.report.figures.canvas import origin
from dynident.report.page import number
from dynident.report.typography import said
from dynident.ui import layout, readout
from dynident.ui.differences import changes, degree_words
from dynident.ui.drawings import Zoom, curve_drawing, motion_drawing, residual_drawing, torque_drawing
from dynident.ui.edit import edited
from dynident.ui.latest import Stale
from dynident.ui.parameters import determined, parameter_table
from dynident.ui.view import View

if TYPE_CHECKING:
    from dynident.report.figures import Drawing
    from dynident.tuning import Bench, QuickFit, Smoothed, Tuning
    from dynident.ui.session import Session
    from dynident.ui.whole import WholeRuns

__all__ = ["Page"]


class Page:
    """Answers the callbacks of all pages of a ``session``; it knows none of them by itself."""

    def __init__(self, session: Session) -> None:
        self.session = session

    @property
    def bench(self) -> Bench:
        """The bench, once there is one."""
        if self.session.bench is None:
            raise PreventUpdate
        return self.session.bench

    @property
    def runs(self) -> WholeRuns:
        """The whole identifications."""
        if self.session.runs is None:
            raise PreventUpdate
        return self.session.runs

    def layout(self) -> Any:
        """Return what a browser gets first: what is being done, until there is a bench."""
        name = self.session.path.name
        bench = self.session.bench
        return layout.starting(name) if bench is None else layout.page(name, bench, View.start(bench))

    def waiting(self, ticks: int | None, again: int | None) -> tuple[Any, ...]:  # noqa: ARG002
        """Say what is being done before there is a page, or why there is none."""
        session = self.session
        if ctx.triggered_id == "again" and session.failed:
            session.start()
        step = session.step
        width = f"{100 * step.done / step.total:.0f}%" if step.total else "30%"
        bar = {"width": width}
        return step.words, bar, session.failed, not session.failed, session.bench is not None

    def act(self, moved: Mapping[str, Any]) -> dict[str, Any]:
        """Return the address after a control was moved, and what is wrong with its value."""
        control, search = str(moved.get("control")), str(moved.get("search") or "")
        try:
            view = View.start(self.bench) if control == "reset" else View.of_query(search, self.bench)
            shown = _controls(view, self.bench)["controls"]
            if control in shown and moved.get("value") == shown[control]:  # rounded, or of one joint of several
                return {"search": search, "words": ""}
            after = edited(view, control, moved.get("value"), self.bench).to_query(self.bench)
            View.of_query(after, self.bench)
        except DynidentError as error:
            return {"search": search, "words": str(error)}
        return {"search": after, "words": ""}

    def sync(self, search: str) -> tuple[Any, ...]:
        """Return what the controls show for an address, and its windows."""
        try:
            view = View.of_query(search or "", self.bench)
        except DynidentError as error:
            return (*[no_update] * 8, str(error))
        bench, tuning = self.bench, view.tuning
        return (
            _controls(view, bench),
            _windows(tuning),
            f"{view.joint}, {view.log}",
            f"Torque of {view.joint}",
            tuning.filter is None,
            *self._file(tuning),
            "",
        )

    def _file(self, tuning: Tuning) -> tuple[Any, ...]:
        """Return what is not in the file, and whether it cannot be saved, or a save undone."""
        unsaved = changes(self.session.saved, tuning, self.bench.joints)
        return readout.unsaved(unsaved), not unsaved, len(self.session.files) < 2

    def save(self, save: int | None, undo: int | None, search: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Write the setting into the file, or what was there before."""
        session = self.session
        try:
            tuning = View.of_query(search or "", self.bench).tuning
            if ctx.triggered_id == "undo":
                session.undo()
                said = f"{session.path.name} is as it was before the last save."
            else:
                places = session.save(tuning)
                said = f"Saved in {session.path.name}: {listed(places, 6) or 'as it was'}."
        except DynidentError as error:
            return "", *[no_update] * 3, str(error)
        return said, *self._file(tuning), ""

    def curves(self, wanted: Mapping[str, Any]) -> dict[str, Any]:
        """Return the curves of the joint that is drawn for the degree at which its slider is, or what is wrong.

        While the slider moves they are less ``fine``, and without the spectrum.
        """
        try:
            bench = self.bench
            view = View.of_query(str(wanted.get("search") or ""), bench)
            tuning, joint = view.tuning, bench.joints.index(view.joint)
            if wanted.get("degree") is not None:
                tuning = tuning.with_degree(float(wanted["degree"]), joint if view.alone else None)
            one = bench.smoothed(tuning, view.log, view.joint)
        except DynidentError as error:
            return {"words": str(error), "wrong": True}
        unit, fine = bench.switches.model.joints[joint].unit, bool(wanted.get("fine"))
        motion = motion_drawing(one, unit, tuning.windows(view.log), _zoom(wanted), fine=fine)
        found = {"motion": plain(motion), "words": _reached(one, unit), "zero": origin(one.t)}
        found["degree"] = degree_words(tuning.degree[joint])
        return found | ({"residual": plain(residual_drawing(one, unit))} if fine else {})

    def fit(self, search: str, last: Mapping[str, Any] | None, tab: str) -> Any:
        """Return the quick fit of a setting beside that of the last one."""
        return self._newest(tab, "fit", lambda: self._fit(search or "", last or {}))

    def _fit(self, search: str, last: Mapping[str, Any]) -> tuple[Any, ...]:
        bench = self.bench
        try:
            view = View.of_query(search, bench)
            fit = bench.fitted(view.tuning)
        except DynidentError as error:
            return (*[no_update] * 5, str(error), "")
        before = self._before(view.tuning, last)
        old = None if before is None else bench.fitted(before)
        since = [] if before is None else changes(before, view.tuning, bench.joints)
        kept = last if last.get("now") == search else {"now": search, "before": last.get("now")}
        return (
            readout.numbers(fit, old),
            readout.errors(fit, old, view.joint),
            readout.changed(since),
            self._parameters(fit, old),
            kept,
            "",
            f"quick fit in {number(1e3 * fit.seconds, 2)} ms",
        )

    def _before(self, tuning: Tuning, last: Mapping[str, Any]) -> Tuning | None:
        """Return the setting before this one; None where there was none."""
        for key in ("now", "before"):
            if last.get(key) is None:
                continue
            try:
                before = View.of_query(last[key], self.bench).tuning
            except DynidentError:  # of another run of the server
                continue
            if before != tuning:
                return before
        return None

    def _parameters(self, fit: QuickFit, old: QuickFit | None) -> list[Any]:
        now = determined(fit)
        return [
            html.H2("Parameters"),
            html.P("Quick: without errors of the motion; the whole identification follows.", className="muted"),
            parameter_table(now, None if old is None else determined(old)),
        ]

    def torque(self, kept: Any, zoomed: Any, search: str) -> Any:  # noqa: ARG002
        """Return the torque of the joint and the log that are drawn."""
        bench = self.bench
        try:
            view = View.of_query(search or "", bench)
            log = bench.fitted(view.tuning).logs[view.log]
        except DynidentError:
            raise PreventUpdate from None
        joint = bench.joints.index(view.joint)
        unit = bench.switches.model.joints[joint].effort
        return plain(torque_drawing(log, joint, unit, view.tuning.windows(view.log), _zoom(zoomed or {})))

    def curve(self, rested: Mapping[str, Any], tab: str) -> Any:
        """Return the curve of the cross-validated error, and its marks, once a person pauses."""
        return self._newest(tab, "curve", lambda: self._curve(rested.get("search") or ""))

    def _curve(self, search: str) -> tuple[Any, ...]:
        bench = self.bench
        try:
            view = View.of_query(search, bench)
            found = bench.curve(view.tuning, view.joint if view.alone else None)
        except DynidentError as error:
            return no_update, html.Span(str(error), className="wrong")
        joint = bench.joints.index(view.joint)
        drawn = curve_drawing(found, view.tuning.degree[joint], joint, view.alone)
        return plain(drawn), [html.Button(name, id={"button": f"mark:{name}"}) for name in found.marks]

    def whole(self, rested: Any, ticks: Any, search: str, tab: str, last: Mapping[str, Any] | None) -> tuple[Any, ...]:  # noqa: ARG002
        """Return the verdict on the whole identification, or how far it is; it begins when a person pauses."""
        try:
            view = View.of_query(search or "", self.bench)
        except DynidentError:
            return no_update, no_update, True
        if ctx.triggered_id == "rested":
            self.runs.want(str(tab), view.tuning)
        ended = self.runs.ended(view.tuning)
        if ended is None:
            return readout.pending(self.runs.step(view.tuning)), no_update, False
        if ended.found is None:
            return [html.H2("Verdict"), html.P(ended.failed, role="alert", className="wrong")], no_update, True
        before = self._before(view.tuning, last or {})
        old = None if before is None else self.runs.ended(before)
        was = determined(old.found) if old is not None and old.found is not None else None
        parameters = [html.H2("Parameters"), parameter_table(determined(ended.found), was)]
        return readout.verdict(ended.found), parameters, True

    def _newest(self, tab: str, what: str, work: Any) -> Any:
        try:
            return self.session.latest((tab, what), work)
        except Stale:
            raise PreventUpdate from None


def plain(drawing: Drawing) -> dict[str, Any]:
    """Return a figure as the plain data that a store holds."""
    found: dict[str, Any] = json.loads(drawing.json())
    return found


def _controls(view: View, bench: Bench) -> dict[str, Any]:
    """Return the values of the controls by name, and which buttons are pressed."""
    tuning, joint = view.tuning, bench.joints.index(view.joint)
    filtering = tuning.filter
    chosen = {
        *(f"joint:{view.joint}", f"log:{view.log}", f"reach:{'one' if view.alone else 'all'}"),
        *(f"term:{kind}" for kind in tuning.terms[joint]),
        *(f"fitted:{one}" for one in bench.joints if one not in tuning.unfitted),
        *(f"estimator:{tuning.estimator}", f"filter:{'none' if filtering is None else 'low-pass'}"),
    }
    numbers = {
        "min_speed": tuning.min_speed[joint],
        "decimate": None if filtering is None else filtering.decimate,
        "cutoff": None if filtering is None else filtering.cutoff,
        "offset": round(1e3 * tuning.time_offset, 6),
    }
    return {"controls": numbers, "pressed": sorted(chosen), "degree": tuning.degree[joint]}


def _windows(tuning: Tuning) -> Any:
    if not tuning.excluded:
        return html.P("None. Drag over the curves, or give times.", className="muted")
    return html.Ul(
        [
            html.Li(
                [
                    f"{log}: {number(start, 4)} to {number(stop, 4)} s ",
                    html.Button("use again", id={"button": f"include:{k}"}, className="quiet small"),
                ]
            )
            for k, (log, start, stop) in enumerate(tuning.excluded)
        ],
        className="windows",
    )


def _reached(one: Smoothed, unit: str) -> str:
    words = [f"S/n = {number(10.0**one.degree, 3)} reached", f"noise {number(one.noise, 2)} {unit}"]
    words += [f"cut-off {number(one.cutoff, 3)} Hz"] if one.cutoff == one.cutoff else []
    words += [f"{number(one.edf, 3)} degrees of freedom"] if one.edf == one.edf else []
    return said(" · ".join(words))


def _zoom(wanted: Mapping[str, Any]) -> Zoom:
    given = wanted.get("zoom")
    return (float(given[0]), float(given[1])) if given else None
