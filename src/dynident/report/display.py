"""How an identification shows itself: lines in a terminal, tables in a notebook, the report's figures one by one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import InputError, choices, listed
from dynident.identification import Use, judge
from dynident.report import figures
from dynident.report.check import check_summary, check_tables
from dynident.report.page import PageTable, number
from dynident.report.parameters import terminal_parameters
from dynident.report.validation import error_table
from dynident.report.verdict import verdict_text
from dynident.report.wording import words
from dynident.report.words import ROLES, logs_of

if TYPE_CHECKING:
    import plotly.graph_objects as go

    from dynident.checks import CheckResult
    from dynident.identification import Identification
    from dynident.models import Joint
    from dynident.validation import LogValidation

__all__ = ["Plot", "check_html", "check_lines", "summary", "summary_html"]

FEW = 3  # parameters, logs and findings of a summary
LONGEST = 100  # letters of a sentence there


def summary(found: Identification) -> str:
    """Return a few lines: what the model is fit for, the torque errors, and the first parameters."""
    return "\n".join(_lines(found))


def _lines(found: Identification) -> Iterator[str]:
    verdict = judge(found) if _judged(found) else None
    yield f"<Identification of {found.model.name!r}" + (f": {verdict.use.value}" if verdict else "")
    if verdict and verdict.use is Use.DO_NOT_USE:
        yield f"  {_cut(words(verdict.reasons[0]))}"
    for role, word in ROLES.items():
        if logs := logs_of(found, role):
            errors = (f"{log.name} {number(log.errors.relative_error, 3)} %" for log in logs)
            yield f"  torque error, {word}: {listed(errors, FEW)}"
    rows = zip(found.estimate.names, found.estimate.value, found.errors.best, found.estimate.units, strict=True)
    known = sorted(rows, key=lambda row: not np.isfinite(row[2]))  # what the data determine first
    shown = (f"{name} = {number(value)} +- {number(std, 2)} {unit}" for name, value, std, unit in known)
    yield f"  {listed(shown, FEW)}>"


def _judged(found: Identification) -> bool:
    """Whether the signals are there that a verdict looks at; a saved result has none."""
    return bool(found.validations) and all(log.signals is not None for log in found.validations)


def check_lines(found: CheckResult) -> str:
    """Return a few lines: how many errors and warnings there are, and the most severe of them."""
    worst = [row for table in check_tables(found)[: len(found.findings) and 1] for row in table.rows][:FEW]
    lines = [f"<CheckResult: {check_summary(found)}", *(_cut(f"  {': '.join(filter(None, row))}") for row in worst)]
    return "\n".join(lines) + ">"


def check_html(found: CheckResult) -> str:
    """Return the findings and the facts behind them as HTML for a notebook; all texts are escaped."""
    return f"<div><p><b>{escape(check_summary(found))}</b></p>{''.join(map(_table, check_tables(found)))}</div>"


def _cut(text: str) -> str:
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."


def summary_html(found: Identification) -> str:
    """Return the verdict, the errors and the parameters as HTML for a notebook; all texts are escaped."""
    table, notes = terminal_parameters(found)
    verdict = verdict_text(found)[0] if _judged(found) else "A saved result; its verdict is in its report."
    parts = [f"<h4>{escape(found.model.name)}</h4>", f"<p><b>{escape(verdict)}</b></p>"]
    parts += [_table(error_table(found)), _table(table), *(f"<p>{escape(note)}</p>" for note in notes)]
    return f"<div>{''.join(parts)}</div>"


def _table(table: PageTable) -> str:
    sides = ["right" if column.numeric else "left" for column in table.columns]
    heads = "".join(
        f'<th style="text-align: {side}">{escape(column.group)}{"<br>" * bool(column.group)}{escape(column.title)}</th>'
        for side, column in zip(sides, table.columns, strict=True)
    )
    rows = (
        "".join(f'<td style="text-align: {side}">{escape(cell)}</td>' for side, cell in zip(sides, row, strict=True))
        for row in table.rows
    )
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table><caption>{escape(table.caption)}</caption><tr>{heads}</tr>{body}</table>"


@dataclass(frozen=True, eq=False)
class Plot:
    """The figures of a report, drawn by plotly; a notebook shows each that a cell returns, ``write_html`` writes it.

    ``log`` and ``joint`` are names; by default the first log that was held out, and the joint with its largest error.
    Raises InputError for unknown names, and for signals of a result that was loaded from a file.
    """

    found: Identification

    def __repr__(self) -> str:
        calls = ("torque(log, joint)", "smoothing(log, joint)", "free_run(log, joint)", "errors()", "parameters()")
        return f"<Plot of {self.found.model.name!r}: {', '.join(calls)}; each has write_html(file)>"

    def torque(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw measured and predicted torque of one joint, and their difference."""
        one, axis = self._chosen(log, joint)
        return figures.torque_figure(one, axis.name, axis.effort).figure()

    def smoothing(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw position, velocity and acceleration of one joint, and what the smoothing took away."""
        one, axis = self._chosen(log, joint)
        motion = one.motion
        return figures.motion_figure(motion, axis.name, axis.unit, 2000, one.recorded, motion.time_offset).figure()

    def free_run(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw measured and simulated position of one joint; InputError where there is no free simulation."""
        one, axis = self._chosen(log, joint)
        if one.free_run is None:
            raise InputError(
                f"{one.name}: there is no free simulation; ask for one by the field `restart` of a recipe."
            )
        return figures.run_figure(one.free_run, axis.name, axis.unit).figure()

    def errors(self) -> go.Figure:
        """Draw the torque error of each joint on all logs."""
        return figures.error_figure(self.found.validations, [joint.name for joint in self.found.model.joints]).figure()

    def parameters(self) -> go.Figure:
        """Draw the 95 % interval of each parameter, in % of its value."""
        estimate, model = self.found.estimate, self.found.model
        known = () if figures.only_nominal(model) else [parameter.value for parameter in model.parameters]
        return figures.interval_figure(
            estimate.names, estimate.units, estimate.value, self.found.errors.best, known
        ).figure()

    def _chosen(self, log: str | None, joint: str | None) -> tuple[LogValidation, Joint]:
        logs = {one.name: one for one in (*logs_of(self.found, "train"), *logs_of(self.found, "validation"))}
        if log is None:
            log = next(iter(logs_of(self.found, "validation")), next(iter(logs.values()))).name
        if log not in list(logs):
            raise InputError(f"there is no log {log!r}; {choices(log, logs)}")
        joints = {one.name: one for one in self.found.model.joints}
        if joint is None:
            joint = max(joints, key=lambda name: logs[log].errors.per_joint.get(name, 0.0))
        if joint not in list(joints):
            raise InputError(f"there is no joint {joint!r}; {choices(joint, joints)}")
        return logs[log], joints[joint]
