"""Answers of the server to a page: curves, fit, verdict; each answer follows from the address alone."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

from dash import ctx, html, no_update
from dash.exceptions import PreventUpdate

from dynident.apps.tuning import readout
from dynident.apps.tuning.bench import Bench
from dynident.apps.tuning.curve import SmoothedJoint
from dynident.apps.tuning.drawings import (
    OTHER_SETTING,
    Zoom,
    curve_drawing,
    loop_drawing,
    motion_drawing,
    residual_drawing,
    torque_drawing,
)
from dynident.apps.tuning.edit import View, apply_control, degree_words, setting_changes
from dynident.apps.tuning.quick_fit import QuickFit
from dynident.apps.tuning.readout import parameter_table
from dynident.apps.tuning.session import Session, Stale, tuned_paths
from dynident.apps.tuning.tuning import Tuning
from dynident.report import Array, Drawing
from dynident.report.figures import time_origin
from dynident.report.page import typeset
from dynident.runtime import DynidentError, number


class Page:
    """Answers the callbacks of all pages of a ``session``; it keeps no state of any of them."""

    def __init__(self, session: Session) -> None:
        self.session, self.bench, self.runs = session, session.bench, session.runs

    def act(self, change: Mapping[str, Any]) -> dict[str, Any]:
        """Return the address after a control was moved, and what is wrong with its value."""
        control, search = str(change.get("control")), str(change.get("search") or "")
        try:
            view = View.start(self.bench) if control == "reset" else View.of_query(search, self.bench)
            # the browser sends a value back that it was given: rounded, or of one joint of several, it is no change
            shown_values = _control_values(view, self.bench)["controls"]
            if control in shown_values and change.get("value") == shown_values[control]:
                return {"search": search, "words": ""}
            new_search = apply_control(view, control, change.get("value"), self.bench).to_query(self.bench)
            # an address that the server itself could not read must not reach the browser
            View.of_query(new_search, self.bench)
        except DynidentError as error:
            return {"search": search, "words": str(error)}
        return {"search": new_search, "words": ""}

    def sync(self, search: str) -> tuple[Any, ...]:
        """Return the values of the controls for an address, its windows, and how it differs from the file."""
        try:
            view = View.of_query(search or "", self.bench)
        except DynidentError as error:
            return (*[no_update] * 8, str(error))
        bench, tuning = self.bench, view.tuning
        return (
            _control_values(view, bench),
            tuning.filter is None,
            _windows(tuning),
            f"{view.joint}, {view.log}",
            f"Torque of {view.joint}",
            readout.unsaved_settings(setting_changes(bench.start, tuning, bench.joints)),
            [html.Option(value=name) for name in self._other_columns(view.log)],
            "",
            "",
        )

    def _other_columns(self, log: str) -> tuple[str, ...]:
        """Return the columns of a recording that are not used; none where it cannot be read any longer."""
        try:
            return self.bench.other_columns(log)
        except DynidentError:
            return ()

    def save(self, save: int | None, search: str, tab: str) -> tuple[str, str]:  # noqa: ARG002
        """Write the setting into a new file, and return its name, or what is wrong."""
        try:
            path = self.session.save(View.of_query(search or "", self.bench).tuning, str(tab))
        except DynidentError as error:
            return "", str(error)
        usual_name = next(tuned_paths(path)).name
        remark = "" if path.name == usual_name else f" {usual_name} is not of this page, and stays as it is."
        return f"Saved in {path.name}.{remark}", ""

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
            beside = None
            if view.column in self._other_columns(view.log):
                beside = view.column, bench.other_column(view.log, view.column, smoothed.t)
        except DynidentError as error:
            return {"words": str(error), "wrong": True}
        unit, fine = bench.switches.model.joints[joint].unit, bool(request.get("fine"))
        windows, zoom = tuning.windows(view.log), _zoom_window(request)
        motion = motion_drawing(smoothed, unit, windows, zoom, fine=fine, beside=beside)
        reply: dict[str, Any] = {"motion": drawing_data(motion), "words": _smoothing_words(smoothed, unit)}
        reply |= {"zero": time_origin(smoothed.t), "degree": degree_words(tuning.degree[joint])}
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
            return (*[no_update] * 4, str(error))
        before = self._setting_before(view.tuning, last)
        last_fit = None if before is None else bench.fit(before)
        history = last if last.get("now") == search else {**last, "now": search, "before": last.get("now")}
        errors = readout.errors(fit, last_fit, view.joint)
        return history, readout.numbers(fit, last_fit), errors, parameter_table(fit, last_fit), ""

    def _setting_before(self, tuning: Tuning, last: Mapping[str, Any]) -> Tuning | None:
        """Return the setting to compare with: the one that was kept, else that before; None where there is none."""
        # after a reload the newest address may be the current one: then the one before it counts
        for key in ("kept", "now", "before"):
            if last.get(key) is None:
                continue
            try:
                before = View.of_query(last[key], self.bench).tuning
            except DynidentError:  # of another run of the server
                continue
            if before != tuning:
                return before
        return None

    def torque(self, last: Mapping[str, Any] | None, zoomed: Any, search: str) -> Any:
        """Return the torque of the joint and the log that are drawn, over time and over velocity, with that of the
        setting to compare with."""
        bench = self.bench
        try:
            view = View.of_query(search or "", bench)
            before = self._setting_before(view.tuning, last or {})
            fits = [bench.fit(tuning) for tuning in (view.tuning, before) if tuning is not None]
        except DynidentError:
            raise PreventUpdate from None
        joint, windows = bench.joints.index(view.joint), view.tuning.windows(view.log)
        unit, speed_unit = bench.switches.model.joints[joint].effort, f"{bench.switches.model.joints[joint].unit}/s"
        log, *others = (fit.logs[view.log] for fit in fits)
        over_time = torque_drawing(log, joint, unit, windows, _zoom_window(zoomed or {}), *others)
        over_velocity = loop_drawing(_friction_loops(fits, view.log, joint), unit, speed_unit)
        return drawing_data(over_time), drawing_data(over_velocity)

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
        parameters = parameter_table(ended.result, outcome_before.result if outcome_before else None)
        return readout.verdict(ended.result), parameters, True

    def _run_latest(self, tab: str, kind: str, work: Any) -> Any:
        try:
            return self.session.latest((tab, kind), work)
        except Stale:
            raise PreventUpdate from None


def _friction_loops(fits: Sequence[QuickFit], name: str, joint: int) -> dict[str, tuple[Array, Array]]:
    """Return velocities and torques without those of the bodies: measured, predicted, and by another setting."""
    loops: dict[str, tuple[Array, Array]] = {}
    for fit, title in zip(fits, ("predicted", OTHER_SETTING), strict=False):
        log = fit.logs[name]
        mask, inertial = log.motion.mask, fit.inertial_torque[name][:, joint]
        for key, torque in (("measured", log.motion.tau), (title, log.predicted)):
            loops.setdefault(key, (log.motion.dq[mask, joint], (torque[:, joint] - inertial)[mask]))
    return {key: loops[key] for key in ("measured", OTHER_SETTING, "predicted") if key in loops}  # the last on top


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
        "column": view.column,
    }
    return {"controls": numbers, "pressed": sorted(pressed), "degree": tuning.degree[joint]}


def _windows(tuning: Tuning) -> Any:
    if not tuning.excluded:
        return html.P("None. Drag over the curves, or give times.", className="muted")
    items = []
    for k, (log, start, stop) in enumerate(tuning.excluded):
        button = html.Button("use again", id={"button": f"include:{k}"}, className="quiet small")
        items.append(html.Li([f"{log}: {number(start, 4)} to {number(stop, 4)} s ", button]))
    return html.Ul(items, className="windows")


def _smoothing_words(smoothed: SmoothedJoint, unit: str) -> str:
    words = [f"S/n = {number(10.0**smoothed.degree, 3)} reached", f"noise {number(smoothed.noise, 2)} {unit}"]
    words += [f"cut-off {number(smoothed.cutoff, 3)} Hz"] if smoothed.cutoff == smoothed.cutoff else []
    words += [f"{number(smoothed.edf, 3)} degrees of freedom"] if smoothed.edf == smoothed.edf else []
    return typeset(" · ".join(words))


def _zoom_window(request: Mapping[str, Any]) -> Zoom:
    window = request.get("zoom")
    return (float(window[0]), float(window[1])) if window else None
