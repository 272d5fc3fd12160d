"""The demo arm's files, which lie in ``files``, and how far an identification of it is from the truth."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np

from dynident.apps.demo.arm import JOINTS, LINKS, demo_truth
from dynident.files.results import as_path, probe_folder, write_bytes
from dynident.identification import Identification
from dynident.models import Model
from dynident.motion.log import Motion
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

SEED = 12
HARMONICS = 5
STANDARD_ERRORS_95 = 1.96  # standard errors that hold 95 %

STRETCHED_POSE = (0.0, np.pi / 2, 0.0, 0.0, 0.0, 0.0)  # the arm stretched out


@dataclass(frozen=True)
class Day:
    """A recording: its length, the period of the motion's first harmonic (s), and its share of the joints' reach."""

    name: str
    duration: float
    period: float
    share: float


def fourier_motion(rng: np.random.Generator, day: Day, t: Array) -> tuple[Array, Array, Array]:
    """Return q, dq and ddq (N, 6) of a random Fourier series within the joints' limits, at times t (s)."""
    n = len(JOINTS)
    reach, fastest = (np.array([getattr(joint, name) for joint in JOINTS]) for name in ("reach", "velocity"))
    phases, sizes = rng.uniform(0, 2 * np.pi, (HARMONICS, n)), rng.uniform(0.4, 1.0, (HARMONICS, n))
    sizes /= np.sqrt(np.arange(1, HARMONICS + 1))[:, None]
    w = 2 * np.pi / day.period * np.arange(1, HARMONICS + 1)

    def derivative(order: int, times: Array) -> Array:
        angle = w[:, None] * times[:, None, None] + phases + order * np.pi / 2
        return np.asarray((w[:, None] ** order * sizes * np.cos(angle)).sum(axis=1))

    period_times = np.linspace(0, day.period, 2000)
    # scale each joint to its share of the reach, unless that would exceed its speed limit
    scale = np.minimum(
        day.share * reach / np.abs(derivative(0, period_times)).max(axis=0),
        0.8 * fastest / np.abs(derivative(1, period_times)).max(axis=0),
    )
    q, dq, ddq = (scale * derivative(order, t) for order in range(3))
    return q, dq, ddq


UNSEEN_MOTION = Day("unseen", 10.0, 8.0, 0.55)


@dataclass(frozen=True)
class ComparedValue:
    """An estimated value with the true one, and its standard error where it is known."""

    name: str
    estimate: float
    true: float
    std: float | None
    unit: str


class Comparison(Noun):
    """The errors of an identification of the demo arm.

    Torque errors are relative (%), on a motion never recorded, against the true torque without noise: of the
    identified model, and of the robot file's inertias with the true friction. ``values`` are single parameters;
    ``within`` is the number of the ``base`` parameters that are within 1.96 of their standard errors.
    """

    torque_error: float
    file_error: float
    values: tuple[ComparedValue, ...]
    within: int
    base: int


def compare_with_truth(identification: Identification) -> Comparison:
    """Return the errors of a result of ``dynident identify`` on the demo arm, whatever its terms are."""
    truth, value = demo_truth(), identification.estimate.value
    t = np.arange(0.0, UNSEEN_MOTION.duration, 0.01)
    # the test motion is random, but the same in each comparison
    states = fourier_motion(np.random.default_rng([SEED, len(UNSEEN_MOTION.name)]), UNSEEN_MOTION, t)
    mask = np.ones(len(t), dtype=bool)
    motion = Motion(t, *states, np.zeros_like(states[0]), tuple(joint.name for joint in JOINTS), mask)
    drawn = np.concatenate([*(link.shape.inertia(link.mass) for link in LINKS), truth.value[10 * len(LINKS) :]])
    true_torque, model_torque, file_torque = (
        model.torque(**model.remembering(motion).states(), theta=theta)
        for model, theta in ((truth.model, truth.value), (identification.model, value), (truth.model, drawn))
    )
    # base parameters are compared with the projection of the true torque on the model, whose terms may be others
    base, error = identification.base.on_data, value - _project_truth(identification.model, motion, true_torque)
    absolute_error = np.abs(error if base is None else base.combination @ error)
    std = identification.errors.std if identification.errors.base_std is None else identification.errors.base_std
    return Comparison(
        _relative_error(model_torque - true_torque, true_torque),
        _relative_error(file_torque - true_torque, true_torque),
        _compared_values(identification),
        int((absolute_error < STANDARD_ERRORS_95 * std).sum()),
        len(absolute_error),
    )


