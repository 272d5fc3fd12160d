"""The choice of the terms beside the bodies, in a report, in a terminal, and beside the settings that repeat it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dynident.estimators import Consistency
from dynident.identification import Identification
from dynident.identification.terms import TermChoice, TermTrial, TrialOutcome
from dynident.identification.terms.search import MIN_GAIN, MIN_GAIN_ERRORS, MIN_STRICT_GAIN_ERRORS
from dynident.regression import BaseParameters
from dynident.report.figures import Array
from dynident.report.identification.data import excitation_table
from dynident.report.identification.figures import interval_figure, relative_std, singular_figure, trial_figure
from dynident.report.page import UNIT, Column, Facts, Figure, Fold, Gallery, Head, PageBlock, PageSection, PageTable
from dynident.report.words import huge, motion_known, tiny
from dynident.runtime import number
from dynident.runtime.families import TERMS

OUTCOMES: Mapping[TrialOutcome, str] = {
    TrialOutcome.ENTERED: "entered",
    TrialOutcome.TOO_SMALL: "refused: it gains too little",
    TrialOutcome.WITHIN_ERROR: "refused: the gain is within its error",
    TrialOutcome.REFUTED_FASTER: "refused: worse on faster motion",
    TrialOutcome.REFUTED_FURTHER: "refused: worse further out than fitted",
    TrialOutcome.REFUTED_BY_LOG: "refused: worse on another recording",
    TrialOutcome.NEGATIVE: "refused: its coefficient would be negative",
    TrialOutcome.NOT_EXCITED: "refused: the data do not show it",
    TrialOutcome.REDUNDANT: "taken out again: the others do its work",
    TrialOutcome.KEPT: "kept: the joint moves one way only, which does not tell it from an offset",
}
_LEAD = (
    "The terms of each joint were chosen by cross-validation on the training logs. The gain is the share of the "
    "joint's squared error, on stretches of time left out of the fit, that a term removes. A term is used if its gain "
    f"is above {MIN_GAIN_ERRORS:g} standard errors ({MIN_STRICT_GAIN_ERRORS:g} for special kinds) and {MIN_GAIN:g} %, "
    "and if it does not predict faster motion worse. `dynident identify CONFIG --write-config FILE` writes them down."
)
_FIGURE = "With the plain set (offset, rotor inertia, viscous and Coulomb friction), the cross-validated error is"
MIN_SHOWN_SHIFT = 0.1  # standard errors that constraints must move a base parameter by to be shown
MAX_UNFOLDED_PARAMETERS = 24  # base parameters from which on they are folded
_BASE = (
    "Base parameters are the combinations of parameters that act on the torque each in its own way; unlike the single "
    "parameters in them, their values follow from the data alone. The standard errors allow for correlated residuals, "
    "those to their right assume independent ones. Where constraints moved a value, what it would be without them is "
    "shown, and the standard errors count the difference as a possible error."
)
_SINGULAR = (
    "Singular values of the regressor with its columns scaled to equal length. A clear step where they become hollow "
    "means a clear rank; filled ones far below 1 are combinations that these motions hardly show."
)
_EIGENVALUES = (
    "The pseudo-inertia of a body of real mass has no negative eigenvalue (Wensing, Kim and Slotine, 2018). "
    "It is scaled by the body's usual mass and length; a zero lies on the boundary of what is possible."
)


def term_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section on the terms, where they were chosen."""
    choice = identification.calibration.terms
    if choice is None or not choice.trials:
        return
    views = []
    for joint, before, after in zip(choice.joints, choice.before, choice.after, strict=True):
        if trials := _sort_trials(choice.trials_of(joint)):
            caption = f"{joint}: {_FIGURE} {number(before, 3)} %, with the terms chosen {number(after, 3)} %."
            views.append(((joint,), (Figure(trial_figure(trials, OUTCOMES), caption),)))
    table, gallery = Fold("All that was tried", (_trial_table(choice),)), Gallery(("joint",), tuple(views))
    yield PageSection("Friction and other terms", (_LEAD, term_table(choice), gallery, table))


