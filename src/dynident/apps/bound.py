"""Figures of the Cramer-Rao bound: what a record can say of each parameter, and what methods make of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from enum import Enum
from typing import Any

import numpy as np

from dynident.identification import AccuracyBound, Measure, Origin
from dynident.report import Drawing
from dynident.report.figures import AMBER, BLUE, GREEN, INK, RED, VIOLET, mark_rows, panels, plain, trace
from dynident.report.page import (
    UNIT,
    Column,
    Facts,
    Figure,
    Head,
    PageBlock,
    PageSection,
    PageTable,
    formula_blocks,
    pair_table,
    render,
    short_formula,
)
from dynident.report.words import settings_of
from dynident.runtime import join_names, number

CHANGE_NAMES: Mapping[str, str] = {
    "now": "now",
    "bit": "+1 encoder bit",
    "torque": "torque × 10",
    "twice": "2 × record",
    "longer": "4 × record",
}
CHANGE_STYLES = {
    "now": (RED, "circle"), "bit": (BLUE, "circle-open"),
    "torque": (GREEN, "diamond"), "longer": (AMBER, "line-ns-open"),
}  # fmt: skip

WELL = 10.0  # a parameter is called well determined up to this least standard deviation, % of its value
KNOWN_WELL, MOTION_LIMITS = f"known to {WELL:g} % at best", "limited by the motion"
CAUSE_COLOURS = {
    KNOWN_WELL: GREEN, "limited by torque noise": BLUE, "limited by position noise": VIOLET, MOTION_LIMITS: AMBER,
}  # fmt: skip
MAX_SIGN_KNOWN = 100.0  # above it not even the sign is sure
MAX_FULL_LIST, SHOWN_WORST = 40, 25  # a terminal shows up to so many parameters all, of more the worst
MAX_SENTENCES = 5  # least known parameters that sentences name
MIN_DOMINANT_SHARE = 0.5  # share of the variance from which a noise is named first
# how many times knowing the other parameters would lower the deviation, to call the motion the limit
MIN_TIED_INFLATION = 5.0
MIN_MISFIT_RATIO = 3.0  # residual over the torque's own noise, from which the model is named
MIN_FILTERED_RATIO = 300.0  # the same ratio, from which the torque must have been filtered
MIN_COLOURED_FACTOR = 1.5  # factor by which correlation in the residual would raise the bound, to speak of
HEADS = {"now": "now", "bit": "+1 bit", "torque": "torque x 10", "longer": "4 x record"}


class Limit(Enum):
    """What about a motion limits a parameter: it does not show it, ties it to others, hardly shows it, or only noise
    does."""

    UNSEEN = "not excited"
    TIED = "tied to others"
    WEAK = "weakly excited"
    NOISE = "noise"


_BOUND_NOTE = (
    "The Cramér-Rao bound: no unbiased method has smaller standard deviations with these sensors on this motion, if "
    "their noise is white. It is taken about the smoothed motion and the fit. +1 bit: position noise halved. Torque "
    "x 10: torque noise a tenth. 4 x record: the same motion four times."
)


def bound_figure(bound: AccuracyBound, labels: Sequence[str]) -> Drawing:
    """Draw the least standard deviation of each parameter in % of its value, now and after each change; log axis."""
    labels = [plain(label) for label in labels]
    figure = panels([""], 130 + 20 * len(labels), shared=False)
    with np.errstate(divide="ignore", invalid="ignore"):
        fit = 100 * bound.fit / np.abs(bound.value)
        series = {name: 100 * std / np.abs(bound.value) for name, std in bound.std.items() if name in CHANGE_STYLES}
    marks = {"fit": (fit, "this fit", INK, "x-thin-open"), **{
        name: (values, CHANGE_NAMES[name], *CHANGE_STYLES[name]) for name, values in series.items()
    }}  # fmt: skip
    mark_rows(figure, labels, marks.values(), "standard deviation, % of the value")
    return figure


def limit_figure(bound: AccuracyBound) -> Drawing:
    """Draw how many base parameters of each joint can be known well, and what limits the others.

    A parameter counts for the last joint on whose torque the first of its combination acts.
    """
    model = bound.identification.model
    columns = [set(part.tolist()) for part in model.structure.columns]
    lead_joints = [max((j for j, part in enumerate(columns) if k in part), default=0) for k in bound.independent]
    causes = [_cause(bound, k) for k in range(len(bound.names))]
    joints = [plain(joint.name) for joint in model.joints]
    figure = panels([""], 110 + 26 * len(joints), shared=False)
    for cause, colour in CAUSE_COLOURS.items():
        counts = [sum(x == (j, cause) for x in zip(lead_joints, causes, strict=True)) for j in range(len(joints))]
        if any(counts):
            figure.add(trace("bar", x=counts, y=joints, orientation="h", name=cause, marker={"color": colour}))
    figure.axes("y", type="category", autorange="reversed", showgrid=False)
    figure.axes("x", title="base parameters", rangemode="tozero")
    figure.layout.update(barmode="stack", bargap=0.3, hovermode="closest", legend={"traceorder": "normal"})
    figure.layout["showlegend"] = True
    return figure


def _cause(bound: AccuracyBound, k: int) -> str:
    if bound.relative[k] <= WELL:
        return KNOWN_WELL
    is_motion = _limit(bound, k) in (Limit.UNSEEN, Limit.TIED)
    return MOTION_LIMITS if is_motion else f"limited by {_dominant_noise(bound, k)[0]}"


def bound_table(bound: AccuracyBound, short: bool = False) -> PageTable:
    """Return the table of the least standard deviations.

    With ``short``, as in a terminal, a long table is cut to the worst parameters.
    """
    rows = range(len(bound.names))
    if short and len(bound.names) > MAX_FULL_LIST:
        # A stable sort keeps the order of the model among equal parameters
        rows = sorted(np.argsort(-bound.relative, kind="stable")[:SHOWN_WORST].tolist())  # type: ignore[assignment]
    heads: tuple[Head, ...] = (
        "value",
        UNIT,
        ("fit", "sd, %"),
        *((head, "least sd, %") for head in HEADS.values()),
        "least sd",
    )
    cells = []
    for k in rows:
        size = abs(float(bound.value[k])) or np.nan
        sizes = [bound.fit[k], *(bound.std[name][k] for name in HEADS)]
        row = [short_formula(bound.names[k]), number(float(bound.value[k])), bound.units[k]]
        row += [number(100 * float(x) / size, 2) for x in sizes]
        cells.append((*row, number(float(bound.std["now"][k]), 2), _limit_cell(bound, k)))
    title = "Least standard deviations of the base parameters, now and with better sensors or a longer record"
    if len(cells) < len(bound.names):
        title += f" (the worst {len(cells)} of {len(bound.names)})"
    return PageTable.of(("parameter",), (*heads, Column("limited by", numeric=False)), cells, title)


def noise_table(bound: AccuracyBound) -> PageTable:
    """Return the noise of each joint for which the bound holds, beside the torque's scatter between samples."""
    joints, noise = bound.identification.model.joints, bound.noise
    rows = (
        (joint.name, *(number(float(values[j]), 3) for values in (noise.q, noise.tau, noise.sensor)))
        for j, joint in enumerate(joints)
    )
    heads = ("position noise", "torque noise", "torque scatter, sample to sample")
    origins = "; ".join(f"{quantity}: {text}" for quantity, text in _noise_origins(bound).items())
    return PageTable.of(("joint",), heads, rows, f"Noise, SI ({origins})")


