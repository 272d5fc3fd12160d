"""Includes of a MuJoCo model: one text of several files, as MuJoCo joins them."""

from __future__ import annotations

import os
from pathlib import Path

from dynident.errors import ModelError
from dynident.export.edit import Text
from dynident.io.opener import XML_WEIGHT, afford, real, text
from dynident.models.robot_file import parse

__all__ = ["with_includes"]


def with_includes(xml: str, path: Path) -> str:
    """Return the text of an MJCF at ``path`` with each ``<include file=...>`` replaced by the elements of that file.

    Names are relative to the folder of ``path``, else to that of the file that includes; a file may be included once,
    as in MuJoCo. The rest of the text stays as it is. Raises ModelError where a file cannot be read, is no XML, has
    no elements, or is included twice, as in a cycle.
    """
    return _joined(xml, path, path, {real(path): path.name}) if "<include" in xml else xml


def _joined(xml: str, path: Path, main: Path, seen: dict[Path, str]) -> str:
    """Return the text of the file at ``path``; adds to the files ``seen``, by their real names."""
    if parse(xml, path.name).tag not in ("mujoco", "mujocoinclude"):
        return xml
    edited, size = Text(xml), len(xml)
    for node in [node for node in edited.root.walk() if node.tag == "include"]:
        name = node.attributes.get("file", "")
        if not name or node.children:
            raise ModelError(f"{path.name}: <include> needs a `file`, and no elements of its own.")
        content = _content(_found(name, path, main), main, seen)
        size += len(content)
        afford(XML_WEIGHT * size, f"{main.name}: with what it includes it would take", ModelError)
        edited.replace(node, content)
    return str(edited)


def _found(name: str, path: Path, main: Path) -> Path:
    beside = main.parent / name
    return beside if os.path.exists(beside) else path.parent / name


def _content(path: Path, main: Path, seen: dict[Path, str]) -> str:
    """Return what is inside the root element of an included file."""
    key = real(path, ModelError)
    if key in seen:
        raise ModelError(f"{main.name}: {path.name} is included twice, or includes itself; include each file once.")
    seen[key] = path.name
    xml = _joined(text(path, ModelError, (".xml", ".mjcf"), XML_WEIGHT), path, main, seen)
    parse(xml, path.name)  # says what is wrong with the XML
    root = Text(xml).root
    if not root.children:
        raise ModelError(f"{main.name}: {path.name}, which it includes, has no elements; delete the <include>.")
    return xml.encode()[root.inside : root.close].decode()
