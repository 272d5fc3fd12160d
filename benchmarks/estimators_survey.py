"""The table of estimators_measured.md on what a survey of estimators concluded: whether it holds in the figures here.

Each conclusion has a rule that decides by the figures that are kept; where a figure is missing, it is not decided.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from estimators_page import figure, mean_square
from page_tables import markdown

__all__ = ["CONCLUSIONS", "survey"]

Row = Mapping[str, Any]
LEVELS = (17.0, 12.0)
PLAIN, DIDIM, OUTPUT, MAXIMUM = "least_squares", "didim", "output_error", "maximum_likelihood"
WEIGHTED, INSTRUMENTS = "weighted_least_squares", "instrumental_variables, simulated"
SIMULATING = (INSTRUMENTS, DIDIM, OUTPUT)
KALMAN = "augmented_kalman"
NOT = "not measured"


class MissingError(Exception):
    """A figure that is not there."""


class Figures:
    """The figures of both files, by what they are asked for."""

    def __init__(self, study: Row, robots: Row) -> None:
        cells = study.get("arm", {}).get("cells", ())
        self.cells: dict[tuple[str, float], Row] = {
            (cell["method"], cell["level"]): cell for cell in cells if cell["rms"]
        }
        self.fits = {name: fit for name, fit in robots.get("emps", {}).get("fits", {}).items() if "reason" not in fit}
        self.robots = robots.get("robots", {})

    def cell(self, estimator: str, level: float, smoother: str = "spline") -> Row:
        try:
            return self.cells[f"{smoother} + {estimator}", level]
        except KeyError:
            raise MissingError(estimator) from None

    def rms(self, estimator: str, level: float) -> float:
        return mean_square(self.cell(estimator, level)["rms"])

    def seconds(self, estimator: str) -> float:
        return float(self.cell(estimator, LEVELS[0])["seconds"])

    def held_out(self, name: str) -> float:
        try:
            return float(self.fits[name]["errors"]["validation"]["filtered"])
        except KeyError:
            raise MissingError(name) from None


Answer = tuple[Sequence[bool], str]  # whether it holds in each case, and by which figures


def most_accurate(of: Figures) -> Answer:
    """Against all that is linear in the parameters or a filter."""
    others = (PLAIN, WEIGHTED, "total_least_squares", KALMAN)
    best = [min(of.rms(name, level) for name in others if (f"spline + {name}", level) in of.cells) for level in LEVELS]
    own = [[of.rms(name, level) for name in (DIDIM, INSTRUMENTS)] for level in LEVELS]
    said = [f"{level:g} bits: {figure(a)} and {figure(b)}, the best of the others {figure(c)}"
            for level, (a, b), c in zip(LEVELS, own, best, strict=True)]  # fmt: skip
    return [each < x for pair, x in zip(own, best, strict=True) for each in pair], f"rms at {'; '.join(said)}"


def filtering_helps(of: Figures) -> Answer:
    raw, smooth = (float(of.cell(PLAIN, LEVELS[1], name)["error"]) for name in ("difference", "spline"))
    return [raw > 2 * smooth], f"held out, 12 bits: {figure(raw)} % by differences, {figure(smooth)} % on the spline"


def enough_filtered(of: Figures) -> Answer:
    """By least squares whose joints are weighted, as there."""
    pairs = [(of.rms(WEIGHTED, x), min(of.rms(name, x) for name in (DIDIM, INSTRUMENTS))) for x in LEVELS]
    said = "; ".join(f"{level:g} bits: {figure(a)}, {figure(b)}" for level, (a, b) in zip(LEVELS, pairs, strict=True))
    return [a < 1.2 * b for a, b in pairs], f"rms on the spline, weighted, and by the better of the two at {said}"


def robust(of: Figures) -> Answer:
    ratios = {name: of.rms(name, LEVELS[1]) / of.rms(name, LEVELS[0]) for name in SIMULATING}
    said = ", ".join(f"{named(name)} {figure(x)}" for name, x in ratios.items())
    return [ratio < 1.5 for ratio in ratios.values()], f"rms at 12 bits over that at 17: {said}"


def input_error(of: Figures) -> Answer:
    pairs = [(of.rms(DIDIM, level), of.rms(OUTPUT, level)) for level in LEVELS]
    said = "; ".join(f"{level:g} bits: {figure(a)}, {figure(b)}" for level, (a, b) in zip(LEVELS, pairs, strict=True))
    return [a < b for a, b in pairs], f"rms of DIDIM and output error at {said}"


def cheap(of: Figures) -> Answer:
    ratio = of.seconds(DIDIM) / of.seconds(PLAIN)
    return [ratio < 10], f"{figure(ratio)} times the seconds of least squares"


def slow(of: Figures) -> Answer:
    ratio = of.seconds(OUTPUT) / of.seconds(DIDIM)
    return [ratio > 5], f"{figure(ratio)} times those of DIDIM; derivatives are exact here"


def consistent(of: Figures) -> Answer:
    ratio = of.seconds("consistent") / of.seconds(PLAIN)
    return [2 < ratio < 5], f"{figure(ratio)} times; and an rms of {figure(of.rms('consistent', LEVELS[1]))} at 12 bits"


def dear(of: Figures) -> Answer:
    cost, rms = of.seconds(KALMAN), of.rms(KALMAN, LEVELS[0])
    others, plain = max(of.seconds(name) for name in (PLAIN, *SIMULATING)), of.rms(PLAIN, LEVELS[0])
    return [cost > others, rms > plain], (
        f"seconds and rms at 17 bits: {figure(cost)} s, {figure(rms)}; least squares {figure(plain)}; "
        f"the others {figure(others)} s at most"
    )


def real(of: Figures) -> Answer:
    plain, *others = (of.held_out(name) for name in ("least squares", "instrumental variables", DIDIM, "output error"))
    said = ", ".join(figure(other) for other in others)
    return [other > 0.95 * plain for other in others], f"EMPS held out: {said} %, least squares {figure(plain)} %"


def needs_controller(of: Figures) -> Answer:
    if not of.robots:
        raise MissingError("robots")
    lacking = [name for name, result in of.robots.items() if DIDIM in result["absent"]]
    if not any(DIDIM in robot["absent"] or fitted(robot) for robot in of.robots.values()):
        raise MissingError(DIDIM)
    return [bool(lacking)], f"DIDIM does not apply to {len(lacking)} of {len(of.robots)} real robots"


def fitted(result: Row) -> bool:
    return any(row["estimator"] == DIDIM for row in result["rows"])


def named(estimator: str) -> str:
    return {INSTRUMENTS: "instrumental variables", DIDIM: "DIDIM", OUTPUT: "output error"}[estimator]


CONCLUSIONS: tuple[tuple[str, Callable[[Figures], Answer]], ...] = (
    ("DIDIM and instrumental variables are the most accurate in simulation", most_accurate),
    ("least squares is biased by noise of the positions unless these are low-passed well", filtering_helps),
    ("well low-passed, least squares is about as good as the two", enough_filtered),
    ("what simulates the loop hardly minds noise of the positions", robust),
    ("to fit torques in the loop is better than to fit positions", input_error),
    ("DIDIM costs a few times least squares (five there)", cheap),
    ("output error costs ten times DIDIM (its derivatives were differences)", slow),
    ("physical consistency costs about three times the same without", consistent),
    ("Kalman filters cost most and are less accurate, as they depend on how they are tuned", dear),
    ("on real arms what simulates is no better than least squares, as the loop is not known well", real),
    ("DIDIM and instruments from simulation need the controller", needs_controller),
)


def survey(study: Row, robots: Row) -> str:
    """Every conclusion, whether it holds in the figures here, and by which."""
    of, lines = Figures(study, robots), []
    for text, rule in CONCLUSIONS:
        try:
            holds, said = rule(of)
        except (MissingError, ValueError) as lacks:
            lines.append([text, "", f"{NOT}: {lacks}" if isinstance(lacks, MissingError) else NOT])
        else:
            lines.append([text, "yes" if all(holds) else "in part" if any(holds) else "no", said])
    return markdown(["conclusion", "here", "figures"], lines)
