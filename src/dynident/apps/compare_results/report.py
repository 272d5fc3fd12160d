"""The words, tables and page of ``dynident compare-results``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from dynident.apps.compare_results.comparison import BaseDifference, ComparedResult, LogDifference, ResultComparison
from dynident.report import Drawing
from dynident.report.figures import BLUE, GRID, RED, Trace, panels, plain, trace
from dynident.report.page import Badge, Column, Figure, Fold, Head, PageBlock, PageSection, PageTable, render
from dynident.report.words import ROLES
from dynident.runtime import Use, count, join_names, number, percent

MAX_SHOWN_DIFFERENCE = 20.0  # standard errors beyond which a mark stands at the edge
MAX_TERMINAL_ROWS = 12  # base parameters in a terminal
HASH_DIGITS = 8  # digits of a hash
MIN_SHOWN_P_VALUE = 1e-4  # p-values below it are said to be below it
RECORDING_WORDS = {True: "the same", False: "another", None: "not known"}
METHOD = (
    "A base parameter is a combination of parameters that the torque depends on. Those of the reference are compared "
    "which the other result determines as well. The difference of each is divided by its standard error, that of both "
    "results together, which allows for correlated residuals and noise of the motion; probabilities are corrected for "
    "the number of parameters (Holm). The test of all together uses their covariances."
)
LIMITATIONS = (
    "Standard errors do not count what the model lacks, nor that friction changes with temperature, load and wear: "
    "of a real robot, friction on another day differs significantly though nothing is wrong."
)


def difference_figure(diff: ResultComparison) -> Drawing:
    """Draw the difference of each base parameter in standard errors, in the order of the first result.

    Those that differ significantly are triangles. The band holds 95 % of what chance makes.
    """
    order = {name: k for k, name in enumerate(diff.first.base_names)}
    rows = sorted(diff.base, key=lambda row: order[row.name])
    figure = panels([""], 330, shared=False)
    significant = {row.name for row in diff.significant}
    for name, colour, symbol, indices in (
        ("no significant difference", BLUE, "circle", [k for k, row in enumerate(rows) if row.name not in significant]),
        ("significant", RED, "triangle-up", [k for k, row in enumerate(rows) if row.name in significant]),
    ):
        if indices:
            figure.add(_difference_marks(name, colour, symbol, indices, rows))
    reach = max([3.0, *(min(abs(row.z), MAX_SHOWN_DIFFERENCE) for row in rows)])
    figure.axes("y", title="difference, standard errors", range=[-1.15 * reach, 1.15 * reach], zeroline=True)
    figure.axes("x", title="base parameter, in the order of the reference", range=[-1, len(rows)])
    band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "y0": -1.96, "y1": 1.96}
    band |= {"fillcolor": GRID, "line": {"width": 0}, "layer": "below"}
    figure.layout.update(hovermode="closest", showlegend=True, shapes=[band])
    return figure


def _difference_marks(name: str, colour: str, symbol: str, indices: list[int], rows: list[BaseDifference]) -> Trace:
    text = [
        f"{plain(row.name)}: {row.first:.4g} ± {row.first_std:.2g}, then {row.second:.4g} ± {row.second_std:.2g} "
        f"{plain(row.unit)}; {row.z:+.2g} standard errors"
        for row in (rows[k] for k in indices)
    ]
    z = np.clip([rows[k].z for k in indices], -MAX_SHOWN_DIFFERENCE, MAX_SHOWN_DIFFERENCE)
    return trace(
        "scatter", x=indices, y=z, mode="markers", name=name, marker={"color": colour, "size": 9, "symbol": symbol},
        text=text, hovertemplate="%{text}<extra></extra>",
    )  # fmt: skip


def headline(diff: ResultComparison) -> str:
    """Return the names of both results and the outcome, as a headline."""
    return f"{diff.second.name} beside {diff.first.name}: {_outcome_word(diff)}"


def _outcome_word(diff: ResultComparison) -> str:
    if diff.worse:
        return "worse, and the parameters differ" if diff.differs else "worse"
    if diff.differs:
        return "the parameters differ significantly"
    if not diff.comparable:
        return "nothing that can be compared"
    return "no significant difference"


def _badge(diff: ResultComparison) -> Badge:
    if diff.worse:
        return Badge("worse", "bad")
    if diff.differs:
        return Badge("differs", "fair")
    return Badge("no difference", "good") if diff.comparable else Badge("not comparable", "fair")


def comparison_lines(diff: ResultComparison) -> tuple[str, ...]:
    """Return the comparison in sentences."""
    return (*_parameter_lines(diff), *_log_lines(diff), *_use_lines(diff), *_export_lines(diff))


def _parameter_lines(diff: ResultComparison) -> Iterator[str]:
    reference, other = diff.first, diff.second
    if reference.joints and other.joints and set(reference.joints) != set(other.joints):
        unshared = sorted(set(reference.joints) ^ set(other.joints))
        yield f"Joints of one result alone: {join_names(unshared, 6)}."
    if not diff.base:
        yield "No base parameter is determined by both results: the models, or their parameters, are others."
        return
    differing = len(diff.significant)
    differ = "differs significantly by itself" if differing <= 1 else "differ significantly by themselves"
    yield (
        f"{differing or 'None'} of {count(len(diff.base), 'base parameter')} that both determine {differ} "
        f"(level {percent(100 * diff.level)}, corrected for their number)."
    )
    if diff.chi_squared is not None and diff.p_value is not None:
        freedom = f"{count(diff.freedom, 'degree')} of freedom"
        yield (
            f"All together: chi-squared = {number(diff.chi_squared, 3)} for {freedom}, "
            f"p {_p_value_text(diff.p_value, sign=True)}."
        )
    else:
        yield "They are not tested all together: how their errors go together is not in an older result."
    if diff.alone:
        alone, them = count(len(diff.alone), "base parameter"), "it" if len(diff.alone) == 1 else "them"
        yield f"{alone} of {reference.name} cannot be compared: {other.name} does not determine {them}."
    if diff.shared_training:
        yield (
            f"Both were fitted to {join_names(diff.shared_training, 3)} and share its noise: differences are more "
            "accurate than this test assumes, so it is conservative."
        )


def _log_lines(diff: ResultComparison) -> Iterator[str]:
    if not diff.logs:
        yield "No log has the same name and role in both, so that torque errors are not compared."
    elif not diff.compared_logs:
        yield "Logs of the same name are of other recordings, so that their torque errors do not tell which is better."
    elif unlike := [log.name for log in diff.logs if log.role == "validation" and log.is_same_recording is False]:
        yield (
            f"Of {join_names(unlike)}, held out, other recordings or samples were judged (file, window, exclusions), "
            "so that these errors do not compare."
        )
    for log in diff.compared_logs:
        end = f": {number(abs(log.growth), 2)} % {'more' if log.growth > 0 else 'less'}"
        # A change that rounds to 0.0 % is no change
        end = end if abs(log.growth) >= 0.05 else ", the same"
        worse = f", beyond the {percent(diff.tolerance)} allowed" if log in diff.worse_logs else ""
        errors = f"{percent(log.second.relative_error)} against {percent(log.first.relative_error)}"
        yield f"Torque error on {log.name} ({ROLES.get(log.role, log.role)}): {errors}{end}{worse}."


def _use_lines(diff: ResultComparison) -> Iterator[str]:
    reference_use, use = diff.first.use, diff.second.use
    if reference_use is not None and use is not None and reference_use is not use:
        words = "not to be used" if reference_use is Use.DO_NOT_USE else reference_use.value
        yield f"Verdict: {use.value}, where {diff.first.name} is {words}."


def _export_lines(diff: ResultComparison) -> Iterator[str]:
    if diff.lost_exports and diff.second.exports:
        files = join_names(diff.lost_exports, 4)
        yield f"Written and verified with {diff.first.name}, but not with {diff.second.name}: {files}."
    for result in (diff.first, diff.second):
        gone = [export.file for export in result.exports if export.there is False]
        if gone:
            yield f"Of {result.name}, no longer there as written: {join_names(gone, 4)}."


def overview_table(results: Sequence[ComparedResult]) -> PageTable:
    """Return one row per result: verdict, largest errors, number of base parameters and of proven files."""
    rows = [
        (
            result.name, "-" if result.use is None else result.use.value, _largest_error(result, "validation"),
            _largest_error(result, "train"), str(len(result.base_names)),
            str(sum(file.proven for file in result.exports)),
        )
        for result in results
    ]  # fmt: skip
    numbers = ("held out, %", "training, %", "base parameters", "files verified")
    return PageTable.of(("result", "verdict"), numbers, rows)


def _largest_error(result: ComparedResult, role: str) -> str:
    return number(max((log.errors.relative_error for log in result.logs if log.role == role), default=None), 3)


def comparison_tables(diff: ResultComparison) -> Iterator[PageTable]:
    """Yield the tables of a comparison: base parameters that differ most, torque errors, exported files."""
    if diff.base:
        yield _base_table(diff, short=True)
    if diff.logs:
        yield _error_table(diff)
    if diff.first.exports or diff.second.exports:
        yield _export_table(diff)


def _base_table(diff: ResultComparison, short: bool) -> PageTable:
    row_count = max(len(diff.significant), MAX_TERMINAL_ROWS) if short else len(diff.base)
    rows = [
        (
            row.name, _value_text(row.first, row.first_std), number(row.first_std, 2),
            _value_text(row.second, row.second_std), number(row.second_std, 2),
            row.unit, f"{row.z:+.2f}" if abs(row.z) < 1e3 else f"{row.z:+.1e}", _p_value_text(row.p_value),
        )
        for row in diff.base[:row_count]
    ]  # fmt: skip
    values = ((title, name) for name in (diff.first.name, diff.second.name) for title in ("value", "std"))
    heads: tuple[Head, ...] = (*values, Column("unit", numeric=False), "difference, std", "p")
    suffix = f"; {len(diff.base) - row_count} more differ less" if row_count < len(diff.base) else ""
    return PageTable.of(("base parameter",), heads, rows, f"Base parameters, those that differ most first{suffix}")


def _value_text(value: float, std: float) -> str:
    """Format a value with the digits that its standard error leaves."""
    if not 1e-4 <= std < 1e5 or abs(value) >= 1e5:
        return number(value)
    # Keep as many decimals as give the standard error two significant digits
    decimals = max(1 - math.floor(math.log10(std)), 0)
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0.00


def _p_value_text(value: float, sign: bool = False) -> str:
    """Format a probability, with a sign of comparison where ``sign``."""
    if value < MIN_SHOWN_P_VALUE:
        return f"< {MIN_SHOWN_P_VALUE:g}"
    return f"= {number(value, 2)}" if sign else number(value, 2)


def _error_table(diff: ResultComparison) -> PageTable:
    # Held-out logs come first
    rows: list[tuple[str, ...]] = []
    for log in sorted(diff.logs, key=lambda log: log.role == "train"):
        role, recording = ROLES.get(log.role, log.role), RECORDING_WORDS[log.is_same_recording]
        rows.append((log.name, role, "all", *_error_cells(log, None), recording))
        joints = [joint for joint in log.first.per_joint if joint in log.second.per_joint]
        rows += [(log.name, role, joint, *_error_cells(log, joint), "") for joint in joints]
    heads = (f"{diff.first.name}, %", f"{diff.second.name}, %", "change, %", Column("recording", numeric=False))
    return PageTable.of(("log", "role", "joint"), heads, rows, "Torque errors on logs of the same name and role")


def _error_cells(log: LogDifference, joint: str | None) -> tuple[str, str, str]:
    pair = [part.relative_error if joint is None else part.per_joint[joint] for part in (log.first, log.second)]
    change = 100.0 * (pair[1] / pair[0] - 1.0) if pair[0] > 0 else float("nan")
    return number(pair[0], 3), number(pair[1], 3), "-" if change != change else f"{change:+.1f}"


def _export_table(diff: ResultComparison) -> PageTable:
    sides = [{export.file: export for export in result.exports} for result in (diff.first, diff.second)]
    rows = []
    for file in dict.fromkeys((*sides[0], *sides[1])):
        pair = [side.get(file) for side in sides]
        cells = [
            ("-", "-")
            if export is None
            else (("yes" if export.proven else "no"), export.sha256[:HASH_DIGITS] + ("" if export.there else " (gone)"))
            for export in pair
        ]
        # Files are the same only where both results have them with equal hashes
        hashes = {export.sha256 for export in pair if export is not None}
        identical = "yes" if len(hashes) == 1 and None not in pair else "no"
        rows.append((file, *cells[0], *cells[1], identical))
    names = (diff.first.name, diff.second.name)
    heads = [Column(title, name, numeric=False) for name in names for title in ("verified", "SHA-256")]
    caption = "Files of the model, verified by reloading, and the beginning of their hash"
    return PageTable.of(("file",), (*heads, Column("same", numeric=False)), rows, caption)


def comparison_page(comparisons: Sequence[ResultComparison]) -> str:
    """Return comparisons with one reference as one HTML page."""
    reference = comparisons[0].first
    sections = [
        PageSection("Results", (overview_table([reference, *(diff.second for diff in comparisons)]),)),
        *(_section(diff) for diff in comparisons),
        PageSection("How it is compared", (METHOD, LIMITATIONS)),
    ]
    names = join_names([diff.second.name for diff in comparisons], 3)
    return render("Comparison of results", f"{names} beside {reference.name}.", sections)


def _section(diff: ResultComparison) -> PageSection:
    blocks: list[PageBlock] = [comparison_lines(diff), *comparison_tables(diff)]
    if diff.base:
        caption = "Differences of base parameters in their standard errors; the band holds 95 % of what chance makes."
        blocks.insert(0, Figure(difference_figure(diff), caption))
    if diff.base:
        blocks.append(Fold(f"All {len(diff.base)} base parameters", (_base_table(diff, short=False),)))
    return PageSection(f"{diff.second.name} beside {diff.first.name}", tuple(blocks), _badge(diff))


def comparison_dict(comparisons: Sequence[ResultComparison]) -> dict[str, Any]:
    """Return comparisons as plain values, for JSON."""
    plain_values = [_comparison_as_dict(diff) for diff in comparisons]
    reference = comparisons[0].first.name
    return {"format": "dynident comparison", "version": 1, "reference": reference, "comparisons": plain_values}


def _comparison_as_dict(diff: ResultComparison) -> dict[str, Any]:
    return {
        "result": diff.second.name, "word": _outcome_word(diff), "sentences": list(comparison_lines(diff)),
        "differs": diff.differs, "worse": diff.worse, "level": diff.level, "tolerance": diff.tolerance,
        "parameters": {
            "chi_squared": diff.chi_squared, "freedom": diff.freedom, "p_value": diff.p_value,
            "compared": [asdict(row) | {"significant": row in diff.significant} for row in diff.base],
            "not_compared": list(diff.alone), "shared_recordings": list(diff.shared_training),
        },
        "torque_errors": [
            {
                "log": log.name, "role": log.role, "same_recording": log.is_same_recording, "change": log.growth,
                "worse": log in diff.worse_logs, "errors": [asdict(log.first), asdict(log.second)],
            }
            for log in diff.logs
        ],
        "verdicts": [diff.first.use, diff.second.use],
        "exports": [[asdict(export) for export in result.exports] for result in (diff.first, diff.second)],
    }  # fmt: skip
