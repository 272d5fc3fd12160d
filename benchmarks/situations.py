"""Wrong situations of simulated robots, and who finds them: python3 benchmarks/situations.py --out table.jsonl.

Each situation is a project on disk as a user has it (URDF, CSV, YAML). It is examined as ``dynident check`` does, and
identified and judged as ``dynident identify`` does, by each estimator. Printed: who found what is wrong (only
findings that the same robot without a fault does not have), the verdict, and the torque error (%) on the held-out log
and on a motion twice as fast that was never seen, against the true torque, and against it as that system would show
it. Where the cause has a name, whether it is named, and stands first among what to set right.

A line of JSON per run is appended to --out, where runs that are there already are left out; --table prints such a file.
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from situation_arm import RATE, Built, build
from situation_list import CAUSES, SITUATIONS, Situation

from dynident.checks import CheckResult
from dynident.checks.missing import TRIED_KINDS
from dynident.checks.robot_notes import MissingTerm
from dynident.identification import Identification, judge
from dynident.identification.terms import TrialOutcome
from dynident.identification.verdict import Verdict
from dynident.identification.verdict_reasons import ForbiddingFindings
from dynident.identification.verdict_steps import SetRight
from dynident.motion.log import Motion
from dynident.project.project import Project, read_project
from dynident.runtime import DynidentError, Finding, Severity

ESTIMATORS = ("least_squares", "consistent", "maximum_likelihood")
CONTROL = {"three": "right", "six": "right-six"}  # what a right robot's findings are
Row = dict[str, Any]


def run(situation: Situation, estimator: str, seed: int = 0) -> Row:
    """Return what check, identify and its verdict say of one situation, by one estimator."""
    began = time.perf_counter()
    row: Row = {"name": situation.name, "estimator": estimator, "arm": situation.setup.arm, "seed": seed}
    row |= {"shown": situation.shown.name.lower(), "wrong": situation.wrong}
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        built = build(situation.setup, Path(folder), estimator, seed)
        try:
            project = read_project(built.config)
            row |= _checked(project)
            row |= _identified(project, built)
        except DynidentError as error:
            row |= {"verdict": "refused", "error": str(error).replace(folder, ".")}
    return row | {"seconds": round(time.perf_counter() - began, 2)}


def _checked(project: Project) -> Row:
    result: CheckResult = project.examine()
    kept = [finding for finding in result.findings if finding.severity is not Severity.INFO]
    return {"check": sorted({(_kind(x.message), x.joint or "") for x in kept})}


def _identified(project: Project, built: Built) -> Row:
    result = project.identify()
    verdict = judge(result)
    held = None if verdict.held_out is None else verdict.held_out.error
    noted = [note for note in result.notes if note.severity is not Severity.INFO]
    moved = [note for note in result.notes if note.severity is Severity.INFO]
    return {
        "verdict": verdict.use.value,
        "reasons": sorted(
            {
                _kind(reason.findings[0].message if isinstance(reason, ForbiddingFindings) else reason)
                for reason in verdict.reasons
            }
        ),
        "warnings": sorted({_kind(x) for x in noted}),
        "notes": sorted({_kind(x) for x in moved}),
        "causes": sorted({*map(_cause, [*result.findings, *result.notes]), *map(_kind, verdict.reasons)}),
        "first": next(iter(_named_causes(verdict)), None),
        "settled": sorted(_settled(result)),
        "training": _rounded(
            max(validation.errors.relative_error for validation in result.validations if validation.role == "train")
        ),
        "held_out": _rounded(held),
        "faster": _rounded(_error(result, built, built.torque)),
        "as_shown": _rounded(_error(result, built, built.seen)),
    }


def _named_causes(verdict: Verdict) -> Iterator[str]:
    """Yield the causes that a verdict names: those that forbid a use, then what it says to set right."""
    yield from (_cause(reason.findings[0]) for reason in verdict.reasons if isinstance(reason, ForbiddingFindings))
    yield from (_cause(x.finding) for x in verdict.next if isinstance(x, SetRight))


def _settled(identification: Identification) -> Iterator[str]:
    """Yield the causes that an identification has set right by itself."""
    offset, tilt, terms = (getattr(identification.calibration, name) for name in ("time_offset", "base_tilt", "terms"))
    yield from ["TimeOffset"] * bool(offset and offset.seconds)
    yield from ["TiltedBase"] * bool(tilt and (tilt.x or tilt.y))
    entered = {x.kind.split()[0] for x in (terms.trials if terms else ()) if x.outcome is TrialOutcome.ENTERED}
    yield from (effect.value for effect, kinds in TRIED_KINDS.items() if kinds & entered)


def _error(identification: Identification, built: Built, torque: np.ndarray) -> float:
    """Return the relative error (%) of the torque on the faster motion; the model may have fewer joints."""
    n, model = len(identification.model.joints), identification.model
    t, mask = np.arange(len(built.q)) / RATE, np.ones(len(built.q), dtype=bool)
    states = built.q[:, :n], built.dq[:, :n], built.ddq[:, :n]
    motion = model.remembering(Motion(t, *states, torque[:, :n], tuple(joint.name for joint in model.joints), mask))
    said = model.torque(*states, identification.estimate.value, motion.memory)
    return float(100 * np.linalg.norm(torque[:, :n] - said) / np.linalg.norm(torque[:, :n]))


def _kind(said: object) -> str:
    """Return the type of a note; of a text its first words."""
    return type(said).__name__ if not isinstance(said, str) else f"{said[:40]!r}"


def _cause(said: object) -> str:
    """Return what is named as a cause: the effect of a missing term, else the type of the note."""
    note = said.message if isinstance(said, Finding) else said
    return note.effect.value if isinstance(note, MissingTerm) else _kind(note)


def _named(row: Row) -> str:
    """Return whether the cause is named: first, set right unasked, or at all; empty where it has no name."""
    cause = CAUSES.get(row["name"])
    if cause is None or "causes" not in row:
        return ""
    if row["first"] == cause:
        return "first"
    return "itself" if cause in row.get("settled", ()) else "yes" if cause in row["causes"] else "no"


def _rounded(x: float | None) -> float | None:
    return None if x is None or not np.isfinite(x) else float(f"{x:.4g}")


def known(file: Path | None, seed: int = 0) -> dict[tuple[str, str], Row]:
    """Return the rows of a file with this seed by situation and estimator."""
    if file is None or not file.exists():
        return {}
    rows = map(json.loads, file.read_text().splitlines())
    return {(row["name"], row["estimator"]): row for row in rows if row.get("seed", 0) == seed}


def table(done: dict[tuple[str, str], Row]) -> Iterator[str]:
    """Yield lines of the table, and the counts at the end."""
    numbers = " ".join(f"{name:>8s}" for name in ("train", "held", "faster", "as shown"))
    yield f"{'situation':22s} {'estimator':10s} {'shown':6s} {'by':9s} {'named':6s} {'verdict':12s}{numbers}  findings"
    counts: dict[str, int] = {}
    for row in done.values():
        check, judged = own(row, done)
        by = "check" if check and not judged else "identify" if judged and not check else "both" if check else "nobody"
        good = row["verdict"].startswith("good")
        if row["shown"] == "yes":
            kind = "found, good" if good and by != "nobody" else "good in silence" if good else "stopped"
        else:
            kind = f"{row['shown']}: {'good' if good else 'stopped'}{'' if by == 'nobody' else ', with findings'}"
        counts[f"{row['estimator']}: {kind}"] = counts.get(f"{row['estimator']}: {kind}", 0) + 1
        numbers = " ".join(f"{_cell(row.get(k)):>8s}" for k in ("training", "held_out", "faster", "as_shown"))
        short = row["verdict"].replace("good for ", "")
        said = "; ".join([f"check {', '.join(check)}"] * bool(check) + [f"identify {', '.join(judged)}"] * bool(judged))
        head = f"{row['name']:22s} {row['estimator'][:10]:10s} {row['shown']:6s}"
        yield f"{head} {by:9s} {_named(row):6s} {short:12s}{numbers}  {said}"
        if named := _named(row):
            key = f"{row['estimator']}: cause named: {named}"
            counts[key] = counts.get(key, 0) + 1
    yield ""
    yield from (f"{name}: {count}" for name, count in sorted(counts.items()))


def own(row: Row, done: dict[tuple[str, str], Row]) -> tuple[list[str], list[str]]:
    """Return the findings of check, and of identify, that the right robot does not have."""
    base = done.get((CONTROL[row["arm"]], row["estimator"]), {}) if row["shown"] != "right" else {}
    check = sorted({kind for kind, _ in row.get("check", [])} - {kind for kind, _ in base.get("check", [])})
    if row["verdict"] == "refused":
        return check, ["refused"]
    said = {*row["reasons"], *row["warnings"]} - {*base.get("reasons", []), *base.get("warnings", [])}
    usual = {"NoFreeRun", "InertiasFree", "Undetermined"}
    return check, sorted(said - usual)


def _cell(x: float | None) -> str:
    return "-" if x is None else f"{x:.3g}"


def chosen(only: Iterable[str]) -> list[Situation]:
    """Return the situations of these names (none: all), and the right robots that they are compared with."""
    names = set(only)
    if unknown := names - {x.name for x in SITUATIONS}:
        raise SystemExit(f"no such situation: {', '.join(sorted(unknown))}; {', '.join(x.name for x in SITUATIONS)}")
    bases = {CONTROL[x.setup.arm] for x in SITUATIONS if x.name in names}
    return sorted([x for x in SITUATIONS if not names or x.name in names | bases], key=lambda x: x.name not in bases)


def main() -> None:
    """Run what is asked for, and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", default=[], metavar="NAME", help="situations to run (default: all)")
    parser.add_argument("--estimator", nargs="*", choices=ESTIMATORS, default=list(ESTIMATORS))
    parser.add_argument("--seed", type=int, default=0, help="of bodies, noise and paths (default: 0)")
    parser.add_argument("--out", type=Path, help="file of JSON lines; runs that are in it are not run again")
    parser.add_argument("--table", type=Path, nargs="*", default=[], help="print the tables of such files, run nothing")
    parser.add_argument("--keep", type=Path, help="write the projects of --only into this folder, run nothing")
    args = parser.parse_args()
    for file in args.table:
        print("\n".join([f"{file}:", *table(known(file, args.seed))]))
    if args.table:
        return
    if args.keep:
        for case in chosen(args.only):
            (args.keep / case.name).mkdir(parents=True, exist_ok=True)
            print(build(case.setup, args.keep / case.name, args.estimator[0], args.seed).config)
        return
    done = known(args.out, args.seed)
    for situation in chosen(args.only):
        for estimator in args.estimator:
            if (situation.name, estimator) in done:
                continue
            row = run(situation, estimator, args.seed)
            row = json.loads(json.dumps(row))
            done[situation.name, estimator] = row
            if args.out:
                with args.out.open("a") as file:
                    file.write(json.dumps(row) + "\n")
            print(f"{row['name']}, {estimator}: {row['verdict']}, {row['seconds']} s", flush=True)
    names = {x.name for x in chosen(args.only)}
    print("\n".join(table({key: row for key, row in done.items() if key[0] in names and key[1] in args.estimator})))


if __name__ == "__main__":
    main()
