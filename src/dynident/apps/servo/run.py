"""From a configuration of a servo arm to its identified model: logs, fit, suspects, rollouts and files."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from dynident.apps.servo.backlash import Backlash, find_backlash
from dynident.apps.servo.commands import command_findings, limit_findings
from dynident.apps.servo.fit import ServoFit, fit_values, split_into_windows, suspect_entries
from dynident.apps.servo.judge import position_noise, roll_out
from dynident.apps.servo.plant import ServoLog, ServoPlant, import_mujoco
from dynident.apps.servo.result import ServoIdentification, entry_name
from dynident.apps.servo.robot import MAX_ROLLOUT_DIFFERENCE, load_plant, mjcf_text, rollout_difference, write_mjcf
from dynident.apps.servo.start import MAX_DELAY, SmoothLog, smooth_servo_log, start_values
from dynident.apps.servo.values import FRICTION, Entry, Quantity, ServoValues
from dynident.checks import check_log
from dynident.files.tables import DataTable
from dynident.models import Joint
from dynident.project.config import model_file
from dynident.project.drive_settings import ServoSettings
from dynident.project.logs import read_recording, read_unchecked, turning_joints
from dynident.project.project import Project, log_files
from dynident.project.settings import Config, LogSpec, RobotSettings, check_joints
from dynident.runtime import ConfigError, ModelError, Severity, number, report_progress, require
from dynident.runtime.arrays import Array

MAX_NOISE_RATIO = 1.3  # of residuals to noise, beyond which another kind of commands is tried
MAX_ROUNDS = 2  # of testing what is given and fitting it too


@dataclass(frozen=True)
class ServoArm:
    """A robot file as it is simulated: its ``text`` as an MJCF, the ``plant``, and its ``nominal`` values."""

    robot: RobotSettings
    settings: ServoSettings
    source: str
    text: str
    plant: ServoPlant
    nominal: ServoValues

    def beside(self, values: ServoValues) -> ServoValues:
        """Return the file's values to compare with: with the delay that was found, and the kp that it does not say."""
        kp = np.where(np.isnan(self.nominal.kp), values.kp, self.nominal.kp)
        return replace(self.nominal, delay=values.delay, kp=kp)

    def with_gaps(self, ks: Sequence[int]) -> ServoPlant:
        """Return the plant with gaps behind some joints."""
        names = self.plant.joints
        return load_plant(self.robot, self.text, names, self.source, [names[k] for k in ks])


def load_servos(project: Project) -> ServoArm:
    """Return the arm of a configuration; ConfigError where it is not of that kind, else as ``fit_servos``."""
    settings, robot = project.config.simulation, project.config.model
    path = model_file(robot, project.path.parent)
    if not isinstance(settings, ServoSettings) or not isinstance(robot, RobotSettings) or path is None:
        raise ConfigError("a servo arm has a robot file as its `model` and `simulation: { kind: servo }`.")
    check_joints(project.config, project.model.joints)
    text = mjcf_text(path)
    plant = load_plant(robot, text, [joint.name for joint in project.model.joints], path.name)
    return ServoArm(robot, settings, path.name, text, plant, nominal_values(plant, settings))


def fit_servos(project: Project) -> ServoIdentification:
    """Identify the arm of servos that a configuration describes, by simulating it in MuJoCo.

    Raises ConfigError where the configuration is not of that kind, ModelError where MuJoCo is not installed or cannot
    simulate the file, InputError where a log cannot be used.
    """
    import_mujoco()
    arm = load_servos(project)
    config, joints, plant, nominal = project.config, project.model.joints, arm.plant, arm.nominal
    settings = arm.settings
    logs, remarks = read_servo_logs(project)
    motions = {role: [smooth_servo_log(log) for log in logs[role]] for role in logs}
    findings = command_findings([x for role in motions.values() for x in role], plant.joints, nominal.takes_torque)
    warnings = [*project.warnings, *remarks, *map(str, findings)]
    report_progress("looking for the delay")
    fitted, fit, suspects = choose_fit(plant, motions["train"], nominal, settings)
    held = fitted[0].log.held
    noise = np.max([position_noise(motion.log.q) for motion in fitted], axis=0)
    gaps = find_backlash(arm.with_gaps, fitted, fit, noise)
    motions = {role: [motion if held else interpolate_commands(motion) for motion in motions[role]] for role in motions}
    if not held and settings.commands == "estimate":
        warnings.append("commands are interpolated: so the positions are explained better than if each is held.")
    report_progress("simulating all recordings")
    before = arm.beside(fit.values)
    rollouts = tuple(roll_out(plant, motion, role, fit.values, before) for role in motions for motion in motions[role])
    mjcf = write_mjcf(arm.text, plant, fit.values)
    difference = rollout_difference(arm.robot, mjcf, plant, fit.values, motions["train"][0].log, arm.source)
    if difference > MAX_ROLLOUT_DIFFERENCE:
        words = f"{arm.source}: as written with the fitted values it moves differently, by {difference:.2g}."
        if fit.converged:
            raise ModelError(words)
        warnings.append(words)  # without damping, say, the digits of the values grow to that
    at_limits = limit_findings(plant.joints, [x for role in motions.values() for x in role], fit.values)
    warnings += [*map(str, at_limits), *_backlash_warnings(gaps, joints), *_fit_warnings(fit, plant)]
    files = [file for file in (project.sources.configuration, project.sources.model, *log_files(config)) if file]
    hashes = {file.path: file.sha256 for file in files}
    return ServoIdentification(
        project.model.name, joints, fit, before, suspects, gaps, rollouts, mjcf, difference, tuple(warnings), hashes,
        project.sources.configuration, held,
    )  # fmt: skip