def _project_truth(model: Model, motion: Motion, torque: Array) -> Array:
    """Return parameters (p) with which a model best approximates a torque (N, n): the truth in its own terms."""
    Y = model.regressor(**model.remembering(motion).states())
    rows = Y.reshape(-1, Y.shape[-1])
    size = np.linalg.norm(rows, axis=0) + np.finfo(float).tiny
    return np.asarray(np.linalg.lstsq(rows / size, torque.ravel(), rcond=1e-9)[0] / size)


def _compared_values(identification: Identification) -> tuple[ComparedValue, ...]:
    truth, lines = demo_truth(), list[ComparedValue]()
    offset, tilt = identification.calibration.time_offset, identification.calibration.base_tilt
    if offset is not None:
        std = None if offset.std is None else 1e3 * offset.std
        lines.append(
            ComparedValue("torque stamped later by", -1e3 * offset.seconds, -1e3 * truth.time_offset, std, "ms")
        )
    if tilt is not None:
        for axis, *angles in zip("xy", (tilt.x, tilt.y), truth.tilt, tilt.std, strict=True):
            value, true, std = np.rad2deg(angles).tolist()
            lines.append(ComparedValue(f"tilt about {axis}", value, true, std, "deg"))
    lines.append(
        ComparedValue("gravity, arm stretched out", _gravity_torque(identification), _gravity_torque(None), None, "N m")
    )
    true_by_name = dict(zip(truth.model.names, truth.value.tolist(), strict=True))
    for k, parameter in enumerate(identification.model.parameters):
        if parameter.role in ("viscous", "coulomb") and parameter.name in true_by_name:
            std, value = float(identification.errors.std[k]), float(identification.estimate.value[k])
            lines.append(ComparedValue(parameter.name, value, true_by_name[parameter.name], std, parameter.unit))
    return tuple(lines)


def _gravity_torque(identification: Identification | None) -> float:
    """Return the gravity torque of the second joint with the arm stretched out, as identified or, for None, true."""
    truth, pose, zeros = demo_truth(), np.array([STRETCHED_POSE]), np.zeros((1, len(STRETCHED_POSE)))
    model, theta = (
        (truth.model, truth.value) if identification is None else (identification.model, identification.estimate.value)
    )
    theta_without_offset = np.where([parameter.name.startswith("offset") for parameter in model.parameters], 0.0, theta)
    memory = np.zeros((1, model.memory)) if model.memory else None
    torque = model.torque(pose, zeros, zeros, theta_without_offset, memory)[0]
    return float(torque[[joint.name for joint in JOINTS].index("shoulder_lift")])


def _relative_error(error: Array, reference: Array) -> float:
    return 100.0 * float(np.linalg.norm(error) / np.linalg.norm(reference))


def demo_files(folder: str | Path) -> Path:
    """Write the demo arm's files to a folder and return it.

    The files are arm.urdf, meshes, monday.parquet, tuesday.parquet, and controller.yaml, the drives' gains as a
    configuration names them. A file that exists with the right content is left. Raises InputError, before
    anything is written, where another file of the same name exists, or where nothing can be written.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     sorted(path.name for path in demo_files(folder).iterdir())
    ['arm.urdf', 'controller.yaml', 'meshes', 'monday.parquet', 'tuesday.parquet']
    """
    folder = as_path(folder)
    contents = {folder / name: file.read_bytes() for name, file in _shipped_files()}
    missing = {path: data for path, data in contents.items() if not os.path.lexists(path)}
    for path in contents.keys() - missing.keys():
        if not _has_content(path, contents[path]):
            raise InputError(f"{path}: exists already, and is not the demo arm's; choose another folder.")
    for place in dict.fromkeys(path.parent for path in missing):
        probe_folder(place)
    for path, data in missing.items():
        write_bytes(path, data)
    return folder


def _has_content(path: Path, data: bytes) -> bool:
    try:
        return path.is_file() and path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:  # not ours to read
        return False


def _shipped_files() -> Iterator[tuple[str, Traversable]]:
    """Yield the shipped files with their names in a folder."""
    place = files("dynident.apps.demo") / "files"
    for entry in sorted(place.iterdir(), key=lambda file: file.name):
        if entry.is_dir():
            yield from ((f"{entry.name}/{file.name}", file) for file in entry.iterdir())
        else:
            yield entry.name, entry
