"""Advice names a command as the user would type it."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from dynident.cli.typed import typed


@pytest.mark.skipif(os.name == "nt", reason="shlex splits as POSIX shells do")
@pytest.mark.parametrize("program", ["dynident", "python -m dynident", "python3 '/home/a b/dev.py' run"])
def test_the_name_is_that_by_which_it_was_called(program: str) -> None:
    @click.group()
    def group() -> None: ...

    @group.command()
    def hint() -> None:
        click.echo(typed("check", Path("my arm.yaml")))

    done = CliRunner().invoke(group, ["hint"], prog_name=program)
    assert shlex.split(done.output) == [*shlex.split(program), "check", "my arm.yaml"]


def test_usage_names_what_started_it() -> None:
    def usage(**more: str) -> str:
        command = [sys.executable, "-m", "dynident", "check", "--help"]
        return subprocess.run(command, env={**os.environ, **more}, capture_output=True, text=True, check=True).stdout

    assert usage(DYNIDENT_COMMAND="python3 dev.py run").startswith("Usage: python3 dev.py run check [OPTIONS]")
    assert usage(DYNIDENT_COMMAND="").partition(" check")[0].endswith("-m dynident")
