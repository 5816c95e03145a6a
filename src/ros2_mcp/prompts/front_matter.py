"""The front matter of a Markdown file: YAML between two lines of `---`, with the line of every key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

_FENCE = "---"
_BOOL = "tag:yaml.org,2002:bool"
_NULL = "tag:yaml.org,2002:null"


class FrontMatterError(Exception):
    """What is wrong, and in which line of the file, counted from 1."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line = line
        self.text = text


@dataclass(frozen=True, slots=True)
class Entry:
    """A mapping of the front matter: the YAML node and the line of every key. Lines count from 1 in the file.

    Everything in it is read as text, as a client would write it; what it means is for the arguments to say.
    """

    nodes: Mapping[str, Any]
    lines: Mapping[str, int]
    line: int

    def line_of(self, key: str) -> int:
        """The line of a key; of the whole entry if it is not there."""
        return self.lines.get(key, self.line)

    def text(self, key: str) -> str:
        """The text under a key; empty where there is none.

        Raises:
            FrontMatterError: if there is a list or a mapping.
        """
        return _text(self.nodes[key], self.line_of(key), key) if key in self.nodes else ""

    def texts(self, key: str) -> list[str]:
        """The texts in the list under a key.

        Raises:
            FrontMatterError: if there is anything else.
        """
        return [_text(node, self.line_of(key), key) for node in self._items(key, "such as [slow, fast]")]

    def flag(self, key: str) -> bool:
        """Whether the value under a key is true; false where there is none.

        Raises:
            FrontMatterError: if it is neither true nor false.
        """
        if key in self.nodes and getattr(self.nodes[key], "tag", "") != _BOOL:
            raise FrontMatterError(self.line_of(key), f"{key} must be true or false.")
        return self.text(key).lower() == "true"

    def number(self, key: str, otherwise: float) -> float:
        """The number under a key.

        Raises:
            FrontMatterError: if it is none.
        """
        try:
            return float(self.text(key) or otherwise)
        except ValueError:
            raise FrontMatterError(self.line_of(key), f"{key} must be a number.") from None

    def entries(self, key: str) -> Iterator[Entry]:
        """The mappings in the list under a key.

        Raises:
            FrontMatterError: if there is anything else.
        """
        for node in self._items(key, "each entry starting with '- name: …'"):
            yield _entry(node, f"each of {key}")

    def is_list(self, key: str) -> bool:
        """Whether there is a list under a key."""
        return key in self.nodes and isinstance(self.nodes[key].value, list) and not _is_mapping(self.nodes[key])

    def _items(self, key: str, example: str) -> list[Any]:
        if self.is_list(key):
            return self.nodes[key].value
        if key in self.nodes and self.nodes[key].tag != _NULL:
            raise FrontMatterError(self.line_of(key), f"{key} must be a list, {example}.")
        return []


def split(text: str) -> tuple[Entry, str, int]:
    """The front matter, the text after it, and the line where that text starts.

    Raises:
        FrontMatterError: if there is no front matter, or it is not a mapping in YAML.
    """
    lines = text.split("\n")
    if lines[0].rstrip() != _FENCE:
        raise FrontMatterError(1, "It must start with a line of ---, the front matter, and another line of ---.")
    end = next((number for number, line in enumerate(lines) if number and line.rstrip() == _FENCE), None)
    if end is None:
        raise FrontMatterError(1, "The front matter has no end: a line of --- is missing.")
    return _entry(_parse("\n".join(lines[1:end])), "the front matter"), "\n".join(lines[end + 1 :]), end + 2


def _parse(text: str) -> Any:
    """The root of the YAML, not yet made into values: nothing in it can act, and every part knows its line."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        return cast("Any", YAML(typ="safe", pure=True)).compose(text)
    except YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or "unreadable"
        raise FrontMatterError(mark.line + 2 if mark else 2, f"Not valid YAML: {problem}.") from None
    except RecursionError:
        raise FrontMatterError(2, "Not valid YAML: nested too deep.") from None


def _is_mapping(node: Any) -> bool:
    return str(getattr(node, "id", "")) == "mapping"


def _line(node: Any) -> int:
    """YAML counts lines from 0 and starts after the first fence."""
    return node.start_mark.line + 2


def _entry(node: Any, what: str) -> Entry:
    if not _is_mapping(node):
        raise FrontMatterError(_line(node) if node else 2, f"{what} must be made of lines like 'name: value'.")
    nodes: dict[str, Any] = {}
    lines: dict[str, int] = {}
    for key_node, value in node.value:
        key = _text(key_node, _line(key_node), "a key")
        if key in nodes:
            raise FrontMatterError(_line(key_node), f"{key} is there twice.")
        nodes[key], lines[key] = value, _line(key_node)
    return Entry(nodes, lines, _line(node))


def _text(node: Any, line: int, what: str) -> str:
    if not isinstance(node.value, str):
        raise FrontMatterError(line, f"{what} must be a text; put it in quotes.")
    return "" if node.tag == _NULL else node.value.strip()
