"""Tables, words and page of an identified servo arm, its numbers for programs, and the files of a result."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.servo.judge import ServoRollout, ServoUse
from dynident.apps.servo.predict import ServoPrediction
from dynident.apps.servo.result import NOT_JUDGED, ServoIdentification, entry_name
from dynident.apps.servo.run import fit_servos
from dynident.files.folder import ResultFolder, refuse_other_report, result_folder
from dynident.files.opener import refuse_inputs
from dynident.files.results import as_path, json_text
from dynident.project.project import Project, read_project
from dynident.project.result_format import SERVO_FORMAT, SERVO_VERSION
from dynident.report import Drawing
from dynident.report.figures import AMBER, BLUE, INK, curve, panels
from dynident.report.page import UNIT, Badge, Beside, Facts, Figure, Fold, Gallery, PageSection, PageTable, render
from dynident.report.page import pair_table as pairs
from dynident.runtime import number

NUMBERS, PAGE, MODEL = "servo.json", "report.html", "robot.xml"
TONES = {ServoUse.GOOD: "good", ServoUse.CARE: "fair", ServoUse.NO: "bad"}
ERRORS = {"whole": "error", "half_second": "window_error", "file": "nominal_error", "noise": "noise"}


def verdict_words(result: ServoIdentification) -> str:
    """Return what the model is good for, with the rollouts that tell it."""
    held_out = [rollout for rollout in result.rollouts if rollout.role == "validation"]
    if result.use is None:
        return f"{NOT_JUDGED[0].upper()}{NOT_JUDGED[1:]}."
    names = ("error", "nominal_error", "noise")
    largest = {name: max(float(getattr(r, name).max()) for r in held_out) for name in names}
    joint_names = ", ".join(result.joints[gap.k].name for gap in result.backlash)
    words = {name: number(1e3 * value, 2) for name, value in largest.items()}
    return (
        f"{result.name}: {result.use}. At the worst joint, held-out rollouts are {words['error']} mrad (mm) from the "
        f"measured positions, {words['nominal_error']} with the values of the robot file; the noise of the positions "
        f"is {words['noise']}." + ("" if not result.backlash else f" Backlash of {joint_names} is not in the model.")
    )


def parameter_table(result: ServoIdentification) -> PageTable:
    """Return the fitted values with their standard errors, beside those of the file."""
    names, rows = [joint.name for joint in result.joints], []
    for entry, value, std, nominal in result.rows():
        texts = number(value, 4), number(std, 2), number(nominal, 4), result.unit(entry)
        rows.append((entry_name(entry, names), *texts))
    title = "Values by which the simulated positions are nearest to the measured ones"
    return PageTable.of(("parameter",), ("value", "std. error", "file", UNIT), rows, title)


def rollout_table(result: ServoIdentification | ServoPrediction) -> PageTable:
    """Return the errors of rollouts by recording and joint, in mrad or mm."""
    rows = [
        (r.log.name, r.role, joint.name, *(number(1e3 * float(getattr(r, name)[k]), 3) for name in ERRORS.values()))
        for r in result.rollouts
        for k, joint in enumerate(result.joints)
    ]
    title = "Errors of rollouts (root mean squares), mrad or mm"
    return PageTable.of(("recording", "role", "joint"), ("whole", "0.5 s", "file, whole", "noise"), rows, title)


def suspect_lines(result: ServoIdentification) -> tuple[str, ...]:
    """Return what of the given values the logs contradict."""
    names, fit = [joint.name for joint in result.joints], result.fit
    stds = dict(zip(fit.entries, fit.std, strict=True))
    return tuple(
        f"{entry_name(entry, names)}: {number(result.nominal.entry(entry), 4)} was given, but the logs say "
        f"{number(fit.values.entry(entry), 4)} +- {number(float(stds[entry]), 2)}, which is used; look why."
        for entry in result.suspects
    )


def servo_page(result: ServoIdentification) -> str:
    """Return the result as one HTML page."""
    use, fit = result.use, result.fit
    badge = Badge(str(use or NOT_JUDGED), TONES[use] if use else "fair")  # type: ignore[arg-type]
    largest = f"{number(1e3 * float(fit.scale.max()), 2)} mrad", "largest error of a joint in training"
    delay = f"{number(1e3 * fit.values.delay)} ms", "from command to position"
    facts = Facts((delay, largest, (f"{len(fit.entries)}", "values fitted")))
    judged = [rollout for rollout in result.rollouts if rollout.role == "validation"] or result.rollouts
    worst = max(judged, key=lambda rollout: float(rollout.error.max()))
    k = int(worst.error.argmax())
    caption = f"The worst joint: {result.joints[k].name} on {worst.log.name}."
    picture = Figure(_drawing(worst, k, bool(fit.values.takes_torque[k])), caption)
    views = []
    for r in sorted(result.rollouts, key=lambda r: r.role != "validation"):
        for k, (joint, is_torque) in enumerate(zip(result.joints, fit.values.takes_torque.tolist(), strict=True)):
            figure = Figure(_drawing(r, k, is_torque), "" if is_torque else "The command acts late.")
            views.append(((f"{r.log.name} ({r.role})", joint.name), (figure,)))
    notes = (*suspect_lines(result), *result.warnings)
    method = (
        "The arm is simulated in MuJoCo from the first sample of each recording, driven by the commands; "
        "standard errors count that residuals are correlated over time. A delay of the command and one of the position "
        "act alike: it is their sum. An error of kp that no gravity or inertia shows is in all values of the joint."
    )
    sections = [
        PageSection("Verdict", (Beside((verdict_words(result), facts), (picture,)),), badge),
        PageSection("Warnings", (notes or "None.",)),
        PageSection("Values", (parameter_table(result), method)),
        PageSection(
            "Rollouts beside the measurement", (Gallery(("recording", "joint"), tuple(views)), rollout_table(result))
        ),
        PageSection("Files", (Fold("SHA-256 of the files read", (pairs("file", list(result.hashes.items())),)),)),
    ]
    lead = f"{len(result.joints)} servos, identified from commands and positions; {MODEL} is the model."
    return render(f"Servos of {result.name}", lead, sections)


def _drawing(rollout: ServoRollout, k: int, is_torque: bool) -> Drawing:
    """Draw a joint's rollout beside its positions, and commands unless these are torques, and the errors below."""
    log = rollout.log
    t = log.t - log.t[0]
    figure = panels(["position, rad or m", "error, mrad or mm"], 420, heights=[2.0, 1.0])
    lines = [(log.q[:, k], "measured", INK), (rollout.simulated[:, k], "simulated", BLUE)]
    lines[:0] = [] if is_torque else [(np.interp(log.t, log.sent, log.command[:, k]), "command", AMBER)]
    for series, name, colour in lines:
        figure.add(curve(t, series, name, {"color": colour, "width": 1.5}, 600))
    difference = 1e3 * (rollout.simulated[:, k] - log.q[:, k])
    figure.add(curve(t, difference, "simulated less measured", {"color": BLUE, "width": 1}, 600), 2)
    return figure


