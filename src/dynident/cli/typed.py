"""Commands as the user would type them, for advice on what to do next."""

from __future__ import annotations

import os
import shlex
import subprocess

import click

__all__ = ["typed"]


def typed(*words: object) -> str:
    """Return a command of dynident as a shell takes it, under the name by which the running one was called.

    >>> typed("check", "my arm.yaml")
    "dynident check 'my arm.yaml'"
    """
    context = click.get_current_context(silent=True)
    program = context and context.find_root().info_name
    texts = [str(word) for word in words]
    return f"{program or 'dynident'} {subprocess.list2cmdline(texts) if os.name == 'nt' else shlex.join(texts)}"