def term_table(choice: TermChoice) -> PageTable:
    """Return one row per joint: the cross-validated errors, and the terms that entered with their gains."""
    title = "terms chosen, with constants and gain in % of the squared error"
    heads = (Column(title, numeric=False, prose=True), "error, %", "with the plain set, %")
    rows = (
        (joint, _list_terms(choice, joint), number(after, 3), number(before, 3))
        for joint, before, after in zip(choice.joints, choice.before, choice.after, strict=True)
    )
    caption = "Terms chosen by the training logs, and the cross-validated torque error"
    return PageTable.of(("joint",), heads, rows, caption)


def choice_comments(identification: Identification, source: str) -> dict[str, list[str]]:
    """Return why settings were chosen, as lines of comments by key of the configuration; the key "" is all of it."""
    calibration, recipe = identification.calibration, identification.recipe
    comments = {
        "": [
            f"Written by `dynident identify {source} --write-config`: what was chosen there is named here, so that the",
            "result is the same. Numbers have all of their digits for that. The comments of that file are not kept.",
        ]
    }
    if (choice := calibration.terms) is not None:
        comments["model.terms"] = [
            "chosen on the training logs; gains in % of the squared cross-validated error of the joint:",
            *(
                f"{joint}: {_list_terms(choice, joint)}; error {number(before, 3)} -> {number(after, 3)} %"
                for joint, before, after in zip(choice.joints, choice.before, choice.after, strict=True)
            ),
        ]
        if recipe.min_speed is not None:
            comments["min_speed"] = ["rad/s or m/s: slower samples are left out of the fit of that joint"]
    calibrated_values = {
        "model.base_tilt": ("rad, about x and y", calibration.base_tilt),
        "time_offset": ("s", calibration.time_offset),
        "estimator": ("strength of the prior", calibration.prior_strength),
    }
    comments |= {key: [f"{unit}: {value}"] for key, (unit, value) in calibrated_values.items() if value is not None}
    if calibration.smoother is not None:
        tried = len(calibration.smoother.candidates)
        comments["smoother"] = [f"{tried} were compared by the cross-validated torque error"]
    if recipe.rests == "trim":
        comments["rests"] = ["at the ends; those within as cross-validation says, unless there is a min_speed"]
    return comments


def _list_terms(choice: TermChoice, joint: str) -> str:
    """Return the terms of a joint, with constants and gains of those that were tried."""
    terms = {TERMS.kind_of(term): "" for term in choice.terms if joint in getattr(term, "acts_on", choice.joints)}
    entered = [trial for trial in choice.trials_of(joint) if trial.outcome is TrialOutcome.ENTERED]
    for trial in entered:
        constants = "".join(f"{name} {_setting_text(value)}, " for name, value in trial.settings if value)
        terms[trial.kind] = f" ({constants}gain {number(trial.gain, 3)} +- {number(trial.std, 2)})"
    return ", ".join(f"{kind}{gain}" for kind, gain in terms.items()) or "none"


def _sort_trials(trials: Sequence[TermTrial]) -> list[TermTrial]:
    """Return trials in the order of a reader: those that entered first, then by gain."""
    return sorted(trials, key=lambda trial: (trial.outcome is not TrialOutcome.ENTERED, -trial.gain))


def _trial_table(choice: TermChoice) -> PageTable:
    outcome = Column("outcome", numeric=False, prose=True)
    heads = ("gain, %", "std. error", "on faster motion, %", "std. error", outcome)
    rows = []
    for joint in choice.joints:
        for trial in _sort_trials(choice.trials_of(joint)):
            constants = ", ".join(f"{name} {_setting_text(value)}" for name, value in trial.settings) or "-"
            gains = (number(gain, 3) for gain in (trial.gain, trial.std, trial.faster, trial.faster_std))
            rows.append((joint, trial.kind, constants, *gains, OUTCOMES[trial.outcome]))
    caption = "Gain, in % of the squared cross-validated error of the joint"
    return PageTable.of(("joint", "term", "constants"), heads, rows, caption)


def _setting_text(value: object) -> str:
    if isinstance(value, tuple):
        return " and ".join(map(_setting_text, value))
    return number(value, 3) if isinstance(value, float) else str(value)


