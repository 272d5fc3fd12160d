"""The parts of a report, and the one HTML page made of them.

A page is a list of sections; a section is a list of blocks. Text from files and configurations is escaped; plotly.js
and the styles are part of the page, which needs no network.
"""

from __future__ import annotations

import re
import zlib
from base64 import b64encode
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.abc import ResourceLoader
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Literal
from urllib.parse import quote

from markupsafe import Markup, escape

from dynident.runtime import InputError, Noun, escape_acting, install_command

if TYPE_CHECKING:
    import jinja2

    from dynident.report.figures import Drawing

NEGATIVE = re.compile(r"(?:(?<=[ (])|^)-(?=\d)")  # in a sentence; 5-7 is a range
SUPERSCRIPTS = str.maketrans("-0123456789", "\u207b\u2070\u00b9\u00b2\u00b3\u2074\u2075\u2076\u2077\u2078\u2079")
MINUS, HARD = "\u2212", "\u00a0"
UNITS = re.compile(r"\b(N|kg|m|mm|rad|s|Hz)\^(-?\d+)\b(?!\.\d)")
POWER = re.compile(r"(?<![\w.])(-?\d+(?:\.\d+)?)e([-+]?\d+)(?![\w.]\w|\w)")
MAX_FORMULA_LENGTH = 30  # signs of a formula in a table
# in a sentence, where a name may hold 1e5
SENTENCE_POWER = re.compile(r"(?<![\w.])([-\u2212]?\d+\.\d+(?=e)|[-\u2212]?\d+(?=e[-+]))e([-+]?\d+)(?!\.?\w)")


def unit_text(text: str) -> str:
    """Return a text with the powers of its units above the line.

    >>> unit_text("N m s/rad"), unit_text("kg m^2")
    ('N m s/rad', 'kg m²')
    """
    return UNITS.sub(lambda match: f"{match[1]}{match[2].translate(SUPERSCRIPTS)}", text)


def cell(text: str) -> str:
    """Return a number with a true minus and a power of ten; a lone hyphen means that there is none, and stays.

    >>> print(cell("-1.20e-5").replace(HARD, " "), cell("-"))
    −1.20 × 10⁻⁵ -
    """
    if len(text) < 2 or hasattr(text, "__html__"):
        return text
    return unit_text(_typeset_powers(POWER, text)).replace("-", MINUS)


def sentence(text: str) -> Markup:
    """Return a sentence, escaped, with its `code` set as such, ± for +-, and no line break before %."""
    if hasattr(text, "__html__"):
        return Markup(text)  # noqa: S704 -- it is one already
    parts = re.split(r"`([^`]+)`", text)
    plain = [str(escape(typeset(part))) for part in parts[::2]]
    codes = [f"<code>{escape(part)}</code>" for part in parts[1::2]]
    return Markup("".join(piece for pair in zip(plain, [*codes, ""], strict=True) for piece in pair))  # noqa: S704 -- escaped


def typeset(text: str) -> str:
    """Return a text with ±, typeset units and powers of ten, and no line break before %."""
    plain = _typeset_powers(SENTENCE_POWER, NEGATIVE.sub(MINUS, text))
    return unit_text(plain.replace("+-", "±").replace(" %", f"{HARD}%"))


def _typeset_powers(pattern: re.Pattern[str], text: str) -> str:
    return pattern.sub(lambda match: f"{match[1]}{HARD}×{HARD}10{str(int(match[2])).translate(SUPERSCRIPTS)}", text)


@dataclass(frozen=True)
class Column:
    """A table's column: neighbours of the same ``group`` share a heading; numbers stand on the right; ``prose`` holds
    sentences, which a terminal wraps, ``unit`` units or levels, which are typeset.
    """

    title: str
    group: str = ""
    numeric: bool = True
    muted: bool = False
    prose: bool = False
    unit: bool = False


UNIT = Column("unit", numeric=False, unit=True)
MEANING = Column("meaning", numeric=False, prose=True)
Head = str | tuple[str, str] | Column  # the title of a column of numbers, alone or with its group, or another column