def _noise_origins(bound: AccuracyBound) -> dict[str, str]:
    return {"positions": str(bound.noise.positions), "torques": str(bound.noise.torques)}


def bound_findings(bound: AccuracyBound) -> list[str]:
    """Return plain sentences on what limits the accuracy: all parameters, possible gains, the worst ones, warnings."""
    return [*_overall_sentences(bound), *_worst_sentences(bound), *_cautions(bound)]


def _overall_sentences(bound: AccuracyBound) -> Iterator[str]:
    relative, count = bound.relative, len(bound.names)
    well, lost = int((relative <= WELL).sum()), int((relative > MAX_SIGN_KNOWN).sum())
    tail = f"; {lost} cannot be distinguished from zero" if lost else ""
    yield (
        f"{well} of {count} base parameters can be known to {WELL:g} % or better from this record, by the best method; "
        f"the median is {number(float(np.median(relative)), 2)} %{tail}."
    )
    # Parameters that no motion excites have an infinite bound: their gain is NaN and is left out
    with np.errstate(invalid="ignore"):
        bought = {name: 100 * (1 - bound.std[name] / bound.std["now"]) for name in ("bit", "torque")}
    gains = {name: values[np.isfinite(values)] for name, values in bought.items()}
    if gains["bit"].size and gains["torque"].size:
        best = int(np.nanargmax(np.where(np.isfinite(bought["bit"]), bought["bit"], -1.0)))
        yield (
            f"One more encoder bit lowers the bound by {number(float(np.median(gains['bit'])), 2)} % in the median (at "
            f"most {number(float(gains['bit'].max()), 2)} %, {short_formula(bound.names[best])}), ten times the torque "
            f"accuracy by {number(float(np.median(gains['torque'])), 2)} %; a record twice as long by 29 %, four times "
            "by 50 %."
        )
    # Ratio of the fit's standard errors to the bound; only parameters with a bound count
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = bound.fit / bound.std["now"]
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size:
        yield (
            f"The fit's own standard errors are {number(float(np.median(ratio)), 2)} times the bound in the median: "
            "that is what a better method could gain, unless it is due to correlated residuals."
        )


