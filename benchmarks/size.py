"""A long recording of 7 joints as Parquet, with its configuration: python3 benchmarks/size.py FOLDER SAMPLES."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

JOINTS = 7
LINK = (
    '<link name="l{k}"><inertial><origin xyz="0.02 0.01 0.12"/><mass value="{mass}"/>'
    '<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    '<joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/><origin xyz="0.02 0 0.2"/>'
    '<axis xyz="{axis}"/><limit effort="100" velocity="4" lower="-2.8" upper="2.8"/></joint>'
)


def arm() -> str:
    """An arm of seven joints, alternately about z and y, lighter towards its end."""
    links = []
    for k in range(1, JOINTS + 1):
        mass, parent = 4.0 * 0.75**k, f"l{k - 1}" if k > 1 else "base"
        inertia = {"xx": 0.02 * mass, "yy": 0.018 * mass, "zz": 0.006 * mass}
        links.append(LINK.format(k=k, mass=mass, parent=parent, axis="0 0 1" if k % 2 else "0 1 0", **inertia))
    return f'<robot name="arm"><link name="base"/>{"".join(links)}</robot>'


def record(folder: Path, n: int) -> None:
    """Write robot, log (1 kHz, five sines a joint, noise on both) and configuration."""
    import polars as pl

    from dynident.models import Model, RigidBodies, RotorInertia
    from dynident.models.friction import Coulomb, Offset, Viscous

    bodies = RigidBodies(arm())
    joints = bodies.joints
    model = Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)))
    usual = {"rotor": 0.3, "viscous": 1.0, "coulomb": 0.8}
    theta = np.array([usual.get(p.role, 0.1) if p.value is None else p.value for p in model.parameters])
    rng, t = np.random.default_rng(0), np.arange(n) * 1e-3
    rate, size, phase = (rng.uniform(*sides, (5, JOINTS)) for sides in ((0.3, 3.0), (0.2, 0.5), (0.0, 6.0)))
    waves = [(size[h] * np.exp(1j * (rate[h] * t[:, None] + phase[h])), rate[h]) for h in range(5)]
    q, dq, ddq = (sum((wave * (1j * w) ** order).imag for wave, w in waves) for order in range(3))
    blocks = [slice(k, k + 50_000) for k in range(0, n, 50_000)]
    tau = np.concatenate([model.torque(q[b], dq[b], ddq[b], theta) for b in blocks])
    q, tau = q + 2e-5 * rng.standard_normal(q.shape), tau + 0.05 * rng.standard_normal(tau.shape)
    names = [joint.name for joint in joints]
    columns = {"t": t} | {f"{x}.q": q[:, j] for j, x in enumerate(names)}
    pl.DataFrame(columns | {f"{x}.tau": tau[:, j] for j, x in enumerate(names)}).write_parquet(folder / "log.parquet")
    (folder / "arm.urdf").write_text(arm())
    channels = {"position": ("q", "rad"), "torque": ("tau", "N m")}
    lines = ["model: arm.urdf", "time: { column: t, unit: s }", "train: [{ file: log.parquet }]"]
    for section, (end, unit) in channels.items():
        lines += [f"{section}:", *(f"  {x}: {{ column: {x}.{end}, unit: {unit} }}" for x in names)]
    (folder / "arm.yaml").write_text("\n".join([*lines, "estimator: { kind: consistent }"]) + "\n")


if __name__ == "__main__":
    record(Path(sys.argv[1]), int(sys.argv[2]))
