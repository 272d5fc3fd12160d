"""The words and tables of ``dynident bound``: what any method could reach, what limits it, what would be bought."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from dynident.bounds import Measure, Origin
from dynident.report import figures
from dynident.report.calibration_words import settings_of
from dynident.report.page import UNIT, Column, Facts, Figure, PageBlock, PageSection, PageTable, number, pairs, render
from dynident.report.wording import words

if TYPE_CHECKING:
    from dynident.bounds import AccuracyBound

__all__ = ["bound_dict", "bound_findings", "bound_page", "bound_table", "noise_table"]

WELL = 10.0  # a parameter is called well determined up to this least standard deviation, % of its value
LOST = 100.0  # above it not even the sign is sure
FULL_LIST, WORST = 40, 25  # a terminal shows up to so many parameters all, of more the worst
WORDS = 5  # parameters that get a sentence of their own
MAINLY = 0.5  # share of the variance from which a noise is named first
TIED = 5.0  # how many times knowing the other parameters would lower the deviation, to call the motion the limit
MISFIT = 3.0  # residual over the torque's own noise, from which the model is named
FILTERED = 300.0  # the same ratio, from which the torque must have been filtered
COLOURED = 1.5  # factor by which correlation in the residual would raise the bound, to speak of
SHORT = 28  # signs of a formula in a terminal
HEADS = {"now": "now", "bit": "+1 bit", "torque": "torque x 10", "longer": "4 x record"}

_WHAT = (
    "The Cramér-Rao bound: no unbiased method has smaller standard deviations with these sensors on this motion, if "
    "their noise is white. It is taken about the smoothed motion and the fit. +1 bit: position noise halved. Torque "
    "x 10: torque noise a tenth. 4 x record: the same motion four times."
)


def bound_table(found: AccuracyBound, short: bool = False) -> PageTable:
    """Return the table of least standard deviations; ``short`` for a terminal: the worst of many."""
    rows = range(len(found.names))
    if short and len(found.names) > FULL_LIST:
        rows = sorted(np.argsort(-found.relative, kind="stable")[:WORST].tolist())  # type: ignore[assignment]
    columns = [Column("parameter", numeric=False), Column("value"), UNIT]
    columns += [Column("fit", "sd, %"), *(Column(HEADS[name], "least sd, %") for name in HEADS), Column("least sd")]
    columns += [Column("limited by", numeric=False)]
    cells = []
    for k in rows:
        size = abs(float(found.value[k])) or np.nan
        sizes = [found.fit[k], *(found.std[name][k] for name in HEADS)]
        row = [_label(found, k), number(float(found.value[k])), found.units[k]]
        row += [number(100 * float(x) / size, 2) for x in sizes]
        cells.append((*row, number(float(found.std["now"][k]), 2), _limit(found, k)))
    title = "Least standard deviations of the base parameters, now and with better sensors or a longer record"
    if len(cells) < len(found.names):
        title += f" (the worst {len(cells)} of {len(found.names)})"
    return PageTable(tuple(columns), tuple(cells), title)


def noise_table(found: AccuracyBound) -> PageTable:
    """Return the noise by joint that the bound is taken for, beside the torque's own scatter."""
    joints, noise = found.identification.model.joints, found.noise
    rows = tuple(
        (joint.name, number(float(noise.q[j]), 3), number(float(noise.tau[j]), 3), number(float(noise.sensor[j]), 3))
        for j, joint in enumerate(joints)
    )
    heads = ("position noise", "torque noise", "torque scatter, sample to sample")
    origins = "; ".join(f"{what}: {text}" for what, text in _origins(found).items())
    return PageTable((Column("joint", numeric=False), *map(Column, heads)), rows, f"Noise, SI ({origins})")


def _origins(found: AccuracyBound) -> dict[str, str]:
    return {"positions": words(found.noise.positions), "torques": words(found.noise.torques)}


def bound_findings(found: AccuracyBound) -> list[str]:
    """Return what limits in plain sentences: all parameters together, what is bought, the worst ones, and warnings."""
    return [*_overall(found), *_worst(found), *_cautions(found)]


