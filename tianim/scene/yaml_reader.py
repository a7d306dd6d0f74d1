"""A strict YAML reader: plain data and the line of each key, nothing that runs.

YAML 1.2's words are used, not 1.1's: `no` and `on` are text, `1e-2` and `1e5` are numbers, `010`
is ten. Tags, duplicate keys, keys that are not text, deep nesting and aliases that multiply are
refused. A number in exponent form that is whole (`1e5`) is a whole number, so that counts take it.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import yaml
from yaml.composer import Composer
from yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode
from yaml.parser import Parser
from yaml.reader import Reader
from yaml.resolver import BaseResolver
from yaml.scanner import Scanner

Key = tuple[str | int, ...]

# Far over any scene; a YAML bomb of nine lines has 1e9 values once its aliases are written out.
MOST_VALUES = 100_000
# Deeper than any scene; Python's own stack holds some 10 times as many levels.
DEEPEST = 64
# Whole numbers up to here are exact as float64.
EXACT = 2.0**53
# Longer digit strings are read as floats: Python refuses to convert those of thousands of digits.
LONGEST_INTEGER = 30

INTEGER = re.compile(r"[-+]?[0-9][0-9_]*")
HEXADECIMAL = re.compile(r"0x[0-9a-fA-F]+")
DECIMAL = re.compile(r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9_]*)?)([eE][-+]?[0-9]+)?")
NOT_FINITE = re.compile(r"([-+]?)\.(inf|Inf|INF|nan|NaN|NAN)")
WORDS: dict[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}


class ReadError(Exception):
    """What is wrong with a text, with its line where that is known."""

    def __init__(self, reason: str, line: int | None = None) -> None:
        self.reason, self.line = reason, line
        super().__init__(reason)


@dataclass
class PlainData:
    """Data of a file, and the line (from 1) of each key and item."""

    data: Any
    lines: dict[Key, int] = field(default_factory=dict)


def read_yaml(text: str) -> PlainData:
    """The one document in `text`. Raises ReadError; an empty text gives None."""
    with _clear_errors():
        node = _Composer(text).get_single_node()
    if node is None:
        return PlainData(None)
    plain = PlainData(None)
    plain.data = _Builder(plain.lines).build(node, ())
    return plain


def number(text: str) -> int | float:
    """A number as written; a whole one in exponent form (`1e5`) is an int where it is exact."""
    text = text.replace("_", "")
    if INTEGER.fullmatch(text) and len(text) <= LONGEST_INTEGER:
        return int(text)
    value = float(text)
    if "e" in text.lower() and abs(value) <= EXACT and value.is_integer():
        return int(value)
    return value


def check_size(data: Any) -> None:
    """Raise ReadError where data from another reader is too deep or too much."""
    level, total = [data], 0
    for _ in range(DEEPEST):
        total += len(level)
        if total > MOST_VALUES:
            raise ReadError(f"more than {MOST_VALUES} values")
        level = [item for value in level for item in _items(value)]
        if not level:
            return
    raise ReadError(f"nested deeper than {DEEPEST} levels")


def _items(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return list(value.values())
    return value if isinstance(value, list) else []


@contextmanager
def _clear_errors() -> Iterator[None]:
    """PyYAML's errors as one line each."""
    try:
        yield
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = error.problem or error.context or "syntax error"
        if reason.startswith("but ") and error.context:
            reason = f"{error.context}, {reason}"
        raise ReadError(f"not valid YAML: {reason}", mark.line + 1 if mark else None) from None
    except yaml.reader.ReaderError as error:
        raise ReadError(f"not a text file: character {error.character!r}") from None
    except yaml.YAMLError as error:
        raise ReadError(f"not valid YAML: {' '.join(str(error).split())}") from None


def _line(node: Node) -> int:
    return int(node.start_mark.line) + 1


class _Composer(Reader, Scanner, Parser, Composer, BaseResolver):
    """Text to nodes; scalars stay text, tags are refused."""

    def __init__(self, text: str) -> None:
        Reader.__init__(self, text)
        Scanner.__init__(self)
        Parser.__init__(self)
        Composer.__init__(self)
        BaseResolver.__init__(self)
        self.depth = 0
        self.count = 0

    def compose_node(self, parent: Node | None, index: Any) -> Node | None:
        """As PyYAML's, with limits."""
        event: Any = self.peek_event()
        line = event.start_mark.line + 1
        tag = getattr(event, "tag", None)
        if tag is not None:
            raise ReadError(f"tags are not allowed: {_short_tag(tag)}", line)
        self.depth += 1
        self.count += 1
        if self.depth > DEEPEST:
            raise ReadError(f"nested deeper than {DEEPEST} levels", line)
        if self.count > MOST_VALUES:
            raise ReadError(f"more than {MOST_VALUES} values", line)
        node: Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node


def _short_tag(tag: str) -> str:
    return tag.replace("tag:yaml.org,2002:", "!!")


class _Builder:
    """Nodes to plain data; notes the line of each key."""

    def __init__(self, lines: dict[Key, int]) -> None:
        self.lines = lines
        self.count = 0

    def build(self, node: Node, path: Key) -> Any:
        self.count += 1
        if self.count > MOST_VALUES:
            raise ReadError(f"more than {MOST_VALUES} values once its aliases are written out", _line(node))
        if len(path) > DEEPEST:
            raise ReadError(f"nested deeper than {DEEPEST} levels (an alias within itself?)", _line(node))
        self.lines.setdefault(path, _line(node))
        if isinstance(node, MappingNode):
            return self._mapping(node, path)
        if isinstance(node, SequenceNode):
            return [self.build(item, (*path, index)) for index, item in enumerate(node.value)]
        assert isinstance(node, ScalarNode)
        return _scalar(node)

    def _mapping(self, node: MappingNode, path: Key) -> dict[str, Any]:
        data: dict[str, Any] = {}
        for key_node, value_node in node.value:
            key = _scalar(key_node) if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                shown = key_node.value if isinstance(key_node, ScalarNode) else "a list or mapping"
                raise ReadError(f"a key must be text, not {shown}", _line(key_node))
            if key in data:
                raise ReadError(duplicate(path, key), _line(key_node))
            inner = (*path, key)
            self.lines[inner] = _line(key_node)
            data[key] = self.build(value_node, inner)
        return data


def duplicate(path: Key, key: str) -> str:
    """The message for a key that stands twice."""
    if path in (("systems",), ("bodies",)):
        return f"two {path[0]} with one name: {key!r}"
    return f"key {key!r} stands twice" + (f" in {'.'.join(map(str, path))}" if path else "")


def _scalar(node: ScalarNode) -> Any:
    text = node.value
    if node.style is not None:
        return text
    if text in WORDS:
        return WORDS[text]
    if HEXADECIMAL.fullmatch(text):
        return int(text, 16)
    if INTEGER.fullmatch(text) or DECIMAL.fullmatch(text):
        return number(text)
    if found := NOT_FINITE.fullmatch(text):
        return float(found[1] + found[2])
    return text
