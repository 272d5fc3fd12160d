"""Mutation score: how many small faults, put into the source one at a time, do the tests notice?

cosmic-ray makes the mutants. Its own runner edits the checkout and runs one command for all of them; here a sample is
drawn from all rooms, each file as often as it has lines, and each mutant is put into a copy of the project. Once all
tests run with coverage, which tells those that run a line: of a mutant these run, the nearest first, until one fails.
"""

from __future__ import annotations

import argparse
import ast
import builtins
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
from collections.abc import Collection, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Lock

ROOT = Path(__file__).resolve().parents[1]
SOURCE = Path("src/dynident")
EQUIVALENT = ROOT / "benchmarks" / "mutation_equivalent.toml"
MEMORY = 8 << 30  # bytes that a mutant may take, where the system can limit it
MAX_TESTS, MAX_TIME = 150, 400.0  # tests of a mutant at most, the nearest; seconds, after which it is taken as noticed
# tests that compare all that is shown or written: they see what runs when a file is imported, and are never too far
WIDE = tuple(f"tests/laws/test_{x}.py" for x in ("written", "shown", "sentences", "values", "printed"))
# tests that compare what the package holds, and run no line of it
LISTS = (
    "tests/laws/test_data.py::test_data_cannot_be_changed_and_arrays_are_not_compared",
    "tests/laws/test_defaults.py::test_no_default_changes_unseen",
)
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

    These are annotations, whether arguments are given by name, ``strict`` of ``zip``, which only compares lengths, and
    the ``maxsize`` of caches.
    """
    try:
        tree = ast.parse(code)
    except SyntaxError:
        return None
    for node in ast.walk(tree):
        if isinstance(node, ast.arg | ast.AnnAssign):
            node.annotation = ast.Constant(None)
        elif isinstance(node, ast.arguments):
            node.args, node.posonlyargs, node.kwonlyargs = [*node.posonlyargs, *node.args, *node.kwonlyargs], [], []
            node.defaults, node.kw_defaults = [*node.defaults, *filter(None, node.kw_defaults)], []
        elif isinstance(node, ast.FunctionDef):
            node.returns = None
        elif isinstance(node, ast.Call):
            node.keywords = [keyword for keyword in node.keywords if keyword.arg not in ("strict", "maxsize")]
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
        result = [place for node in nodes for place in get_operator(name)().mutation_positions(node)]
        for occurrence, ((row, _), _) in enumerate(result):
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
    listed = {
        (entry["path"], entry["was"], entry["becomes"]) for entry in tomllib.loads(EQUIVALENT.read_text())["mutant"]
    }
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


class Coverage:
    """Which tests run which lines of the source, from one run of all tests without a mutant."""

    def __init__(self, file: Path, root: Path) -> None:
        """``file`` is what coverage has written, ``root`` the project as it was then."""
        from coverage.sqldata import CoverageData

        data = CoverageData(str(file))
        data.read()
        self.root = root
        self.by_line = {
            path: {
                line: {context.split("|")[0] for context in contexts if context}
                for line, contexts in data.contexts_by_lineno(path).items()
            }
            for path in files(rooms())
        }
        self.size = Counter(test for lines in self.by_line.values() for tests in lines.values() for test in tests)

    def tests_of(self, path: str, line: int) -> list[str]:
        """Return the tests that run a line, those first that run the fewest others: they are the nearest and fastest.

        What stands outside functions runs when a file is imported, and no test can be named for it. Of a constant these
        are then the tests that run a line with its name, of the head of a function those of its body, else of the file,
        and all that are ``WIDE``. Of these none is left out for being far. All but the lines of functions are in
        ``LISTS``.
        """
        statement, is_inside = innermost_statement((self.root / path).read_text(encoding="utf-8"), line)
        if isinstance(statement, ast.Assign | ast.AnnAssign) and not is_inside:
            names = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)} - set(dir(builtins))
            tests = self._tests_with(names)
        elif is_inside or isinstance(statement, ast.FunctionDef):
            tests = self._union(path, range(statement.lineno, (statement.end_lineno or line) + 1))
        else:
            tests = self._union(path, self.by_line[path])
        wide = {test for test in self.size if test.startswith(WIDE)}
        is_head = isinstance(statement, ast.FunctionDef)
        tests |= set() if is_inside or is_head else wide
        # a table of lambdas is a constant, too: who runs one of them comes first
        runs_line = self.by_line[path].get(line, set[str]())
        nearest = sorted(tests | runs_line, key=lambda test: (test not in runs_line, self.size[test], test))
        lists = [] if is_inside and not is_head else list(LISTS)
        return lists + nearest[:MAX_TESTS] + [test for test in nearest[MAX_TESTS:] if test in wide]

    def _union(self, path: str, lines: Collection[int]) -> set[str]:
        return set[str]().union(*(self.by_line[path].get(line, set[str]()) for line in lines))

    def _tests_with(self, names: Collection[str]) -> set[str]:
        """Return the tests that run a line of any file with one of some names, or that lie in a file with one."""
        word, tests = re.compile(r"\b(" + "|".join(map(re.escape, names)) + r")\b"), set[str]()
        for file in {test.split("::")[0] for test in self.size}:
            if word.search((self.root / file).read_text(encoding="utf-8")):
                tests |= {test for test in self.size if test.startswith(f"{file}::")}
        for path in self.by_line:
            text = (self.root / path).read_text(encoding="utf-8").splitlines()
            tests |= self._union(path, [k + 1 for k, content in enumerate(text) if word.search(content)])
        return tests


def innermost_statement(code: str, line: int) -> tuple[ast.stmt, bool]:
    """Return the innermost statement on a line, of which compound ones only have their head; is it in a function?"""
    statement, is_inside = ast.parse(code).body[0], False
    nodes: list[ast.AST] = [ast.parse(code)]
    while nodes := [node for outer in nodes for node in ast.iter_child_nodes(outer)]:
        nodes = [x for x in nodes if getattr(x, "lineno", line) <= line <= (getattr(x, "end_lineno", 0) or line)]
        for node in nodes:
            if isinstance(node, ast.stmt):
                is_inside = is_inside or isinstance(statement, ast.FunctionDef)
                statement = node
    return statement, is_inside


def digest(root: Path, *paths: str) -> str:
    """Return a hash of files, and of the Python files of folders, below ``root``."""
    files = [file for path in paths for file in (sorted((root / path).rglob("*.py")) or [root / path])]
    return hashlib.sha256(b"\0".join(file.read_bytes() for file in files)).hexdigest()[:16]


def limit_memory() -> None:
    """Limit the memory of this process, where the system can: sanitizers and browsers of other tests need more."""
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))


class Copy:
    """A copy of the project in which one file at a time is changed."""

    def __init__(self, folder: Path) -> None:
        self.root, self.failed = folder / "project", ""
        shutil.copytree(ROOT, self.root, ignore=shutil.ignore_patterns(*SKIPPED))
        shared = ROOT.parent / "shared"  # recordings that some tests need
        if shared.exists():
            (folder / "shared").symlink_to(shared)
        self.environment = os.environ | {"PYTHONPATH": str(self.root / "src"), "PYTHONHASHSEED": "0"}
        self.environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}

    def measure(self, file: Path) -> Coverage:
        """Return what tests run, by ``file`` where that is of the same project; ends the program where a test fails."""
        state = file.with_suffix(".of")
        if not (file.exists() and state.exists() and state.read_text() == digest(self.root, "src", "tests")):
            settings = self.root / ".coveragerc"
            settings.write_text("[run]\nsource = dynident\nrelative_files = true\n", encoding="utf-8")
            options = ("--cov=dynident", "--cov-context=test", "--cov-report=", "-q", "--tb=short")
            two = ("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder", "--ignore=tests/browser")
            command = [sys.executable, "-m", "pytest", *two, *options]
            if subprocess.run(command, cwd=self.root, env=self.environment | {"COVERAGE_FILE": str(file)}).returncode:
                sys.exit("Tests fail without a mutant.")
            state.write_text(digest(self.root, "src", "tests"))
        return Coverage(file, self.root)

    def run(self, tests: Sequence[str]) -> str:
        """Return "survived", "killed" or "too long"; ``failed`` is the test that did."""
        options = ("-x", "-q", "--tb=no", "--no-header", "-p", "no:cacheprovider", "--hypothesis-profile=mutation")
        self.failed, command = "", [sys.executable, "-m", "pytest", *options, *tests]
        try:
            done = subprocess.run(
                command, cwd=self.root, env=self.environment, capture_output=True, timeout=MAX_TIME,
                preexec_fn=limit_memory,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return "too long"
        self.failed = " ".join(re.findall(r"^(?:FAILED|ERROR) (.+?)(?: - |$)", done.stdout.decode(), re.MULTILINE))
        return "killed" if done.returncode else "survived"

    def try_out(self, mutant: Mutant, tests: Sequence[str]) -> str:
        """Return what becomes of a mutant, and put its file back; a test that fails without it, too, does not count."""
        target, remaining = self.root / mutant.path, list(tests)
        before = target.read_text(encoding="utf-8")
        while remaining:
            try:
                self._write(target, mutant.code)
                result, failed = self.run(remaining), self.failed
            finally:
                self._write(target, before)
            is_named = result == "killed" and failed in remaining
            if not is_named or self.run(remaining[: remaining.index(failed) + 1]) != "killed":
                self.failed = failed
                return result
            remaining.remove(self.failed or failed)
        return "survived"

    @staticmethod
    def _write(target: Path, code: str) -> None:
        target.write_text(code, encoding="utf-8")
        for old in (target.parent / "__pycache__").glob(f"{target.stem}.*.pyc"):
            old.unlink()  # it may have the same size and second as the new text


def known(out: Path) -> dict[tuple[str, str, str, int], Outcome]:
    """Return the outcomes of earlier runs, the last of each mutant."""
    lines = out.read_text(encoding="utf-8").splitlines() if out.exists() else []
    result = [Outcome(**json.loads(line)) for line in lines]
    return {(entry.path, entry.was, entry.becomes, entry.line): entry for entry in result}


def holds(old: Outcome | None, source: str, tests: str) -> bool:
    """Tell whether an outcome stands: its file is the same, and a survivor's tests are."""
    return old is not None and old.source == source and (old.result != "survived" or old.tests == tests)


