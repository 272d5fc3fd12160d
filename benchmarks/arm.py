"""An arm to try things on: seven links with offsets as on common arms, written as a robot file."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

LINKS = (  # mass, height of the next joint, its offset, its axis turned about x by so many right angles
    (4.0, 0.33, 0.0, -1),
    (3.5, 0.0, 0.0, 1),
    (3.0, 0.32, 0.08, 1),
    (2.7, 0.0, -0.08, -1),
    (1.7, 0.38, 0.0, 1),
    (1.6, 0.0, 0.09, 1),
    (0.5, 0.10, 0.0, 0),
)


def urdf(links: Sequence[tuple[float, float, float, int]], turn: int = 0) -> str:
    """Write an arm as URDF text; its first axis is turned by so many right angles, zero for upright."""
    parts, rise, shift = ['<robot name="arm"><link name="base"/>'], 0.3, 0.0
    for k, (mass, height, offset, quarter) in enumerate(links, start=1):
        parent = "base" if k == 1 else f"link{k - 1}"
        size = 0.02 * mass
        parts.append(
            f'<link name="link{k}"><inertial><origin xyz="0.01 0.02 {0.05 + height / 2:.3f}"/><mass value="{mass}"/>'
            f'<inertia ixx="{size:.4f}" iyy="{0.9 * size:.4f}" izz="{0.3 * size:.4f}" ixy="0" ixz="0" iyz="0"/>'
            f'</inertial></link><joint name="joint{k}" type="revolute"><parent link="{parent}"/><child link="link{k}"/>'
            f'<origin xyz="{shift} 0 {rise}" rpy="{turn * np.pi / 2:.15f} 0 0"/><axis xyz="0 0 1"/>'
            '<limit lower="-3" upper="3" effort="80" velocity="3"/></joint>'
        )
        rise, shift, turn = height, offset, quarter
    return "".join([*parts, "</robot>"])
