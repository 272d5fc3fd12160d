"""Expansion of the macros of URDF files by the ROS program xacro.

A xacro file is code: its expressions are evaluated. The program runs without a shell, within limits of time
and size.
"""

from __future__ import annotations

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Timer
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

from dynident.files.opener import XML_WEIGHT, afford, file_status, read_text, real_path, remember_inputs
from dynident.models.robot_files import exact_angle, parse
from dynident.runtime import MEMORY_VARIABLE, ModelError, format_bytes, install_command, memory_budget

_START_TAG = re.compile(rb"""<[^\s/>]+(?:\s+[^\s=/>]+\s*=\s*(?:"[^"]*"|'[^']*'))*\s*/?>""")
_ATTRIBUTE = re.compile(rb"""\s+([^\s=/>]+)\s*=\s*("[^"]*"|'[^']*')""")
XACRO = ".xacro"
SUFFIXES = (".urdf", ".xml", ".mjcf", XACRO)
MAX_DURATION = 60.0  # s
PROGRAM_MEMORY = 150_000_000  # bytes that xacro itself takes, and Python below it
ADVICE = (
    "expand the file where ROS is installed, with `xacro robot.urdf.xacro > robot.urdf`, and name robot.urdf; or "
    "install xacro by: "
)


@dataclass(eq=False)
class XmlNode:
    """An element: where its start tag begins and ends, where its end tag begins, and where it ends (bytes)."""

    tag: str
    attributes: Mapping[str, str]
    start: int
    inside: int
    close: int = 0
    end: int = 0
    children: list[XmlNode] = field(default_factory=list)

    @property
    def empty(self) -> bool:
        """Whether the element is one tag, ``<a/>``."""
        return self.close == self.inside == self.end

    def find(self, tag: str) -> XmlNode | None:
        """Return the first child of that name."""
        return next((child for child in self.children if child.tag == tag), None)

    def walk(self) -> Iterator[XmlNode]:
        """Yield the element and all below it, in the order of the text."""
        yield self
        for child in self.children:
            yield from child.walk()