def nominal_values(plant: ServoPlant, settings: ServoSettings) -> ServoValues:
    """Return the values of the robot file, with the gains and limits of the configuration."""
    servos, model = [settings.joints[name] for name in plant.joints], plant.model
    ones = np.ones(len(servos))
    # an actuator that pulls to its command has the same gain on both, others say nothing of kp
    gain, pull = model.actuator_gainprm[plant.actuators, 0], -model.actuator_biasprm[plant.actuators, 1]
    file_kp = np.where(np.isclose(gain, pull) & (gain > 0), gain * plant.gear**2, np.nan)
    kp = [kp if servo.kp == "estimate" else servo.kp or 0.0 for servo, kp in zip(servos, file_kp, strict=True)]
    return ServoValues(
        armature=model.dof_armature[plant.dofs].copy(),
        damping=model.dof_damping[plant.dofs].reshape(len(servos), -1)[:, 0].copy(),
        frictionloss=model.dof_frictionloss[plant.dofs].copy(),
        kp=np.array(kp, dtype=float),
        kd=np.array([servo.kd for servo in servos], dtype=float),
        limit=np.array([servo.limit or np.inf for servo in servos], dtype=float),
        offset=0 * ones,
        command_offset=0 * ones,
        mass=ones,
        delay=0.0 if settings.delay == "estimate" else settings.delay,
    )


def choose_fit(
    plant: ServoPlant, motions: Sequence[SmoothLog], nominal: ServoValues, settings: ServoSettings
) -> tuple[Sequence[SmoothLog], ServoFit, tuple[Entry, ...]]:
    """Return the recordings as they were fitted, the fit, and what was given but fitted too, as they contradict it."""
    free_delay = settings.delay == "estimate"
    free_kp = [settings.joints[name].kp == "estimate" for name in plant.joints]
    start = start_values(plant, motions, nominal, free_delay=free_delay)
    joints = range(len(plant.joints))
    entries = [Entry(quantity, k) for quantity in FRICTION for k in joints]
    entries += [Entry(Quantity.KP, k) for k in joints if free_kp[k]]
    entries += [Entry(Quantity.DELAY, 0)] if free_delay else []
    motions, fit = fit_windows(plant, motions, start, entries)
    # the simulation misses positions by clearly more than their noise
    is_unexplained = (fit.scale > MAX_NOISE_RATIO * position_noise(motions[0].log.q)).any()
    if settings.commands == "estimate" and is_unexplained:
        motions, fit = _try_interpolated(plant, motions, nominal, fit)
    suspects: list[Entry] = []
    for _ in range(MAX_ROUNDS):
        report_progress("testing what is given")
        proposed = suspect_entries(plant, motions, fit)
        if not proposed:
            break
        suspects += proposed
        values = fit.values.changed(list(proposed), list(proposed.values()))
        motions, fit = fit_windows(plant, motions, values, (*fit.entries, *proposed))
    return motions, fit, tuple(suspects)


def fit_windows(
    plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues, entries: Sequence[Entry]
) -> tuple[Sequence[SmoothLog], ServoFit]:
    """Return recordings and fit from ``values``: in windows where torques are commanded, whose states are renewed."""
    if not values.takes_torque.any():
        return motions, fit_values(plant, motions, values, entries)
    for _ in range(2):
        windows = [split_into_windows(plant, motion, values) for motion in motions]
        fit = fit_values(plant, windows, values, entries)
        values = fit.values
    return windows, fit


def _try_interpolated(
    plant: ServoPlant, motions: Sequence[SmoothLog], nominal: ServoValues, fit: ServoFit
) -> tuple[Sequence[SmoothLog], ServoFit]:
    """Return recordings and fit with commands that are interpolated, where these explain the positions better."""
    report_progress("trying interpolated commands")
    lines: Sequence[SmoothLog] = [interpolate_commands(motion) for motion in motions]
    # from the beginning: values that were fitted to other commands may be at their limits
    start = start_values(plant, lines, nominal, free_delay=Entry(Quantity.DELAY, 0) in fit.entries)
    lines, other = fit_windows(plant, lines, start, fit.entries)
    return (lines, other) if np.log(other.scale).sum() < np.log(fit.scale).sum() else (motions, fit)


def interpolate_commands(motion: SmoothLog) -> SmoothLog:
    """Return a recording whose commands are interpolated."""
    return replace(motion, log=replace(motion.log, held=False))


