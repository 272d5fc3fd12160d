"""Payloads from and to files: recordings by name, ``payload.json``, the gains in it, and a URDF with the payload."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.payload.body import Component, SameRecording
from dynident.apps.payload.estimate import ArmEvidence, DriveGains
from dynident.apps.payload.payload import Payload
from dynident.files.opener import real_path, remember_inputs
from dynident.files.tables import recording_parts
from dynident.identification import Identification, Sources
from dynident.models import RigidBodies
from dynident.motion.log import Log
from dynident.project.config import fingerprint, parse_config
from dynident.project.export import (
    IdentifiedModel,
    check_payload_link,
    identified_urdf,
    relocate_urdf,
    with_payload_link,
)
from dynident.project.saved import load, read_log_like, result_values
from dynident.runtime import InputError, ModelError, report_progress

FORMAT, VERSION = "dynident payload", 1
NUMBERS = "payload.json"
REQUESTED = ("known_mass", "known_centre", "gain_error", "gain_change", "friction_change", "load_friction", "removed")


def read_loaded(
    identification: Identification, texts: Sequence[str], *, allow_code: bool = False
) -> tuple[dict[str, Log] | Identification, tuple[str, ...]]:
    """Return the recordings with the payload, named on a command line, or the second result where one is named; and
    what reading warns of. Raises InputError where both are named, and the errors of ``load`` and ``payload_logs``."""
    results = [text for text in texts if text.lower().endswith(".json")]
    if not results:
        logs, _, warnings = payload_logs(identification, texts, allow_code=allow_code)
        return logs, warnings
    if len(texts) > 1:
        raise InputError(f"{results[0]}: is a result; give one result, or recordings alone.")
    return read_arm(results[0], allow_code=allow_code), ()


def read_arm(path: str | Path, *, allow_code: bool = False) -> Identification:
    """Return a result that can be compared; InputError where it lacks the covariance that this takes, and the errors of
    ``load``."""
    identification = load(path, allow_code=allow_code)
    ArmEvidence.of(identification, str(path))
    return identification


def payload_logs(
    identification: Identification, texts: Sequence[str], *, allow_code: bool = False, new: bool = False
) -> tuple[dict[str, Log], tuple[SameRecording, ...], tuple[str, ...]]:
    """Return recordings named on a command line by name, notes on those left out, and what reading warns of.

    ``new``: those that the result was fitted to are left out, as they count there. Raises InputError where torques are
    missing, or one with the payload was fitted to without it, and the errors of ``read_log_like``.
    """
    fitted_files = _training_files(identification, allow_code) if texts else set()
    logs, notes, warnings = dict[str, Log](), [], list[str]()
    for text in texts:
        files = [part.rpartition("=")[2] for part in text.split(",")]
        for file in files:
            remember_inputs(file)
        # a log that the result was fitted to is not independent of it
        if all(not fitted_files.isdisjoint(_identities(Path(file))) for file in files):
            if not new:
                raise InputError(f"{text}: the result was made from it; name a recording that differs by the payload.")
            notes.append(SameRecording(text))
            continue
        report_progress(f"reading {text}")
        reading = read_log_like(identification, text, allow_code=allow_code)
        if not reading.measured:
            raise InputError(f"{text}: has no torques; a payload is seen by the torque alone.")
        warnings += reading.warnings
        for log in reading.logs:
            logs[_unused_name(log.source, logs)] = log
    return logs, tuple(notes), tuple(warnings)


def _identities(file: Path) -> tuple[str, ...]:
    """Return the path of a file and, where it is one, its SHA-256, by which it is known where it was moved."""
    return str(real_path(file)), *([fingerprint(file)] if file.is_file() else [])


def _training_files(identification: Identification, allow_code: bool) -> set[str]:
    """Return path and SHA-256 of the recordings that a result was fitted to; not those that were held out."""
    configuration = identification.provenance.configuration
    if configuration is None:
        return set()
    folder = Path(configuration.path).parent
    config = parse_config(configuration.text, folder, configuration.path, allow_code=allow_code)
    files = set()
    for path in (path for spec in config.train for path in spec.file.values()):
        with suppress(InputError):  # recordings that are no longer there
            files |= {str(real_path(file)) for file in recording_parts(path)}
    return files | {file.sha256 for file in identification.provenance.logs if file.path in files and file.sha256}


def _unused_name(name: str, logs: Mapping[str, Log]) -> str:
    names = chain([name], (f"{name} ({k})" for k in count(2)))
    return next(candidate for candidate in names if candidate not in logs)


def read_gains(path: Path) -> DriveGains:
    """Return the gains of the drives in the ``payload.json`` of a known mass; InputError where there are none."""
    name = "payload.json of `dynident payload`"
    data = result_values(path, name)
    if data.get("format") != FORMAT or data.get("version") != VERSION:
        raise InputError(f"{path}: is not a {name}.")
    try:
        gains = data["gains"]
        n, mass = len(gains["joints"]), gains["known_mass"]
        factor, covariance = np.array(gains["factor"], dtype=float), np.array(gains["covariance"], dtype=float)
        joints = tuple(map(str, gains["joints"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: its gains cannot be read ({error}); run `dynident payload` again.") from error
    if not mass:
        raise InputError(
            f"{path}: its payload had no known mass, so it does not tell the gains; use --known-mass there."
        )
    # a file that was edited or damaged: wrong shapes, gains that are not positive, or no covariance
    is_complete = factor.shape == (n,) and covariance.shape == (n, n) and np.isfinite(covariance).all()
    if not is_complete or not (factor > 0).all() or not np.linalg.eigvalsh(covariance)[0] > -1e-12:
        raise InputError(f"{path}: its gains are damaged; run `dynident payload` again.")
    return DriveGains(joints, factor, covariance, float(mass))


def payload_data(payload: Payload, sources: Sources, words: Sequence[str]) -> dict[str, Any]:
    """Return a payload as plain values, with its notes in words; of one that is not seen, only the mass."""
    is_shown = [payload.is_significant or entry is Component.MASS for entry in Component]
    body, request, gains = payload.body, payload.request, payload.gains
    return {
        "format": FORMAT,
        "version": VERSION,
        "frame": payload.mount.frame,
        "body": payload.mount.body,
        "seen": payload.is_significant,
        "payload": [
            {"name": name, "value": value if show else None, "std": std if show else None, "unit": name.unit}
            for name, value, std, show in zip(Component, body.values, body.std, is_shown, strict=True)
        ],
        "parameters": {"value": payload.value, "unconstrained": payload.free, "covariance": payload.covariance},
        "shares": {source.value: share for source, share in payload.shares.items()},
        "gains": {
            "joints": gains.joints, "factor": gains.factor, "std": gains.std, "correction": gains.correction,
            "covariance": gains.covariance, "known_mass": gains.known_mass or None,
        },
        "request": {name: getattr(request, name) for name in REQUESTED},
        "factor": payload.factor,
        "torque": [asdict(entry) for entry in payload.logs],
        "notes": list(words),
        "provenance": asdict(sources),
    }  # fmt: skip


def payload_name(identification: Identification) -> str:
    """Return the name of the URDF with a payload, after the robot file."""
    robot = identification.provenance.model
    return f"{'robot' if robot is None else Path(robot.path).name.split('.')[0]}_payload.urdf"


def payload_urdf(identification: Identification, payload: Payload, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return the URDF of the identified arm with the payload as a link, for a folder, and what to say of it.

    Where the result cannot be written as a URDF, the arm has the inertias of its file. Raises ModelError where that is
    none, no payload is seen, or the text, loaded again, has another torque.
    """
    if not payload.is_significant:
        raise ModelError("no payload is seen")
    bodies = next(term for term in identification.model.terms if isinstance(term, RigidBodies))
    if bodies.format != "urdf":
        raise ModelError(f"{bodies.source}: it is an MJCF; a payload is written into a URDF.")
    notes: tuple[str, ...] = ()
    # the identified inertias where a URDF can hold them, else those of the file
    try:
        before = identified_urdf(IdentifiedModel(identification.model, identification.estimate.value)).text
    except ModelError as error:
        before, notes = bodies.xml, (f"the arm has the inertias of its file there: {str(error).rstrip('.')}",)
    body = payload.body
    after = with_payload_link(before, payload.mount.frame, body.mass, body.centre, body.tensor)
    # the change of the bodies' parameters by the payload, to prove that the link adds just this
    columns = identification.model.parameter_slices[identification.model.terms.index(bodies)]
    added = (payload.mount.transform @ payload.value)[columns]
    check_payload_link(before, after, bodies, added)
    return relocate_urdf(after, identification.provenance, folder), notes
