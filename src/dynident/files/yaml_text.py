"""Safe loading of YAML within the size of a configuration; aliases count as often as they are used."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
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
    """YAML loader with a limit of nodes, aliases written out; keys are given once, and texts, also ``on``."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._sizes: dict[int, int] = {}  # the nodes in each, with aliases written out

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Count a node while the text is read: nested aliases grow exponentially."""
        is_alias = self.check_event(yaml.AliasEvent)
        node = super().compose_node(parent, index)
        if node is not None and not is_alias:
            if node.tag == _INT_TAG and len(node.value) > MAX_DIGITS:
                words = f"{node.value[:20]}... is a number of {len(node.value)} digits; no setting is so large"
                raise yaml.composer.ComposerError(None, None, words, node.start_mark)
            inside = node.value if isinstance(node, yaml.CollectionNode) else ()
            children = chain.from_iterable(inside) if isinstance(node, yaml.MappingNode) else inside
            self._sizes[id(node)] = 1 + sum(self._sizes[id(child)] for child in children)
        # an alias inside its own anchor has no size yet
        if self._sizes.get(id(node), MAX_NODES + 1) > MAX_NODES:
            raise _TooManyError
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Read keys as texts."""
        node = super().compose_mapping_node(anchor)
        keys = [key for key, _ in node.value if isinstance(key, yaml.ScalarNode)]  # others are refused as keys
        for key in keys:
            key.tag = _STR_TAG if key.tag == _BOOL_TAG else key.tag
        counts = Counter(key.value for key in keys)
        if repeated := [key for key in keys if counts[key.value] > 1]:
            words = f"the key {repeated[0].value!r} is given twice; keep one of them"
            raise yaml.composer.ComposerError(None, None, words, repeated[-1].start_mark)
        return node


class _TooManyError(Exception):
    """More nodes than a configuration may have."""


def load_yaml(text: str, source: str) -> Any:
    """Return the content of a YAML text; ConfigError where it is not valid, too large, or repeats a key."""
    if len(text) > MAX_CHARACTERS:
        raise ConfigError(f"{source}: has {len(text)} characters; {MAX_CHARACTERS} are the most that are read.")
    try:
        data = ConfigLoader(text).get_single_data()
        if is_deep(data):
            raise RecursionError
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
    return data


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
