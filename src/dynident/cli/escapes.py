"""Names as text: no character of a file, column or joint acts on a terminal."""

from __future__ import annotations

import re
import unicodedata

__all__ = ["one_line", "visible"]


def visible(text: str) -> str:
    r"""Return a text with escapes, such as ``\x1b``, for all that could act on a terminal, except line breaks.

    These are the control characters (ESC, BEL, backspace, C1), those that turn the direction of writing or are not
    seen, and halves of surrogate pairs, by which Python holds the bytes of names that are no text.
    """
    if text.isprintable():
        return text
    return "".join(one if one == "\n" or _is_shown(one) else one.encode("unicode_escape").decode() for one in text)


def one_line(text: str) -> str:
    r"""Return a message as ``visible`` does; only a line that is indented stands alone.

    Other line breaks, those of names, become ``\n``: no name can pass for a message.
    """
    return re.sub(r"\n(?!  )", r"\\n", visible(text).rstrip("\n"))


def _is_shown(one: str) -> bool:
    return one.isprintable() or unicodedata.category(one) == "Zs"
