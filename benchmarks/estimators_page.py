"""The tables of benchmarks/estimators_measured.md, from the figures that benchmarks/estimators.py has measured."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from page_tables import DOCS, OUT, filled, markdown

__all__ = ["FIGURES", "PAGE", "TABLES", "draw", "page", "tables"]

PAGE, FIGURES = DOCS.parent / "benchmarks" / "estimators_measured.md", OUT / "estimators.json"
Row = Mapping[str, Any]
KNOWN = ", torque known"
SMOOTHER = "smoother "  # before the name of a method of the article's that is a smoother with least squares
ARTICLE = {  # its own methods, as a smoother and as an estimator
    "raw": ("difference", ""),
    "filtered": ("butterworth as in the article", ""),
    "spline": ("spline as in the article", "least_squares"),
    "spline-early": ("the same, the transient dropped before", "least_squares, the transient dropped before"),
    "identify": ("", "the same by `identify`"),
    "ml": ("", "maximum_likelihood, start at rest"),
}


def draw(kept: Row) -> None:
    """Write the tables anew."""
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept), encoding="utf-8")


def page(text: str, kept: Row) -> str:
    """Return the page with its tables anew, as far as there are figures."""
    return filled(text, tables(kept))


def tables(kept: Row) -> dict[str, str]:
    """Return the tables by name, of the studies that are kept."""
    return {name: table(kept[study]) for name, (study, table) in TABLES.items() if study in kept}


def measured(part: Row) -> str:
    """How the figures were had."""
    return (
        f"{part['runs']} runs where none are said, seed {part['seed']}; {part['minutes']:g} min on "
        f"{part['workers']} workers, at a load of {part['load']:g} by others."
    )


def mean_square(values: Sequence[float]) -> float:
    """The root of the mean square over the parameters."""
    return float(np.sqrt(np.mean(np.square(values)))) if len(values) else float("nan")


def rms(cell: Row) -> str:
    return figure(mean_square(cell["rms"]))


def parts(cell: Row) -> str:
    return f"{figure(mean_square(cell['bias']))} / {figure(mean_square(cell['spread']))}"


def coverage(cell: Row) -> str:
    return f"{100 * np.mean(cell['coverage']):.0f}" if cell["coverage"] else "–"


def figure(value: float) -> str:
    """Return a number in three digits."""
    return "–" if np.isnan(value) else f"{value:.3g}"


def fits(cells: Sequence[Row]) -> list[str]:
    """Runs of each cell, failures of all, and the median of the seconds."""
    failed, unsettled = (sum(cell[key] for cell in cells) for key in ("failed", "unsettled"))
    of = sum(cell["runs"] for cell in cells)
    why = ", ".join(dict.fromkeys(reason for cell in cells for reason in cell["reasons"]))
    named = (failed, f"failed ({why})" if why else "failed"), (unsettled, "not converged")
    bad = [f"{count} {what}" for count, what in named if count]
    seconds = np.median([cell["seconds"] for cell in cells])
    return [f"{cells[0]['runs']}", f"{', '.join(bad)} of {of}" if bad else "", f"{seconds:.2g}"]


def article(shown: Callable[[Row], str], smoothers: bool, *, more: bool = False) -> Callable[[Row], str]:
    """Return a table of the article's scenarios and levels: every smoother, or every estimator."""

    def table(part: Row) -> str:
        columns = [*dict.fromkeys((base(x)[0], x["level"]) for x in part["cells"])]
        lines = []
        for label, cells in labelled(part, smoothers):
            result = {(base(cell)[0], cell["level"]): cell for cell in cells}
            figures = [shown(result[key]) if key in result else "" for key in columns]
            lines.append([label, *figures, *(fits(cells) if more else ())])
        if more and not smoothers:
            reference = [figure(part["known"][name][f"{level:g}"]) for name, level in columns]
            lines.insert(0, ["bound of a torque that is known", *reference, "", "", ""])
        head = ["", *(f"{name} {level:.0e}".replace("e-0", "e-") for name, level in columns)]
        body = markdown([*head, *(("runs", "fits", "s") if more else ())], lines)
        return f"{body}\n\n{measured(part)}{lacking(part)}" if more else body

    return table


def base(cell: Row) -> tuple[str, bool]:
    """The scenario of the article, and whether the log knew the torque."""
    name, mark, _ = cell["scenario"].partition(KNOWN)
    return name, bool(mark)


