"""A day of an arm at 1 kHz, simulated into Parquet files, and what identifying it takes.

    python benchmarks/long_log.py write FOLDER --samples 100000000
    python benchmarks/long_log.py measure FOLDER --workers 2

``write`` needs 100 bytes of disk a sample. ``measure`` runs the command ``dynident identify``, watches the memory of
all of its processes, and compares the parameters found with the true ones.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import polars as pl
from arm import LINKS, urdf
from numpy.typing import NDArray

import dynident as dy
from dynident.models import Model

Array = NDArray[np.float64]
JOINTS, RATE = 6, 1000.0
SIGMA_Q, SIGMA_TAU = 2e-5, (1.0, 1.0, 0.6, 0.3, 0.2, 0.1)  # rad, N m
TERMS = ("rotor", "viscous", "coulomb", "offset")
FRICTION = {"Ia": 0.4, "Fv": 3.0, "Fc": 4.0, "offset": 0.5}  # of the first joints, by the names of parameters
WAVES = 4
PART, BLOCK = 1_000_000, 100_000


def model(folder: Path) -> Model:
    """Return the arm with its friction."""
    return dy.read_robot(folder / "arm.urdf", terms=TERMS)


def truth(arm: Model) -> Array:
    """Return the parameters that are true: the bodies as in the robot file, friction smaller from joint to joint."""
    pairs = ((parameter, parameter.name.partition("_joint")) for parameter in arm.parameters)
    return np.array([
        parameter.value if parameter.value is not None else FRICTION[kind] / int(joint)
        for parameter, (kind, _, joint) in pairs
    ])  # fmt: skip


def motion(t: Array, seed: int) -> tuple[Array, Array, Array]:
    """Return a quasi-periodic motion (N, n): a few incommensurate waves for each joint, and its derivatives."""
    rng = np.random.default_rng(seed)
    frequency = rng.uniform(0.3, 3.0, (WAVES, JOINTS))  # rad/s
    frequency[0] *= 0.1
    size, phase = rng.uniform(0.2, 0.6, (WAVES, JOINTS)), rng.uniform(0, 6, (WAVES, JOINTS))
    q, dq, ddq = np.zeros((3, len(t), JOINTS))
    for w, a, b in zip(frequency, size, phase, strict=True):
        angle = t[:, None] * w + b
        wave, slope = a * np.sin(angle), a * np.cos(angle)
        q += wave
        dq += w * slope
        ddq -= w**2 * wave
    return q, dq, ddq


def recorded(arm: Model, theta: Array, start: int, count: int, seed: int) -> pl.DataFrame:
    """Return some rows of the recording."""
    rng = np.random.default_rng([seed, start])
    t = (start + np.arange(count)) / RATE
    q, dq, ddq = motion(t, seed)
    tau = arm.torque(q, dq, ddq, theta)
    q += SIGMA_Q * rng.standard_normal(q.shape)
    tau = tau + np.array(SIGMA_TAU) * rng.standard_normal(tau.shape)
    columns = {"t": t} | {f"q{j + 1}": q[:, j] for j in range(JOINTS)} | {f"f{j + 1}": tau[:, j] for j in range(JOINTS)}
    return pl.DataFrame(columns)


def write(folder: Path, samples: int) -> None:
    """Write robot file, configuration, held-out log and the day."""
    (folder / "day").mkdir(parents=True, exist_ok=True)
    (folder / "arm.urdf").write_text(urdf(LINKS[:JOINTS]))
    arm = model(folder)
    theta = truth(arm)
    (folder / "truth.json").write_text(json.dumps(dict(zip(arm.names, theta.tolist(), strict=True))))
    channels = {
        "position": [f"  joint{j}: {{ column: q{j}, unit: rad, multi_turn: true }}" for j in range(1, JOINTS + 1)],
        "torque": [f"  joint{j}: {{ column: f{j}, unit: N m }}" for j in range(1, JOINTS + 1)],
    }
    text = [
        f"model: {{ file: arm.urdf, terms: [{', '.join(TERMS)}], base_tilt: none }}",
        "time: { column: t, unit: s }",
        *(line for key, lines in channels.items() for line in (f"{key}:", *lines)),
        "train: [{ file: 'day/*.parquet', name: day }]",
        "validation: [{ file: tuesday.parquet }]",
    ]
    (folder / "robot.yaml").write_text("\n".join(text) + "\n")
    recorded(arm, theta, 0, 60_000, 7).write_parquet(folder / "tuesday.parquet")
    began = time.perf_counter()
    for k, start in enumerate(range(0, samples, PART)):
        stop = min(start + PART, samples)
        blocks = [recorded(arm, theta, a, min(BLOCK, stop - a), 1) for a in range(start, stop, BLOCK)]
        pl.concat(blocks).write_parquet(folder / "day" / f"part{k}.parquet", compression="zstd", row_group_size=BLOCK)
        if k % 10 == 0:
            print(f"{stop:,} samples, {time.perf_counter() - began:.0f} s", flush=True)


def family(root: int) -> Iterator[int]:
    """Yield a process and all that come from it (Linux)."""
    yield root
    try:
        children = Path(f"/proc/{root}/task/{root}/children").read_text().split()
    except OSError:
        return
    for one in children:
        yield from family(int(one))


def peak(process: int) -> int:
    """Return the most memory (bytes) that a process has had, 0 where it is gone."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM")), 0)