def base_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section of the base parameters where the identification has found them."""
    basis = identification.base.on_data
    if basis is None:
        return
    units = [identification.estimate.units[k] for k in basis.independent]
    values = basis.to_base(identification.estimate.value)
    figure = interval_figure(basis.groupings, units, values, base_errors(identification))
    caption = "Base parameters: 95 % intervals (1.96 standard errors to both sides) in % of the values."
    table, intervals = _base_table(identification, basis), Figure(figure, caption)
    note = f"{_BASE} {motion_known(identification)}"
    blocks: tuple[PageBlock, ...] = (table, intervals)
    if basis.rank > MAX_UNFOLDED_PARAMETERS:
        blocks = Fold(table.caption, (table,)), Fold("Their intervals", (intervals,))
    yield PageSection("Base parameters", (note, *blocks))


def base_errors(identification: Identification) -> Array:
    """Return the best known standard errors (r) of the base parameters, NaN where there are none."""
    best, basis = identification.errors.base_std, identification.base.on_data
    return np.full(0 if basis is None else basis.rank, np.nan) if best is None else best


def _base_table(identification: Identification, basis: BaseParameters) -> PageTable:
    robust, plain = identification.errors.allows_correlation, identification.errors.base_std_independent
    values, errors = basis.to_base(identification.estimate.value), base_errors(identification)
    heads: list[Head] = ["value", "std. error", "%"]
    physics = identification.estimate.consistency
    free = physics.unconstrained if physics else None
    unconstrained = values if free is None else basis.to_base(free)
    # A constraint acts on a parameter where it moves the value by a notable part of its standard error
    is_held = np.abs(values - unconstrained) > MIN_SHOWN_SHIFT * errors
    heads += [Column("if independent", muted=True)] * robust + [UNIT]
    heads += [Column("without constraints", muted=True)] * bool(is_held.any())
    rows = []
    for k, lead in enumerate(basis.independent):
        relative = float(relative_std(values[k : k + 1], errors[k : k + 1])[0])
        cells = [basis.groupings[k], number(float(values[k])), number(float(errors[k]), 2), number(relative, 2)]
        cells += [number(None if plain is None else float(plain[k]), 2)] * robust
        cells += [identification.estimate.units[lead]]
        rows.append((*cells, *[number(float(unconstrained[k])) if is_held[k] else ""] * bool(is_held.any())))
    return PageTable.of(("base parameter",), heads, rows, "Base parameters and their values")


def condition_section(identification: Identification) -> PageSection:
    """Return the section of excitation and condition: how the joints moved, and what that determines of the model."""
    basis, estimate = identification.base.on_data, identification.estimate
    meaning, table = excitation_table(identification)
    facts, blocks = [], list[PageBlock]()
    if basis is None:
        facts += [(f"{estimate.determined.rank} of {len(estimate.names)}", "rank on the data")]
        facts += [(number(float(estimate.determined.condition), 3), "condition of the regressor, columns scaled")]
    else:
        values, structural = basis.singular_values, identification.base.structural
        condition = float(values[0] / values[basis.rank - 1]) if basis.rank else float("inf")
        facts += [(f"{basis.rank} of {len(basis.names)}", "rank on the data")]
        facts += [(str(structural.rank), "rank that any motion could show")] if structural else []
        facts += [(number(condition, 3), "condition of the base parameters, columns scaled")]
        facts += [(huge(basis.gap), "gap in the singular values at the rank")]
        blocks.append(Figure(singular_figure(basis), _SINGULAR))
    missing = tuple(map(str, identification.base.unexcited))
    if missing:
        blocks.append(PageSection("What these data do not show", (missing,)))
    return PageSection("Excitation and condition", (Facts(tuple(facts)), meaning, table, *blocks))


def consistency_section(identification: Identification) -> Iterator[PageSection]:
    """Yield the section on physical consistency: the mass matrix, the bodies, and what the constraints cost."""
    consistency = identification.estimate.consistency or Consistency()
    eigenvalues, costs = consistency.eigenvalues, consistency.costs
    blocks: list[PageBlock] = [str(identification.mass)] if identification.mass else []
    if eigenvalues:
        rows = [(body, tiny(float(value), 3)) for body, value in eigenvalues.items()]
        caption = "Smallest eigenvalue of the pseudo-inertia of each body"
        blocks += [_EIGENVALUES, PageTable.of(("body",), ("smallest eigenvalue, scaled",), rows, caption)]
    if costs:
        names = {family: "all together" if family == "all" else family for family in costs}
        rows = [(names[family], number(float(value), 3)) for family, value in costs.items()]
        caption = "What the constraints add to the weighted error of the training data"
        blocks.append(PageTable.of(("constraints",), ("cost, % of the torque",), rows, caption))
    if blocks:
        yield PageSection("Physical consistency", tuple(blocks))
