"""Speed and memory beside the peers, in one run: python3 dev.py bench [PART ...].

Parts: the tables of performance_measured.md by their names, "marks" for all of these, "growth" for its plots, and
"peers" for the errors on measured robots beside those of others (defaults_peers.py); all where none is named.

Every work is done in processes of its own, with the kernel, without it and by its peers in turn, with one BLAS thread;
figures are the best of several repetitions, so that ratios are of the same seconds, and a busy machine disturbs little.
--json keeps the figures in a file, with those that it has of other parts. --page does so in out/performance.json, and
writes the tables and plots of benchmarks/performance_measured.md; --draw does without measuring.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from marks import TABLES, works
from measure import Figure, measured
from page_tables import DOCS, read_figures, write_figures
from tables import FIGURES, PAGE, page, pictures, summary, table

HERE = Path(__file__).parent
PARTS = (*TABLES, "growth", "peers")
FACTS = """
import json, os, platform, sys, time
from pathlib import Path
import numpy, scipy, dynident
from dynident.runtime.kernel import kernel
cpu = Path("/proc/cpuinfo")
names = [line.partition(":")[2].strip() for line in cpu.read_text().splitlines() if line.startswith("model name")] \
    if cpu.exists() else []
print(json.dumps({"date": time.strftime("%d %B %Y"), "dynident": dynident.__version__, "kernel": str(kernel()),
    "level": kernel().level, "processor": names[0] if names else platform.machine(), "cores": os.cpu_count(),
    "system": platform.system(), "python": platform.python_version(), "numpy": numpy.__version__,
    "scipy": scipy.__version__, "load": round(os.getloadavg()[0], 1)}))
"""


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"{', '.join((*PARTS, 'marks'))}")
    parser.add_argument("--json", type=Path, metavar="FILE", help="keep the figures in a file")
    parser.add_argument(
        "--page", action="store_true", help="keep them for benchmarks/performance_measured.md, and write it"
    )
    parser.add_argument(
        "--draw", action="store_true", help="write benchmarks/performance_measured.md from the figures that it has"
    )
    given = parser.parse_args(arguments)
    if wrong := [name for name in given.parts if name not in (*PARTS, "marks")]:
        parser.error(f"unknown part {wrong[0]!r}; known: {', '.join((*PARTS, 'marks'))}")
    if os.name == "nt":
        parser.error("Windows does not tell what a process has used; run the benchmarks on Linux or macOS.")
    file = FIGURES if given.page or given.draw else given.json
    parts = [part for name in given.parts for part in (TABLES if name == "marks" else [name])] or list(PARTS)
    if "peers" in parts and not given.draw:
        subprocess.run([sys.executable, HERE / "defaults_peers.py", *["--page"] * given.page], check=True)
    if parts == ["peers"]:  # it has a page of its own
        return
    if not given.draw:
        bench([part for part in parts if part != "peers"], file)
    if given.page or given.draw:
        draw()


def bench(parts: list[str], file: Path | None) -> None:
    """Measure the works of some parts; print their tables, and keep the figures in a file."""
    machine = facts()
    if not machine["level"]:
        print(f"There is no compiled kernel here: {machine['kernel']}; it is not measured.", file=sys.stderr)
    kept = read_figures(file).get("works", {}) if file else {}
    result: dict[str, Any] = {}
    todo = works(parts)
    for k, work in enumerate(todo, start=1):
        began = time.monotonic()
        ways = work.ways if machine["level"] else tuple(way for way in work.ways if way != "with")
        figures = measured(replace(work, ways=ways))
        result[work.key] = {way: kept_of(x) for way, x in figures.items()}
        print(f"{k} of {len(todo)}, {time.monotonic() - began:.0f} s: {told(work.key, result)}", flush=True)
        if file:  # after each, so that a run that is stopped has kept what it has
            reference = {
                key: kept[key] | result.get(key, {}) if key in kept else result[key] for key in (*kept, *result)
            }
            write_figures({"machine": machine, "works": reference}, file)
    for name in parts:
        if name in TABLES:
            print(f"\n{table(TABLES[name], result)}")
    print(f"\n{summary(parts, result)}")


def kept_of(figure: Figure | str) -> dict[str, float] | str:
    """What is kept of a figure: four digits, or why there is none."""
    if isinstance(figure, str):
        return figure
    return {name: float(f"{value:.4g}") for name, value in asdict(figure).items()}


def facts() -> dict[str, Any]:
    """What the figures are taken on."""
    best = {name: value for name, value in os.environ.items() if name != "DYNIDENT_KERNEL"}
    done = subprocess.run([sys.executable, "-c", FACTS], check=True, capture_output=True, text=True, env=best)
    return dict(json.loads(done.stdout))


def told(key: str, result: Mapping[str, Any]) -> str:
    """A work and its figures, in a line."""
    costs = (f"{way} {x['cpu']:.4g} s" if isinstance(x, Mapping) else f"{way} -" for way, x in result[key].items())
    return f"{key}: {', '.join(costs)}"


def draw() -> None:
    """Write the page with its plots from the figures that are kept."""
    kept = read_figures(FIGURES)
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8"), kept["machine"], kept["works"]), encoding="utf-8")
    for name, text in pictures(kept["works"]).items():
        (DOCS / f"growth_{name}.svg").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
