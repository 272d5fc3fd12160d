"""Safe loading of YAML within the size of a configuration; aliases count as often as they are used."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from itertools import chain
from typing import Any

import yaml
from yaml.reader import Reader

from dynident.runtime import ConfigError

# what no line may hold: names in quotes are escaped by then, so that this is left in comments only
UNPRINTABLE = re.compile(f"{Reader.NON_PRINTABLE.pattern}|[\n\r\x85\u2028\u2029]")
# names that YAML takes as they are, but for words such as yes
_PLAIN_NAME = re.compile(r"(?!\.+$)[A-Za-z_./][A-Za-z0-9_./-]*")
MAX_NESTING = 50  # levels of lists and mappings

MAX_CHARACTERS, MAX_NODES = 1_000_000, 50_000
MAX_DIGITS, _INT_TAG = 300, "tag:yaml.org,2002:int"  # a float has no more digits before its point
_BOOL_TAG, _STR_TAG = "tag:yaml.org,2002:bool", "tag:yaml.org,2002:str"


class ConfigLoader(yaml.SafeLoader):
    """YAML loader with a limit of nodes; keys such as ``on`` are texts, not the truth values of YAML 1.1."""

    count = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Count a node."""
        self.count += 1
        if self.count > MAX_NODES:
            raise _TooManyError
        return super().compose_node(parent, index)

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Read keys as texts."""
        node = super().compose_mapping_node(anchor)
        for key, _ in node.value:
            key.tag = _STR_TAG if key.tag == _BOOL_TAG else key.tag
        return node


class _TooManyError(Exception):
    """More nodes than a configuration may have."""


def load_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text; ConfigError where it is not valid, too large, or repeats a key."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"{source}: has {len(text)} characters; {MAX_CHARACTERS} are the most that are read.")
    try:
        loader = ConfigLoader(text)
        tree = loader.get_single_node()
        # nodes are counted before they are constructed: nested aliases grow exponentially
        _count_nodes(tree, {}, source)
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
            f"{source}: has more than {MAX_NODES} values, those of aliases counted each time; write fewer."
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


def _count_nodes(node: yaml.Node | None, node_counts: dict[int, int], source: str) -> int:
    """Return the number of nodes with aliases written out; ``node_counts`` caches those of visited nodes.

    Raises ConfigError for a number of more digits than any setting has.
    """
    if not isinstance(node, yaml.MappingNode | yaml.SequenceNode):
        if node is not None and node.tag == _INT_TAG and len(node.value) > MAX_DIGITS:
            raise ConfigError(
                f"{source}: line {node.start_mark.line + 1}: {node.value[:20]}... is a number of {len(node.value)} "
                "digits; no setting is so large."
            )
        return 1
    if id(node) not in node_counts:
        node_counts[id(node)] = MAX_NODES  # where an alias is inside its own anchor
        inside = chain.from_iterable(node.value) if isinstance(node, yaml.MappingNode) else node.value
        node_counts[id(node)] = 1 + sum(_count_nodes(child, node_counts, source) for child in inside)
        if node_counts[id(node)] > MAX_NODES:
            raise _TooManyError
    return node_counts[id(node)]


def _doubled_keys(node: yaml.Node | None, visited: set[int]) -> Iterator[yaml.Node]:
    """Yield the keys that repeat in their mapping; each node is visited once, as ``visited`` tells."""
    if node is None or id(node) in visited:
        return
    visited.add(id(node))
    if isinstance(node, yaml.MappingNode):
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]  # others are refused as keys
        counts = Counter(key.value for key in keys)
        yield from (key for key in reversed(keys) if counts[key.value] > 1)
        for child in chain.from_iterable(node.value):
            yield from _doubled_keys(child, visited)
    elif isinstance(node, yaml.SequenceNode):
        for child in node.value:
            yield from _doubled_keys(child, visited)


def is_deep(data: object) -> bool:
    """Whether lists and mappings are nested deeper than any settings or results are, or in a ring."""
    # one level per round, keyed by identity: a ring never ends, but shared parts are not multiplied
    level = {id(data): data}
    for _ in range(MAX_NESTING):
        parts = [part for part in level.values() if isinstance(part, Mapping | list)]
        level = {id(x): x for part in parts for x in (part.values() if isinstance(part, Mapping) else part)}
    return any(isinstance(node, Mapping | list) for node in level.values())


def yaml_name(name: str) -> str:
    """Return a name as a YAML scalar, quoted where YAML would read it as another type."""
    if _PLAIN_NAME.fullmatch(name) and isinstance(yaml.safe_load(name), str):
        return name
    return yaml.safe_dump(name, default_style='"', allow_unicode=True, width=math.inf).strip()
