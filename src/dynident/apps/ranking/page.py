"""The page of ``dynident compare``: which to take, errors with what they cost, all combinations, by joint, methods."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from dynident.apps.ranking.ranking import RankedCombination, Ranking, geometric_mean
from dynident.apps.ranking.report import interval_ends, mark_words, ranking_findings, ranking_heading
from dynident.report import Drawing
from dynident.report.figures import AMBER, BLUE, GREEN, INK, RED, VIOLET, Trace, panels, plain, trace
from dynident.report.page import Badge, Column, Facts, Figure, Fold, Head, PageBlock, PageSection, PageTable, render
from dynident.report.words import huge
from dynident.runtime import count, number, part_text, percent, short, shorten_names

NAMES, BASES = ("smoother", "estimator"), {"validation": "on held-out motion", "train": "in cross-validation"}
COLOURS = (BLUE, RED, GREEN, AMBER, VIOLET, INK)
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star")
MAX_ERROR_RATIO = 30.0  # times the least error, beyond which a mark stands at the edge
ROW_HEIGHT = 15  # px of a combination
MAX_LINEAR_RATIO = 4.0  # ratio of the ends of an axis from which on it is logarithmic
MAX_JOINT_NAME_LENGTH = 16  # letters of a joint above its column
COMMON_NOTE = (
    "Terms of the model, tilt of the base and what of the logs is fitted were chosen once, by the configuration's own "
    "recipe; only smoother and estimator differ. A time offset that is estimated is so for each smoother. All are "
    "fitted and judged on the samples that all smoothers keep, against the unfiltered torque. The torque of a held-out "
    'log is predicted from its positions as the same smoother sees them; "same motion" is the error with the motion of '
    "the configured smoother, in which only the parameters differ. Errors are geometric means over the joints of their "
    "relative errors: one percent less in any joint counts the same, however much torque it has, as in the likelihood "
    'of residuals of each joint\'s own size; "all joints" is the error of all torques together, as `identify` has it. '
    "In cross-validation, stretches of the training are predicted from the others; where a log is held out, estimators "
    "that simulate or iterate over all samples take part only if they are best. A wrong robot file is fitted by all "
    "alike, and a wrong factor of all torques shows in no error: the verdict of `dynident identify` counts more."
)
CHANCE_NOTE = (
    "Differences are told from chance by drawing blocks of time anew, the same ones for all (paired block bootstrap); "
    "the blocks are as long as the differences are correlated{length}. A combination is called worse only where it is "
    "worse than another by more than the largest of all its differences is by chance (Hsu, 1981), so that those within "
    "chance of the best hold the truly best one with 95 %, though the best was chosen by the data. This is about "
    "motions like the held-out ones: of another motion nothing is known."
)
COSTS_NOTE = (
    "Seconds are those of this computer, with one thread: the smoothing of all logs, and the estimate with its "
    "correction of the bias by errors of the motion. Conditions are of the scaled regressor, in what the data "
    "determine. The smallest eigenvalue of the pseudo-inertias is relative to the usual size of a body: below zero, a "
    "body is impossible."
)


def ranking_figure(ranking: Ranking) -> Drawing:
    """Draw the error of each combination, grouped by estimator, one mark per smoother.

    The line through a mark is the 95 % interval of its difference to the best, whose error is the dashed line.
    Open marks are worse by more than chance.
    """
    places, names, centres = _row_positions(ranking)
    figure = panels([""], 110 + ROW_HEIGHT * (int(max(places.values(), default=0)) + 1), shared=False)
    best_error = ranking.standings[0].error
    edge = MAX_ERROR_RATIO * best_error
    for k, name in enumerate(_smoother_names(ranking)):
        rows = [row for row in ranking.standings if row.combination.smoother == name]
        at = {"x": [min(row.error, edge) for row in rows], "y": [places[row.combination.name] for row in rows]}
        figure.add(trace("scatter", **at, error_x=_error_bars(rows, best_error), **_mark_properties(name, k, rows)))
    reach = [-1.0, max(places.values()) + 1.0]
    line = {"color": INK, "width": 1.2, "dash": "dash"}
    ends = {"x": [best_error, best_error], "y": reach, "mode": "lines", "name": "best", "line": line}
    figure.add(trace("scatter", **ends, hoverinfo="skip", showlegend=False))
    figure.axes("y", tickvals=centres, ticktext=[plain(name) for name in names], range=reach[::-1], showgrid=False)
    low, high = _error_range(ranking.standings, edge)
    _set_range(figure, "x", low, high, "mean joint error, % (geometric mean of the torque errors)")
    figure.layout.update(hovermode="closest", showlegend=True, shapes=_estimator_bands(centres, places))
    return figure


def cost_figure(ranking: Ranking) -> Drawing:
    """Draw the error of each combination over the seconds that smoothing and estimate took.

    Open marks are worse than the best by more than chance; the ring is the one to take.
    """
    figure = panels([""], 430, shared=False)
    best_error = ranking.standings[0].error
    edge = MAX_ERROR_RATIO * best_error
    if ranking.choice is not None:
        ring = {"color": "rgba(0, 0, 0, 0)", "size": 20, "line": {"width": 1.6, "color": INK}}
        at = {"x": [ranking.choice.seconds], "y": [ranking.choice.error]}
        figure.add(trace("scatter", **at, mode="markers", name="to take", marker=ring, hoverinfo="skip"))
    for k, name in enumerate(_smoother_names(ranking)):
        rows = [row for row in ranking.standings if row.combination.smoother == name]
        at = {"x": [row.seconds for row in rows], "y": [min(row.error, edge) for row in rows]}
        figure.add(trace("scatter", **at, **_mark_properties(name, k, rows)))
    times = [row.seconds for row in ranking.standings]
    _set_range(figure, "x", min(times) / 1.3, max(times) * 1.3, "smoothing and estimate, s")
    largest_error = min(max(row.error for row in ranking.standings), edge)
    _set_range(figure, "y", best_error * 0.93, largest_error * 1.1, "mean joint error, %")
    figure.layout.update(hovermode="closest", showlegend=True)
    return figure


def _smoother_names(ranking: Ranking) -> list[str]:
    """Return the smoothers that have an error, in the order in which they are compared."""
    used_names = {row.combination.smoother for row in ranking.standings}
    return [smoother.name for smoother in ranking.smoothers if smoother.name in used_names]


def _row_positions(ranking: Ranking) -> tuple[dict[str, float], list[str], list[float]]:
    """Return the height of each combination by its name, and names and centres of the estimators, best first."""
    order = list(dict.fromkeys(row.combination.estimator for row in ranking.standings))
    smoothers = _smoother_names(ranking)
    combinations = [row.combination for row in ranking.standings]
    places: dict[str, float] = {}
    centres, at = list[float](), 0.0
    # Rows of one estimator follow each other; an empty row separates estimators
    for name in order:
        group = sorted((smoothers.index(x.smoother), x.name) for x in combinations if x.estimator == name)
        places |= {combination: at + k for k, (_, combination) in enumerate(group)}
        centres.append(at + (len(group) - 1) / 2)
        at += len(group) + 1
    return places, order, centres


def _error_range(ranked: Sequence[RankedCombination], edge: float) -> tuple[float, float]:
    """Return the ends of an axis that holds all marks and intervals, at most up to ``edge``."""
    best_error = ranked[0].error
    ends = [row.error for row in ranked] + [best_error + row.interval[1] for row in ranked]
    starts = [best_error] + [best_error + row.interval[0] for row in ranked]
    low, high = min(filter(math.isfinite, starts)), min(max(filter(math.isfinite, ends)), edge)
    return max(low, 0.5 * best_error) * 0.96, high * 1.06


def _estimator_bands(centres: Sequence[float], places: dict[str, float]) -> list[dict[str, object]]:
    """Return a pale band behind every other estimator."""
    edges = sorted(places.values())
    groups: list[list[float]] = []
    for y in edges:
        # Neighbours more than one row apart belong to different estimators
        if groups and y - groups[-1][-1] < 1.5:
            groups[-1].append(y)
        else:
            groups.append([y])
    band = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "line": {"width": 0}, "layer": "below"}
    return [
        {**band, "y0": group[0] - 0.8, "y1": group[-1] + 0.8, "fillcolor": "rgba(128, 128, 128, 0.10)"}
        for group in groups[: len(centres)][::2]
    ]


def _error_bars(rows: list[RankedCombination], best_error: float) -> Trace | None:
    """Return the 95 % intervals of the differences to the best as bars; None where one is not known."""
    ends = [(row.interval[1] - (row.error - best_error), (row.error - best_error) - row.interval[0]) for row in rows]
    if not all(math.isfinite(x) for pair in ends for x in pair):
        return None
    return {
        "type": "data", "symmetric": False, "array": [max(a, 0.0) for a, _ in ends],
        "arrayminus": [max(b, 0.0) for _, b in ends], "thickness": 1.2, "width": 0,
    }  # fmt: skip


def _mark_properties(name: str, k: int, rows: list[RankedCombination]) -> Trace:
    """Return what the marks of the k-th smoother look like, and their hover texts."""
    return {
        "mode": "markers", "name": plain(name), "marker": _marker_style(k, rows),
        "text": [_hover_text(row) for row in rows], "hovertemplate": "%{text}<extra></extra>",
    }  # fmt: skip


def _marker_style(k: int, rows: list[RankedCombination]) -> Trace:
    symbol = SYMBOLS[k % len(SYMBOLS)]
    symbols = [f"{symbol}-open" if row.is_worse else symbol for row in rows]
    widths = [1.6 if row.is_worse else 0.0 for row in rows]
    return {"color": COLOURS[k % len(COLOURS)], "size": 9, "symbol": symbols, "line": {"width": widths}}


def _hover_text(row: RankedCombination) -> str:
    suffix = " (of the configuration)" if row.combination.is_configured else ""
    low, high = row.interval
    against = "" if math.isnan(low) else f"<br>to the best: {low:+.2g} to {high:+.2g} percentage points"
    return (
        f"{plain(row.combination.smoother)} with {plain(row.combination.estimator)}{suffix}<br>{row.error:.4g} %, "
        f"{row.seconds:.2g} s{against}"
    )


def _set_range(figure: Drawing, letter: str, low: float, high: float, title: str) -> None:
    """Set the range of an axis, which is logarithmic where its ends differ by more than a factor of four."""
    if high <= MAX_LINEAR_RATIO * low:
        figure.axes(letter, title=title, range=[low, high])  # type: ignore[arg-type]
        return
    # Ticks at 1, 2 and 5 of each decade, or at powers of ten alone where there are many decades
    decades = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    steps = (1, 2, 5) if high < 300 * low else (1,)
    ticks = [step * 10.0**k for k in decades for step in steps]
    ends, labels = [math.log10(low), math.log10(high)], [f"{tick:g}" for tick in ticks]
    figure.axes(letter, title=title, type="log", range=ends, tickvals=ticks, ticktext=labels)  # type: ignore[arg-type]


def ranking_page(ranking: Ranking) -> str:
    """Return the comparison as one HTML page."""
    sections = [PageSection("Which to take", tuple(_choice_blocks(ranking)), _badge(ranking))]
    if ranking.standings:
        sections.append(PageSection("Errors", tuple(_figure_blocks(ranking))))
        sections.append(PageSection("All combinations", (_combination_table(ranking),)))
        sections.append(PageSection("By joint", (_joint_table(ranking),)))
    if any(row.truth is not None for row in ranking.standings):
        sections.append(PageSection("Against the truth", tuple(_truth_blocks(ranking))))
    if ranking.failures or ranking.absent:
        sections.append(PageSection("Without an estimate", tuple(_failure_blocks(ranking))))
    chance = CHANCE_NOTE.format(length=f", {short(ranking.block, 2)} s" if math.isfinite(ranking.block) else "")
    sections.append(PageSection("How it is compared", (COMMON_NOTE, chance, COSTS_NOTE, _parts_table(ranking))))
    lead = f"{count(len(ranking.rows), 'combination')} on {ranking.name}: {ranking_heading(ranking)}."
    return render("Smoothers and estimators compared", lead, sections)


def _badge(ranking: Ranking) -> Badge | None:
    configured = ranking.configured_entry
    if configured is None or not ranking.standings:
        return Badge("no estimate", "bad") if not ranking.standings else None
    if ranking.forbidding_findings:
        return Badge("correct first what was found", "bad")
    if ranking.rival is not None:
        return Badge("contradicted by cross-validation", "fair")
    if configured in ranking.as_good:
        return Badge("yours is among the best", "good")
    return Badge("others are better", "fair") if ranking.has_enough_blocks else None


def _choice_blocks(ranking: Ranking) -> Iterator[PageBlock]:
    best, choice, configured = ranking.best, ranking.choice, ranking.configured_entry
    facts: list[tuple[str, ...]] = []
    if choice is not None:
        words = f"{choice.combination}; torque error {percent(choice.overall)}"
        facts.append((percent(choice.error), "mean joint error of the one to take", words))
    if best is not None and best is not choice:
        facts.append((percent(best.error), "least mean joint error", str(best.combination)))
    if configured is not None and configured not in (choice, best) and math.isfinite(configured.error):
        facts.append((percent(configured.error), "mean joint error of yours", str(configured.combination)))
    if ranking.has_enough_blocks:
        words = f"of {len(ranking.standings)} with an error"
        facts.append((str(len(ranking.within_chance)), "within chance of the best", words))
    if facts:
        yield Facts(tuple(facts))
    yield ranking_findings(ranking)


def _figure_blocks(ranking: Ranking) -> Iterator[PageBlock]:
    note = (
        " The line through a mark is the 95 % interval of its difference to the best, whose error is the dashed line; "
        "open marks are worse by more than chance, which counts that the best was chosen among many."
        if ranking.has_enough_blocks
        else ""
    )
    caption = (
        f"Torque error {BASES[ranking.basis]}, geometric mean over joints, by estimator; the best of each comes first."
    )
    yield Figure(ranking_figure(ranking), caption + note)
    yield Figure(cost_figure(ranking), "The same errors over what they cost; the ring is the one to take.")


def _combination_table(ranking: Ranking) -> PageTable:
    heads = (
        "mean joint error, %", ("from", "more than best, 95 %"), ("to", "more than best, 95 %"), "all joints, %",
        "same motion, %", "cross-validated, %", "training, %", "condition", "eigenvalue", "seconds",
    )  # fmt: skip
    rows = []
    for row in ranking.standings:
        means = (row.overall, *map(geometric_mean, (row.same_motion, row.cross_validated, row.training)))
        names = (*row.combination.shown_names, mark_words(ranking, row))
        errors = (number(row.error), *interval_ends(ranking, row), *(number(value, 3) for value in means))
        rows.append((*names, *errors, huge(row.condition), number(row.eigenvalue, 2), number(row.seconds, 2)))
    return PageTable.of((*NAMES, ""), heads, rows, "Relative torque errors, geometric mean over joints")


def _joint_table(ranking: Ranking) -> PageTable:
    joints = shorten_names(ranking.joints, MAX_JOINT_NAME_LENGTH)
    rows = []
    for row in ranking.standings:
        errors = row.ranking_errors(ranking.basis)
        cells = (number(errors.get(joint), 3) for joint in ranking.joints)
        rows.append((*row.combination.shown_names, *cells))
    return PageTable.of(NAMES, joints, rows, f"Relative torque error {BASES[ranking.basis]} by joint, %")


def _truth_blocks(ranking: Ranking) -> Iterator[PageBlock]:
    heads: list[Head] = ["error, median %", "error, in bounds (rms)", "intervals that hold it", "of"]
    rows = [
        (
            *row.combination.shown_names, number(row.truth.relative, 3),
            number(row.truth.over_bound, 3), str(row.truth.covered), str(row.truth.count),
        )
        for row in ranking.standings
        if row.truth is not None
    ]  # fmt: skip
    yield (
        "Errors of the base parameters whose truth is known, in % of it and in units of the least standard deviation "
        "that any unbiased method can reach on these logs (about 1 where it is reached: one recording shows bias and "
        "spread together), and how many of the 95 % intervals hold the truth."
    )
    yield PageTable.of(NAMES, heads, rows, "Base parameters against the truth")
    heads = ["error", "std", Column("unit", numeric=False)]
    for row in dict.fromkeys((ranking.choice, ranking.best, ranking.configured_entry)):
        if row is not None and row.truth:
            errors = zip(
                ranking.parameters, row.truth.error.tolist(), row.truth.std.tolist(), ranking.units, strict=True
            )
            cells = ((name, number(error, 3), number(std, 2), unit) for name, error, std, unit in errors)
            table = PageTable.of(("base parameter",), heads, cells)
            yield Fold(f"Base parameters of {row.combination}", (table,))


def _failure_blocks(ranking: Ranking) -> Iterator[PageBlock]:
    rows = [(*row.combination.shown_names, row.outcome.value, row.reason) for row in ranking.failures]
    rows += [(row.smoother or "any", row.estimator or "any", "does not apply", row.reason) for row in ranking.absent]
    reason = Column("reason", numeric=False, prose=True)
    yield PageTable.of((*NAMES, "status"), (reason,), rows, "Combinations without an error, and why")


def _parts_table(ranking: Ranking) -> PageTable:
    rows = []
    for part in ranking.smoothers:
        offset = ranking.offsets.get(part.name)
        words = f"; time offset {short(1000 * offset, 3)} ms" if offset else ""
        rows.append(("smoother", part.name, part_text(part.part) + words))
    rows += [("estimator", part.name, part_text(part.part)) for part in ranking.estimators]
    return PageTable.of(("", "name"), (Column("settings", numeric=False, prose=True),), rows, "What was compared")
