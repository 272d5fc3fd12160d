"""Verification of a written model: load it again, by independent readers if installed, and compare its torque."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from dynident.files.folder import result_folder
from dynident.files.opener import real_path, refuse_inputs, watch_inputs
from dynident.files.results import as_path
from dynident.files.xml_text import SUFFIXES
from dynident.identification import Identification, Sources
from dynident.models import Model
from dynident.motion.log import Motion, subsample
from dynident.project.export.formats import Mjcf, Numpy, Urdf, Yaml
from dynident.project.export.identified import IdentifiedModel
from dynident.project.export.robot_files import relocate_files
from dynident.project.export.servos import identified_model
from dynident.project.export.written import Export, Exporter, ExportText, FileError, Proof, Reader, States
from dynident.project.saved import source_files
from dynident.regression import BLOCK
from dynident.runtime import ConfigError, ModelError, check_type, choices, join_names
from dynident.runtime.arrays import Array
from dynident.runtime.families import EXPORTERS
from dynident.validation import relative_error

MIN_TORQUE_SHARE = 1e-6  # a joint's torque counts as no smaller than this share of the largest joint's
ENDINGS = (*SUFFIXES, ".yaml", ".yml", ".json", ".py")  # of a path that is a file, and no folder
FOREIGN = {"Pinocchio": ("pinocchio", "pin"), "MuJoCo": ("mujoco", "mujoco")}  # their modules and packages
ALWAYS: tuple[Exporter, ...] = (Yaml(), Numpy())
ROBOT: Mapping[str, Exporter] = {exporter.format: exporter for exporter in (Urdf(), Mjcf())}


def spread(motions: tuple[Motion, ...], count: int = 500) -> States:
    """Return q, dq, ddq of about ``count`` usable samples (N, n), evenly spread over the motions."""
    pairs = list(zip(motions, subsample(motions, count), strict=True))
    names = ("q", "dq", "ddq")
    q, dq, ddq = (np.concatenate([getattr(motion, name)[rows] for motion, rows in pairs]) for name in names)
    return q, dq, ddq


def random_states(joints: int, rng: np.random.Generator, count: int = 500) -> States:
    """Return random q, dq, ddq (count, joints) of a few rad or m, per s and per s^2, for use without a motion."""
    q, dq, ddq = rng.uniform(-3, 3, (3, count, joints))
    return q, dq, ddq


def prove(written: ExportText, identified: IdentifiedModel, states: States, exporter: Exporter) -> Proof:
    """Compare the torque of the text, loaded again, with that of the model without the terms left out.

    The exporter names the readers and the terms that it can hold.
    """
    expected = exporter.torque(identified, states)
    differences: dict[str, float] = {}
    skipped: list[str] = []
    for name, reader in exporter.readers.items():
        module, package = FOREIGN.get(name, ("", ""))
        if module and importlib.util.find_spec(module) is None:
            own_readers = " and ".join(reader_name for reader_name in exporter.readers if reader_name not in FOREIGN)
            skipped.append(f"{name} is not installed (the package `{package}`): only {own_readers} loaded the file")
            continue
        try:
            differences[name] = _relative_difference(reader(written.text, identified, states), expected)
        except Exception as error:  # another library's parser may raise anything
            reason = " ".join(str(error).split())
            # a reader that also fails on the original file says nothing about the export
            if name in FOREIGN and _is_unreadable(reader, identified):
                skipped.append(f"{name} can read neither this file nor the original: {reason}")
            else:
                differences[name] = float("inf")
                skipped.append(f"{name} cannot read it: {reason}")
    return Proof(differences, len(expected), tuple(skipped))


def _relative_difference(torque: Array, expected: Array) -> float:
    size = np.linalg.norm(expected, axis=0)
    # a joint with almost no torque must not turn rounding into a large relative error
    scale = np.maximum(size, MIN_TORQUE_SHARE * size.max())
    error = np.linalg.norm(torque - expected, axis=0)
    worst = np.divide(error, scale, out=np.where(error > 0, np.inf, 0.0), where=scale > 0).max()
    return float(worst) if np.isfinite(worst) else float("inf")


def _is_unreadable(reader: Reader, identified: IdentifiedModel) -> bool:
    """Return whether a reader cannot read the original file either."""
    bodies, _ = identified.bodies
    empty: Array = np.zeros((0, len(bodies.joints)))
    try:
        reader(bodies.xml, identified, (empty, empty, empty))
    except Exception:  # another library's parser may raise anything
        return True
    return False


def exports(identification: Identification, format: str | None = None) -> tuple[Export, ...]:  # noqa: A002
    """Return the robot's own file with the identified values, if there is one, the parameters, and a NumPy module.

    With another ``format`` its file is the last. Each is verified on samples of the logs, and has its own torque errors
    on them, or the reason why it cannot be written. A saved result has no samples: random states take their place.
    """
    identified = identified_model(identification)
    motions = tuple(log.motion for log in identification.validations if log.signals is not None)
    states = spread(motions) if motions else random_states(len(identification.model.joints), np.random.default_rng(0))
    exporters = _usual(identified)
    if format is not None and all(exporter.format != format for exporter in exporters):
        exporters = (*exporters, EXPORTERS.get(format, "format")())
    made = [(exporter, export(identified, exporter, states)) for exporter in exporters]
    return tuple(
        replace(file, errors=tuple(_errors(identification, identified, exporter, file))) for exporter, file in made
    )


def _errors(
    identification: Identification, identified: IdentifiedModel, exporter: Exporter, file: Export
) -> Iterator[FileError]:
    """Yield the errors of a file on the logs: those of the model, where it leaves nothing out."""
    if not file.ready or file.written is None:
        return
    for log in identification.validations:
        model_error = file_error = log.errors.relative_error
        if file.written.left_out:
            if log.signals is None:
                continue
            motion = log.motion
            parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
            states = [(motion.q[s], motion.dq[s], motion.ddq[s]) for s in parts]
            torque = np.concatenate([exporter.torque(identified, block) for block in states])
            file_error = relative_error(motion.tau[motion.mask], torque[motion.mask])
        yield FileError(log.name, log.role, model_error, file_error)


def export_files(model: Model) -> tuple[str, ...]:
    """Return the names of the files that ``exports`` gives for a model."""
    identified = IdentifiedModel(model, np.zeros(len(model.parameters)))
    return tuple(exporter.file(identified) for exporter in _usual(identified))


def _usual(identified: IdentifiedModel) -> tuple[Exporter, ...]:
    robots = [ROBOT[robot.format]] if (robot := identified.robot) else []
    return (*robots, *ALWAYS)


def _size_notes(written: ExportText, identified: IdentifiedModel, exporter: Exporter, states: States) -> Iterator[str]:
    """Yield how large the torque is that a text leaves out, joint by joint, but for terms that depend on the past."""
    if not written.left_out:
        return
    torque = exporter.torque(identified, states)
    squares = (Numpy().torque(identified, states) - torque) ** 2
    smallest = MIN_TORQUE_SHARE * np.abs(torque).max(initial=0.0)
    words = [
        f"{size:.2g} {joint.effort} at {joint.name!r}"
        for joint, size in zip(
            identified.model.joints, np.sqrt(squares.sum(axis=0) / max(len(squares), 1)), strict=True
        )
        if size > smallest
    ]
    if words:
        yield f"what it leaves out is, as root mean square over the states compared, {join_names(words)}"


def export(identified: IdentifiedModel, exporter: Exporter, states: States) -> Export:
    """Return the text of an exporter with its verification at the states q, dq, ddq (N, n).

    Where the format cannot hold the model, or the text does not reproduce its torque, ``Export.refusal`` is the reason.

    >>> import numpy as np
    >>> from dynident.models.lagrangian import pendulum
    >>> model = pendulum()
    >>> written = export(IdentifiedModel(model, model.values), Yaml(), random_states(1, np.random.default_rng(0)))
    >>> written.ready, written.file
    (True, 'parameters.yaml')
    """
    file = exporter.file(identified)
    try:
        written = exporter.write(identified)
    except ModelError as error:
        return Export(exporter.format, file, refusal=str(error))
    proof = prove(written, identified, states, exporter)
    if proof.proven:
        notes = (*written.notes, *_size_notes(written, identified, exporter, states))
        return Export(exporter.format, file, replace(written, notes=notes), proof)
    words = ", ".join(f"{name} {value:.2g}" for name, value in proof.readers.items())
    reason = (
        f"the text, loaded again, does not reproduce the identified torque: relative difference {words}, allowed is "
        f"{proof.limit:g}. {' '.join(proof.skipped)}"
    )
    return Export(exporter.format, file, written, proof, reason.strip())


def export_model(identification: Identification, path: str | Path, format: str | None = None) -> tuple[Path, ...]:  # noqa: A002
    """Write the identified model for other programs to a folder, or to one file by its ending, and return the files.

    ``format`` is urdf, mjcf, drake, isaac, pinocchio, yaml, numpy, or one that another package adds; None writes the
    robot's own file, yaml and numpy, or what the ending says. Each is loaded again and compared before it is written.
    Raises ConfigError for an unknown format or ending, or where the robot's own file would be replaced, ModelError
    where the model cannot be written so.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> from tempfile import TemporaryDirectory
    >>> arm = pendulum()
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(1001) * 0.01)
    >>> found = dy.identify(arm, dy.record(motion, 1e-4, 0.01, np.random.default_rng(0)).log)
    >>> with TemporaryDirectory() as folder:
    ...     [file.name for file in dy.export_model(found, folder)]
    ['parameters.yaml', 'model.py']
    """
    check_type("export_model", identification, Identification, "give the Identification")
    folder, file = as_path(path), ""
    if not folder.is_dir() and folder.suffix.lower() in ENDINGS:
        folder, file = folder.parent, folder.name
    selection = relocate_exports(folder, _select_exports(identification, format, file), identification.provenance)
    with watch_inputs(*source_files(identification.provenance)):
        refuse_inputs(*(folder / export.file for export in selection))
        with result_folder(folder) as target_folder:
            return target_folder.replace(
                {
                    export.file: export.written.text
                    for export in selection
                    if export.written is not None and export.ready
                }
            )


def relocate_exports(folder: Path, model_exports: Iterable[Export], sources: Sources) -> tuple[Export, ...]:
    """Return exports for a folder: a URDF names meshes relative to its own folder, so their paths are adapted."""
    relocated = []
    for export in model_exports:
        if export.format in ("urdf", "drake") and export.written is not None:
            text = relocate_urdf(export.written.text, sources, folder)
            export = replace(export, written=replace(export.written, text=text))
        relocated.append(export)
    return tuple(relocated)


def relocate_urdf(text: str, sources: Sources, folder: Path) -> str:
    """Return a URDF to be written to a folder, with mesh names relative to it."""
    start = None if sources.model is None else real_path(Path(sources.model.path).parent)
    if start is None or start == real_path(folder):
        return text
    try:
        mesh_folder = Path(os.path.relpath(start, real_path(folder))).as_posix()
    except ValueError:  # another drive
        mesh_folder = start.as_posix()
    return relocate_files(text, mesh_folder)


def _select_exports(identification: Identification, name: str | None, file: str) -> list[Export]:
    """Return the export of this format, or all where it is None; that of a ``file`` by its ending has its name.

    Raises ModelError where none can be written.
    """
    if name is not None and name not in EXPORTERS.kinds():
        raise ConfigError(f"export_model: there is no format {name!r}; {choices(name, EXPORTERS.kinds())}")
    all_exports = exports(identification, name)
    selection = [export for export in all_exports if name in (None, export.format)]
    if file:
        endings = {Path(export.file).suffix: replace(export, file=file) for export in selection}
        if (ending := Path(file).suffix.lower()) not in endings:
            raise ConfigError(
                f"export_model: {file!r} is no file of {name or 'this model'}: it ends in {' or '.join(endings)}. Name "
                "such a file, or a folder for all."
            )
        name, selection = endings[ending].format, [endings[ending]]
    refused = [export for export in selection if not export.ready]
    # where all formats are asked for, some may be refused; a format that is named may not
    if refused and (name is not None or len(refused) == len(selection)):
        raise ModelError(f"{refused[0].file}: {refused[0].refusal}")
    return selection