@dataclass(frozen=True)
class PageTable:
    """A table of texts: each row has one cell per column; ``links``, one for each row, are where its first cell leads,
    as ``relative_link`` makes them, "" for nowhere.
    """

    columns: tuple[Column, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    links: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.links and len(self.links) != len(self.rows):
            raise ValueError(f"Table {self.caption!r}: {len(self.links)} links for {len(self.rows)} rows.")
        for i, row in enumerate(self.rows):
            if len(row) != len(self.columns):
                raise ValueError(
                    f"Table {self.caption!r}: row {i} has {len(row)} cells for {len(self.columns)} columns."
                )

    @classmethod
    def of(
        cls,
        texts: Sequence[str],
        heads: Iterable[Head],
        rows: Iterable[Iterable[str]],
        caption: str = "",
        files: Iterable[str] = (),
    ) -> PageTable:
        """Return a table: columns of ``texts`` by their titles, then those of the ``heads``; rows lead to ``files``."""
        columns = [Column(title, numeric=False) for title in texts]
        for head in heads:
            columns.append(head if isinstance(head, Column) else Column(*((head,) if isinstance(head, str) else head)))
        return cls(tuple(columns), tuple(map(tuple, rows)), caption, tuple(map(relative_link, files)))

    @property
    def groups(self) -> tuple[tuple[str, int], ...]:
        """Headings above the columns, each with the number of columns it spans; empty where no column has one."""
        runs = tuple((name, len(list(run))) for name, run in groupby(column.group for column in self.columns))
        return runs if any(name for name, _ in runs) else ()


class Facts(Noun):
    """The few numbers to see first: a value, what it is and, where there is more to say, a note below it."""

    facts: tuple[tuple[str, ...], ...]
    large: bool = False


class Badge(Noun):
    """A word to see first, in the colour of its tone."""

    text: str
    tone: Literal["good", "fair", "bad"]


class Code(Noun):
    """A text that is shown as it is, line by line."""

    text: str


class Figure(Noun):
    """A figure and the sentence below it; one that moves has a ``player``, or only follows others."""

    figure: Drawing
    caption: str = ""
    player: bool = True


class PageSection(Noun):
    """A titled part of a page; text becomes a paragraph, a tuple of texts a list, a section a part of its own."""

    title: str
    blocks: tuple[PageBlock, ...]
    badge: Badge | None = None


class Fold(Noun):
    """Blocks behind their title, which a reader opens."""

    title: str
    blocks: tuple[PageBlock, ...]


class Gallery(Noun):
    """Views of which a reader sees one at a time: each has one option per label, such as its log and its joint.

    A choice holds for all galleries of the page that offer it.
    """

    labels: tuple[str, ...]
    views: tuple[tuple[tuple[str, ...], tuple[PageBlock, ...]], ...]

    @property
    def options(self) -> tuple[tuple[str, tuple[str, ...]], ...]:
        """Each label with the options among which there is a choice."""
        columns = zip(*(keys for keys, _ in self.views), strict=True)
        return tuple((label, tuple(dict.fromkeys(column))) for label, column in zip(self.labels, columns, strict=False))


class Beside(Noun):
    """Two columns of blocks that stand side by side where there is room, one a little wider."""

    left: tuple[PageBlock, ...]
    right: tuple[PageBlock, ...]
    wide: Literal["left", "right"] = "right"


PageBlock = str | tuple[str, ...] | PageTable | Facts | Code | Figure | PageSection | Fold | Gallery | Beside


def short_formula(name: str) -> str:
    """Return the formula of a base parameter; of a long one the first parameter and how many follow."""
    if len(name) <= MAX_FORMULA_LENGTH:
        return name
    lead, *others = name.replace(" - ", " + ").split(" + ")
    return f"{lead} (+{len(others)} more)" if others else name


def formula_blocks(names: Sequence[str]) -> tuple[Fold, ...]:
    """Return what the shortened formulas of base parameters stand for, where there are any."""
    rows = tuple((short_formula(name), name) for name in names if short_formula(name) != name)
    table = PageTable.of(("base parameter", "formula"), (), rows)
    return (Fold("What the base parameters stand for", (table,)),) if rows else ()


def relative_link(path: str) -> str:
    """Return the link to a file below the folder of the page, whatever its name; an empty text for others."""
    parts = path.split("/")
    return f"./{quote(path, errors='replace')}" if parts[0] and ".." not in parts else ""


def pair_table(title: str, content: Sequence[tuple[str, str]], caption: str = "") -> PageTable:
    """Return a table of names and texts, such as settings or versions."""
    return PageTable.of((title, "value" if title else ""), (), (map(str, pair) for pair in content), caption)


def render(title: str, lead: str, sections: Sequence[PageSection]) -> str:
    """Return one HTML page: title, lead, contents, sections; plotly.js is embedded once, if there is a figure.

    All texts are escaped, except those that are ``markupsafe.Markup`` already.
    """
    from dynident._version import __version__
    from dynident.runtime.kernel import kernel

    template = _environment().get_template("page.html")
    made_by = {"version": __version__, "kernel": str(kernel())}
    page = template.render(title=title, lead=lead, sections=sections, plotly=plotly_packed, **made_by)
    return escape_acting(page)


def stylesheet() -> str:
    """Return the styles of a page, for pages that are made elsewhere."""
    return _environment().get_template("page.css").render()


@cache
def _environment() -> jinja2.Environment:
    import jinja2

    loader, undefined = jinja2.PackageLoader("dynident.report"), jinja2.StrictUndefined
    environment = jinja2.Environment(
        loader=loader, autoescape=True, undefined=undefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"kind": _block_kind, "cell": cell, "said": typeset}
    environment.filters |= {"json": _figure_json, "words": sentence}
    return environment


@cache
def plotly_packed() -> str:
    """Return plotly's JavaScript deflated, in base 64: 2 MB of a page in place of 5, which the page inflates."""
    return b64encode(zlib.compress(_plotly_source(), 6)).decode("ascii")


def _plotly_source() -> bytes:
    """Return plotly's JavaScript: that of the wheel, else that of an installed plotly, which is not imported."""
    for name, folder in (("dynident.report", "templates"), ("plotly", "package_data")):
        spec = find_spec(name)
        if spec and spec.origin and isinstance(spec.loader, ResourceLoader):
            with suppress(OSError):
                return spec.loader.get_data(str(Path(spec.origin).parent / folder / "plotly.min.js"))
    raise InputError(f"the script that draws the figures of reports is missing: {install_command('plotly')}")


def _block_kind(block: PageBlock) -> str:
    if isinstance(block, str):
        return "html" if hasattr(block, "__html__") else "text"
    return "list" if isinstance(block, tuple) else type(block).__name__.removeprefix("Page").lower()


def _figure_json(figure: Drawing) -> Markup:
    """Return the figure as JSON that can stand in a script element whatever its texts hold."""
    text = figure.json()
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return Markup(text)  # noqa: S704 -- no sign is left that could end the element