def servo_dict(result: ServoIdentification) -> dict[str, Any]:
    """Return the numbers of a result for programs; ``low`` and ``high`` hold 95 %, as for domain randomisation."""
    rollouts = [
        {"name": r.log.name, "role": r.role} | {key: getattr(r, name) for key, name in ERRORS.items()}
        for r in result.rollouts
    ]
    return {
        "format": SERVO_FORMAT, "version": SERVO_VERSION,
        "robot": result.name, "use": None if result.use is None else str(result.use),
        "joints": [joint.name for joint in result.joints], "parameters": result.parameters(), "rollouts": rollouts,
        "backlash": [
            {"joint": result.joints[gap.k].name, "size": gap.size, "at": "output" if gap.output else "motor"}
            for gap in result.backlash
        ],
        "converged": result.fit.converged, "written_model_difference": result.difference,
        "warnings": [*suspect_lines(result), *result.warnings], "files": result.hashes,
        "configuration": result.configuration and {
            "path": result.configuration.path, "text": result.configuration.text
        },
        "commands_held": result.held,
    }  # fmt: skip


def identify_servos(config: str | Path | Project, out: str | Path | ResultFolder | None = None) -> ServoIdentification:
    """Identify the arm of servos that a configuration (YAML) describes, by simulating it in MuJoCo.

    Into the folder ``out`` are written ``robot.xml``, the model of MuJoCo with the fitted values, ``servo.json``, for
    ``dynident predict`` and ``dynident export``, and ``report.html``.

    Raises ConfigError where the configuration is not of that kind, or the folder holds the report of another command,
    ModelError where MuJoCo is not installed or cannot simulate the file, InputError where a log cannot be used.

    >>> import dynident as dy
    >>> result = dy.identify_servos("arm.yaml", "arm-out")  # doctest: +SKIP
    >>> result.use, result.frame()  # doctest: +SKIP
    """
    project = config if isinstance(config, Project) else read_project(config)
    if out is None:
        return fit_servos(project)
    with nullcontext(out) if isinstance(out, ResultFolder) else result_folder(as_path(out)) as folder:
        refuse_other_report(folder.path, NUMBERS)
        refuse_inputs(*(folder.path / name for name in (MODEL, NUMBERS, PAGE)))
        result = fit_servos(project)
        folder.replace({MODEL: result.mjcf, NUMBERS: json_text(servo_dict(result)), PAGE: servo_page(result)})
    return result