def used(process: int) -> float:
    """Return the seconds of CPU that a process has used, 0 where it is gone."""
    try:
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def measure(folder: Path, workers: int, memory: float | None) -> None:
    """Run the command and print what it took."""
    out = folder / "out"
    more = [] if memory is None else ["--memory", str(memory)]
    command = [sys.executable, "-m", "dynident", "identify", str(folder / "robot.yaml"), "--out", str(out), *more]
    began = time.perf_counter()
    peaks: dict[int, int] = {}
    cpu: dict[int, float] = {}
    with subprocess.Popen([*command, "--workers", str(workers)]) as run:
        while run.poll() is None:
            for one in family(run.pid):
                peaks[one], cpu[one] = max(peaks.get(one, 0), peak(one)), max(cpu.get(one, 0.0), used(one))
            time.sleep(0.2)
    seconds, total = time.perf_counter() - began, sum(cpu.values())
    table = pl.concat([pl.read_parquet(one) for one in out.glob("pieces-*.parquet")])
    found = json.loads((out / "result.json").read_text())
    samples = sum(pl.scan_parquet(one).select(pl.len()).collect().item() for one in (folder / "day").glob("*.parquet"))
    known = json.loads((folder / "truth.json").read_text())
    off = [
        (one["value"] - sum(share * known[name] for name, share in one["combination"].items())) / one["std"]
        for one in found["base_parameters"]["on_data"]["parameters"]
    ]
    print(f"exit code {run.returncode}; {samples:,} samples, {len(table)} pieces, {workers} workers")
    print(f"{seconds:.0f} s, {total:.0f} s of CPU; {table['seconds'].sum():.0f} s of these in the pieces")
    print(f"{3600 * samples / total:.3g} samples per core-hour")
    print(f"peak memory of a process {max(peaks.values()) / 2**20:.0f} MiB, of each: "
          f"{', '.join(f'{one / 2**20:.0f}' for one in sorted(peaks.values(), reverse=True)[:6])}")  # fmt: skip
    print(f"{len(off)} base parameters, {np.mean(np.abs(off) < 1.96):.0%} within 1.96 standard errors of the truth; "
          f"rms {np.sqrt(np.mean(np.square(off))):.2f} standard errors")  # fmt: skip


def main() -> None:
    """Parse the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("write", "measure"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--samples", type=int, default=100_000_000)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--memory", type=float, help="budget of a file in GB: a smaller one for a shorter day")
    given = parser.parse_args()
    if given.what == "write":
        write(given.folder, given.samples)
    else:
        measure(given.folder, given.workers, given.memory)


if __name__ == "__main__":
    main()