def _backlash_warnings(gaps: Sequence[Backlash], joints: Sequence[Joint]) -> Iterator[str]:
    """Yield what is to be said of gaps."""
    for gap in gaps:
        joint, place = joints[gap.k], "in front of" if gap.output else "behind"
        unit = "mm" if joint.kind == "prismatic" else "mrad"
        yield (
            f"joint {joint.name!r} has about {number(1e3 * gap.size, 2)} {unit} of backlash {place} its encoder, which "
            "is not in the model: add it to your simulation, or mend the gear."
        )


def _fit_warnings(fit: ServoFit, plant: ServoPlant) -> Iterator[str]:
    """Yield what is to be said of a fit."""
    if not fit.converged:
        yield "the search has not converged: the values may be off by more than their errors."
    for entry in fit.vanished:
        yield f"{entry_name(entry, plant.joints)} is driven to zero: another law, mass or gain may stand for it."
    if fit.values.delay > 0.9 * MAX_DELAY:
        yield f"a delay of {fit.values.delay:.3g} s is long; are commands and positions in step?"
    if fit.values.delay == 0 and Entry(Quantity.DELAY, 0) in fit.entries:
        yield "no delay is seen, or a negative one: are commands stamped later than positions?"
    for group in fit.undetermined:
        names = [entry_name(entry, plant.joints) for entry in group]
        yield f"the logs do not tell apart: {', '.join(names)}; record faster and slower motions, or give one of them."


def read_servo_logs(project: Project) -> tuple[dict[str, list[ServoLog]], tuple[str, ...]]:
    """Read all recordings with their commands by role ("train", "validation"), and warnings on their positions.

    Raises ConfigError where there are no servos, and InputError where a recording cannot be used.
    """
    config, joints, warnings = project.config, project.model.joints, list[str]()
    if not isinstance(config.simulation, ServoSettings):
        raise ConfigError("simulation: the recordings of servos need `kind: servo`.")
    logs: dict[str, list[ServoLog]] = {}
    for role in ("train", "validation"):
        logs[role], remarks = _servo_logs(getattr(config, role), config, config.simulation, joints)
        warnings += remarks
    return logs, tuple(warnings)


def _servo_logs(
    specs: Sequence[LogSpec], config: Config, settings: ServoSettings, joints: Sequence[Joint]
) -> tuple[list[ServoLog], list[str]]:
    """Return recordings with their commands, and warnings on their positions."""
    servos = settings.joints.items()
    # commands are read as positions of their own, in full: those before a window act in it
    takes_torque = np.array([settings.joints[joint.name].kp is None for joint in joints])
    efforts = {joint.name: joint.effort for joint in joints}
    # each joint has a channel of both kinds, of which one is its command
    updates = {
        "position": {name: config.position[name] if servo.kp is None else servo.command for name, servo in servos},
        "torque": {
            name: servo.command.model_copy(update={} if servo.kp is None else {"unit": efforts[name], "gain": 0.0})
            for name, servo in servos
        },
        "gaps": "split",
        "time": config.time.model_copy(update={"spacing": "stamps"}),
    }
    command_config = config.model_copy(update=updates)
    logs, warnings = list[ServoLog](), list[str]()
    for spec in specs:
        report_progress(f"reading {spec.label}")
        reading = read_unchecked(spec, config, joints, read_recording, torque=False)
        full = spec.model_copy(update={"window": (), "exclude": ()})
        pieces = read_unchecked(full, command_config, joints, partial(_read_commands, settings), torque=False).logs
        t = np.concatenate([piece.t for piece in pieces])
        command = np.vstack([np.where(takes_torque, piece.tau, piece.q) for piece in pieces])
        warnings += reading.warnings
        for log in reading.logs:
            kinds = {joint.name: joint.kind for joint in joints}
            findings = check_log(log, kinds, turning_joints(config), torque=False)
            require(findings, log.source)
            # counts of an encoder are seen by the fit, whose residuals they are
            shown = (f for f in findings if f.severity is Severity.WARNING and f.message.topic != "quantised")
            warnings += [str(replace(finding, source=log.source)) for finding in shown]
            logs.append(
                ServoLog(log.source, log.t, log.q, _spaced(t, log.t), command, settings.commands != "interpolated")
            )
    return logs, warnings


def _read_commands(settings: ServoSettings, spec: LogSpec, needed: Collection[str]) -> DataTable:
    """Return the table of a recording; InputError with the place in the configuration for a command that is missing."""
    table = read_recording(spec, needed)
    for name, servo in settings.joints.items():
        for column in servo.command.terms:
            table.column(column, f"simulation.joints.{name}.command")
    return table


def _spaced(sent: Array, t: Array) -> Array:
    """Return the stamps of commands (M); those of rows whose positions were spaced evenly, at ``t`` (N), as these."""
    first = int(np.argmin(np.abs(sent - t[0])))
    rows = slice(first, first + len(t))
    spaced = sent.copy()
    if len(sent[rows]) == len(t) and np.abs(sent[rows] - t).max() < np.median(np.diff(t)) / 2:
        spaced[rows] = t
    return np.sort(spaced)
