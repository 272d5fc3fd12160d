"""Answers of the server to a page: curves, fit, verdict; each answer follows from the address alone."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any
from urllib.parse import parse_qsl, urlencode

from dash import ctx, html, no_update
from dash.exceptions import PreventUpdate

from dynident.apps.tuning import layout, readout
from dynident.apps.tuning.drawings import Zoom, curve_drawing, motion_drawing, residual_drawing, torque_drawing
from dynident.apps.tuning.edit import apply_control, degree_words, setting_changes
from dynident.apps.tuning.readout import determined_parameters, parameter_table
from dynident.apps.tuning.session import Stale
from dynident.report.figures import time_origin
from dynident.report.page import typeset
from dynident.runtime import ConfigError, DynidentError, choices, join_names, number

if TYPE_CHECKING:
    from dynident.apps.tuning.bench import Bench
    from dynident.apps.tuning.curve import SmoothedJoint
    from dynident.apps.tuning.quick_fit import QuickFit
    from dynident.apps.tuning.session import Session, WholeRuns
    from dynident.apps.tuning.tuning import Tuning
    from dynident.report import Drawing

JOINT, LOG, ONE = "show_joint", "show_log", "only_this_joint"
VIEW_KEYS = (JOINT, LOG, ONE)


@dataclass(frozen=True)
class View:
    """A ``tuning``, the ``joint`` and the ``log`` that are drawn, and whether a change is of that joint
    ``alone``.
    """

    tuning: Tuning
    joint: str
    log: str
    alone: bool = False

    @classmethod
    def start(cls, bench: Bench) -> View:
        """Return the view that is shown first."""
        return cls(bench.start, bench.joints[0], bench.log_names[0])

    @classmethod
    def of_query(cls, text: str, bench: Bench) -> View:
        """Return the view of an address (its part after the question mark); ConfigError where it makes no sense."""
        from dynident.apps.tuning.tuning import parse_query

        pairs = parse_qsl(text.removeprefix("?"), keep_blank_values=True)
        view_values = dict(pair for pair in pairs if pair[0] in VIEW_KEYS)
        tuning = parse_query(urlencode([pair for pair in pairs if pair[0] not in VIEW_KEYS]), bench)
        joints, logs = bench.joints, bench.log_names
        joint, log = view_values.get(JOINT, joints[0]), view_values.get(LOG, logs[0])
        for key, value, allowed in ((JOINT, joint, joints), (LOG, log, logs)):
            if value not in allowed:
                raise ConfigError(f"address: {key}={value}: there is no such one; {choices(value, allowed)}")
        return cls(tuning, joint, log, alone=view_values.get(ONE) == "yes")

    def to_query(self, bench: Bench) -> str:
        """Return the part of an address from the question mark on that says what differs from the start."""
        from dynident.apps.tuning.tuning import to_query

        view_settings = [(JOINT, self.joint, bench.joints[0]), (LOG, self.log, bench.log_names[0])]
        changed_settings = [(key, value) for key, value, default in view_settings if value != default] + [
            (ONE, "yes")
        ] * self.alone
        texts = [to_query(self.tuning, bench.start, bench.joints), urlencode(changed_settings)]
        query = "&".join(text for text in texts if text)
        return f"?{query}" if query else ""


class Page:
    """Answers the callbacks of all pages of a ``session``; it keeps no state of any of them."""

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
        """Return what a browser gets first: the progress, until there is a bench."""
        name = self.session.path.name
        bench = self.session.bench
        return layout.starting_page(name) if bench is None else layout.tuning_page(name, bench, View.start(bench))

    def waiting(self, ticks: int | None, retry_clicks: int | None) -> tuple[Any, ...]:  # noqa: ARG002
        """Return the progress before there is a page, or why there is none."""
        session = self.session
        if ctx.triggered_id == "again" and session.failed:
            session.start()
        step = session.step
        width = f"{100 * step.completed / step.total:.0f}%" if step.total else "30%"
        bar = {"width": width}
        return step.words, bar, session.failed, not session.failed, session.bench is not None

    def act(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """Return the address after a control was moved, and what is wrong with its value."""
        control, search = str(change.get("control")), str(change.get("search") or "")
        try:
            view = View.start(self.bench) if control == "reset" else View.of_query(search, self.bench)
            # the browser sends a value back that it was given: rounded, or of one joint of several, it is no change
            shown_values = _control_values(view, self.bench)["controls"]
            if (
                control in shown_values and change.get("value") == shown_values[control]
            ):  # rounded, or of one joint of several
                return {"search": search, "words": ""}
            new_search = apply_control(view, control, change.get("value"), self.bench).to_query(self.bench)
            # an address that the server itself could not read must not reach the browser
            View.of_query(new_search, self.bench)
        except DynidentError as error:
            return {"search": search, "words": str(error)}
        return {"search": new_search, "words": ""}

    def sync(self, search: str) -> tuple[Any, ...]:
        """Return the values of the controls for an address, and its windows."""
        try:
            view = View.of_query(search or "", self.bench)
        except DynidentError as error:
            return (*[no_update] * 8, str(error))
        bench, tuning = self.bench, view.tuning
        return (
            _control_values(view, bench),
            _windows(tuning),
            f"{view.joint}, {view.log}",
            f"Torque of {view.joint}",
            tuning.filter is None,
            *self._file(tuning),
            "",
        )

    def _file(self, tuning: Tuning) -> tuple[Any, ...]:
        """Return the settings that are not in the file, and whether a save, or its undoing, is impossible."""
        unsaved = setting_changes(self.session.saved_tuning, tuning, self.bench.joints)
        return readout.unsaved_settings(unsaved), not unsaved, len(self.session.files) < 2

    def save(self, save: int | None, undo: int | None, search: str) -> tuple[Any, ...]:  # noqa: ARG002
        """Write the setting into the file, or restore what was there before."""
        session = self.session
        try:
            tuning = View.of_query(search or "", self.bench).tuning
            if ctx.triggered_id == "undo":
                session.undo()
                message = f"{session.path.name} is as it was before the last save."
            else:
                places = session.save(tuning)
                message = f"Saved in {session.path.name}: {join_names(places, 6) or 'as it was'}."
        except DynidentError as error:
            return "", *[no_update] * 3, str(error)
        return message, *self._file(tuning), ""

    def curves(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return the curves of the joint that is drawn for the degree at which its slider is, or what is wrong.

        While the slider moves they are less ``fine``, and without the spectrum.
        """
        try:
            bench = self.bench
            view = View.of_query(str(request.get("search") or ""), bench)
            tuning, joint = view.tuning, bench.joints.index(view.joint)
            if request.get("degree") is not None:
                tuning = tuning.with_degree(float(request["degree"]), joint if view.alone else None)
            smoothed = bench.smooth(tuning, view.log, view.joint)
        except DynidentError as error:
            return {"words": str(error), "wrong": True}
        unit, fine = bench.switches.model.joints[joint].unit, bool(request.get("fine"))
        motion = motion_drawing(smoothed, unit, tuning.windows(view.log), _zoom_window(request), fine=fine)
        reply = {
            "motion": drawing_data(motion),
            "words": _smoothing_words(smoothed, unit),
            "zero": time_origin(smoothed.t),
        }
        reply["degree"] = degree_words(tuning.degree[joint])
        return reply | ({"residual": drawing_data(residual_drawing(smoothed, unit))} if fine else {})

    def fit(self, search: str, last: Mapping[str, Any] | None, tab: str) -> Any:
        """Return the quick fit of a setting next to that of the last one."""
        return self._run_latest(tab, "fit", lambda: self._fit(search or "", last or {}))

    def _fit(self, search: str, last: Mapping[str, Any]) -> tuple[Any, ...]:
        bench = self.bench
        try:
            view = View.of_query(search, bench)
            fit = bench.fit(view.tuning)
        except DynidentError as error:
            return (*[no_update] * 5, str(error), "")
        before = self._setting_before(view.tuning, last)
        last_fit = None if before is None else bench.fit(before)
        differences = [] if before is None else setting_changes(before, view.tuning, bench.joints)
        history = last if last.get("now") == search else {"now": search, "before": last.get("now")}
        return (
            readout.numbers(fit, last_fit),
            readout.errors(fit, last_fit, view.joint),
            readout.change_list(differences),
            self._parameters(fit, last_fit),
            history,
            "",
            f"quick fit in {number(1e3 * fit.seconds, 2)} ms",
        )

    def _setting_before(self, tuning: Tuning, last: Mapping[str, Any]) -> Tuning | None:
        """Return the setting before this one; None where there was none."""
        # after a reload the newest address may be the current one: then the one before it counts
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

    def _parameters(self, fit: QuickFit, last_fit: QuickFit | None) -> list[Any]:
        now = determined_parameters(fit)
        return [
            html.H2("Parameters"),
            html.P("Quick: without errors of the motion; the whole identification follows.", className="muted"),
            parameter_table(now, None if last_fit is None else determined_parameters(last_fit)),
        ]

    def torque(self, fit_state: Any, zoomed: Any, search: str) -> Any:  # noqa: ARG002
        """Return the torque of the joint and the log that are drawn."""
        bench = self.bench
        try:
            view = View.of_query(search or "", bench)
            log = bench.fit(view.tuning).logs[view.log]
        except DynidentError:
            raise PreventUpdate from None
        joint = bench.joints.index(view.joint)
        unit = bench.switches.model.joints[joint].effort
        return drawing_data(torque_drawing(log, joint, unit, view.tuning.windows(view.log), _zoom_window(zoomed or {})))

    def curve(self, rested: Mapping[str, Any], tab: str) -> Any:
        """Return the curve of the cross-validated error, and its marks, once the user pauses."""
        return self._run_latest(tab, "curve", lambda: self._curve(rested.get("search") or ""))

    def _curve(self, search: str) -> tuple[Any, ...]:
        bench = self.bench
        try:
            view = View.of_query(search, bench)
            degree_curve = bench.curve(view.tuning, view.joint if view.alone else None)
        except DynidentError as error:
            return no_update, html.Span(str(error), className="wrong")
        joint = bench.joints.index(view.joint)
        drawn = curve_drawing(degree_curve, view.tuning.degree[joint], joint, view.alone)
        return drawing_data(drawn), [html.Button(name, id={"button": f"mark:{name}"}) for name in degree_curve.marks]

    def verdict(
        self,
        rested: Any,  # noqa: ARG002  # what calls, not what is asked
        ticks: Any,  # noqa: ARG002
        search: str,
        tab: str,
        last: Mapping[str, Any] | None,
    ) -> tuple[Any, ...]:
        """Return the verdict on the whole identification, or its progress; it begins when the user pauses."""
        try:
            view = View.of_query(search or "", self.bench)
        except DynidentError:
            return no_update, no_update, True
        if ctx.triggered_id == "rested":
            self.runs.request_run(str(tab), view.tuning)
        ended = self.runs.outcome(view.tuning)
        if ended is None:
            return readout.pending_verdict(self.runs.step(view.tuning)), no_update, False
        if ended.result is None:
            return [html.H2("Verdict"), html.P(ended.failed, role="alert", className="wrong")], no_update, True
        before = self._setting_before(view.tuning, last or {})
        outcome_before = None if before is None else self.runs.outcome(before)
        parameters_before = (
            determined_parameters(outcome_before.result)
            if outcome_before is not None and outcome_before.result is not None
            else None
        )
        parameters = [html.H2("Parameters"), parameter_table(determined_parameters(ended.result), parameters_before)]
        return readout.verdict(ended.result), parameters, True

    def _run_latest(self, tab: str, kind: str, work: Any) -> Any:
        try:
            return self.session.latest((tab, kind), work)
        except Stale:
            raise PreventUpdate from None


