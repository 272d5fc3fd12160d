"""The tables of estimators_measured.md on real robots and peers, from what benchmarks/estimators_robots.py kept."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from estimators_page import FIGURES as STUDY
from estimators_page import PAGE, figure
from estimators_survey import survey
from page_tables import OUT, filled, markdown, read_figures

__all__ = ["FIGURES", "PAGE", "TABLES", "draw", "page", "tables"]

FIGURES = OUT / "estimators_robots.json"
Row = Mapping[str, Any]
# A. Janot, M. Gautier, M. Brunot, "Data set and reference models of EMPS", 2019: least squares of the inverse dynamics
VALUE, STD = (95.1089, 203.5034, 20.3935, -3.1648), (0.1085, 1.1460, 0.1012, 0.0444)
PUBLISHED = {"filtered": 4.083, "simulated": 0.0138}, {"filtered": 5.982, "simulated": 0.0080}
NAMES = {"emps": "EMPS", "double_pendulum": "double pendulum", "lwr4": "LWR4", "panda": "Panda", "tx40": "TX40"}
SAME = 1e-6  # relative difference of errors that are the same
BEST = 3  # combinations that are shown of a robot
PLAIN = ("spline", "least_squares")
UNSETTLED = "unsettled"
TOO_SHORT = "held-out motion too short to tell chance"


def draw(kept: Row) -> None:
    """Write the tables anew."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept), encoding="utf-8")


def page(text: str, kept: Row) -> str:
    """Return the page with its tables anew, as far as there are figures."""
    return filled(text, tables(kept))


def tables(kept: Row) -> dict[str, str]:
    """Return the tables by name: of the parts that are kept, and of the survey, which takes figures of both files."""
    result = {name: table(kept[part]) for name, (part, table) in TABLES.items() if part in kept}
    study = read_figures(STUDY)
    return result | {"survey": survey(study, kept)} if study else result


def emps(part: Row) -> str:
    """Values with standard errors, how far they are from the published ones, and errors in %."""
    head = ["", "M, kg", "Fv, N s/m", "Fc, N", "offset, N", "apart", "fit, %", "position, %", "held out, %",
            "position, %", "s"]  # fmt: skip
    lines = [
        ["published", *values(VALUE, STD), "", *(figure(value) for log in PUBLISHED for value in log.values()), ""]
    ]
    lines += [emps_line(name, fit) for name, fit in part["fits"].items()]
    failed = [f"{name}: {fit['reason']}" for name, fit in part["fits"].items() if "reason" in fit]
    said = "".join(f"\n\nNo estimate by {x}" for x in failed)
    return f"{markdown(head, lines)}{said}\n\nAt a load of {part['load']:g} by others."


def emps_line(name: str, fit: Row) -> list[str]:
    if "reason" in fit:
        return [name, *[""] * 10]
    logs = [f"{figure(of(log, key))}" for log in fit["errors"].values() for key in ("filtered", "simulated")]
    return [name, *values(fit["value"], fit["std"]), figure(apart(fit)), *logs, f"{fit['seconds']:.2g}"]


def values(value: Sequence[float], std: Sequence[float | None]) -> list[str]:
    return [f"{x:.5g} ± {figure(of({'std': two}, 'std'))}" for x, two in zip(value, std, strict=True)]


def apart(fit: Row) -> float:
    """The largest difference to the published values, in standard errors of both."""
    both = np.hypot(np.array(fit["std"], dtype=float), STD)
    return float(np.max(np.abs(np.array(fit["value"]) - VALUE) / both))


def of(row: Row, key: str) -> float:
    """A number that may be missing."""
    return float("nan") if row[key] is None else float(row[key])


def robots(part: Row) -> str:
    """The best, the configured and the plain combination of each robot."""
    head = ["robot", "", "smoother", "estimator", "held out, %", "all joints, %", "more than the best by (95 %)",
            "worse than another", "s"]  # fmt: skip
    lines = [line for robot in NAMES if robot in part for line in robot_lines(robot, part[robot])]
    missing = [name for robot, name in NAMES.items() if robot not in part]
    notes = [counted(NAMES[robot], part[robot]) for robot in NAMES if robot in part]
    notes += [f"Not measured: {', '.join(missing)}."] if missing else []
    return "\n\n".join([markdown(head, lines), " ".join(notes)])


def by_smoother(part: Row) -> str:
    """Errors of each smoother with least squares, by robot."""
    return by_robot(part, "smoother", "estimator", PLAIN[1])


def by_estimator(part: Row) -> str:
    """Errors of each estimator on the default spline, by robot."""
    return by_robot(part, "estimator", "smoother", PLAIN[0])


