"""Payloads from and to files: recordings by name, ``payload.json``, the gains in it, and a URDF with the payload."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from dynident.errors import InputError, ModelError
from dynident.export import Identified, check_payload_link, identified_urdf, relocated, with_payload_link
from dynident.identification import Identification, Sources
from dynident.io.config import parse_config
from dynident.io.fields import is_deep
from dynident.io.folder import refuse_other_report
from dynident.io.opener import content, keep, real
from dynident.io.recording_parts import recording_parts
from dynident.io.saved import load, read_log_like
from dynident.log import Log
from dynident.models import RigidBodies
from dynident.payload import Component, DriveGains, Evidence, Payload, SameRecording

__all__ = [
    "FORMAT", "NUMBERS", "check_places", "payload_data", "payload_logs", "payload_name", "payload_urdf", "read_arm",
    "read_gains", "read_loaded",
]  # fmt: skip

FORMAT, VERSION = "dynident payload", 1
NUMBERS = "payload.json"
REQUESTED = ("known_mass", "known_centre", "gain_error", "friction_change", "load_friction", "removed")
WEIGHT = 30  # memory of the content of JSON, per byte of its text


def read_loaded(
    found: Identification,
    texts: Sequence[str],
    *,
    allow_code: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[dict[str, Log] | Identification, tuple[str, ...]]:
    """Return the recordings with the payload, named on a command line, or the second result where one is named; and
    what reading warns of. Raises InputError where both are named, and the errors of ``load`` and ``payload_logs``."""
    results = [text for text in texts if text.lower().endswith(".json")]
    if not results:
        logs, _, warnings = payload_logs(found, texts, allow_code=allow_code, say=say)
        return logs, warnings
    if len(texts) > 1:
        raise InputError(f"{results[0]}: is a result; give one result, or recordings alone.")
    return read_arm(results[0], allow_code=allow_code), ()


def read_arm(path: str | Path, *, allow_code: bool = False) -> Identification:
    """Return a result that can be compared; InputError where it lacks the covariance that this takes, and the errors of
    ``load``."""
    found = load(path, allow_code=allow_code)
    Evidence.of(found, str(path))
    return found


def check_places(loaded: Sequence[str], unloaded: Sequence[str], out: Path | None) -> None:
    """Raise InputError where a recording is named as with and without the payload, ConfigError where ``out`` holds the
    report of another command, such as that of the result."""
    for text in loaded:
        if text in unloaded:
            raise InputError(f"{text}: is named as a recording with the payload and as one without; name it once.")
    if out is not None:
        refuse_other_report(out, NUMBERS)


def payload_logs(
    found: Identification,
    texts: Sequence[str],
    *,
    allow_code: bool = False,
    new: bool = False,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[dict[str, Log], tuple[SameRecording, ...], tuple[str, ...]]:
    """Return recordings named on a command line by name, notes on those left out, and what reading warns of.

    ``new``: those that the result was fitted to are left out, as they count there. Raises InputError where torques are
    missing, or one with the payload was fitted to without it, and the errors of ``read_log_like``.
    """
    known = _fitted(found, allow_code) if texts else set()
    logs, notes, warnings = dict[str, Log](), [], list[str]()
    for text in texts:
        files = [part.rpartition("=")[2] for part in text.split(",")]
        for file in files:
            keep(file)
        if all(str(real(Path(file))) in known for file in files):
            if not new:
                raise InputError(f"{text}: the result was made from it; name a recording that differs by the payload.")
            notes.append(SameRecording(text))
            continue
        say(f"reading {text}")
        reading = read_log_like(found, text, allow_code=allow_code)
        if not reading.measured:
            raise InputError(f"{text}: has no torques; a payload is seen by the torque alone.")
        warnings += reading.warnings
        for log in reading.logs:
            logs[_unused(log.source, logs)] = log
    return logs, tuple(notes), tuple(warnings)


def _fitted(found: Identification, allow_code: bool) -> set[str]:
    """Return the files of the recordings that a result was fitted to; not those that were held out."""
    given = found.provenance.configuration
    if given is None:
        return set()
    config = parse_config(given.text, Path(given.path).parent, given.path, allow_code=allow_code)
    files = set()
    for path in (path for spec in config.train for path in spec.file.values()):
        with suppress(InputError):  # recordings that are no longer there
            files |= {str(real(file)) for file in recording_parts(path)}
    return files


def _unused(name: str, logs: Mapping[str, Log]) -> str:
    return next(one for one in (name, *(f"{name} ({k})" for k in range(2, 10**6))) if one not in logs)


def read_gains(path: Path) -> DriveGains:
    """Return the gains of the drives in the ``payload.json`` of a known mass; InputError where there are none."""
    try:
        data = json.loads(content(path, InputError, (".json",), WEIGHT))
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: is not a payload.json of `dynident payload` ({error}).") from error
    if not isinstance(data, dict) or is_deep(data) or data.get("format") != FORMAT or data.get("version") != VERSION:
        raise InputError(f"{path}: is not a payload.json of `dynident payload`.")
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
    whole = factor.shape == (n,) and covariance.shape == (n, n) and np.isfinite(covariance).all()
    if not whole or not (factor > 0).all() or not np.linalg.eigvalsh(covariance)[0] > -1e-12:
        raise InputError(f"{path}: its gains are damaged; run `dynident payload` again.")
    return DriveGains(joints, factor, covariance, float(mass))


def payload_data(found: Payload, sources: Sources, words: Sequence[str]) -> dict[str, Any]:
    """Return a payload as plain values, with its notes in words; of one that is not seen the mass alone."""
    shown = [found.seen or one is Component.MASS for one in Component]
    body, request, gains = found.body, found.request, found.gains
    return {
        "format": FORMAT,
        "version": VERSION,
        "frame": found.mount.frame,
        "body": found.mount.body,
        "seen": found.seen,
        "payload": [
            {"name": name, "value": value if show else None, "std": std if show else None, "unit": name.unit}
            for name, value, std, show in zip(Component, body.values, body.std, shown, strict=True)
        ],
        "parameters": {"value": found.value, "unconstrained": found.free, "covariance": found.covariance},
        "shares": {source.value: share for source, share in found.shares.items()},
        "gains": {
            "joints": gains.joints, "factor": gains.factor, "std": gains.std, "correction": gains.correction,
            "covariance": gains.covariance, "known_mass": gains.known_mass or None,
        },
        "request": {name: getattr(request, name) for name in REQUESTED},
        "factor": found.factor,
        "torque": [asdict(one) for one in found.logs],
        "notes": list(words),
        "provenance": asdict(sources),
    }  # fmt: skip


def payload_name(found: Identification) -> str:
    """Return the name of the URDF with a payload, after the robot file."""
    robot = found.provenance.model
    return f"{'robot' if robot is None else Path(robot.path).name.split('.')[0]}_payload.urdf"


def payload_urdf(found: Identification, payload: Payload, folder: Path) -> tuple[str, tuple[str, ...]]:
    """Return the URDF of the identified arm with the payload as a link, for a folder, and what to say of it.

    Where the result cannot be written as a URDF, the arm has the inertias of its file. Raises ModelError where that is
    none, no payload is seen, or the text, loaded again, has another torque.
    """
    if not payload.seen:
        raise ModelError("no payload is seen")
    bodies = next(term for term in found.model.terms if isinstance(term, RigidBodies))
    if bodies.format != "urdf":
        raise ModelError(f"{bodies.source}: it is an MJCF; a payload is written into a URDF.")
    said: tuple[str, ...] = ()
    try:
        before = identified_urdf(Identified(found.model, found.estimate.value)).text
    except ModelError as error:
        before, said = bodies.xml, (f"the arm has the inertias of its file there: {str(error).rstrip('.')}",)
    body = payload.body
    after = with_payload_link(before, payload.mount.frame, body.mass, body.centre, body.tensor)
    start = sum(len(term.parameters) for term in found.model.terms[: found.model.terms.index(bodies)])
    added = (payload.mount.turn @ payload.value)[start : start + len(bodies.parameters)]
    check_payload_link(before, after, bodies, added)
    return _moved(after, found.provenance, folder), said


def _moved(text: str, sources: Sources, folder: Path) -> str:
    """Return a URDF for a folder, as ``moved_to`` does."""
    start = None if sources.model is None else real(Path(sources.model.path).parent)
    if start is None or start == real(folder):
        return text
    try:
        way = Path(os.path.relpath(start, real(folder))).as_posix()
    except ValueError:  # another drive
        way = start.as_posix()
    return relocated(text, way)
