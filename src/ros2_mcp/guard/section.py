"""Read YAML strictly: values are requested by key, and a key that is never requested is an error with its line.

The node tree is read without constructing objects: YAML tags cannot run code, and every node has its line number.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any, cast

from ros2_mcp.model.errors import BadInput
from ros2_mcp.model.names import did_you_mean

_TAG = "tag:yaml.org,2002:"
_MAX_DEPTH = 20
"""The deepest nesting of lists and mappings; a policy has 5 levels."""


class PolicyFileError(BadInput):
    """An error in a policy: `origin` is its file, `line` counts from 1 (0: no line)."""

    def __init__(self, origin: str, line: int, problem: str, hint: str = "") -> None:
        super().__init__(f"{origin}, line {line}: {problem}" if line else f"{origin}: {problem}", hint)
        self.origin, self.line, self.problem = origin, line, problem


def parse(text: str, origin: str, what: str = "the policy", begin: str = "Begin with: policy: 1") -> Section:
    """Parse a YAML text that must be one mapping. Raises `PolicyFileError`.

    Args:
        text: the whole text.
        origin: the file, for error messages.
        what: a description of the mapping, for error messages.
        begin: the hint for an empty text.
    """
    from ruamel.yaml import YAML  # the import takes 90 ms, which a server without a policy saves
    from ruamel.yaml.error import YAMLError

    try:
        root = cast("Any", YAML(typ="safe", pure=True)).compose(text)
    except YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None) or "unreadable"
        raise PolicyFileError(origin, mark.line + 1 if mark else 1, f"not valid YAML: {problem}.") from None
    except (RecursionError, ValueError) as error:
        raise PolicyFileError(origin, 1, f"not valid YAML: {error}.") from None
    if root is None:
        raise PolicyFileError(origin, 1, "it is empty.", begin)
    _check_tree(root, origin, set(), 0)
    return Section(root, what, origin)


def _check_tree(node: Any, origin: str, seen: set[int], depth: int) -> None:
    """Raise an error for aliases, by which a short text expands without limit, and for nesting that is too deep."""
    if id(node) in seen:
        raise PolicyFileError(origin, _line(node), "an anchor is used again; write the value out.")
    seen.add(id(node))
    if depth > _MAX_DEPTH:
        raise PolicyFileError(origin, _line(node), "nested too deep.")
    if node.id in ("mapping", "sequence"):
        for child in cast("list[Any]", node.value):
            parts = cast("tuple[Any, ...]", child) if isinstance(child, tuple) else (child,)
            for part in parts:
                _check_tree(part, origin, seen, depth + 1)


def _line(node: Any) -> int:
    return int(node.start_mark.line) + 1


@dataclass(eq=False)
class Section:
    """One mapping of the file; `what` describes it in error messages. Methods that read raise `PolicyFileError`."""

    node: Any
    what: str
    origin: str
    _nodes: dict[str, Any] = field(default_factory=dict[str, Any])
    _asked: dict[str, None] = field(default_factory=dict[str, None])

    def __post_init__(self) -> None:
        if self.node.id != "mapping":
            raise self.error(self.node, f"{self.what} must be made of lines like 'key: value'.")
        for key_node, value in self.node.value:
            if key_node.id != "scalar":
                raise self.error(key_node, "a key must be a string.")
            key = str(key_node.value)
            if key in self._nodes:
                raise self.error(key_node, f"{key!r} is there twice.")
            self._nodes[key] = value
        if not self._nodes:
            raise self.error(self.node, f"{self.what} is empty.")

    @property
    def line(self) -> int:
        """The line of the beginning, from 1."""
        return _line(self.node)

    @property
    def keys(self) -> Sequence[str]:
        """The keys in the order of the file."""
        return list(self._nodes)

    def error(self, node: Any, problem: str, hint: str = "") -> PolicyFileError:
        """Return an error about a node, for the caller to raise."""
        return PolicyFileError(self.origin, _line(node), problem, hint)

    def error_at(self, key: str, problem: str, hint: str = "") -> PolicyFileError:
        """Return an error about the value of a key, for the caller to raise."""
        return self.error(self._nodes.get(key, self.node), problem, hint)

    def has(self, key: str) -> bool:
        """Return whether the key exists, and mark it as known."""
        self._asked[key] = None
        return key in self._nodes

    def require(self, *keys: str) -> None:
        """Raise an error unless all of these keys exist."""
        for key in keys:
            if not self.has(key):
                raise self.error(self.node, f"{self.what} needs {key!r}.")

    def text(self, key: str, otherwise: str = "") -> str:
        """Return the text of a key."""
        return self._text(key, self._nodes[key]) if self.has(key) else otherwise

    def choice(self, key: str, choices: Sequence[str], otherwise: str) -> Any:
        """Return the text of a key, which must be one of several words."""
        value = self.text(key, otherwise)
        if value not in choices:
            hint = did_you_mean(value, choices, f"Choose from {', '.join(filter(None, choices))}.")
            raise self.error_at(key, f"{key} cannot be {value!r}.", hint)
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return one text or a list of texts as a tuple; empty without the key."""
        if not self.has(key):
            return ()
        node = self._nodes[key]
        return tuple(self._text(key, each) for each in (self._items(key) if node.id == "sequence" else [node]))

    def flag(self, key: str) -> bool:
        """Return whether the value of a key is true; false without the key."""
        return self.has(key) and self._flag(key, self._nodes[key])

    def number(
        self, key: str, otherwise: float | None = None, *, low: float = 0.0, high: float = math.inf
    ) -> float | None:
        """Return the number of a key, within bounds; `otherwise` without the key."""
        if not self.has(key):
            return otherwise
        return self._bounded(key, self._nodes[key], low, high)

    def needed_number(self, key: str, otherwise: float, *, low: float = 0.0, high: float = math.inf) -> float:
        """Return the number of a key, as `number`, where there is always a default."""
        return cast("float", self.number(key, otherwise, low=low, high=high))

    def pair(self, key: str) -> tuple[float, float]:
        """Return two numbers, the lower one first: `[-0.5, 0.5]`."""
        self.has(key)
        items = self._items(key, "[low, high]")
        if len(items) != 2:
            raise self.error_at(key, f"{key} must be [low, high].")
        low, high = (self._bounded(key, item, -math.inf, math.inf) for item in items)
        if low > high:
            raise self.error_at(key, f"{key}: {low:g} is more than {high:g}; write [low, high].")
        return low, high

    def points(self, key: str) -> tuple[tuple[float, float], ...]:
        """Return points in a plane: `[[0, 0], [12, 0], [12, 8]]`."""
        self.require(key)
        found: list[tuple[float, float]] = []
        for node in self._items(key, "[[x, y], …]"):
            if node.id != "sequence" or len(node.value) != 2:
                raise self.error(node, f"each point of {key} must be [x, y].")
            x, y = (self._bounded(key, part, -math.inf, math.inf) for part in node.value)
            found.append((x, y))
        return tuple(found)

    def scalars(self, key: str) -> tuple[Any, ...]:
        """Return one scalar or a list of scalars as a tuple: texts, numbers or booleans."""
        self.has(key)
        node = self._nodes[key]
        return tuple(self._scalar(key, each) for each in (self._items(key) if node.id == "sequence" else [node]))

    def section(self, key: str, what: str = "") -> Section | None:
        """Return the mapping of a key; None without the key."""
        return Section(self._nodes[key], what or key, self.origin) if self.has(key) else None

    def sections(self, key: str, what: str) -> list[Section]:
        """Return the mappings in the list of a key; empty without the key."""
        return [Section(node, what, self.origin) for node in self._items(key, "a list: - …")] if self.has(key) else []

    def named_sections(self, key: str, what: str) -> Mapping[str, Section]:
        """Return the mappings below a key, by name: its value is a mapping of names to mappings."""
        outer = self.section(key)
        return outer.each(what) if outer else {}

    def each(self, what: str) -> Mapping[str, Section]:
        """Return the nested mapping of each key, by key."""
        return {name: Section(self._nodes[name], f"{what} {name}", self.origin) for name in self.all()}

    def all(self) -> Iterator[str]:
        """Iterate over all keys, and mark them as known: names that the user has chosen, or paths of fields."""
        self._asked.update(dict.fromkeys(self._nodes))
        return iter(self._nodes)

    def done(self) -> None:
        """Raise an error for a key that was never requested."""
        for key, node in self._nodes.items():
            if key not in self._asked:
                known = list(self._asked)
                hint = did_you_mean(key, known, f"Known here: {', '.join(known)}.")
                raise self.error(node, f"{key!r} means nothing in {self.what}.", hint)

    def _items(self, key: str, example: str = "a list") -> list[Any]:
        node = self._nodes[key]
        if node.id != "sequence" or not node.value:
            problem = "must not be empty" if node.id == "sequence" else f"must be {example}"
            hint = "Leave it out where there is nothing to say." if node.id == "sequence" else ""
            raise self.error(node, f"{key} {problem}.", hint)
        return node.value

    def _text(self, key: str, node: Any) -> str:
        if node.id != "scalar" or node.tag != f"{_TAG}str":
            raise self.error(node, f"{key} must be a string; put it in quotes.")
        return str(node.value)

    def _flag(self, key: str, node: Any) -> bool:
        text = str(node.value).lower()
        if node.id != "scalar" or node.tag != f"{_TAG}bool" or text not in ("true", "false"):
            # YAML 1.1 reads `yes` and `on` as true, YAML 1.2 as text.
            raise self.error(node, f"{key} must be true or false.")
        return text == "true"

    def _bounded(self, key: str, node: Any, low: float, high: float) -> float:
        value = _number_of(node)
        if value is None:
            raise self.error(node, f"{key} must be a number.")
        if not low <= value <= high:
            within = f"from {low:g} to {high:g}" if math.isfinite(high) else f"{low:g} or more"
            raise self.error(node, f"{key} is {value:g}; it must be {within}.")
        return float(value)

    def _scalar(self, key: str, node: Any) -> Any:
        if node.id == "scalar" and node.tag == f"{_TAG}str":
            return str(node.value)
        if node.id == "scalar" and node.tag == f"{_TAG}bool":
            return self._flag(key, node)
        if (number := _number_of(node)) is not None:
            return number
        raise self.error(node, f"{key} must be a string, a number, true or false.")


def _number_of(node: Any) -> float | None:
    """Return the finite number that a node holds; None if it holds none."""
    text = str(node.value).replace("_", "")
    with suppress(ValueError, OverflowError):  # OverflowError: larger than any float
        if node.id == "scalar" and node.tag in (f"{_TAG}int", f"{_TAG}float"):
            number = int(text, 0) if node.tag == f"{_TAG}int" else float(text)
            return number if math.isfinite(number) else None
    return None
