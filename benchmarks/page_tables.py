"""Tables of a page between marks, so that a command can write them anew: ``<!-- NAME -->`` ... ``<!-- /NAME -->``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

__all__ = ["filled", "markdown"]


def filled(text: str, tables: Mapping[str, str]) -> str:
    """Return a page with its tables anew; what is between other marks stays."""
    for name, body in tables.items():
        before, _, rest = text.partition(f"<!-- {name} -->")
        text = f"{before}<!-- {name} -->\n\n{body}\n\n<!-- /{name} -->{rest.partition(f'<!-- /{name} -->')[2]}"
    return text


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
