"""Payloads on real arms: python3 benchmarks/payload_logs.py DATA, the folder of the recordings that examples/ name.

Each arm is identified as its example says; to the measured torque of its held-out recording that of a known payload is
added, which is then sought in it, with the gains of the drives taken as known to 3 %, and as known.
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import yaml

from dynident.apps.payload import PayloadRequest, find_payload, mount_of
from dynident.apps.payload.body import physical_components
from dynident.identification import Identification, identify
from dynident.models import from_physical
from dynident.motion.log import Log
from dynident.project.project import read_project

EXAMPLES = Path(__file__).parents[1] / "examples"
ARMS = {"lwr4": 3.0, "panda": 2.0, "tx40": 1.5}  # kg
CENTRE = (0.02, -0.03, 0.08)


def identified(name: str, data: Path) -> tuple[Identification, dict[str, Log]]:
    """Return the result of an example, and its held-out recordings."""
    text = (EXAMPLES / f"{name}.yaml").read_text().replace(": data/", f": {data.resolve()}/")
    settings = yaml.safe_load(text) | {"simulation": None}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, f"{name}.yaml")
        path.write_text(yaml.safe_dump(settings))
        project = read_project(path)
    logs, _ = project.logs()
    return identify(project.model, logs["train"], logs["validation"], project.recipe), dict(logs["validation"])


def rows(name: str, data: Path) -> Iterator[tuple[str, ...]]:
    """Yield what is found of a payload, for gains known to 3 % and known."""
    result, logs = identified(name, data)
    mount, mass = mount_of(result.model), ARMS[name]
    phi = from_physical(mass, CENTRE, np.diag([0.012, 0.015, 0.006]) * mass / 3)
    truth = physical_components(phi)
    for gain_error in (3.0, 0.0):
        loaded = {key: _loaded(result, log, mount.transform @ phi) for key, log in logs.items()}
        payload = find_payload(result, loaded, request=PayloadRequest(gain_error=gain_error))
        error, std = payload.body.values - truth, payload.body.std
        centre = ", ".join(f"{1e3 * a:.1f} ± {1e3 * b:.1f}" for a, b in zip(error[1:4], std[1:4], strict=True))
        seconds = sum(float(log.t[-1] - log.t[0]) for log in logs.values())
        held = int((np.abs(error) < 1.96 * std).sum())
        row = name, f"{seconds:.1f}", f"{mass:g}", f"{gain_error:g} %", f"{error[0]:.3f} ± {std[0]:.3f}"
        yield *row, centre, f"{held} of 10"


def _loaded(identification: Identification, log: Log, added: np.ndarray) -> Log:
    """Return a recording with the torque of a payload added."""
    joints = tuple(joint.name for joint in identification.model.joints)
    motion = identification.recipe.motion(log.select(joints))
    torque = identification.model.remembering(motion)
    return replace(
        log.select(joints), tau=log.select(joints).tau + identification.model.torque(**torque.states(), theta=added)
    )


def main() -> None:
    """Print the table of all arms."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path)
    asked = parser.parse_args()
    heads = ("arm", "s", "kg", "gains", "error of the mass, kg", "error of the centre, mm (x, y, z)", "within 95 %")
    print(f"| {' | '.join(heads)} |\n|{'---|' * len(heads)}")
    for name in ARMS:
        for row in rows(name, asked.data):
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
