"""YAML by safe loading, of a size that a configuration may have: aliases count as often as they are used."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from typing import Any

import yaml

from dynident.errors import ConfigError
from dynident.io.fields import is_deep

__all__ = ["ConfigLoader", "load_yaml"]

MOST_CHARACTERS, MOST_NODES = 1_000_000, 50_000
DIGITS, _WHOLE = 300, "tag:yaml.org,2002:int"  # a float has no more digits before its point
_TRUTH, _TEXT = "tag:yaml.org,2002:bool", "tag:yaml.org,2002:str"


class ConfigLoader(yaml.SafeLoader):
    """Stops where there are too many nodes; keys such as ``on`` are texts, not the truth values of YAML 1.1."""

    count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Count a node."""
        self.count += 1
        if self.count > MOST_NODES:
            raise _TooManyError
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Read keys as texts."""
        node = super().compose_mapping_node(anchor)
        for key, _ in node.value:
            key.tag = _TEXT if key.tag == _TRUTH else key.tag
        return node


class _TooManyError(Exception):
    """More nodes than a configuration may have."""


def load_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text; ConfigError where it is not valid, too large, or has a key twice."""
    if len(text) > MOST_CHARACTERS:
        raise ConfigError(f"{source}: has {len(text)} characters; {MOST_CHARACTERS} are the most that are read.")
    try:
        loader = ConfigLoader(text)
        tree = loader.get_single_node()
        _count(tree, {}, source)
        doubled = next(_doubled_keys(tree, set()), None)
        data = None if tree is None else loader.construct_document(tree)
        if is_deep(data):
            raise RecursionError
    except ConfigError:
        raise
    except RecursionError:
        raise ConfigError(f"{source}: its lists and mappings are nested too deep; no setting is.") from None
    except _TooManyError:
        raise ConfigError(
            f"{source}: has more than {MOST_NODES} values, those of aliases counted each time; write fewer."
        ) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        where = f"line {mark.line + 1}, column {mark.column + 1}: " if mark else ""
        raise ConfigError(f"{source}: {where}{error.problem}; the file must be valid YAML.") from error
    except Exception as error:  # values such as 2022-99-99 fail in many ways inside the YAML reader
        raise ConfigError(f"{source}: is not valid YAML ({type(error).__name__}: {error}).") from error
    if doubled is not None:
        line = doubled.start_mark.line + 1
        raise ConfigError(f"{source}: line {line}: the key {doubled.value!r} is given twice; keep one of them.")
    return data


def _count(node: yaml.Node | None, known: dict[int, int], source: str) -> int:
    """Return the number of nodes with aliases written out; ``known`` holds those of the nodes visited.

    Raises ConfigError for a number of more digits than any setting has.
    """
    if not isinstance(node, yaml.MappingNode | yaml.SequenceNode):
        if node is not None and node.tag == _WHOLE and len(node.value) > DIGITS:
            raise ConfigError(
                f"{source}: line {node.start_mark.line + 1}: {node.value[:20]}... is a number of {len(node.value)} "
                "digits; no setting is so large."
            )
        return 1
    if id(node) not in known:
        known[id(node)] = MOST_NODES  # where an alias is inside its own anchor
        inside = chain.from_iterable(node.value) if isinstance(node, yaml.MappingNode) else node.value
        known[id(node)] = 1 + sum(_count(child, known, source) for child in inside)
        if known[id(node)] > MOST_NODES:
            raise _TooManyError
    return known[id(node)]


def _doubled_keys(node: yaml.Node | None, seen: set[int]) -> Iterator[yaml.Node]:
    """Yield the keys that repeat in their mapping; ``seen`` holds the nodes visited, each once."""
    if node is None or id(node) in seen:
        return
    seen.add(id(node))
    if isinstance(node, yaml.MappingNode):
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]  # others are refused as keys
        counts = Counter(key.value for key in keys)
        yield from (key for key in reversed(keys) if counts[key.value] > 1)
        for child in chain.from_iterable(node.value):
            yield from _doubled_keys(child, seen)
    elif isinstance(node, yaml.SequenceNode):
        for child in node.value:
            yield from _doubled_keys(child, seen)
