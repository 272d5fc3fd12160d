"""The identified model as files for other programs: pure functions from an identification to verified texts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from dynident.errors import ModelError
from dynident.export.exporter import Exporter, States
from dynident.export.formats import Mjcf, Numpy, Urdf, Yaml
from dynident.export.identified import Identified
from dynident.export.mjcf import identified_mjcf
from dynident.export.numpy_module import identified_module
from dynident.export.parameters import identified_yaml
from dynident.export.payload_link import check_payload_link, with_payload_link
from dynident.export.proof import prove, random_states, spread
from dynident.export.readers import declared
from dynident.export.urdf import identified_urdf, joints_alone, relocated
from dynident.export.written import Export, FileError, Proof, Written
from dynident.identification import Identification
from dynident.models import Model
from dynident.regression import BLOCK
from dynident.validation import relative_error

__all__ = [
    "Export",
    "Exporter",
    "FileError",
    "Identified",
    "Mjcf",
    "Numpy",
    "Proof",
    "Urdf",
    "Written",
    "Yaml",
    "check_payload_link",
    "declared",
    "export",
    "export_files",
    "exports",
    "identified_mjcf",
    "identified_module",
    "identified_urdf",
    "identified_yaml",
    "joints_alone",
    "prove",
    "random_states",
    "relocated",
    "spread",
    "with_payload_link",
]

ALWAYS: tuple[Exporter, ...] = (Yaml(), Numpy())
ROBOT: Mapping[str, Exporter] = {one.format: one for one in (Urdf(), Mjcf())}


def exports(found: Identification) -> tuple[Export, ...]:
    """Return the robot's own file with the identified values, if there is one, the parameters, and a NumPy module.

    Each is verified on samples of the logs, and has its own torque errors on them, or the reason why it cannot be
    written.
    """
    estimate = found.estimate
    identified = Identified(found.model, estimate.value, estimate.std, tuple(estimate.provenance))
    states = spread(tuple(log.motion for log in found.validations))
    made = [(one, export(identified, one, states)) for one in _usual(identified)]
    return tuple(replace(file, errors=tuple(_errors(found, identified, one, file))) for one, file in made)


def _errors(found: Identification, identified: Identified, exporter: Exporter, file: Export) -> Iterator[FileError]:
    """Yield the errors of a file on the logs: those of the model, where it leaves nothing out."""
    if not file.ready or file.written is None:
        return
    for log in found.validations:
        known = own = log.errors.relative_error
        if file.written.left_out:
            motion = log.motion
            parts = [slice(start, start + BLOCK) for start in range(0, len(motion), BLOCK)]
            states = [(motion.q[s], motion.dq[s], motion.ddq[s]) for s in parts]
            torque = np.concatenate([exporter.torque(identified, one) for one in states])
            own = relative_error(motion.tau[motion.mask], torque[motion.mask])
        yield FileError(log.name, log.role, known, own)


def export_files(model: Model) -> tuple[str, ...]:
    """Return the names of the files that ``exports`` gives for a model."""
    identified = Identified(model, np.zeros(len(model.parameters)))
    return tuple(one.file(identified) for one in _usual(identified))


def _usual(identified: Identified) -> tuple[Exporter, ...]:
    robots = [ROBOT[robot.format]] if (robot := identified.robot) else []
    return (*robots, *ALWAYS)


def export(identified: Identified, exporter: Exporter, states: States) -> Export:
    """Return the text of an exporter with its verification at the states q, dq, ddq (N, n).

    Where the format cannot hold the model, or the text does not reproduce its torque, ``Export.refusal`` is the reason.

    >>> import numpy as np
    >>> from dynident.models.gallery import pendulum
    >>> model = pendulum()
    >>> written = export(Identified(model, model.values), Yaml(), random_states(1, np.random.default_rng(0)))
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
        return Export(exporter.format, file, written, proof)
    words = ", ".join(f"{name} {value:.2g}" for name, value in proof.readers.items())
    reason = (
        f"the text, loaded again, does not reproduce the identified torque: relative difference {words}, allowed is "
        f"{proof.limit:g}. {' '.join(proof.skipped)}"
    )
    return Export(exporter.format, file, written, proof, reason.strip())
