"""``dynident tune`` prints where the page is, and ends with Ctrl-C."""

import socket
from pathlib import Path

import numpy as np
import pytest

from dynident.cli.failures import StopSignal
from tests.cli.commands import refuse, run

pytest.importorskip("dash")

CONFIG = """\
model: gallery:slider
time: { column: t, unit: s }
position: { slider: { column: q, unit: m } }
torque: { slider: { column: tau, unit: N } }
train: [ { file: monday.npz } ]
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    t = np.arange(500) * 0.01
    np.savez(tmp_path / "monday.npz", t=t, q=np.sin(3 * t), tau=-45 * np.sin(3 * t))
    path = tmp_path / "slider.yaml"
    path.write_text(CONFIG)
    return path


@pytest.mark.parametrize(("stop", "code"), [(KeyboardInterrupt(), 0), (StopSignal(15), 143)])
def test_a_signal_ends_it(config: Path, monkeypatch: pytest.MonkeyPatch, stop: KeyboardInterrupt, code: int) -> None:
    def interrupted(server: object) -> None:
        raise stop

    opened = []
    monkeypatch.setattr("dynident.apps.tuning.server.answer", interrupted)
    monkeypatch.setattr("dynident.apps.tuning.server.open_browser", opened.append)
    done = run("tune", config)
    assert done.exit_code == code
    assert "http://127.0.0.1:" in done.output
    assert len(opened) == 1
    run("tune", config, "--no-browser")
    assert len(opened) == 1


def test_what_is_wrong_is_said_before_there_is_a_page(config: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        done = run("tune", config, "--port", port)
    assert done.exit_code == 1
    assert f"--port {port}: " in done.output
    config.write_text(CONFIG.replace("time:", "tim:"))
    assert run("tune", config).exit_code == 1
    config.write_text(CONFIG)
    np.savez(config.with_name("monday.npz"), t=np.zeros(3), q=np.zeros(3), tau=np.zeros(3))
    refuse("tune", config, says="monday")
