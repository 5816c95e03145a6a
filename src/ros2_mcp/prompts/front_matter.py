"""The front matter of a Markdown file: YAML between two lines of `---`, with the line of every key."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, cast

_FENCE = "---"


class FrontMatterError(Exception):
    """What is wrong, and in which line of the file, counted from 1."""

    def __init__(self, line: int, text: str) -> None:
        super().__init__(text)
        self.line = line
        self.text = text


@dataclass(frozen=True, slots=True)
class Entry:
    """A mapping of the front matter; `line` is where it starts, counted from 1 in the file."""

    values: Mapping[str, Any]
    lines: Mapping[str, int]
    line: int

    def line_of(self, key: str) -> int:
        """The line of a key; of the whole entry if it is not there."""
        return self.lines.get(key, self.line)

    def entries(self, key: str) -> Iterator[Entry]:
        """The mappings in the list under a key.

        Raises:
            FrontMatterError: if there is anything else.
        """
        items: Any = self.values.get(key) or []
        if not isinstance(items, list):
            raise FrontMatterError(self.line_of(key), f"{key} must be a list, each entry starting with '- name: …'.")
        for number, item in enumerate(cast("list[Any]", items)):
            yield _entry(item, cast("Any", items).lc.item(number)[0], f"each of {key}")


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
    return _parse("\n".join(lines[1:end])), "\n".join(lines[end + 1 :]), end + 2


def _parse(text: str) -> Entry:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        return _entry(cast("Any", YAML(typ="rt", pure=True)).load(text), 0, "the front matter")
    except MarkedYAMLError as error:
        marked = cast("Any", error)
        mark = marked.problem_mark or marked.context_mark
        raise FrontMatterError(mark.line + 2 if mark else 2, f"Not valid YAML: {marked.problem}.") from None
    except YAMLError as error:
        raise FrontMatterError(2, f"Not valid YAML: {error}.") from None


def _entry(loaded: Any, line: int, what: str) -> Entry:
    """A mapping as YAML loaded it; YAML counts lines from 0 and starts after the first fence."""
    if not isinstance(loaded, dict):
        raise FrontMatterError(line + 2, f"{what} must be made of lines like 'name: value'.")
    mapping = cast("dict[Any, Any]", loaded)
    position = cast("Any", loaded).lc
    lines = {str(key): position.key(key)[0] + 2 for key in mapping}
    return Entry({str(key): value for key, value in mapping.items()}, lines, position.line + 2)


def as_text(value: Any) -> str:
    """A value of YAML as a client would write it."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list):
        return json.dumps([as_text(part) for part in cast("list[Any]", value)])
    return "" if value is None else str(value)
