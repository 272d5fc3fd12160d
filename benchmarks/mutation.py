"""Mutation score: how many small faults, put into the source one at a time, do the tests of its room notice?

cosmic-ray makes the mutants. Its own runner edits the checkout and runs one command for all of them; here a sample is
drawn from all rooms, each file as often as it has lines, each mutant is put into a copy of the project, and the tests
of its room run, the nearest first, until one fails.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCE = Path("src/dynident")
EQUIVALENT = ROOT / "benchmarks" / "mutation_equivalent.toml"
MEMORY = 8 << 30  # bytes that a mutant may take, where the system can limit it
SLOWER, AT_LEAST = 5.0, 30.0  # a mutant is given this many times the time of its tests, and these seconds more
OPERATORS = tuple(
    f"core/{name}"
    for name in (
        *("ReplaceBinaryOperator_" + pair for pair in ("Add_Sub", "Sub_Add", "Mul_Div", "Div_Mul", "FloorDiv_Mul")),
        *("ReplaceBinaryOperator_" + pair for pair in ("Mod_Mul", "Pow_Mul", "BitAnd_BitOr", "BitOr_BitAnd")),
        *("ReplaceComparisonOperator_" + pair for pair in ("Lt_LtE", "LtE_Lt", "Gt_GtE", "GtE_Gt")),
        *("ReplaceComparisonOperator_" + pair for pair in ("Lt_GtE", "LtE_Gt", "Gt_LtE", "GtE_Lt", "Eq_NotEq")),
        *("ReplaceComparisonOperator_" + pair for pair in ("NotEq_Eq", "Is_IsNot", "IsNot_Is")),
        *("ReplaceUnaryOperator_" + pair for pair in ("Delete_USub", "Delete_Not", "Delete_Invert")),
        *("ReplaceTrueWithFalse", "ReplaceFalseWithTrue", "ReplaceAndWithOr", "ReplaceOrWithAnd", "AddNot"),
        *("ReplaceBreakWithContinue", "ReplaceContinueWithBreak", "ZeroIterationForLoop"),
        *("NumberReplacer", "ExceptionReplacer"),
    )
)
SKIPPED = (".git", ".venv", "*-out", "site", "dist", "__pycache__", ".*_cache", ".hypothesis")


@dataclass(frozen=True)
class Mutant:
    """One fault: the line that it changes, before and after, and the text of the whole file with it."""

    path: str
    line: int
    was: str
    becomes: str
    code: str

    @property
    def key(self) -> tuple[str, str, str]:
        """What names the mutant in the list of equivalent ones."""
        return self.path, self.was, self.becomes


@dataclass(frozen=True)
class Outcome:
    """What became of a mutant; ``source`` and ``tests`` are the hashes for which that holds, ``by`` what failed."""

    path: str
    line: int
    was: str
    becomes: str
    source: str
    tests: str
    result: str
    seconds: float
    by: str = ""


def meaning(code: str) -> str | None:
    """Return the syntax tree without what has no effect on right input; None where the text is no Python.

    These are annotations, and ``strict`` of ``zip``, which only checks that lengths agree.
    """
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.arg):
            node.annotation = None
        elif isinstance(node, ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.Call):
            node.keywords = [one for one in node.keywords if one.arg != "strict"]
    return ast.dump(tree)


def mutants(path: str, seed: int) -> Iterator[tuple[str, Mutant]]:
    """Yield (rank, mutant) of one file in the order of the ranks, which only the seed and the mutated line decide."""
    from cosmic_ray.ast import ast_nodes, get_ast
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator

    code = (ROOT / path).read_text(encoding="utf-8")
    lines, same = code.splitlines(), meaning(code)
    nodes, seen, places = list(ast_nodes(get_ast(code))), Counter[str](), []
    for name in OPERATORS:
        found = [place for node in nodes for place in get_operator(name)().mutation_positions(node)]
        for occurrence, ((row, _), _) in enumerate(found):
            label = f"{seed} {path} {name} {lines[row - 1].strip()}"
            seen[label] += 1
            places.append((hashlib.sha256(f"{label} {seen[label]}".encode()).hexdigest(), name, occurrence))
    for rank, name, occurrence in sorted(places):
        text = mutate_code(code, get_operator(name)(), occurrence)
        tree = None if text is None else meaning(text)
        if text is not None and tree not in (None, same):
            changed = [k for k, (a, b) in enumerate(zip(lines, text.splitlines(), strict=False)) if a != b]
            k = changed[0]
            yield rank, Mutant(path, k + 1, lines[k].strip(), text.splitlines()[k].strip(), text)


def sample(rooms: Sequence[str], size: int, seed: int) -> tuple[list[Mutant], int]:
    """Return mutants of some rooms, and how many equivalent ones were passed over.

    Each is of a file that is drawn with a probability by its lines, the next one of that file by rank.
    """
    listed = {(one["path"], one["was"], one["becomes"]) for one in tomllib.loads(EQUIVALENT.read_text())["mutant"]}
    paths = files(rooms)
    lines = [len((ROOT / path).read_text(encoding="utf-8").splitlines()) for path in paths]
    ranked = {path: mutants(path, seed) for path in dict.fromkeys(paths)}
    rng, chosen, equivalent = random.Random(seed), list[Mutant](), 0
    while len(chosen) < size and any(lines):
        (path,) = rng.choices(paths, lines)
        _, mutant = next(ranked[path], ("", None))
        if mutant is None:  # all mutants of this file are drawn
            lines[paths.index(path)] = 0
        elif mutant.key in listed:
            equivalent += 1
        else:
            chosen.append(mutant)
    return chosen, equivalent


def rooms() -> list[str]:
    """Return the rooms of the package, an application each by itself."""
    folders = [path for path in sorted((ROOT / SOURCE).iterdir()) if path.is_dir() and path.name[0].isalpha()]
    apps = [path for path in sorted((ROOT / SOURCE / "apps").iterdir()) if path.is_dir() and path.name[0].isalpha()]
    single = [path for path in sorted((ROOT / SOURCE / "apps").glob("*.py")) if path.name != "__init__.py"]
    inside = [path for path in folders if path.name not in ("apps", "testing")]
    return [path.relative_to(ROOT / SOURCE).with_suffix("").as_posix() for path in (*inside, *apps, *single)]


def room_of(path: str) -> str:
    """Return the room that a file is in."""
    inner = Path(path).relative_to(SOURCE).with_suffix("")
    return "/".join(inner.parts[: 2 if inner.parts[0] == "apps" else 1])


def files(rooms: Sequence[str]) -> list[str]:
    """Return the files of rooms, from the root of the project, without those that only gather names."""
    paths = (path.relative_to(ROOT).as_posix() for path in sorted((ROOT / SOURCE).rglob("*.py")))
    return [path for path in paths if not path.endswith("__init__.py") and room_of(path) in rooms]


def tests_of(path: str, root: Path) -> tuple[str, ...]:
    """Return the tests below ``root``: the nearest to the file, its examples, those of its folder and of its room.

    Folders are given file by file: pytest takes a file that is named with its folder in the folder's order.
    """
    folder, room = Path(path).relative_to(SOURCE).parent, Path(room_of(path))
    near = [*sorted((root / "tests" / folder).glob("test_*.py")), *sorted((root / "tests" / room).rglob("test_*.py"))]
    alone = root / "tests" / room.parent / f"test_{room.name}.py"
    others = (file.relative_to(root).as_posix() for file in (*near, *([alone] if alone.exists() else [])))
    return tuple(dict.fromkeys([*nearest(path, root), path, *others]))


def nearest(path: str, root: Path) -> list[str]:
    """Return the tests in the folder of a file that are named like it, then those that import what it defines.

    Those that import the most of it come first.
    """
    inner, definitions = Path(path).relative_to(SOURCE), ast.FunctionDef | ast.ClassDef
    tree = ast.parse((root / path).read_text(encoding="utf-8"))
    defined = {node.name for node in tree.body if isinstance(node, definitions)}
    shares = dict[str, float]()
    for test in sorted((root / "tests" / inner.parent).glob("test_*.py")):
        nodes = ast.walk(ast.parse(test.read_text(encoding="utf-8")))
        imported = {name.name for node in nodes if isinstance(node, ast.ImportFrom) for name in node.names}
        named = test.stem in (f"test_{inner.stem}", f"test_{inner.parent.name}")
        if share := float("inf") if named else len(defined & imported):
            shares[test.relative_to(root).as_posix()] = share
    return sorted(shares, key=lambda test: (-shares[test], test))


def digest(root: Path, *paths: str) -> str:
    """Return a hash of files, and of the Python files of folders, below ``root``."""
    found = [one for path in paths for one in (sorted((root / path).rglob("*.py")) or [root / path])]
    return hashlib.sha256(b"\0".join(one.read_bytes() for one in found)).hexdigest()[:16]


class Copy:
    """A copy of the project in which one file at a time is changed."""

    def __init__(self, folder: Path, times: Path) -> None:
        """``times`` is the file that keeps how long tests take without a mutant, for the project as it was then."""
        self.root, self.times = folder / "project", times
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(*SKIPPED))
        self.environment = os.environ | {"PYTHONPATH": str(self.root / "src"), "PYTHONHASHSEED": "0"}
        self.environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        self._project, self.failed = digest(self.root, "src", "tests"), ""

    def run(self, tests: tuple[str, ...], limit: float | None = None) -> str:
        """Return "survived", "killed" or "too long"; ``failed`` is the test that did."""
        options = ("-x", "-q", "--tb=no", "--no-header", "-p", "no:cacheprovider", "--hypothesis-profile=mutation")
        command = [sys.executable, "-m", "pytest", *options, *tests]
        self.failed = ""
        try:
            done = subprocess.run(command, cwd=self.root, env=self.environment, capture_output=True, timeout=limit)
        except subprocess.TimeoutExpired:
            return "too long"
        self.failed = " ".join(re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", done.stdout.decode(), re.MULTILINE))
        return "killed" if done.returncode else "survived"

    def limit(self, tests: tuple[str, ...]) -> float:
        """Return the time that the tests may take with a mutant; ends the program where they fail without one."""
        known = json.loads(self.times.read_text(encoding="utf-8")) if self.times.exists() else {}
        key = " ".join((self._project, *tests))
        if key not in known:
            start = time.monotonic()
            if self.run(tests) != "survived":
                sys.exit(f"These tests fail without a mutant ({self.failed}): {' '.join(tests)}")
            known[key] = round(time.monotonic() - start, 1)
            self.times.write_text(json.dumps(known, indent=1), encoding="utf-8")
        return SLOWER * float(known[key]) + AT_LEAST

    def try_out(self, mutant: Mutant, tests: tuple[str, ...], limit: float) -> str:
        """Return what becomes of a mutant, and put its file back."""
        target = self.root / mutant.path
        before = target.read_text(encoding="utf-8")
        try:
            self._write(target, mutant.code)
            return self.run(tests, limit)
        finally:
            self._write(target, before)

    @staticmethod
    def _write(target: Path, code: str) -> None:
        target.write_text(code, encoding="utf-8")
        for old in (target.parent / "__pycache__").glob(f"{target.stem}.*.pyc"):
            old.unlink()  # it may have the same size and second as the new text


def known(out: Path) -> dict[tuple[str, str, str, int], Outcome]:
    """Return the outcomes of earlier runs, the last of each mutant."""
    lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    found = [Outcome(**json.loads(line)) for line in lines]
    return {(one.path, one.was, one.becomes, one.line): one for one in found}


def holds(old: Outcome | None, source: str, tests: str) -> bool:
    """Tell whether an outcome stands: its file is the same, and a survivor's tests are."""
    return old is not None and old.source == source and (old.result != "survived" or old.tests == tests)


