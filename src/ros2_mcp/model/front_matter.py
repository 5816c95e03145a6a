"""The front matter of a Markdown file: YAML between two lines of `---`, with the line of every key."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any, cast

from ros2_mcp.model.names import did_you_mean

_FENCE = "---"
_BOOL = "tag:yaml.org,2002:bool"
_NULL = "tag:yaml.org,2002:null"


class FrontMatterError(Exception):
    """A mistake in the front matter, with its line in the file, counted from 1."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line = line
        self.text = text


class Entry:
    """A mapping of the front matter: the YAML node and the line of every key. Lines count from 1 in the file.

    All values are read as text, as a client would write them; the declared arguments define their types.

    Raises:
        FrontMatterError: from every method, if a value is not of the requested type.
    """

    def __init__(self, node: Any, what: str) -> None:
        self._line = _line(node) if node else 2
        if not _is_mapping(node):
            raise FrontMatterError(self._line, f"{what} must be made of lines like 'name: value'.")
        self._nodes: dict[str, Any] = {}
        self._lines: dict[str, int] = {}
        for key_node, value in node.value:
            key = _text(key_node, _line(key_node), "a key")
            if key in self._nodes:
                raise FrontMatterError(_line(key_node), f"{key} is there twice.")
            self._nodes[key], self._lines[key] = value, _line(key_node)

    def line_of(self, key: str) -> int:
        """Return the line of a key; of the whole entry if there is no such key."""
        return self._lines.get(key, self._line)

    def check_keys(self, allowed: Sequence[str]) -> None:
        """Raise `FrontMatterError` for any other key than these."""
        for key in self._nodes:
            if key not in allowed:
                hint = did_you_mean(key, allowed, f"Known are: {', '.join(allowed)}.")
                raise FrontMatterError(self.line_of(key), f"{key!r} means nothing here. {hint}")

    def text(self, key: str) -> str:
        """Return the text under a key; empty without the key."""
        return _text(self._nodes[key], self.line_of(key), key) if key in self._nodes else ""

    def texts(self, key: str) -> list[str]:
        """Return the texts in the list under a key."""
        return [_text(node, self.line_of(key), key) for node in self._items(key, "such as [slow, fast]")]

    def flag(self, key: str) -> bool:
        """Return whether the value under a key is true; false without the key."""
        if key in self._nodes and self._nodes[key].tag != _BOOL:
            raise FrontMatterError(self.line_of(key), f"{key} must be true or false.")
        return self.text(key).lower() == "true"

    def number(self, key: str, otherwise: float) -> float:
        """Return the number under a key; `otherwise` without the key."""
        try:
            return float(self.text(key) or otherwise)
        except ValueError:
            raise FrontMatterError(self.line_of(key), f"{key} must be a number.") from None

    def entries(self, key: str) -> list[Entry]:
        """Return the mappings in the list under a key."""
        return [Entry(node, f"each of {key}") for node in self._items(key, "each entry starting with '- name: …'")]

    def is_list(self, key: str) -> bool:
        """Return whether there is a list under a key."""
        return key in self._nodes and isinstance(self._nodes[key].value, list) and not _is_mapping(self._nodes[key])

    def _items(self, key: str, example: str) -> list[Any]:
        if key in self._nodes and not self.is_list(key) and self._nodes[key].tag != _NULL:
            raise FrontMatterError(self.line_of(key), f"{key} must be a list, {example}.")
        return self._nodes[key].value if self.is_list(key) else []


def split(text: str) -> tuple[Entry, str, int]:
    """Split a file into front matter, the text after it, and the line where that text starts.

    Raises:
        FrontMatterError: if there is no front matter, or it is not a mapping in YAML.
    """
    from ruamel.yaml import YAML  # takes 90 ms, which is wasted without a folder of prompts
    from ruamel.yaml.error import YAMLError

    lines = text.split("\n")
    if lines[0].rstrip() != _FENCE:
        raise FrontMatterError(1, "It must start with a line of ---, the front matter, and another line of ---.")
    end = next((number for number, line in enumerate(lines) if number and line.rstrip() == _FENCE), None)
    if end is None:
        raise FrontMatterError(1, "The front matter has no end: a line of --- is missing.")
    try:
        # Nodes, not values: nothing in the YAML can be executed, and every node knows its line.
        root = cast("Any", YAML(typ="safe", pure=True)).compose("\n".join(lines[1:end]))
    except YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or "unreadable"
        raise FrontMatterError(mark.line + 2 if mark else 2, f"Not valid YAML: {problem}.") from None
    except RecursionError:
        raise FrontMatterError(2, "Not valid YAML: nested too deep.") from None
    return Entry(root, "the front matter"), "\n".join(lines[end + 1 :]), end + 2


def entry_of(values: Mapping[str, Any]) -> Entry:
    """Return an entry from a client's JSON, as if it were in a file; raises `FrontMatterError`."""
    return split(f"{_FENCE}\n{json.dumps(values, ensure_ascii=False)}\n{_FENCE}")[0]


def _is_mapping(node: Any) -> bool:
    return str(getattr(node, "id", "")) == "mapping"


def _line(node: Any) -> int:
    """Convert YAML's line, from 0 and without the first line of the file, to a line of the file from 1."""
    return node.start_mark.line + 2


def _text(node: Any, line: int, what: str) -> str:
    if not isinstance(node.value, str):
        raise FrontMatterError(line, f"{what} must be a string; put it in quotes.")
    return "" if node.tag == _NULL else node.value.strip()