class XmlText:
    """The text of a well-formed XML file, with its elements and the edits made so far."""

    def __init__(self, xml: str) -> None:
        self._bytes = xml.encode()
        self._edits: list[tuple[int, int, bytes]] = []
        self.root = self._parse()

    def _parse(self) -> XmlNode:
        parser = expat.ParserCreate("utf-8")
        open_nodes: list[XmlNode] = []
        roots: list[XmlNode] = []

        def start(tag: str, attributes: dict[str, str]) -> None:
            """Note where an element begins and its start tag ends."""
            at = parser.CurrentByteIndex
            # expat gives the start of a tag only; its end is needed to edit attributes and to insert children
            match = _START_TAG.match(self._bytes, at)
            assert match, "expat has read this start tag"  # noqa: S101
            node = XmlNode(tag, attributes, at, match.end())
            (open_nodes[-1].children if open_nodes else roots).append(node)
            open_nodes.append(node)

        def end(_: str) -> None:
            """Note where the content of an element ends, and the element."""
            node = open_nodes.pop()
            is_empty_tag = self._bytes[node.inside - 2 : node.inside] == b"/>"
            node.close = node.inside if is_empty_tag else parser.CurrentByteIndex
            node.end = node.close if is_empty_tag else self._bytes.index(b">", node.close) + 1

        parser.StartElementHandler, parser.EndElementHandler = start, end
        parser.Parse(self._bytes, True)
        return roots[0]

    def set(self, node: XmlNode, values: Mapping[str, str]) -> None:
        """Set attributes; those that the element lacks are added after the others."""
        spans = {
            match[1].decode(): match.span(2) for match in _ATTRIBUTE.finditer(self._bytes, node.start, node.inside)
        }
        last = max((stop for _, stop in spans.values()), default=node.start + 1 + len(node.tag.encode()))
        added = "".join(f" {key}={quoteattr(value)}" for key, value in values.items() if key not in spans)
        for key, value in values.items():
            if key in spans:
                self._replace(*spans[key], quoteattr(value))
        if added:
            self._replace(last, last, added)

    def write_exact_angles(self, node: XmlNode, key: str, count: int = 3) -> None:
        """Write the last ``count`` numbers (rad) of an attribute as the exact angles used in the model."""
        words = node.attributes.get(key, "").split()
        new = [repr(exact_angle(word)) if exact_angle(word) != float(word) else word for word in words[-count:]]
        if new != words[-count:]:
            self.set(node, {key: " ".join([*words[:-count], *new])})

    def drop(self, node: XmlNode, keys: tuple[str, ...]) -> None:
        """Remove attributes that the element has."""
        for match in _ATTRIBUTE.finditer(self._bytes, node.start, node.inside):
            if match[1].decode() in keys:
                self._replace(*match.span(), "")

    def delete(self, node: XmlNode) -> None:
        """Remove an element and the whitespace before it."""
        start = node.start
        # the whitespace before the element goes, so that no empty line remains
        while self._bytes[start - 1 : start].isspace():
            start -= 1
        self._replace(start, node.end, "")

    def replace(self, node: XmlNode, element: str) -> None:
        """Replace an element by another."""
        self._replace(node.start, node.end, element)

    def insert(self, parent: XmlNode, *lines: str) -> None:
        """Insert an element, given in lines, before the first child of another, with the same indentation."""
        gap = self._child_separator(parent)
        block = "".join(gap + line for line in lines)
        # an empty tag must be opened to take a child
        if parent.empty:
            self._replace(
                parent.inside - len("/>"), parent.inside, f">{block}{self._line_indent(parent)}</{parent.tag}>"
            )
        else:
            tail = "" if parent.children else self._line_indent(parent)
            self._replace(parent.inside, parent.inside, block + tail)

    def __str__(self) -> str:
        out = self._bytes
        # from the end, so that the byte positions of earlier edits stay valid
        for start, stop, new in sorted(self._edits, key=lambda edit: edit[:2], reverse=True):
            out = out[:start] + new + out[stop:]
        return out.decode()

    def _replace(self, start: int, stop: int, new: str) -> None:
        self._edits.append((start, stop, new.encode()))

    def _child_separator(self, parent: XmlNode) -> str:
        """Return the line break and whitespace before the first child, or what they would be."""
        if parent.children:
            return self._line_indent(parent.children[0])
        before = self._line_indent(parent)
        return before + "  " if before else ""

    def _line_indent(self, node: XmlNode) -> str:
        """Return the line break and blanks before an element; empty where it does not begin its line."""
        head = self._bytes[: node.start]
        blanks = head[len(head.rstrip(b" \t\r\n")) :].decode()
        line = blanks.rfind("\n")
        return "" if line < 0 else ("\r\n" if blanks[:line].endswith("\r") else "\n") + blanks[line + 1 :]


def with_includes(xml: str, path: Path) -> str:
    """Return the text of an MJCF at ``path`` with each ``<include file=...>`` replaced by the elements of that file.

    Names are relative to the folder of ``path``, else to that of the file that includes; a file may be included once,
    as in MuJoCo. The rest of the text stays as it is. Raises ModelError where a file cannot be read, is no XML, has
    no elements, or is included twice, as in a cycle.
    """
    return _expand_includes(xml, path, path, {real_path(path): path.name}) if "<include" in xml else xml


def _expand_includes(xml: str, path: Path, main: Path, included: dict[Path, str]) -> str:
    """Return the text of the file at ``path`` with its includes; add their real paths to ``included``."""
    if parse(xml, path.name).tag not in ("mujoco", "mujocoinclude"):
        return xml
    edited, size = XmlText(xml), len(xml)
    for node in [node for node in edited.root.walk() if node.tag == "include"]:
        name = node.attributes.get("file", "")
        if not name or node.children:
            raise ModelError(f"{path.name}: <include> needs a `file`, and no elements of its own.")
        beside_main = main.parent / name
        target = beside_main if os.path.exists(beside_main) else path.parent / name
        content = _included_elements(target, main, included)
        # the size is checked while it grows: nested includes can multiply it
        size += len(content)
        afford(XML_WEIGHT * size, f"{main.name}: with what it includes it would take", ModelError)
        edited.replace(node, content)
    return str(edited)


