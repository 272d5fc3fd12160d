"""Figures of the Cramer-Rao bound: what a record can say of each parameter, and what methods make of it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.identification import Measure, Origin
from dynident.report import Drawing
from dynident.report.figures import AMBER, BLUE, GREEN, INK, RED, mark_rows, panels, plain
from dynident.report.page import (
    UNIT,
    Column,
    Facts,
    Figure,
    PageBlock,
    PageSection,
    PageTable,
    formula_blocks,
    pair_table,
    render,
    short_formula,
)
from dynident.report.words import settings_of
from dynident.runtime import number

if TYPE_CHECKING:
    from dynident.identification import AccuracyBound

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
MAX_SIGN_KNOWN = 100.0  # above it not even the sign is sure
MAX_FULL_LIST, SHOWN_WORST = 40, 25  # a terminal shows up to so many parameters all, of more the worst
MAX_SENTENCES = 5  # parameters that get a sentence of their own
MIN_DOMINANT_SHARE = 0.5  # share of the variance from which a noise is named first
# how many times knowing the other parameters would lower the deviation, to call the motion the limit
MIN_TIED_INFLATION = 5.0
MIN_MISFIT_RATIO = 3.0  # residual over the torque's own noise, from which the model is named
MIN_FILTERED_RATIO = 300.0  # the same ratio, from which the torque must have been filtered
MIN_COLOURED_FACTOR = 1.5  # factor by which correlation in the residual would raise the bound, to speak of
HEADS = {"now": "now", "bit": "+1 bit", "torque": "torque x 10", "longer": "4 x record"}

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


def bound_table(bound: AccuracyBound, short: bool = False) -> PageTable:
    """Return the table of the least standard deviations.

    With ``short``, as in a terminal, a long table is cut to the worst parameters.
    """
    rows = range(len(bound.names))
    if short and len(bound.names) > MAX_FULL_LIST:
        # A stable sort keeps the order of the model among equal parameters
        rows = sorted(np.argsort(-bound.relative, kind="stable")[:SHOWN_WORST].tolist())  # type: ignore[assignment]
    columns = [Column("parameter", numeric=False), Column("value"), UNIT]
    columns += [Column("fit", "sd, %"), *(Column(HEADS[name], "least sd, %") for name in HEADS), Column("least sd")]
    columns += [Column("limited by", numeric=False)]
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
    return PageTable(tuple(columns), tuple(cells), title)


def noise_table(bound: AccuracyBound) -> PageTable:
    """Return the noise of each joint for which the bound holds, beside the torque's scatter between samples."""
    joints, noise = bound.identification.model.joints, bound.noise
    rows = tuple(
        (joint.name, number(float(noise.q[j]), 3), number(float(noise.tau[j]), 3), number(float(noise.sensor[j]), 3))
        for j, joint in enumerate(joints)
    )
    heads = ("position noise", "torque noise", "torque scatter, sample to sample")
    origins = "; ".join(f"{quantity}: {text}" for quantity, text in _noise_origins(bound).items())
    return PageTable((Column("joint", numeric=False), *map(Column, heads)), rows, f"Noise, SI ({origins})")


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
    for k in np.argsort(-bound.relative, kind="stable")[:MAX_SENTENCES]:
        yield f"{short_formula(bound.names[int(k)])}: {_limit_sentence(bound, int(k))}"


def _limit_sentence(bound: AccuracyBound, k: int) -> str:
    now, relative = float(bound.std["now"][k]), float(bound.relative[k])
    if not np.isfinite(now):
        return "not determined by this motion at any noise level; excite it."
    at_best = f"{number(relative, 2)} % at best" + (
        ", not distinguishable from zero" if relative > MAX_SIGN_KNOWN else ""
    )
    name, change, share = _dominant_noise(bound, k)
    with np.errstate(divide="ignore", invalid="ignore"):
        after = float(100 * bound.std[change][k] / abs(bound.value[k]))
    step = "one more bit" if change == "bit" else "ten times its accuracy"
    sentence = f"{at_best}. {name.capitalize()} limits it ({number(100 * share, 2)} % of the variance): {step} gives "
    sentence += f"{number(after, 2)} %."
    if bound.inflation[k] > MIN_TIED_INFLATION:
        sentence += (
            f" The motion does too: were all others known, it would be {number(float(bound.inflation[k]), 2)} times "
            f"smaller; hardest to tell from {short_formula(bound.names[int(bound.partner[k])])} "
            f"(correlation {bound.correlation[k]:.3f})."
        )
    elif relative > WELL:
        sentence += " No other parameter hides it: its share of the torque is small in this motion; excite it more."
    return sentence


def _dominant_noise(bound: AccuracyBound, k: int) -> tuple[str, str, float]:
    """Return the noise that limits a parameter most, the change that reduces it, and its share of the variance."""
    share = float(np.nan_to_num(bound.position_share[k]))
    return ("position noise", "bit", share) if share > MIN_DOMINANT_SHARE else ("torque noise", "torque", 1 - share)


def _limit_cell(bound: AccuracyBound, k: int) -> str:
    if not np.isfinite(bound.std["now"][k]):
        return "motion"
    name, _, share = _dominant_noise(bound, k)
    return f"{name.removesuffix(' noise')} {100 * share:.0f} %" + (
        ", motion" if bound.inflation[k] > MIN_TIED_INFLATION else ""
    )


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
    labels = [short_formula(bound.names[k]) for k in range(len(bound.names))]
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
    blocks: tuple[PageBlock, ...] = (facts, tuple(bound_findings(bound)))
    sections = [
        PageSection("What could be reached", blocks),
        PageSection(
            "Bound",
            (
                _BOUND_NOTE,
                bound_table(bound),
                *formula_blocks(bound.names),
                Figure(bound_figure(bound, labels), caption),
            ),
        ),
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
            "name": name,
            "alone": bool(bound.alone[k]),
            "value": float(bound.value[k]),
            "unit": bound.units[k],
            "std": {change: float(std[k]) for change, std in bound.std.items()},
            "relative": float(bound.relative[k]),
            "fit": float(bound.fit[k]),
            "position_share": float(bound.position_share[k]),
            "inflation": float(bound.inflation[k]),
            "partner": bound.names[int(bound.partner[k])],
            "correlation": float(bound.correlation[k]),
        }
        for k, name in enumerate(bound.names)
    ]
    noise = {
        name: dict(zip(joints, getattr(bound.noise, name).tolist(), strict=True)) for name in ("q", "tau", "sensor")
    }
    return {
        "parameters": parameters,
        "noise": {**noise, "from": _noise_origins(bound)},
        "samples": bound.samples,
        "findings": bound_findings(bound),
        "warnings": [str(note) for note in bound.identification.notes],
        "provenance": asdict(bound.identification.provenance),
    }