def by_robot(part: Row, varied: str, fixed: str, value: str) -> str:
    """Errors held out (%), one column a robot, where one part is varied and the other fixed: the least first,
    by the geometric mean over the robots to which it applies."""
    there = [robot for robot in NAMES if robot in part]
    result: dict[str, dict[str, float | None]] = {}
    for robot in there:
        for row in part[robot]["rows"]:
            if row[fixed] == value and "(" not in row[varied]:  # those of the examples have settings
                result.setdefault(row[varied], {})[robot] = row["error"]
    errors = {robot: [value[robot] or np.inf for value in result.values() if robot in value] for robot in there}
    least = {robot: min(some, default=np.inf) for robot, some in errors.items()}

    def over(one: Row) -> float:
        return float(np.mean([np.log((value or np.inf) / least[robot]) for robot, value in one.items()]))

    def shown(one: Row, robot: str) -> str:
        return "" if robot not in one else "failed" if one[robot] is None else f"{one[robot]:.4g}"

    ordered = sorted(result, key=lambda name: (over(result[name]), -len(result[name])))
    lines = [[name, *(shown(result[name], robot) for robot in there)] for name in ordered]
    return markdown(["", *(NAMES[robot] for robot in there)], lines)


def robot_lines(robot: str, result: Row) -> list[list[str]]:
    ranked = [row for row in result["rows"] if row["error"] is not None]
    shown: dict[int, str] = {place: "best" if not place else "" for place in range(min(BEST, len(ranked)))}
    for what, which in (("configured", lambda row: row["own"]), ("plain", lambda row: pair(row) == PLAIN)):
        for place, row in enumerate(ranked):
            if which(row):
                shown[place] = ", ".join(x for x in (shown.get(place), what) if x)
    return [
        [
            NAMES[robot] if not place else "",
            f"{place + 1}. {what}".rstrip(),
            *figures_of(ranked[place], place, result["told_from_chance"]),
        ]
        for place, what in sorted(shown.items())
    ]


def figures_of(row: Row, place: int, told: bool) -> list[str]:
    """A combination and its figures; those of a difference where it is not the best."""
    errors = [f"{row[key]:.4g}" for key in ("error", "overall")]
    reference = place and row["least"] is not None
    ends = [row[name] if reference and abs(row[name]) > SAME * row["error"] else 0 for name in ("least", "most")]
    apart = [f"{ends[0]:.2g} to {ends[1]:.2g}" if reference else "", chance(row) if place and told else ""]
    return [*pair(row), *errors, *apart, f"{row['seconds']:.2g}"]


def pair(row: Row) -> tuple[str, str]:
    return row["smoother"], row["estimator"]


def chance(row: Row) -> str:
    return "more than chance" if row["worse"] else "chance"


def counted(name: str, result: Row) -> str:
    """How many combinations have an error, how many are as good as the best, what failed and what does not apply."""
    rows, within = result["rows"], len(result["within_chance"] or ())
    failed = sum(row["error"] is None for row in rows)
    unsettled = sum(row["status"] == UNSETTLED for row in rows)
    named = (unsettled, "not converged"), (failed, "failed")
    bad = "".join(f", {count} {what}" for count, what in named if count)
    absent = f"; not applicable: {', '.join(result['absent'])}" if result["absent"] else ""
    good = f"{within} of them as good as the best within chance" if result["told_from_chance"] else TOO_SHORT
    return f"{name}: {len(rows)} combinations, {good}{bad}{absent}."


def peers(part: Row) -> str:
    """Errors and seconds of each."""
    head = ["", "", "held out, %", "rms", "s"]
    lines = [
        [row["who"], row["name"].replace("_", " "), *(figure(row[key]) for key in ("error", "rms")),
         f"{row['seconds']:.2g}"]
        for row in part["rows"]
        if "reason" not in row
    ]  # fmt: skip
    failed = [f"{row['who']} {row['name']}".strip() + f": {row['reason']}" for row in part["rows"] if "reason" in row]
    said = "".join(f"\n\nNo estimate by {x}" for x in failed)
    how = f"One recording of {part['seconds']:g} s, at a load of {part['load']:g} by others."
    return f"{markdown(head, lines)}{said}\n\n{how}"


TABLES: Mapping[str, tuple[str, Callable[[Row], str]]] = {
    "emps": ("emps", emps),
    "robots": ("robots", robots),
    "robots_smoothers": ("robots", by_smoother),
    "robots_estimators": ("robots", by_estimator),
    "peers": ("peers", peers),
}