def _worst_sentences(bound: AccuracyBound) -> Iterator[str]:
    """Yield what limits the least known parameters: those with one cause share a sentence."""
    groups: dict[tuple[str, str, Limit], list[int]] = {}
    # a value of zero, such as one at a bound, has no relative error
    has_share = np.isfinite(bound.relative) | ~np.isfinite(bound.std["now"])
    order = np.argsort(-bound.relative, kind="stable")
    for k in order[has_share[order]][:MAX_SENTENCES].tolist():
        noise, change, _ = _dominant_noise(bound, k)
        groups.setdefault((noise, change, _limit(bound, k)), []).append(k)
    for (noise, change, limit), members in groups.items():
        names = join_names(short_formula(bound.names[k]) for k in members)
        if limit is Limit.UNSEEN:
            yield f"This motion does not show {names} at any noise level: excite {_them(members)}."
            continue
        sizes = join_names(f"{short_formula(bound.names[k])} {number(float(bound.relative[k]), 2)} %" for k in members)
        with np.errstate(divide="ignore", invalid="ignore"):
            later = (float(100 * bound.std[change][k] / abs(bound.value[k])) for k in members)
            after = join_names(f"{number(size, 2)} %" for size in later)
        share = min(_dominant_noise(bound, k)[2] for k in members)
        step = "one more bit" if change == "bit" else "ten times the accuracy"
        yield (
            f"{noise.capitalize()} limits the least certain parameters ({number(100 * share, 2)} % of the variance). "
            f"Their least standard errors are {sizes}; with {step}, {after}.{_limit_words(bound, members, limit)}"
        )


def _limit_words(bound: AccuracyBound, members: Sequence[int], limit: Limit) -> str:
    """Return what limits parameters besides a noise, where anything does."""
    if limit is Limit.TIED:
        ties = join_names(
            f"{short_formula(bound.names[k])} to {short_formula(bound.names[int(bound.partner[k])])} (correlation "
            f"{bound.correlation[k]:.3f}; alone, it would be known {number(float(bound.inflation[k]), 2)} times better)"
            for k in members
        )
        return f" The motion limits {_them(members)} too: it ties {ties}."
    return f" This motion hardly shows {_them(members)}: excite {_them(members)} more." if limit is Limit.WEAK else ""


def _them(members: Sequence[int]) -> str:
    return "them" if members[1:] else "it"


def _limit(bound: AccuracyBound, k: int) -> Limit:
    """Return what about the motion keeps a parameter from being known well."""
    if not np.isfinite(bound.std["now"][k]):
        return Limit.UNSEEN
    if bound.inflation[k] > MIN_TIED_INFLATION:
        return Limit.TIED
    return Limit.WEAK if bound.relative[k] > WELL else Limit.NOISE


def _dominant_noise(bound: AccuracyBound, k: int) -> tuple[str, str, float]:
    """Return the noise that limits a parameter most, the change that reduces it, and its share of the variance."""
    share = float(np.nan_to_num(bound.position_share[k]))
    return ("position noise", "bit", share) if share > MIN_DOMINANT_SHARE else ("torque noise", "torque", 1 - share)


def _limit_cell(bound: AccuracyBound, k: int) -> str:
    limit = _limit(bound, k)
    if limit is Limit.UNSEEN:
        return "motion"
    name, _, share = _dominant_noise(bound, k)
    return f"{name.removesuffix(' noise')} {100 * share:.0f} %" + ", motion" * (limit is Limit.TIED)