def run(names: Sequence[str], size: int, seed: int, out: Path) -> tuple[dict[str, list[Outcome]], int]:
    """Try a sample of the rooms, without what an earlier run has tried; one line to ``out`` for each mutant.

    Returns the outcomes by room, and how many equivalent mutants the sample has passed over.
    """
    before, outcomes = known(out), defaultdict[str, list[Outcome]](list)
    out.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        drawn, equivalent = sample(names, size, seed)
        # all further is of the copy: the project may change meanwhile
        copy = Copy(Path(folder), out.with_name("times.json"))
        for count, mutant in enumerate(drawn, start=1):
            tests = tests_of(mutant.path, copy.root)
            source, checks = digest(copy.root, mutant.path), digest(copy.root, *tests)
            outcome = before.get((mutant.path, mutant.was, mutant.becomes, mutant.line))
            if outcome is None or not holds(outcome, source, checks):
                limit, start = copy.limit(tests), time.monotonic()
                place = (mutant.path, mutant.line, mutant.was, mutant.becomes)
                result = copy.try_out(mutant, tests, limit)
                outcome = Outcome(*place, source, checks, result, round(time.monotonic() - start, 1), copy.failed)
                with out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(outcome)) + "\n")
                words = f"{outcome.result:9} {outcome.seconds:6.1f} s  {outcome.path}:{outcome.line}  {outcome.by}"
                print(f"{count} of {len(drawn)}: {words}", flush=True)
            outcomes[room_of(mutant.path)].append(outcome)
    return outcomes, equivalent


