"""Tables of a page between marks, so that a command can write them anew: ``<!-- NAME -->`` ... ``<!-- /NAME -->``."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["DOCS", "OUT", "filled", "markdown", "read_figures", "write_figures"]

DOCS = Path(__file__).resolve().parents[1] / "docs"
OUT = Path(__file__).resolve().parent / "out"  # figures of runs here, which git does not keep: the pages do


def read_figures(file: Path) -> dict[str, Any]:
    """Return the figures that earlier runs have kept, if any."""
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.exists() else {}


def write_figures(figures: Mapping[str, Any], file: Path) -> None:
    """Keep figures for ``--draw`` and for the next run."""
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def filled(text: str, tables: Mapping[str, str]) -> str:
    """Return a page with its tables anew; what is between other marks stays. ValueError where marks are missing."""
    for name, body in tables.items():
        before, start, rest = text.partition(f"<!-- {name} -->")
        _, end, after = rest.partition(f"<!-- /{name} -->")
        if not (start and end):
            raise ValueError(f"the page has no place for {name}")
        text = f"{before}{start}\n\n{body}\n\n{end}{after}"
    return text


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    first, *others = (f"| {' | '.join(line)} |" for line in (head, *rows))
    return "\n".join([first, "|" + "---|" * len(head), *others])
