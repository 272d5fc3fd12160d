"""Write docs/normal_matrix.svg, the pattern of a real normal matrix: .venv/bin/python docs/draw_normal_matrix.py."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from dynident.files.results import write_text
from dynident.identification import normal_matrices
from dynident.models.lagrangian import two_link_arm
from dynident.models.simulation import simulate

TARGET = Path(__file__).with_name("normal_matrix.svg")
SAMPLES, CELL, LEFT, TOP = 12, 9, 10, 26


def pattern() -> tuple[np.ndarray, int]:
    """Return where the matrix of the two-link arm on a few samples is not zero, and the number of its coefficients."""
    arm, t = two_link_arm(), np.linspace(0.2, 1.0, SAMPLES)
    motion = simulate(arm, arm.values, lambda s: [np.sin(3 * s), 0.5 * np.cos(4 * s)], t)
    (one,) = normal_matrices(arm, arm.values, motion, 1e-3, 0.1)
    band, (width, m), p = one.position + one.torque, one.torque.shape, len(one.corner)
    full = np.zeros((m + p, m + p), dtype=bool)
    for d in range(width):
        full[range(d, m), range(m - d)] = band[d, : m - d] != 0
    full[m:, :m] = one.border.T != 0
    full[m:, m:] = one.corner != 0
    return full | full.T, m


def drawing() -> str:
    """Return the picture as SVG, with colours that are readable on white and on black."""
    there, m = pattern()
    size = len(there) * CELL
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size + 250} {size + TOP + 10}"',
        'font-family="sans-serif" font-size="13" fill="#7d7d7d">',
        f'<text x="{LEFT}" y="16">{SAMPLES} samples of an arm: {m} coefficients, {len(there) - m} parameters',
        "</text>",
    ]
    bordered = np.zeros_like(there)
    bordered[m:] = bordered[:, m:] = True
    for colour, part in (("#3584e4", there & ~bordered), ("#e5484d", there & bordered)):
        marks = "".join(f"M{LEFT + CELL * a} {TOP + CELL * b}h8v8h-8z" for b, a in np.argwhere(part))
        parts.append(f'<path fill="{colour}" d="{marks}"/>')
    for y, text in (
        (0.2 * m, "N: a band, three coefficients"), (0.2 * m + 2, "per joint act on a sample"),
        (0.6 * m, "B: the border of the parameters"), (m + 4, "D: the parameters alone"),
    ):  # fmt: skip
        parts.append(f'<text x="{size + LEFT + 12}" y="{TOP + CELL * y:.0f}">{text}</text>')
    return "\n".join([*parts, "</svg>", ""])


if __name__ == "__main__":
    write_text(TARGET, drawing())