def drawing_data(drawing: Drawing) -> dict[str, Any]:
    """Return a figure as the plain data that a store holds."""
    figure: dict[str, Any] = json.loads(drawing.json())
    return figure


def _control_values(view: View, bench: Bench) -> dict[str, Any]:
    """Return the values of the controls by name, and which buttons are pressed."""
    tuning, joint = view.tuning, bench.joints.index(view.joint)
    parallel_filter = tuning.filter
    pressed = {
        *(f"joint:{view.joint}", f"log:{view.log}", f"reach:{'one' if view.alone else 'all'}"),
        *(f"term:{kind}" for kind in tuning.terms[joint]),
        *(f"fitted:{name}" for name in bench.joints if name not in tuning.unfitted),
        *(f"estimator:{tuning.estimator}", f"filter:{'none' if parallel_filter is None else 'low-pass'}"),
    }
    numbers = {
        "min_speed": tuning.min_speed[joint],
        "decimate": None if parallel_filter is None else parallel_filter.decimate,
        "cutoff": None if parallel_filter is None else parallel_filter.cutoff,
        "offset": round(1e3 * tuning.time_offset, 6),
    }
    return {"controls": numbers, "pressed": sorted(pressed), "degree": tuning.degree[joint]}


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


def _smoothing_words(smoothed: SmoothedJoint, unit: str) -> str:
    words = [f"S/n = {number(10.0**smoothed.degree, 3)} reached", f"noise {number(smoothed.noise, 2)} {unit}"]
    words += [f"cut-off {number(smoothed.cutoff, 3)} Hz"] if smoothed.cutoff == smoothed.cutoff else []
    words += [f"{number(smoothed.edf, 3)} degrees of freedom"] if smoothed.edf == smoothed.edf else []
    return typeset(" · ".join(words))


def _zoom_window(request: Mapping[str, Any]) -> Zoom:
    window = request.get("zoom")
    return (float(window[0]), float(window[1])) if window else None
