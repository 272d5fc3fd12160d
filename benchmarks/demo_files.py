"""The files of the demo arm (``src/dynident/apps/demo/files``) made anew: python3 benchmarks/demo_files.py FOLDER.

The recordings are simulated in the loop of the drives, which takes 10 s; all else follows from the arm's description.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl

from dynident.apps.demo.arm import (
    BASE,
    JOINTS,
    LINKS,
    TIME_OFFSET,
    DemoJoint,
    DemoLink,
    LinkCapsule,
    true_model,
    true_values,
)
from dynident.apps.demo.files import SEED, Day, fourier_motion
from dynident.files.results import write_bytes
from dynident.models import to_physical
from dynident.models.simulation import CascadePD
from dynident.motion.log import Motion
from dynident.runtime.arrays import Array
from dynident.validation import free_run

FACETS_AROUND, FACETS_ALONG = 16, 4  # facets around a capsule, and from its end to its cylinder
STEP = 1e-3  # s: the cycle of the drives
LOG_EVERY = 4  # of the samples of the drives, every fourth is logged
ENCODER_STEP = 2 * np.pi / 2**21  # rad
TORQUE_STEP = 0.01  # N m: the torque is logged in such steps
# of the torque: share of the joint's limit, and how much of it is there 4 ms later
NOISE_SHARE, NOISE_CORRELATION = 0.003, 0.8
LEAD_TIME = 1.0  # s that the arm moves before the recording begins
DAYS = (Day("monday", 20.0, 10.0, 0.6), Day("tuesday", 15.0, 7.5, 0.5))


def stl(shape: LinkCapsule) -> bytes:
    """Return the surface as binary STL, with normals outwards."""
    corners = _corners(shape)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sizes = np.linalg.norm(normals, axis=1, keepdims=True)
    has_area = sizes[:, 0] > 0  # a ball has no cylinder
    corners, normals = corners[has_area], normals[has_area] / sizes[has_area]
    facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["normal"], facets["corners"] = normals, corners
    return b"dynident demo arm".ljust(80) + len(corners).to_bytes(4, "little") + facets.tobytes()


def _corners(shape: LinkCapsule) -> Array:
    """Return the corners (facets, 3, 3) of triangles, counter-clockwise from outside."""
    x, y, z = _frame(np.subtract(shape.end, shape.start))
    up = np.linspace(-np.pi / 2, np.pi / 2, 2 * FACETS_ALONG)
    up[FACETS_ALONG - 1], up[FACETS_ALONG] = 0.0, 0.0  # the ends of the cylinder
    across = np.cos(up)
    across[0], across[-1] = 0.0, 0.0
    turn = 2 * np.pi * np.arange(FACETS_AROUND) / FACETS_AROUND
    ring = np.outer(np.cos(turn), x) + np.outer(np.sin(turn), y)
    middle = np.where(np.arange(len(up))[:, None] < FACETS_ALONG, shape.start, shape.end)
    axes = middle + shape.radius * np.outer(np.sin(up), z)
    # rings of points from pole to pole; two triangles join each pair of neighbours on adjacent rings
    rings = axes[:, None] + shape.radius * across[:, None, None] * ring
    low, high = rings[:-1], rings[1:]
    next_points = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    lower_triangles = np.stack((low, next_points[0], next_points[1]), axis=2)[1:]  # the first ring is a point
    upper_triangles = np.stack((low, next_points[1], high), axis=2)[:-1]  # and so is the last
    return np.concatenate((lower_triangles.reshape(-1, 3, 3), upper_triangles.reshape(-1, 3, 3)))


def _frame(along: Array) -> Array:
    """Return three axes (3, 3), the last of them along a vector; any of them where it is zero."""
    size = np.linalg.norm(along)
    z = along / size if size else np.array([0.0, 0.0, 1.0])
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])


def controller() -> str:
    """Return the drives' gains as the last part of a configuration, which makes its free simulation a closed loop."""
    lines = [
        f"    {joint.name}: {{ reference: {{ column: {joint.name}.reference_rad, unit: rad }}, "
        f"kp: {joint.kp}, kv: {joint.kv}, saturation: {joint.effort} }}"
        for joint in JOINTS
    ]
    head = (
        "simulation:  # of the recordings, in the loop of the controller that the arm had: kp in 1/s, kv in N m s/rad"
    )
    drives = f"  period: {STEP:g}  # s: the drives are four times as fast as the log"
    return "\n".join(("", head, "  kind: cascade", drives, "  joints:", *lines)) + "\n"


def urdf() -> str:
    """Return the robot file: inertias and friction as they would be in a drawing and a data sheet."""
    links = [_link_xml(link) for link in (BASE, *LINKS)]
    parents = (BASE, *LINKS)
    joints = [_joint_xml(joint, *ends) for joint, *ends in zip(JOINTS, parents, LINKS, strict=False)]
    head = (
        "<!-- The arm of `dynident demo`: drawn for it, no product. Its inertias are those of solid capsules. -->",
        '<robot name="demo_arm">',
        '  <mujoco><compiler strippath="false"/></mujoco>',
    )
    return "\n".join((*head, *links, *joints, "</robot>")) + "\n"


