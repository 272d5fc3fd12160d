"""Robot files: their text, and the model that a configuration builds from it."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from dynident.errors import ModelError
from dynident.identification import SourceFile
from dynident.io.families import TERMS
from dynident.io.folder import settle
from dynident.io.opener import XML_WEIGHT, opened, real, text
from dynident.io.parts import build
from dynident.io.settings import AUTO, RobotSettings
from dynident.io.xacro import XACRO, expand
from dynident.models import CoupledMotor, Joint, Model, RigidBodies, Term

__all__ = [
    "SUFFIXES",
    "changed",
    "configured_terms",
    "fingerprint",
    "is_xacro",
    "load_robot",
    "model_file",
    "robot_text",
]

SUFFIXES = (".urdf", ".xml", ".mjcf", XACRO)


def robot_text(path: Path) -> str:
    """Return the text of a robot file, with what it includes; a xacro file is expanded by that program.

    Raises ModelError where it cannot be read or is not text.
    """
    from dynident.io.include import with_includes

    settle(path.parent)  # it may be an export
    return expand(path) if is_xacro(path) else with_includes(text(path, ModelError, SUFFIXES, XML_WEIGHT), path)


def is_xacro(path: Path) -> bool:
    """Whether a file is expanded by a program, so that reading it runs what it says."""
    return path.suffix.lower() == XACRO


def changed(file: SourceFile) -> bool:
    """Whether a robot file, or one that it includes, is not as it was; ModelError where one cannot be read."""
    path = Path(file.path)
    if fingerprint(path) != file.sha256:
        return True
    return bool(file.text) and not is_xacro(path) and robot_text(path) != file.text


def model_file(spec: str | RobotSettings, folder: Path) -> Path | None:
    """Return the file that a model is built from; None for a model of the gallery."""
    if isinstance(spec, RobotSettings):
        return next(iter(spec.file.values()))
    name = spec if Path(spec).suffix.lower() in SUFFIXES else spec.rpartition(":")[0]
    return None if name == "gallery" else real(folder / name, ModelError)


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files one after the other; ModelError where one cannot be read."""
    files = sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]
    digest = hashlib.sha256()
    try:
        for file in files:
            with opened(file, ModelError) as content:
                while part := content.read(1 << 20):
                    digest.update(part)
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}.") from error
    return digest.hexdigest()


def load_robot(settings: RobotSettings, text: str | None = None) -> Model:
    """Build the model of a robot file: rigid bodies, rotor inertias, friction, offsets, couplings as configured.

    ``text`` stands for the content of the file where that is known; terms that are to be chosen are not in the model.
    Raises ModelError where the file cannot be read or used, or a joint is unknown.
    """
    if len(settings.file) != 1:
        raise ModelError(f"model.file: names {len(settings.file)} files; a robot is one file.")
    (path,) = settings.file.values()
    xml = robot_text(path) if text is None else text
    bodies = RigidBodies(xml, settings.joints, settings.lock, settings.gravity, path.name)
    joints = bodies.joints
    terms: list[Term] = [bodies, *(one for one in configured_terms(settings, joints) if one is not None)]
    for name, coupling in settings.couplings.items():
        terms.append(
            CoupledMotor(
                joints,
                coupling.joints,
                inertia="rotor" in coupling.terms,
                viscous="viscous" in coupling.terms,
                coulomb="coulomb" in coupling.terms,
                offset=False,
                width=settings.coulomb_width,
                name=name,
            )
        )
    return Model(tuple(terms), name=path.stem)


def configured_terms(settings: RobotSettings, joints: tuple[Joint, ...]) -> tuple[Term | None, ...]:
    """Return the terms that are listed, None for those that are to be chosen."""
    tried = {AUTO, *settings.proposed}
    named = [TERMS.get(one) if isinstance(one, str) and one != AUTO else one for one in settings.terms]
    pairs = zip(settings.terms, named, strict=True)
    return tuple(None if part in tried else _term(one, joints, settings.coulomb_width) for one, part in pairs)


def _term(named: str | Callable[..., Term], joints: tuple[Joint, ...], width: float) -> Term:
    """Return a term for all joints, by its kind alone or with settings of its own."""
    if not isinstance(named, str):
        return named(joints=joints)
    settings = {"kind": named} | ({"width": width} if named == "coulomb" else {})
    term: Term = build(TERMS, settings, "model.terms", joints=joints)
    return term
