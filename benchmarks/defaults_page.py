"""The tables of docs/defaults.md, from the figures that benchmarks/defaults.py and friction_choice.py have measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from defaults_robots import ROBOTS, Robot
from page_tables import DOCS, OUT, filled, markdown, read_figures

__all__ = ["FIGURES", "PAGE", "draw", "laws", "page", "worded"]

PAGE, FIGURES = DOCS / "defaults.md", OUT / "defaults.json"
LABELS = {"by hand": "by hand", "after": "defaults"}  # what is kept, and what the page calls it
Row = dict[str, Any]


def draw() -> None:
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), read_figures(FIGURES)), encoding="utf-8")


def page(text: str, kept: Row) -> str:
    """Return the page with its tables anew."""
    tables = ("robots", robots), ("laws", laws), ("peers", peers)
    return filled(text, {name: table(kept[name]) for name, table in tables if name in kept})


def robots(rows: Mapping[str, Mapping[str, Row]]) -> str:
    """Return the rows, those of a robot together, as Markdown."""
    head = "| | held out, % | reported, % | by joint, % | train, % | terms | s of CPU | mark | noise | refit |"
    lines = [head, "|" + "---|" * 10]
    for name, robot in ROBOTS.items():
        for label, shown in LABELS.items():
            if (row := rows.get(label, {}).get(name)) is not None:
                lines.append("| " + " | ".join([f"{robot.title}, {shown}", *cells(robot, row)]) + " |")
                others = [f"{x['error']:.3g}" for x in row.get("logs", []) if x["role"] == "validation"][1:]
                if others:
                    lines.append(f"| the same on {len(others)} other recordings | {', '.join(others)} |" + " |" * 8)
    return "\n".join(lines)


def peers(rows: Mapping[str, list[Row]]) -> str:
    """Return the errors of others on the same samples as Markdown."""
    lines = []
    for name, fits in rows.items():
        for fit in fits:
            figures = [
                f"{fit[key]:.3g}" if fit.get(key) is not None else "" for key in ("error", "low_passed", "seconds")
            ]
            title = ROBOTS[name].title if fit is fits[0] else ""
            lines.append([title, fit["who"], *(figures if "error" in fit else [f"cannot: {fit['reason']}", "", ""])])
    return markdown(["", "", "held out, %", "after 10 Hz, %", "s of CPU"], lines)


def laws(rows: Mapping[str, Row]) -> str:
    """Return the scores of the laws of friction as Markdown."""
    lines = ["| | found | wrong | same speed | twice as fast | terms missed | wrong terms added |", "|" + "---|" * 7]
    for law, case in rows.items():
        result = f"{case['found']} of {case['needed']}" if case["needed"] else ""
        figures = [law, result, f"{case['wrong']} of {case['joints']}", f"{case['same']:.3f}", f"{case['fast']:.3f}"]
        named = [", ".join(f"{kind} {count}" for kind, count in case[key].items()) for key in ("missed", "entered")]
        lines.append("| " + " | ".join([*figures, *named]) + " |")
    return "\n".join(lines)


def cells(robot: Robot, row: Row) -> list[str]:
    case = held_out(row)
    if case is None:
        return [f"refused: {row['refused']}", *[""] * 8]
    train = next(log for log in row["logs"] if log["role"] == "train")
    mark = "" if robot.mark is None else f"{robot.mark:g}: {'met' if case['error'] <= robot.mark else '**not met**'}"
    joints = ", ".join(f"{value:.3g}" for value in case["joints"].values())
    terms = worded(row["chosen"]["terms"], len(case["joints"]))
    figures = case["error"], case["as_validated"], train["error"], row["seconds"]
    held, reported, trained, seconds = (f"{value:.3g}" for value in figures)
    return [held, reported, joints, trained, terms, seconds, mark, robot.floor, robot.refit]


def held_out(row: Row) -> Row | None:
    return next((x for x in row.get("logs", []) if x["role"] == "validation"), None)


def worded(groups: Mapping[str, list[str]], joints: int) -> str:
    """The terms beside the bodies, with the number of joints where these are not all."""
    counts = {kind: len(set(on)) for kind, on in groups.items() if kind != "RigidBodies"}
    return ", ".join(kind if count == joints else f"{kind} {count}" for kind, count in counts.items())