def _overall(found: AccuracyBound) -> Iterator[str]:
    relative, count = found.relative, len(found.names)
    well, lost = int((relative <= WELL).sum()), int((relative > LOST).sum())
    tail = f"; {lost} cannot be distinguished from zero" if lost else ""
    yield (
        f"{well} of {count} base parameters can be known to {WELL:g} % or better from this record, by the best method; "
        f"the median is {number(float(np.median(relative)), 2)} %{tail}."
    )
    with np.errstate(invalid="ignore"):
        bought = {name: 100 * (1 - found.std[name] / found.std["now"]) for name in ("bit", "torque")}
    gains = {name: values[np.isfinite(values)] for name, values in bought.items()}
    if gains["bit"].size and gains["torque"].size:
        best = int(np.nanargmax(np.where(np.isfinite(bought["bit"]), bought["bit"], -1.0)))
        yield (
            f"One more encoder bit lowers the bound by {number(float(np.median(gains['bit'])), 2)} % in the median (at "
            f"most {number(float(gains['bit'].max()), 2)} %, {_label(found, best)}), ten times the torque accuracy by "
            f"{number(float(np.median(gains['torque'])), 2)} %; a record twice as long by 29 %, four times by 50 %."
        )
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = found.fit / found.std["now"]
    ratio = ratio[np.isfinite(ratio)]
    if ratio.size:
        yield (
            f"The fit's own standard errors are {number(float(np.median(ratio)), 2)} times the bound in the median: "
            "that is what a better method could gain, unless it is due to correlated residuals."
        )


def _worst(found: AccuracyBound) -> Iterator[str]:
    for k in np.argsort(-found.relative, kind="stable")[:WORDS]:
        yield f"{_label(found, int(k))}: {_why(found, int(k))}"


def _why(found: AccuracyBound, k: int) -> str:
    now, relative = float(found.std["now"][k]), float(found.relative[k])
    if not np.isfinite(now):
        return "not determined by this motion at any noise level; excite it."
    at_best = f"{number(relative, 2)} % at best" + (", not distinguishable from zero" if relative > LOST else "")
    name, change, share = _first(found, k)
    with np.errstate(divide="ignore", invalid="ignore"):
        after = float(100 * found.std[change][k] / abs(found.value[k]))
    step = "one more bit" if change == "bit" else "ten times its accuracy"
    said = f"{at_best}. {name.capitalize()} limits it ({number(100 * share, 2)} % of the variance): {step} gives "
    said += f"{number(after, 2)} %."
    if found.inflation[k] > TIED:
        said += (
            f" The motion does too: were all others known, it would be {number(float(found.inflation[k]), 2)} times "
            f"smaller; hardest to tell from {_label(found, int(found.partner[k]))} "
            f"(correlation {found.correlation[k]:.3f})."
        )
    elif relative > WELL:
        said += " No other parameter hides it: its share of the torque is small in this motion; excite it more."
    return said


def _first(found: AccuracyBound, k: int) -> tuple[str, str, float]:
    """Return the noise that limits a parameter most, the change that reduces it, and its share of the variance."""
    share = float(np.nan_to_num(found.position_share[k]))
    return ("position noise", "bit", share) if share > MAINLY else ("torque noise", "torque", 1 - share)


def _limit(found: AccuracyBound, k: int) -> str:
    if not np.isfinite(found.std["now"][k]):
        return "motion"
    name, _, share = _first(found, k)
    return f"{name.removesuffix(' noise')} {100 * share:.0f} %" + (", motion" if found.inflation[k] > TIED else "")


def _cautions(found: AccuracyBound) -> Iterator[str]:
    joints = [joint.name for joint in found.identification.model.joints]
    ratio = found.noise.tau / found.noise.sensor
    worst = int(ratio.argmax())
    fitted = found.noise.torques == Origin(Measure.RESIDUAL)
    if fitted and ratio[worst] > FILTERED:
        yield (
            f"The torque of {joints[worst]} hardly scatters from sample to sample: it was filtered before it was "
            "logged, and its scatter says nothing of the sensor. The residual of the fit sets this bound."
        )
    elif fitted and ratio[worst] > MISFIT:
        yield (
            f"The residual is up to {number(float(ratio[worst]), 2)} times the scatter of the torque between samples "
            f"({joints[worst]}): the model's misfit or slow noise sets this bound, not the torque sensor; see "
            "--torque sensor for the sensor alone."
        )
    factor = _colour(found)
    if factor > COLOURED:
        yield (
            "Residuals are correlated in time: noise as slow as they are would raise the bound up to "
            f"{number(factor, 2)} times (median over the joints)."
        )


