"""What is to be said of a servo configuration and its recordings before they are fitted."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dynident.apps.servo.commands import command_findings, limit_findings
from dynident.apps.servo.plant import ServoLog
from dynident.apps.servo.run import load_servos, read_servo_logs
from dynident.apps.servo.start import MAX_DELAY, SmoothLog, smooth_servo_log, start_values
from dynident.apps.servo.values import ServoValues
from dynident.checks import CheckResult, timing
from dynident.motion.log import Log
from dynident.project.drive_settings import ServoSettings
from dynident.project.project import Project
from dynident.runtime import DynidentError, Finding, Remark, Severity, number

MIN_RATE = 25.0  # Hz


def examine_servos(project: Project) -> CheckResult:
    """Return what is found in the recordings of an arm of servos: their rate and gaps, servos at their limits, and
    how late commands act. What cannot be used is an error among the findings."""
    findings = [Finding(Remark(text), source=project.path.name) for text in project.warnings]
    logs: Mapping[str, Sequence[ServoLog]] = {}
    try:
        logs, warnings = read_servo_logs(project)
        findings += [Finding(Remark(text)) for text in warnings]
        arm = load_servos(project)
        motions = [smooth_servo_log(log) for role in logs for log in logs[role]]
        train = motions[: len(logs["train"])]
        findings += command_findings(motions, arm.plant.joints, arm.nominal.takes_torque)
        settings = project.config.simulation
        is_free = isinstance(settings, ServoSettings) and settings.delay == "estimate"
        values = start_values(arm.plant, train, arm.nominal, free_delay=is_free)
        findings += [
            *_rate_findings(motions),
            *limit_findings(arm.plant.joints, motions, values),
            _delay_finding(values),
        ]
        if not logs["validation"]:
            words = "no recording is held out, so that the model will not be judged; name one under `validation`"
            findings.append(Finding(Remark(words)))
    except DynidentError as error:
        findings.append(Finding(Remark(str(error)), severity=Severity.ERROR))
    names = tuple(joint.name for joint in project.model.joints)
    tables = [Log(log.t, log.q, np.zeros_like(log.q), names, log.name) for role in logs for log in logs[role]]
    findings.sort(key=lambda finding: list(Severity).index(finding.severity))
    return CheckResult(tuple(findings), {log.source: timing(log) for log in tables})


def _rate_findings(motions: Sequence[SmoothLog]) -> Iterator[Finding]:
    for motion in motions:
        rate = 1 / float(motion.t[1] - motion.t[0])
        if rate < MIN_RATE:
            words = f"{number(rate, 2)} Hz shows little of armature and delay; record at {MIN_RATE:g} Hz or faster"
            yield Finding(Remark(words), source=motion.log.name)


def _delay_finding(values: ServoValues) -> Finding:
    words = f"positions follow their commands after about {number(1e3 * values.delay, 2)} ms"
    if values.delay > 0.9 * MAX_DELAY:
        return Finding(Remark(f"{words}, the longest delay that is searched; are commands and positions in step?"))
    return Finding(Remark(words), severity=Severity.INFO)
