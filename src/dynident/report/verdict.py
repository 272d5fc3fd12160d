"""The verdict on an identification in a report: words first, then the mass matrix, residuals and free simulations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from dynident.report.page import Block, Column, Section, Table, number
from dynident.verdict import judge

if TYPE_CHECKING:
    from dynident.identify import Identification

__all__ = ["residual_table", "simulation_section", "verdict_results", "verdict_section", "verdict_text"]

_RESIDUALS = (
    "Explained: one minus the variance left over that of the torque. Of the effort limit: the rmse, in % of what the "
    "robot file allows the joint. Independent after: the time after which samples of the residual count as new ones; "
    "where it is longer than one step, standard errors that assume independence are too small. White: the p-value of "
    "Ljung and Box; real residuals are hardly ever white. The last columns tell where the residual is."
)
_RUNS = (
    "The model is simulated instead of the robot and its position compared with the measured one. In the loop of a "
    "controller, which holds almost any model on its way, look at the torque it asks for too."
)


def verdict_text(identification: Identification) -> tuple[str, tuple[str, ...]]:
    """Return for a terminal the verdict in one paragraph, and the next steps."""
    verdict = judge(identification)
    return f"Verdict: {' '.join(verdict.sentences)}", verdict.next_steps


def verdict_section(identification: Identification) -> Section:
    """Return the verdict with its reasons, what to do next, and the sentence on the mass matrix."""
    verdict = judge(identification)
    blocks: list[Block] = [*verdict.sentences]
    if identification.mass:
        blocks.append(identification.mass.sentence)
    if verdict.reasons:
        blocks.append(Section("Against more", (verdict.reasons,)))
    if verdict.next_steps:
        blocks.append(Section("What to do next", (verdict.next_steps,)))
    return Section(f"Verdict: {verdict.word}", tuple(blocks))


def residual_table(identification: Identification) -> tuple[Block, ...]:
    """Return what is left of the torque, per log and joint, with the words that explain the columns."""
    heads = ("explained", "of the effort limit, %", "independent after, s", "white, p", "below 5 Hz, %", "peak, Hz")
    columns = (Column("log", numeric=False), Column("joint", numeric=False), *map(Column, heads))
    rows = [
        (
            log.name,
            joint,
            number(log.explained.get(joint), 4),
            number(log.effort_share.get(joint), 2),
            number(test.decorrelation, 2),
            number(test.p_value, 2),
            number(100 * test.low_share, 2),
            number(test.peak, 3),
            number(100 * test.reversal_share, 2),
            test.words or "-",
        )
        for log in identification.logs
        for joint, test in log.residuals.items()
    ]
    more = (Column("at reversals, %"), Column("points to", numeric=False))
    return (_RESIDUALS, Table((*columns, *more), tuple(rows), "What is left of the torque, unfiltered")) if rows else ()


def simulation_section(identification: Identification) -> Iterator[Section]:
    """Yield the section of the free simulations, where there are any."""
    if not identification.runs:
        return
    words = (Column("log", numeric=False), Column("driven by", numeric=False), Column("joint", numeric=False))
    columns = (*words, *map(Column, ("position error, %", "of its way, %", "rms", "torque error, %")))
    units = {joint.name: joint.unit for joint in identification.model.joints}
    rows = [
        (
            run.name,
            run.driver if run.restart is None else f"{run.driver}, {run.restart:g} s",
            joint,
            number(run.relative_error[joint], 3),
            number(run.motion_error[joint], 3),
            f"{number(run.rms[joint], 3)} {units[joint]}",
            number(run.torque_error.get(joint), 3),
        )
        for run in identification.runs
        for joint in run.joints
    ]
    failures = tuple(f"{run.name}: {run.failure}" for run in identification.runs if run.failure)
    table = Table(columns, tuple(rows), "Free simulation beside the measured position")
    yield Section("Free simulation", (_RUNS, table, *((failures,) if failures else ())))


def verdict_results(identification: Identification) -> dict[str, Any]:
    """Return the verdict, the mass matrix and the free simulations as plain values."""
    verdict = {
        key: list(value) if isinstance(value, tuple) else value for key, value in asdict(judge(identification)).items()
    }
    found: dict[str, Any] = {"verdict": verdict}
    if mass := identification.mass:
        found["mass_matrix"] = {"positive": bool(mass.positive), "smallest": mass.smallest, "q": mass.q.tolist()}
    keys = ("driver", "restart", "relative_error", "motion_error", "rms", "torque_error", "failure")
    found["simulation"] = {run.name: {key: getattr(run, key) for key in keys} for run in identification.runs}
    return found
