"""The words, tables and page of ``dynident compare-results``."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from dynident.errors import Use
from dynident.report import figures
from dynident.report.page import Badge, Column, Figure, Fold, PageBlock, PageSection, PageTable, number, render
from dynident.report.words import ROLES, count, listed, percent

if TYPE_CHECKING:
    from dynident.identification import ComparedResult, LogDifference, ResultComparison

__all__ = [
    "comparison_dict",
    "comparison_lines",
    "comparison_page",
    "comparison_tables",
    "headline",
    "overview_table",
]

FEW = 12  # base parameters in a terminal
SHORT = 8  # digits of a hash
LEAST = 1e-4  # p-values below it are said to be below it
SAME = {True: "the same", False: "another", None: "not known"}
METHOD = (
    "A base parameter is a combination of parameters that the torque depends on. Those of the reference are compared "
    "which the other result determines as well. The difference of each is divided by its standard error, that of both "
    "results together, which allows for correlated residuals and noise of the motion; probabilities are corrected for "
    "the number of parameters (Holm). The test of all together uses their covariances."
)
LIMITS = (
    "Standard errors do not count what the model lacks, nor that friction changes with temperature, load and wear: "
    "of a real robot, friction on another day differs significantly though nothing is wrong."
)


def headline(found: ResultComparison) -> str:
    """Return what there is to say first."""
    return f"{found.second.name} beside {found.first.name}: {_word(found)}"


def _word(found: ResultComparison) -> str:
    if found.worse:
        return "worse, and the parameters differ" if found.differs else "worse"
    if found.differs:
        return "the parameters differ significantly"
    if not found.comparable:
        return "nothing that can be compared"
    return "no significant difference"


def _badge(found: ResultComparison) -> Badge:
    if found.worse:
        return Badge("worse", "bad")
    if found.differs:
        return Badge("differs", "fair")
    return Badge("no difference", "good") if found.comparable else Badge("not comparable", "fair")


def comparison_lines(found: ResultComparison) -> tuple[str, ...]:
    """Return the comparison in sentences."""
    return (*_parameter_lines(found), *_log_lines(found), *_use_lines(found), *_export_lines(found))


def _parameter_lines(found: ResultComparison) -> Iterator[str]:
    first, second = found.first, found.second
    if first.joints and second.joints and set(first.joints) != set(second.joints):
        others = sorted(set(first.joints) ^ set(second.joints))
        yield f"Joints of one result alone: {listed(others, 6)}."
    if not found.base:
        yield "No base parameter is determined by both results: the models, or their parameters, are others."
        return
    differing = len(found.significant)
    differ = "differs significantly by itself" if differing <= 1 else "differ significantly by themselves"
    yield (
        f"{differing or 'None'} of {count(len(found.base), 'base parameter')} that both determine {differ} "
        f"(level {percent(100 * found.level)}, corrected for their number)."
    )
    if found.chi_squared is not None and found.p_value is not None:
        freedom = f"{count(found.freedom, 'degree')} of freedom"
        yield (
            f"All together: chi-squared = {number(found.chi_squared, 3)} for {freedom}, "
            f"p {_p(found.p_value, sign=True)}."
        )
    else:
        yield "They are not tested all together: how their errors go together is not in an older result."
    if found.alone:
        alone = count(len(found.alone), "base parameter")
        yield f"{alone} of {first.name} cannot be compared: {second.name} does not determine {_it(found.alone)}."
    if found.shared:
        yield (
            f"Both were fitted to {listed(found.shared, 3)}: their errors are not independent, so that differences are "
            "known better than is tested here."
        )


def _it(names: Sequence[str]) -> str:
    return "it" if len(names) == 1 else "them"


def _log_lines(found: ResultComparison) -> Iterator[str]:
    if not found.logs:
        yield "No log has the same name and role in both, so that torque errors are not compared."
    elif not found.judged:
        yield "Logs of the same name are of other recordings, so that their torque errors do not tell which is better."
    elif other := [one.name for one in found.logs if one.role == "validation" and one.same is False]:
        yield (
            f"Of {listed(other)}, held out, other recordings or samples were judged (file, window, exclusions), so "
            "that these errors do not compare."
        )
    for one in found.judged:
        end = f": {number(abs(one.growth), 2)} % {'more' if one.growth > 0 else 'less'}"
        end = end if abs(one.growth) >= 0.05 else ", the same"
        worse = f", beyond the {percent(found.tolerance)} allowed" if one in found.worse_logs else ""
        errors = f"{percent(one.second.relative_error)} against {percent(one.first.relative_error)}"
        yield f"Torque error on {one.name} ({ROLES.get(one.role, one.role)}): {errors}{end}{worse}."


def _use_lines(found: ResultComparison) -> Iterator[str]:
    first, second = found.first.use, found.second.use
    if first is not None and second is not None and first is not second:
        yield f"Verdict: {second.value}, where {found.first.name} is {_is(first)}."


def _is(use: Use) -> str:
    return use.value if use is not Use.DO_NOT_USE else "not to be used"


def _export_lines(found: ResultComparison) -> Iterator[str]:
    if found.lost_exports and found.second.exports:
        files = listed(found.lost_exports, 4)
        yield f"Written and proven with {found.first.name}, but not with {found.second.name}: {files}."
    for result in (found.first, found.second):
        gone = [one.file for one in result.exports if one.there is False]
        if gone:
            yield f"Of {result.name}, no longer there as written: {listed(gone, 4)}."


def overview_table(results: Sequence[ComparedResult]) -> PageTable:
    """Return a row for each result: verdict, largest errors, base parameters, files that are proven."""
    rows = tuple(
        (
            one.name,
            "-" if one.use is None else one.use.value,
            _largest(one, "validation"),
            _largest(one, "train"),
            str(len(one.base_names)),
            str(sum(file.proven for file in one.exports)),
        )
        for one in results
    )
    numbers = map(Column, ("held out, %", "training, %", "base parameters", "files proven"))
    return PageTable((Column("result", numeric=False), Column("verdict", numeric=False), *numbers), rows)


def _largest(one: ComparedResult, role: str) -> str:
    return number(max((log.errors.relative_error for log in one.logs if log.role == role), default=None), 3)


def comparison_tables(found: ResultComparison) -> Iterator[PageTable]:
    """Yield the tables of a comparison; of the base parameters, those that differ most."""
    if found.base:
        yield _base_table(found, few=True)
    if found.logs:
        yield _error_table(found)
    if found.first.exports or found.second.exports:
        yield _export_table(found)


def _base_table(found: ResultComparison, few: bool) -> PageTable:
    most = max(len(found.significant), FEW) if few else len(found.base)
    rows = tuple(
        (
            one.name, _value(one.first, one.first_std), number(one.first_std, 2),
            _value(one.second, one.second_std), number(one.second_std, 2),
            one.unit, f"{one.z:+.2f}" if abs(one.z) < 1e3 else f"{one.z:+.1e}", _p(one.p_value),
        )
        for one in found.base[:most]
    )  # fmt: skip
    columns = (
        Column("base parameter", numeric=False),
        *(Column(title, name) for name in (found.first.name, found.second.name) for title in ("value", "std")),
        Column("unit", numeric=False),
        Column("difference, std"),
        Column("p"),
    )
    left = f"; {len(found.base) - most} more differ less" if most < len(found.base) else ""
    return PageTable(columns, rows, f"Base parameters, those that differ most first{left}")


def _value(value: float, std: float) -> str:
    """Word a value with the digits that its standard error leaves."""
    if not 1e-4 <= std < 1e5 or abs(value) >= 1e5:
        return number(value)
    decimals = max(1 - math.floor(math.log10(std)), 0)
    return f"{round(value, decimals) + 0.0:.{decimals}f}"  # no -0.00


def _p(value: float, sign: bool = False) -> str:
    """Word a probability."""
    if value < LEAST:
        return f"< {LEAST:g}"
    return f"= {number(value, 2)}" if sign else number(value, 2)


def _error_table(found: ResultComparison) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for one in sorted(found.logs, key=lambda one: one.role == "train"):
        role, same = ROLES.get(one.role, one.role), SAME[one.same]
        rows.append((one.name, role, "all", *_errors(one, None), same))
        joints = [joint for joint in one.first.per_joint if joint in one.second.per_joint]
        rows += [(one.name, role, joint, *_errors(one, joint), "") for joint in joints]
    columns = (
        Column("log", numeric=False),
        Column("role", numeric=False),
        Column("joint", numeric=False),
        Column(f"{found.first.name}, %"),
        Column(f"{found.second.name}, %"),
        Column("change, %"),
        Column("recording", numeric=False),
    )
    return PageTable(columns, tuple(rows), "Torque errors on logs of the same name and role")


def _errors(one: LogDifference, joint: str | None) -> tuple[str, str, str]:
    pair = [part.relative_error if joint is None else part.per_joint[joint] for part in (one.first, one.second)]
    change = 100.0 * (pair[1] / pair[0] - 1.0) if pair[0] > 0 else float("nan")
    return number(pair[0], 3), number(pair[1], 3), "-" if change != change else f"{change:+.1f}"


def _export_table(found: ResultComparison) -> PageTable:
    sides = [{one.file: one for one in result.exports} for result in (found.first, found.second)]
    rows = []
    for file in dict.fromkeys((*sides[0], *sides[1])):
        pair = [side.get(file) for side in sides]
        cells = [
            ("-", "-")
            if one is None
            else (("yes" if one.proven else "no"), one.sha256[:SHORT] + ("" if one.there else " (gone)"))
            for one in pair
        ]
        hashes = {one.sha256 for one in pair if one is not None}
        same = "yes" if len(hashes) == 1 and None not in pair else "no"
        rows.append((file, *cells[0], *cells[1], same))
    names = (found.first.name, found.second.name)
    columns = [Column(title, name, numeric=False) for name in names for title in ("proven", "SHA-256")]
    caption = "Files of the model: proven by loading them again, and the beginning of their hash"
    return PageTable((Column("file", numeric=False), *columns, Column("same", numeric=False)), tuple(rows), caption)


def comparison_page(found: Sequence[ResultComparison]) -> str:
    """Return comparisons with one reference as one HTML page."""
    first = found[0].first
    sections = [
        PageSection("Results", (overview_table([first, *(one.second for one in found)]),)),
        *(_section(one) for one in found),
        PageSection("How it is compared", (METHOD, LIMITS)),
    ]
    others = listed([one.second.name for one in found], 3)
    return render("Comparison of results", f"{others} beside {first.name}.", sections)


def _section(found: ResultComparison) -> PageSection:
    blocks: list[PageBlock] = [f"{headline(found)}.", comparison_lines(found)]
    if found.base:
        caption = "Differences of base parameters in their standard errors; the band holds 95 % of what chance makes."
        blocks.append(Figure(figures.difference_figure(found), caption))
    blocks += comparison_tables(found)
    if found.base:
        blocks.append(Fold(f"All {len(found.base)} base parameters", (_base_table(found, few=False),)))
    return PageSection(f"{found.second.name} beside {found.first.name}", tuple(blocks), _badge(found))


def comparison_dict(found: Sequence[ResultComparison]) -> dict[str, Any]:
    """Return comparisons as plain values, for JSON."""
    return {
        "format": "dynident comparison",
        "version": 1,
        "reference": found[0].first.name,
        "comparisons": [_dict(one) for one in found],
    }


def _dict(found: ResultComparison) -> dict[str, Any]:
    return {
        "result": found.second.name,
        "word": _word(found),
        "sentences": list(comparison_lines(found)),
        "differs": found.differs,
        "worse": found.worse,
        "level": found.level,
        "tolerance": found.tolerance,
        "parameters": {
            "chi_squared": found.chi_squared,
            "freedom": found.freedom,
            "p_value": found.p_value,
            "compared": [asdict(one) | {"significant": one in found.significant} for one in found.base],
            "not_compared": list(found.alone),
            "shared_recordings": list(found.shared),
        },
        "torque_errors": [
            {
                "log": one.name, "role": one.role, "same_recording": one.same, "change": one.growth,
                "worse": one in found.worse_logs, "errors": [asdict(one.first), asdict(one.second)],
            }
            for one in found.logs
        ],
        "verdicts": [found.first.use, found.second.use],
        "exports": [[asdict(one) for one in result.exports] for result in (found.first, found.second)],
    }  # fmt: skip