def _link_xml(link: DemoLink) -> str:
    mass, centre, tensor = to_physical(link.shape.inertia(link.mass))
    places = {"ixx": (0, 0), "ixy": (0, 1), "ixz": (0, 2), "iyy": (1, 1), "iyz": (1, 2), "izz": (2, 2)}
    values = " ".join(f'{key}="{_format_number(tensor[place])}"' for key, place in places.items())
    mesh = f'<geometry><mesh filename="meshes/{link.name}.stl"/></geometry>'
    return f"""\
  <link name="{link.name}">
    <inertial>
      <origin xyz="{_format_vector(centre)}"/>
      <mass value="{_format_number(float(mass))}"/>
      <inertia {values}/>
    </inertial>
    <visual>{mesh}</visual>
    <collision>{mesh}</collision>
  </link>"""


def _joint_xml(joint: DemoJoint, parent: DemoLink, child: DemoLink) -> str:
    return f"""\
  <joint name="{joint.name}" type="revolute">
    <parent link="{parent.name}"/>
    <child link="{child.name}"/>
    <origin xyz="{_format_vector(joint.origin)}"/>
    <axis xyz="{_format_vector(joint.axis)}"/>
    <limit lower="{-joint.reach}" upper="{joint.reach}" effort="{joint.effort}" velocity="{joint.velocity}"/>
  </joint>"""


def _format_vector(values: Iterable[float]) -> str:
    return " ".join(_format_number(float(value)) for value in values)


def _format_number(value: float) -> str:
    """Return a number with six digits, as in a drawing, and without a sign where it is zero."""
    return f"{float(f'{value:.6g}') + 0.0:.6g}"


@dataclass(frozen=True)
class _Encoders:
    """A controller that gets positions, and so velocities, in the encoders' steps."""

    drives: CascadePD

    @property
    def joints(self) -> tuple[str, ...]:
        return self.drives.joints

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        now, before = (ENCODER_STEP * np.round(position / ENCODER_STEP) for position in (q, q - STEP * dq))
        return self.drives(t, now, (now - before) / STEP)


def simulate_log(rng: np.random.Generator, day: Day, duration: float | None = None) -> pl.DataFrame:
    """Return the log of a day, or of its first seconds: time, and by joint position, torque, and reference."""
    # the arm moves before the recording begins, so that the loop has settled
    lead, rows = round(LEAD_TIME / STEP), round((duration or day.duration) / STEP / LOG_EVERY)
    t: Array = STEP * np.arange(-lead, LOG_EVERY * rows + 1, dtype=np.float64)
    reference, speed, _ = fourier_motion(rng, day, t)
    reference = np.asarray(np.round(reference, 5), dtype=np.float64)
    names = tuple(joint.name for joint in JOINTS)
    zeros = np.zeros_like(reference)
    reference_motion = Motion(t, reference, speed, zeros, zeros, names, np.ones(len(t), dtype=bool), day.name)
    gains = (np.array([getattr(joint, name) for joint in JOINTS]) for name in ("kp", "kv", "effort"))
    kp, kv, effort = (gain.astype(float) for gain in gains)
    drives = CascadePD(names, t, reference, kp, kv, np.ones(len(names)), effort, zeros)
    run = free_run(true_model(), true_values(), reference_motion, _Encoders(drives))
    # log every fourth cycle; the torque is the mean of the last four cycles, and late by the time offset
    rows_logged = lead + LOG_EVERY * np.arange(rows)
    last_cycles = rows_logged + round(TIME_OFFSET / STEP + LOG_EVERY / 2)  # of the cycles whose mean is reported
    tau = np.mean(
        [run.tau[last_cycles - k] for k in range(1, LOG_EVERY + 1)], axis=0
    ) + effort * NOISE_SHARE * _coloured_noise(rng, rows, len(names))
    return _table(
        t[rows_logged],
        ENCODER_STEP * np.round(run.q[rows_logged] / ENCODER_STEP),
        TORQUE_STEP * np.round(tau / TORQUE_STEP),
        reference[rows_logged],
    )


def _coloured_noise(rng: np.random.Generator, rows: int, n: int) -> Array:
    """Return first-order autoregressive noise (rows, n) of variance 1."""
    from scipy.signal import lfilter

    white = rng.standard_normal((rows, n)) * np.sqrt(1 - NOISE_CORRELATION**2)
    # the first sample gets the stationary variance
    white[0] /= np.sqrt(1 - NOISE_CORRELATION**2)
    return np.asarray(lfilter([1.0], [1.0, -NOISE_CORRELATION], white, axis=0))


def _table(t: Array, q: Array, tau: Array, reference: Array) -> pl.DataFrame:
    columns = {"time_s": pl.Series(np.round(t, 6))}
    for j, joint in enumerate(JOINTS):
        for name, values in (("position_rad", q), ("torque_Nm", tau), ("reference_rad", reference)):
            columns[f"{joint.name}.{name}"] = pl.Series(values[:, j], dtype=pl.Float32)
    return pl.DataFrame(columns)


def make_files() -> Mapping[str, bytes]:
    """Return the content of all files by name, made anew; the simulation of the recordings takes 10 s."""
    contents = {"arm.urdf": urdf().encode(), "controller.yaml": controller().encode()}
    contents |= {f"meshes/{link.name}.stl": stl(link.shape) for link in (BASE, *LINKS)}
    for k, day in enumerate(DAYS):
        buffer = BytesIO()
        table = simulate_log(np.random.default_rng([SEED, k]), day)
        table.write_parquet(buffer, compression="zstd", compression_level=19, statistics=False)
        contents[f"{day.name}.parquet"] = buffer.getvalue()
    return contents


if __name__ == "__main__":
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        sys.exit(__doc__)
    for name, data in make_files().items():
        write_bytes(Path(sys.argv[1]) / name, data)