def _included_elements(path: Path, main: Path, included: dict[Path, str]) -> str:
    """Return what is inside the root element of an included file."""
    key = real_path(path, ModelError)
    if key in included:
        raise ModelError(f"{main.name}: {path.name} is included twice, or includes itself; include each file once.")
    included[key] = path.name
    xml = _expand_includes(read_text(path, ModelError, (".xml", ".mjcf"), XML_WEIGHT), path, main, included)
    parse(xml, path.name)  # says what is wrong with the XML
    root = XmlText(xml).root
    if not root.children:
        raise ModelError(f"{main.name}: {path.name}, which it includes, has no elements; delete the <include>.")
    return xml.encode()[root.inside : root.close].decode()


def expand(path: Path) -> str:
    """Return the URDF that a xacro file stands for, with the default values of its arguments.

    Raises ModelError where the file is not there, xacro is not installed, fails, or takes more than a minute.
    """
    file_status(path, ModelError, (XACRO, ".urdf"))
    remember_inputs(path)
    out, errors, code = _run_program([*_program(path), str(real_path(path, ModelError))])
    if len(out) * XML_WEIGHT > memory_budget() or b"MemoryError" in errors:
        raise ModelError(
            f"{path}: xacro makes more of it than the {format_bytes(memory_budget())} of memory that a file may take; "
            f"mend a macro that repeats without end, or raise this by --memory or {MEMORY_VARIABLE} (in GB)."
        )
    if code < 0:
        raise ModelError(
            f"{path}: xacro was stopped after {MAX_DURATION:g} s; expand the file by hand, and name the result."
        )
    if code:
        lines = [line for line in errors.decode(errors="replace").splitlines() if line.strip()]
        words = "".join(x if x.isprintable() else " " for x in " ".join(lines[-6:]))[:500]
        raise ModelError(f"{path}: xacro cannot expand it: {words or f'it ends with code {code}'}.")
    try:
        return out.decode()
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: what xacro makes of it is not a UTF-8 text ({error}).") from error


def _program(path: Path) -> list[str]:
    """Return the command on the path, else that of the installed package."""
    if (command := shutil.which("xacro")) is not None:
        return [command]
    if importlib.util.find_spec("xacro") is None:
        raise ModelError(f"{path}: needs xacro, which is not installed: {ADVICE}{install_command('xacro')}")
    return [sys.executable, "-P", "-c", "from xacro import main; main()"]


def _limit_memory(process: int, size: int) -> None:
    """Limit the memory (bytes) of a process that has just begun, where the system can."""
    if sys.platform == "linux":
        import resource

        # it may have ended already
        with suppress(ProcessLookupError):
            resource.prlimit(process, resource.RLIMIT_DATA, (size, size))


def _run_program(command: list[str]) -> tuple[bytes, bytes, int]:
    """Return output, errors and exit code of a program; the code is negative where it was stopped."""
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(  # noqa: S603 - the program is xacro, and no shell reads its argument
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors
        ) as process,
    ):
        _limit_memory(process.pid, PROGRAM_MEMORY + memory_budget())
        alarm = Timer(MAX_DURATION, process.kill)
        alarm.start()
        try:
            # one byte beyond the limit shows that the output is too long; the rest is not read
            out = process.stdout.read(memory_budget() // XML_WEIGHT + 1) if process.stdout else b""
            if len(out) > memory_budget() // XML_WEIGHT:
                process.kill()
            code = process.wait()
        finally:
            alarm.cancel()
            process.kill()
        errors.seek(0)
        return out, errors.read(100_000), code