def _cautions(bound: AccuracyBound) -> Iterator[str]:
    joints = [joint.name for joint in bound.identification.model.joints]
    ratio = bound.noise.tau / bound.noise.sensor
    # A residual far above the scatter between samples is misfit, or the torque was filtered when it was logged
    worst = int(ratio.argmax())
    from_residual = bound.noise.torques == Origin(Measure.RESIDUAL)
    if from_residual and ratio[worst] > MIN_FILTERED_RATIO:
        yield (
            f"The torque of {joints[worst]} hardly scatters from sample to sample: it was filtered before it was "
            "logged, and its scatter says nothing of the sensor. The residual of the fit sets this bound."
        )
    elif from_residual and ratio[worst] > MIN_MISFIT_RATIO:
        yield (
            f"The residual is up to {number(float(ratio[worst]), 2)} times the scatter of the torque between samples "
            f"({joints[worst]}): the model's misfit or slow noise sets this bound, not the torque sensor; see "
            "--torque sensor for the sensor alone."
        )
    factor = _correlation_factor(bound)
    if factor > MIN_COLOURED_FACTOR:
        yield (
            "Residuals are correlated in time: noise as slow as they are would raise the bound up to "
            f"{number(factor, 2)} times (median over the joints)."
        )


def _correlation_factor(bound: AccuracyBound) -> float:
    """Return the factor by which correlated residuals would raise the bound of slow effects, the median over joints."""
    # Correlated samples count as one: the bound grows with the root of their number
    factors = [
        np.sqrt(max(test.decorrelation / float(np.diff(log.motion.t).mean()), 1.0))
        for log in bound.identification.validations
        for test in log.residuals.values()
    ]
    return float(np.median(factors)) if factors else 1.0


def bound_page(bound: AccuracyBound) -> str:
    """Return the bound as one HTML page: findings, table, figure, noise, settings."""
    relative, identification = bound.relative, bound.identification
    well = int((relative <= WELL).sum())
    labels = [short_formula(name) for name in bound.names]
    facts = Facts(
        (
            (f"{well} of {len(relative)}", f"base parameters within {WELL:g} % at best"),
            (f"{number(float(np.median(relative)), 2)} %", "median of the least standard deviations"),
            (str(bound.samples), "samples"),
        )
    )
    caption = (
        "Least standard deviation of each base parameter in % of its value, logarithmic: now and after each change; "
        "the cross is the standard error of the fit itself, which allows for correlated residuals."
    )
    limits = Figure(
        limit_figure(bound), "Base parameters by joint: those known well at best, and what limits the others."
    )
    figure = Figure(bound_figure(bound, labels), caption)
    sections = [
        PageSection("What could be reached", (facts, limits, tuple(bound_findings(bound)))),
        PageSection("Bound", (_BOUND_NOTE, bound_table(bound), *formula_blocks(bound.names), figure)),
        PageSection("Noise", (noise_table(bound),)),
        PageSection("Warnings", (tuple(map(str, identification.notes)) or "None.",)),
        PageSection("Settings and versions", tuple(_settings(bound))),
    ]
    logs = ", ".join(log.name for log in identification.validations)
    return render(
        f"What could be reached with {identification.model.name}", f"Least standard deviations from {logs}.", sections
    )


def _settings(bound: AccuracyBound) -> Iterator[PageBlock]:
    sources = bound.identification.provenance
    files = [("model file", sources.model.path)] if sources.model else []
    yield pair_table("setting", [*files, *settings_of(bound.identification).items()])
    if sources.configuration:
        yield pair_table("configuration", [("text", sources.configuration.text)])
    yield pair_table("program", list(sources.versions.items()))


def bound_dict(bound: AccuracyBound) -> dict[str, Any]:
    """Return everything as plain values. Standard deviations are in the parameters' units, shares from 0 to 1."""
    joints = [joint.name for joint in bound.identification.model.joints]
    parameters = [
        {
            "name": name, "alone": bool(bound.alone[k]), "value": float(bound.value[k]), "unit": bound.units[k],
            "std": {change: float(std[k]) for change, std in bound.std.items()}, "relative": float(bound.relative[k]),
            "fit": float(bound.fit[k]), "position_share": float(bound.position_share[k]),
            "inflation": float(bound.inflation[k]), "partner": bound.names[int(bound.partner[k])],
            "correlation": float(bound.correlation[k]),
        }
        for k, name in enumerate(bound.names)
    ]  # fmt: skip
    noise = {
        name: dict(zip(joints, getattr(bound.noise, name).tolist(), strict=True)) for name in ("q", "tau", "sensor")
    }
    return {
        "parameters": parameters, "noise": {**noise, "from": _noise_origins(bound)}, "samples": bound.samples,
        "findings": bound_findings(bound), "warnings": [str(note) for note in bound.identification.notes],
        "provenance": asdict(bound.identification.provenance),
    }  # fmt: skip