def show(outcomes: Mapping[str, Sequence[Outcome]], equivalent: int) -> None:
    """Print the survivors as differences, then the score of each room: of the mutants tried, those noticed."""
    for survivor in (one for tried in outcomes.values() for one in tried if one.result == "survived"):
        print(f"\n{survivor.path}:{survivor.line}")
        differences = difflib.ndiff([survivor.was], [survivor.becomes])
        print("\n".join(line for line in differences if line[0] in "+-"))
    counts = {
        room: Counter("survived" if one.result == "survived" else "killed" for one in tried)
        for room, tried in sorted(outcomes.items())
    }
    counts["all"] = sum(counts.values(), Counter())
    print(f"\n{'room':24} tried  killed  survived    score")
    for room, of in counts.items():
        score = 100 * of["killed"] / max(of.total(), 1)
        print(f"{room:24} {of.total():5} {of['killed']:7} {of['survived']:9}  {score:5.1f} %")
    print(f"Passed over as equivalent: {equivalent}.")


def main() -> None:
    """Parse the command line, run, and print."""
    parser = argparse.ArgumentParser(prog="python3 dev.py mutate", description=__doc__)
    every = rooms()
    parser.add_argument("--only", nargs="+", choices=every, default=every, metavar="ROOM", help=", ".join(every))
    parser.add_argument("--size", type=int, default=60, help="mutants, of all rooms together (default 60)")
    parser.add_argument("--seed", type=int, default=0, help="another seed, another sample")
    parser.add_argument("--out", type=Path, default=ROOT / "mutate-out" / "outcomes.jsonl", help="outcomes, to resume")
    given = parser.parse_args()
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    show(*run(given.only, given.size, given.seed, given.out))


if __name__ == "__main__":
    main()
