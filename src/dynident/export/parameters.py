"""All parameters as YAML: values, standard errors, verdicts, units, meanings and frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import yaml

from dynident.export.identified import Identified
from dynident.export.written import Written

__all__ = ["identified_yaml"]

FRAME = (
    "mass, first moment and inertia of a body are about the origin of its joint's frame with the axes of its link; "
    "they contain all links that move with it"
)


def identified_yaml(identified: Identified) -> Written:
    """Return all parameters as YAML; it can hold any values."""
    model = identified.model
    data: dict[str, Any] = {
        "model": model.name,
        "frames": FRAME,
        "joints": [{"name": joint.name, "kind": joint.kind, "unit": joint.unit} for joint in model.joints],
    }
    if (robot := identified.robot) is not None:
        merged = {body: list(links) for body, links in robot.merged.items()}
        data |= {"robot": {"file": robot.source, "gravity": list(robot.gravity), "locked": dict(robot.locked)}}
        data["robot"]["merged"] = merged
    data["parameters"] = [_row(identified, k) for k in range(len(model.parameters))]
    return Written(yaml.safe_dump(data, sort_keys=False, allow_unicode=True, width=120))


def _row(identified: Identified, k: int) -> dict[str, Any]:
    parameter = identified.model.parameters[k]
    row: dict[str, Any] = {"name": parameter.name, "value": float(identified.value[k])}
    if identified.std is not None:
        row["std"] = float(identified.std[k]) if np.isfinite(identified.std[k]) else None
    if identified.verdict:
        row["verdict"] = str(identified.verdict[k])
    row |= {"unit": parameter.unit, "meaning": parameter.expression}
    return row | ({"body": parameter.body} if parameter.body else {})
