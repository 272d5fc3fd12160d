"""What a draft takes from a fit: the direction of gravity of an arm that hangs on a wall."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynident.cli.identification import draft_from_files
from tests.cli.commands import succeed
from tests.identification.test_base_tilt import ARM, tilted

LIMIT = '<limit lower="-3" upper="3" velocity="20" effort="100"/>'


@pytest.mark.parametrize(("turn", "gravity"), [(0.0, None), (np.pi / 2, (0.0, -9.81, 0.0))], ids=["floor", "wall"])
def test_gravity_is_drafted_with_a_question_where_the_torques_decide_it(
    tmp_path: Path, turn: float, gravity: tuple[float, float, float] | None
) -> None:
    # limits that the motion keeps, so that units are certain
    (tmp_path / "arm.urdf").write_text(re.sub(r"<limit[^>]*>", LIMIT, ARM))
    _, motion = tilted(turn, 0.0)
    names = [f"{kind}_{name}" for kind in ("pos", "torque") for name in motion.joints]
    rows = np.column_stack([motion.t, motion.q, motion.tau])
    np.savetxt(tmp_path / "run.csv", rows, delimiter=",", header=",".join(["t", *names]), comments="")
    draft, _ = draft_from_files(str(tmp_path / "arm.urdf"), [str(tmp_path / "run.csv")], tmp_path)
    written = yaml.safe_load(draft.text)["model"].get("gravity")
    asked = [question for question in draft.questions if question.startswith("model.gravity")]
    if gravity is None:
        assert written is None
        assert not asked
    else:
        assert written == list(gravity)
        (question,) = asked
        assert "Is the robot on a wall or ceiling" in question
        (tmp_path / "arm.yaml").write_text(draft.text.replace("terms: auto", "terms: [viscous]"))
        assert "mounted" not in succeed("identify", tmp_path / "arm.yaml").output