def labelled(part: Row, smoothers: bool) -> Iterator[tuple[str, list[Row]]]:
    """The rows of a table: their names and cells."""
    rows: dict[str, list[Row]] = {}
    for cell in part["cells"]:
        if label := name_of(cell["method"], smoothers):
            rows.setdefault(label + (KNOWN if base(cell)[1] else ""), []).append(cell)
    first = [label for value in ARTICLE.values() if (label := value[0 if smoothers else 1]) in rows]
    yield from ((name, rows[name]) for name in dict.fromkeys([*first, *sorted(rows, key=lambda x: place(rows[x]))]))


def place(cells: Sequence[Row]) -> float:
    """By what rows are sorted: the mean of the logarithm of the error over all cells."""
    return float(np.mean([np.log(size) if (size := mean_square(cell["rms"])) > 0 else np.inf for cell in cells]))


def name_of(method: str, smoothers: bool) -> str:
    """The name in a table of smoothers or of estimators; none where it does not belong there."""
    if method in ARTICLE:
        return ARTICLE[method][0 if smoothers else 1]
    own = method.startswith(SMOOTHER)
    return method.removeprefix(SMOOTHER) if own == smoothers else ""


def lacking(part: Row) -> str:
    """What the logs lack for the rest."""
    return "".join(f"\n\nNot applicable: {name}: {what}" for name, what in part["lacking"].items())


def pairs(part: Row) -> dict[tuple[str, str, float], Row]:
    """The cells of the arm by smoother, estimator and bits."""
    return {(*cell["method"].split(" + ", 1), cell["level"]): cell for cell in part["cells"]}


def star(which: int) -> Callable[[Row], str]:
    """Return a table of the arm: each estimator on the spline (1), each smoother with least squares (0)."""
    fixed = ("spline", "least_squares")[1 - which]

    def table(part: Row) -> str:
        rows: dict[str, dict[float, Row]] = {}
        for (*names, level), cell in pairs(part).items():
            if names[1 - which] == fixed:
                rows.setdefault(names[which], {})[level] = cell
        levels = sorted({x["level"] for x in part["cells"]}, reverse=True)
        what = ("held out, %", "rms", "bias / spread", "coverage, %")
        head = ["", *(f"{name}, {level:g} bits" for level in levels for name in what), "runs", "fits", "s"]
        lines = []
        for name in sorted(rows, key=lambda x: sum(cell.get("error", np.inf) for cell in rows[x].values())):
            cells = rows[name]
            own = [of_arm(cells[level]) if level in cells else [""] * len(what) for level in levels]
            lines.append([name, *(value for x in own for value in x), *fits(list(cells.values()))])
        return f"{markdown(head, lines)}\n\n{measured(part)}{lacking(part) if which else ''}"

    return table


def of_arm(cell: Row) -> list[str]:
    return [figure(cell.get("error", float("nan"))), rms(cell), parts(cell), coverage(cell)]


def grid(level: float) -> Callable[[Row], str]:
    """Return the error (%) held out of every estimator on every smoother, where it has been tried on several."""

    def table(part: Row) -> str:
        errors = {key[:2]: x.get("error", np.nan) for key, x in pairs(part).items() if key[2] == level}
        smoothers, estimators = (list(dict.fromkeys(key[k] for key in errors)) for k in (0, 1))
        rows = {fit: [errors.get((name, fit), np.nan) for name in smoothers] for fit in estimators}
        several = [name for name in estimators if np.isfinite(rows[name]).sum() > 1]
        several.sort(key=lambda name: float(np.nanmean(np.log(rows[name]))))
        return markdown([f"{level:g} bits", *smoothers], [[name, *map(figure, rows[name])] for name in several])

    return table


TABLES: Mapping[str, tuple[str, Callable[[Row], str]]] = {
    "estimators": ("article", article(rms, smoothers=False, more=True)),
    "estimators_parts": ("article", article(parts, smoothers=False)),
    "estimators_coverage": ("article", article(coverage, smoothers=False)),
    "smoothers": ("article", article(rms, smoothers=True, more=True)),
    "smoothers_parts": ("article", article(parts, smoothers=True)),
    "smoothers_coverage": ("article", article(coverage, smoothers=True)),
    "arm_estimators": ("arm", star(1)),
    "arm_smoothers": ("arm", star(0)),
    "arm_17": ("arm", grid(17.0)),
    "arm_12": ("arm", grid(12.0)),
}