def run(names: Sequence[str], size: int, seed: int, out: Path) -> tuple[dict[str, list[Outcome]], int]:
    """Try a sample of the rooms, two at a time, without what was tried before; one line to ``out`` for each mutant.

    Returns the outcomes by room, and how many equivalent mutants the sample has passed over.
    """
    before, outcomes = known(out), defaultdict[str, list[Outcome]](list)
    out.parent.mkdir(parents=True, exist_ok=True)
    copies, lock = SimpleQueue[Copy](), Lock()
    with tempfile.TemporaryDirectory() as folder:
        drawn, equivalent = sample(names, size, seed)
        for name in ("a", "b"):
            (Path(folder) / name).mkdir()
            copies.put(Copy(Path(folder) / name))
        pristine = Copy(Path(folder))
        coverage = pristine.measure(out.with_name("coverage.sqlite").resolve())

        def try_mutant(mutant: Mutant) -> Outcome:
            tests = coverage.tests_of(mutant.path, mutant.line)
            source = digest(pristine.root, mutant.path)
            checks = digest(pristine.root, *dict.fromkeys(test.split("::")[0] for test in tests))
            outcome = before.get((mutant.path, mutant.was, mutant.becomes, mutant.line))
            if outcome is None or not holds(outcome, source, checks):
                copy, start = copies.get(), time.monotonic()
                result = copy.try_out(mutant, tests)
                place, seconds = (mutant.path, mutant.line, mutant.was, mutant.becomes), time.monotonic() - start
                outcome = Outcome(*place, source, checks, result, round(seconds, 1), copy.failed)
                copies.put(copy)
                with lock, out.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(outcome)) + "\n")
                words = f"{result:9} {seconds:6.1f} s  {len(tests):3} tests  {mutant.path}:{mutant.line}  {outcome.by}"
                print(words, flush=True)
            return outcome

        with ThreadPoolExecutor(2) as pool:
            for outcome in pool.map(try_mutant, drawn):
                outcomes[room_of(outcome.path)].append(outcome)
    return outcomes, equivalent


def show(outcomes: Mapping[str, Sequence[Outcome]], equivalent: int) -> None:
    """Print the survivors as differences, then the score of each room: of the mutants tried, those noticed."""
    for survivor in (entry for tried in outcomes.values() for entry in tried if entry.result == "survived"):
        differences = difflib.ndiff([survivor.was], [survivor.becomes])
        print("\n".join([f"\n{survivor.path}:{survivor.line}", *(line for line in differences if line[0] in "+-")]))
    counts = {room: Counter(entry.result == "survived" for entry in tried) for room, tried in sorted(outcomes.items())}
    counts["all"] = sum(counts.values(), Counter())
    print(f"\n{'room':24} tried  killed  survived    score")
    for room, of in counts.items():
        score = 100 * of[False] / max(of.total(), 1)
        print(f"{room:24} {of.total():5} {of[False]:7} {of[True]:9}  {score:5.1f} %")
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
    show(*run(given.only, given.size, given.seed, given.out))


if __name__ == "__main__":
    main()
