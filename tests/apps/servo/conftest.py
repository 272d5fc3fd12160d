"""The demo's arm of servos, drafted and identified once."""

from functools import partial
from pathlib import Path

import pytest

from dynident.apps.demo import servo_files
from tests.cli.commands import succeed


@pytest.fixture(scope="session")
def demo_output(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """The folder of the demo, of recordings of 6 s, with its results; and what it printed."""
    folder = tmp_path_factory.mktemp("servos")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dynident.apps.demo.servo_files", partial(servo_files, duration=6.0))
        return folder, " ".join(succeed("demo", "--servo", "--out", folder).output.split())


@pytest.fixture
def folder(demo_output: tuple[Path, str], monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of the demo, where commands are typed."""
    monkeypatch.chdir(demo_output[0])
    return demo_output[0]