def _colour(found: AccuracyBound) -> float:
    """Return by how much the residuals' correlation would raise the bound of slow effects, the median over joints."""
    factors = [
        np.sqrt(max(test.decorrelation / float(np.diff(log.motion.t).mean()), 1.0))
        for log in found.identification.validations
        for test in log.residuals.values()
    ]
    return float(np.median(factors)) if factors else 1.0


def _label(found: AccuracyBound, k: int) -> str:
    """Return a base parameter's formula, or, where it is long, its first parameter and how many follow."""
    name = found.names[k]
    if len(name) <= SHORT:
        return name
    lead, *rest = name.replace(" - ", " + ").split(" + ")
    return f"{lead} (+{len(rest)} more)" if rest else name


def bound_page(found: AccuracyBound) -> str:
    """Return the bound as one HTML page: findings, table, figure, noise, settings."""
    relative, fact = found.relative, found.identification
    well = int((relative <= WELL).sum())
    labels = [_label(found, k) for k in range(len(found.names))]
    facts = Facts(
        (
            (f"{well} of {len(relative)}", f"base parameters within {WELL:g} % at best"),
            (f"{number(float(np.median(relative)), 2)} %", "median of the least standard deviations"),
            (str(found.samples), "samples"),
        )
    )
    caption = (
        "Least standard deviation of each base parameter in % of its value, logarithmic: now and after each change; "
        "the cross is the standard error of the fit itself, which allows for correlated residuals."
    )
    blocks: tuple[PageBlock, ...] = (facts, tuple(bound_findings(found)))
    sections = [
        PageSection("What could be reached", blocks),
        PageSection(
            "Bound",
            (_WHAT, bound_table(found), *_formulas(found), Figure(figures.bound_figure(found, labels), caption)),
        ),
        PageSection("Noise", (noise_table(found),)),
        PageSection("Warnings", (tuple(map(words, fact.notes)) or "None.",)),
        PageSection("Settings and versions", tuple(_settings(found))),
    ]
    logs = ", ".join(log.name for log in fact.validations)
    return render(f"What could be reached with {fact.model.name}", f"Least standard deviations from {logs}.", sections)


def _formulas(found: AccuracyBound) -> Iterator[PageBlock]:
    """Yield what the shortened names stand for, where there are any."""
    cut = [(_label(found, k), name) for k, name in enumerate(found.names) if _label(found, k) != name]
    if cut:
        columns = (Column("base parameter", numeric=False), Column("formula", numeric=False))
        yield PageTable(
            columns, tuple(cut), "Base parameters: the combinations that act on the torque each in its own way"
        )


def _settings(found: AccuracyBound) -> Iterator[PageBlock]:
    sources = found.identification.provenance
    files = [("model file", sources.model.path)] if sources.model else []
    yield pairs("setting", [*files, *settings_of(found.identification).items()])
    if sources.configuration:
        yield pairs("configuration", [("text", sources.configuration.text)])
    yield pairs("program", list(sources.versions.items()))


def bound_dict(found: AccuracyBound) -> dict[str, Any]:
    """Return everything as plain values. Standard deviations are in the parameters' units, shares from 0 to 1."""
    joints = [joint.name for joint in found.identification.model.joints]
    parameters = [
        {
            "name": name,
            "alone": bool(found.alone[k]),
            "value": float(found.value[k]),
            "unit": found.units[k],
            "std": {change: float(std[k]) for change, std in found.std.items()},
            "relative": float(found.relative[k]),
            "fit": float(found.fit[k]),
            "position_share": float(found.position_share[k]),
            "inflation": float(found.inflation[k]),
            "partner": found.names[int(found.partner[k])],
            "correlation": float(found.correlation[k]),
        }
        for k, name in enumerate(found.names)
    ]
    noise = {
        name: dict(zip(joints, getattr(found.noise, name).tolist(), strict=True)) for name in ("q", "tau", "sensor")
    }
    return {
        "parameters": parameters,
        "noise": {**noise, "from": _origins(found)},
        "samples": found.samples,
        "findings": bound_findings(found),
        "warnings": [words(note) for note in found.identification.notes],
        "provenance": asdict(found.identification.provenance),
    }
