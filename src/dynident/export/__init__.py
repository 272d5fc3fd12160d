"""The identified model as files for other programs: pure functions from an identification to verified texts."""

from __future__ import annotations

from dynident.errors import ModelError, choices
from dynident.export.exporter import Exporter, States
from dynident.export.identified import Identified
from dynident.export.mjcf import identified_mjcf
from dynident.export.numpy_module import identified_module
from dynident.export.parameters import identified_yaml
from dynident.export.proof import prove, random_states, spread
from dynident.export.urdf import identified_urdf
from dynident.export.written import Export, Proof, Written
from dynident.identification import Identification
from dynident.models import RigidBodies
from dynident.parts import EXPORTERS

__all__ = [
    "Export",
    "Exporter",
    "Identified",
    "Proof",
    "Written",
    "export",
    "exports",
    "identified_mjcf",
    "identified_module",
    "identified_urdf",
    "identified_yaml",
    "prove",
    "random_states",
    "spread",
]

ALWAYS = ("yaml", "numpy")


def exports(found: Identification) -> tuple[Export, ...]:
    """Return the robot's own file with the identified values, if there is one, the parameters, and a NumPy module.

    Each is verified on samples of the logs, or has the reason why it cannot be written.
    """
    estimate = found.estimate
    identified = Identified(found.model, estimate.value, estimate.std, tuple(estimate.provenance))
    states = spread(tuple(log.motion for log in found.logs))
    formats = [term.format for term in found.model.terms if isinstance(term, RigidBodies)]
    return tuple(export(identified, one, states) for one in (*formats, *ALWAYS))


def export(identified: Identified, format: str, states: States) -> Export:  # noqa: A002
    """Return one format with its verification at the states q, dq, ddq (N, n).

    ``format`` is a kind of the exporters: "urdf", "mjcf", "numpy" or "yaml". Where the format cannot hold the model, or
    the text does not reproduce its torque, ``Export.refusal`` is the reason. Raises ModelError for an unknown format.

    >>> import numpy as np
    >>> from dynident.models.gallery import pendulum
    >>> model = pendulum()
    >>> written = export(Identified(model, model.values), "yaml", random_states(1, np.random.default_rng(0)))
    >>> written.ready, written.file
    (True, 'parameters.yaml')
    """
    if format not in EXPORTERS.table and format not in EXPORTERS.kinds():
        raise ModelError(f"no export format {format!r}; {choices(format, EXPORTERS.kinds())}")
    exporter: Exporter = EXPORTERS.get(format)()
    file = exporter.file(identified)
    try:
        written = exporter.write(identified)
    except ModelError as error:
        return Export(format, file, refusal=str(error))
    proof = prove(written, identified, states, exporter)
    if proof.proven:
        return Export(format, file, written, proof)
    words = ", ".join(f"{name} {value:.2g}" for name, value in proof.readers.items())
    reason = (
        f"the text, loaded again, does not reproduce the identified torque: relative difference {words}, allowed is "
        f"{proof.limit:g}. {' '.join(proof.skipped)}"
    )
    return Export(format, file, written, proof, reason.strip())
