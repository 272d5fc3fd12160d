"""How much of dynident a run enters: the files and functions that ``sys.setprofile`` sees, by folder.

python benchmarks/entered.py article     least squares of the article's arm, by ``identify`` with its default recipe
python benchmarks/entered.py demo        the command ``dynident identify`` on the files of the demo arm, with its report
python benchmarks/entered.py demo -v     the same, function by function
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import numpy as np
from click.testing import CliRunner

import dynident
from dynident.cli import main

PACKAGE = str(Path(dynident.__file__).parent)


def article() -> Callable[[], object]:
    """The article's arm, one recording of it, and the method with its defaults."""
    from dynident.apps.article import SCENARIOS
    from dynident.apps.article.article import arm_to_identify
    from dynident.identification import Recipe, identify

    log = SCENARIOS["tabulated"].record(1e-6, np.random.default_rng(0)).log
    model = arm_to_identify()
    return lambda: identify(model, [log], recipe=Recipe())


def demo() -> Callable[[], object]:
    """The demo arm's files, identified by the command."""
    folder = Path(tempfile.mkdtemp())
    logs = [str(folder / name) for name in ("monday.parquet", "tuesday.parquet")]
    run("demo", "--files", "--out", str(folder))
    run("init", str(folder / "arm.urdf"), *logs, "-o", str(folder / "robot.yaml"))
    return lambda: run("identify", str(folder / "robot.yaml"), "--out", str(folder / "result"))


def run(*words: str) -> None:
    """Run a command; RuntimeError where it fails."""
    outcome = CliRunner().invoke(main, words)
    if outcome.exit_code:
        raise RuntimeError(outcome.output)


@contextlib.contextmanager
def profiled(codes: set[CodeType]) -> Iterator[None]:
    """Collect the code of all functions of the package that are called meanwhile, in all threads."""

    def see(frame: FrameType, event: str, _: Any) -> None:
        if event == "call" and frame.f_code.co_filename.startswith(PACKAGE):
            codes.add(frame.f_code)

    threading.setprofile(see)
    sys.setprofile(see)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


def entered(call: Callable[[], object]) -> dict[str, list[str]]:
    """Return the functions that a call enters, by file; those of comprehensions, classes and modules do not count.

    The call runs once before, so that what happens only at the first import is not counted.
    """
    codes = set[CodeType]()
    with contextlib.redirect_stdout(io.StringIO()):
        call()
        with profiled(codes):
            call()
    files: dict[str, list[str]] = {}
    for code in codes:
        name = code.co_qualname
        if not name.endswith(">"):
            files.setdefault(str(Path(code.co_filename).relative_to(PACKAGE)), []).append(name)
    return {file: sorted(files[file]) for file in sorted(files)}


def report(words: list[str]) -> None:
    """Print what a run enters."""
    files = entered({"article": article, "demo": demo}[words[0]]())
    if "-v" in words:
        for file, names in files.items():
            print(f"{file}: {', '.join(names)}")
    rooms: dict[str, list[int]] = {}
    for file, names in files.items():
        rooms.setdefault(file.split("/")[0], []).append(len(names))
    for room, counts in sorted(rooms.items()):
        print(f"{room}: {len(counts)} files, {sum(counts)} functions")
    print(f"{words[0]}: {len(files)} files, {sum(map(len, files.values()))} functions")


if __name__ == "__main__":
    if sys.argv[1:2] not in (["article"], ["demo"]):
        sys.exit(__doc__)
    report(sys.argv[1:])
