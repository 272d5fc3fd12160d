"""Formulas of the site, a hook of mkdocs: LaTeX in the pages, as GitHub shows it too, becomes MathML while it is built.

Inline it stands between dollar signs, on lines of its own in a fenced block of the language ``math``. A browser shows
MathML without a script. latex2mathml lets most mistakes pass: what it leaves unread is an error here.
"""

from __future__ import annotations

import re
from typing import Any
from xml.etree import ElementTree

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.inlinepatterns import InlineProcessor
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError

INLINE = r"(?<![\\$\w])\$(?=\S)([^$\n]+(?:\n[^$\n]+)?)(?<=\S)\$(?![\w$])"  # at most over the end of one line
AFTER_CODE = 185  # priority: below that of `code`, above that of a backslash
ARGUMENTS = {"mfrac": 2, "msub": 2, "msup": 2, "msubsup": 3, "munder": 2, "mover": 2, "munderover": 3, "mroot": 2}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add formulas to the extensions of Markdown."""
    config.markdown_extensions.append(Formulas())
    fence = {"name": "math", "class": "math", "format": fenced}
    config.mdx_configs.setdefault("pymdownx.superfences", {})["custom_fences"] = [fence]
    return config


def mathml(formula: str, *, block: bool = False) -> str:
    """Return a formula as MathML; PluginError where it is not LaTeX that can be shown."""
    try:
        text: str = convert(formula, display="block" if block else "inline")
        tree = ElementTree.fromstring(text)  # noqa: S314 - made above
    except Exception as error:  # the package raises whatever it comes across
        raise PluginError(f"the formula {formula!r} cannot be read: {error or type(error).__name__}") from error
    braces = re.sub(r"\\.", "", formula)
    unread = [one for one in tree.itertext() if "\\" in one or (one in "{}" and f"\\{one}" not in formula)]
    short = [one.tag for one in tree.iter() if len(one) != ARGUMENTS.get(one.tag.partition("}")[2], len(one))]
    if unread or short or braces.count("{") != braces.count("}"):
        raise PluginError(f"the formula {formula!r} cannot be read: {', '.join(unread + short) or 'braces'}")
    text = re.sub(r"<mi>(&#x02A\w+;)</mi>", r"<mo>\1</mo>", text)  # relations such as "at least, as a matrix"
    named = re.sub(r"<mo>([a-z]{2,})</mo>", r"<mi>\1</mi>", text)  # functions: a thin space, but before a bracket
    return re.sub(r"(<mi>[a-z]{2,}</mi>)(?=<m(?!o|space))", r'\1<mspace width="0.167em" />', named)


def fenced(source: str, *_: Any, **__: Any) -> str:
    """Return a block of the language ``math``."""
    return mathml(source, block=True)


class Formulas(Extension):
    """Formulas between dollar signs."""

    def extendMarkdown(self, md: Markdown) -> None:
        """Register the pattern."""
        md.inlinePatterns.register(Inline(INLINE, md), "formula", AFTER_CODE)


class Inline(InlineProcessor):
    """Puts a formula where it stood, kept from other patterns."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: ARG002
        """Return the MathML and the place of the formula."""
        return self.md.htmlStash.store(mathml(m[1])), m.start(0), m.end(0)
